"""Filters against each other on the same clouds: errors, seconds, and whether the differences are more than chance."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import statistics
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas
from scipy.stats import rankdata, wilcoxon

from ..core.cloud import PointCloud
from ..core.errors import InputError, JaxfilterError, ParameterError, check_choice, check_positive, check_whole, warn
from ..core.filter import Filter, check_resources
from ..core.params import declared
from ..core.result import FilterResult, Progress, silent
from ..core.version import __version__
from ..datasets import Labelled
from ..methods import FILTERS
from ..scoring import evaluate
from ..terrain.accuracy import FIGURES, dtm_rmse
from ..terrain.interpolation import Interpolation
from .best import LARGER_IS_BETTER, SCORES, cost
from .labels import are_labels, ground_labels, named_labels
from .sweep import check_reference, named_clouds

_Tried = Filter | type[Filter] | np.ndarray  # labels are bool[n]
_Given = list[_Tried] | Mapping[str, Any]  # filters of which one is chosen, or labels of each cloud
Column = tuple[str, str, str]
"""Key in a row, heading, and format of the values (as in ``format(value, spec)``; none for text)."""
_COLUMNS: tuple[Column, ...] = (
    ("method", "method", ""),
    ("cloud", "cloud", ""),
    ("points", "points", ",d"),
    ("type1", "T.I", ".2f"),
    ("type2", "T.II", ".2f"),
    ("total", "TE", ".2f"),
    ("kappa", "kappa", ".2f"),
    ("rmse", "RMSE, m", ".3f"),
    ("p95", "95 %, m", ".3f"),
    ("off", "> 0.5 m, %", ".2f"),
    ("off_1m", "> 1 m, %", ".2f"),
    ("border_off_1m", "> 1 m at the border, %", ".2f"),
    ("seconds", "s", ".3f"),
    ("first_seconds", "s, first call", ".3f"),
)
_TIMES = ("seconds", "first_seconds")
_LEVEL = 0.05
"""Of significance, where it is said that there are too few clouds."""
_OPTIONAL = (*SCORES, *FIGURES)  # what takes a reference
SIGNED = ("mean", "border_mean", "inside_mean")
"""Figures of which the one that is nearest to zero is best."""


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """The outcome of :func:`compare`.

    Attributes:
        table: a row per method and cloud: ``method``, ``cloud``, ``points``, ``ground``; ``type1``, ``type2``, ``total`` and
            ``kappa`` in percent, NaN without a reference; the figures of :func:`jaxfilter.dtm_rmse` by the names of ``as_dict``,
            NaN without a terrain model; ``seconds`` of a call, median, and ``first_seconds`` of the first one, compilation
            included; ``status``, and ``parameters``; ``group``. A method that failed has NaN and the error as status. Labels from
            elsewhere have no seconds.
        provenance: ``jaxfilter``, its version; ``clouds``, the digest of each (:meth:`PointCloud.digest`); and the arguments
            ``choose``, ``repeats`` and ``cell``.

    >>> compared = jf.compare({"SMRF": jf.SMRF(), "MSF": jf.MSF()}, {"scene": cloud}, repeats=0)
    >>> compared.table[["method", "cloud"]].values.tolist()
    [['SMRF', 'scene'], ['MSF', 'scene']]
    """

    table: pandas.DataFrame
    provenance: dict[str, Any] = dataclasses.field(default_factory=dict)

    def by_method(self, score: str = "total", by: str = "cloud") -> pandas.DataFrame:
        """One figure, a row per cloud and a column per method; ``by`` = "group": a row per group, the mean of its clouds.

        >>> compared = jf.compare({"SMRF": jf.SMRF(), "MSF": jf.MSF()}, {"scene": cloud}, repeats=0)
        >>> compared.by_method("kappa").columns.tolist()
        ['SMRF', 'MSF']
        """
        check_choice((*_OPTIONAL, *_TIMES), score=score)
        check_choice(("cloud", "group"), by=by)
        wide = self.table.pivot_table(index="cloud", columns="method", values=score, dropna=False, sort=False)
        clouds, methods = (list(dict.fromkeys(self.table[name])) for name in ("cloud", "method"))
        return self._means(wide.reindex(clouds, columns=methods), by)

    def _means(self, wide: pandas.DataFrame, by: str) -> pandas.DataFrame:
        """Rows of clouds as they are, or the means of their groups."""
        return wide if by == "cloud" else wide.groupby(self.table.groupby("cloud")["group"].first(), sort=False).mean()

    def significance(self, score: str = "total", against: str | None = None, *, by: str = "cloud") -> pandas.DataFrame:
        """Every two methods on the clouds that both have a figure for; with ``against``, every other against that one.

        With ``by`` = "group" the means of groups, over these clouds, stand for clouds: clouds of one site are no independent
        witnesses.

        A row has ``method`` and ``other``, the ``clouds``, the means of both (``mean``, ``mean_other``), mean and median of
        ``method`` less ``other`` (``difference``, ``median_difference``), on how many clouds it is ``better`` and ``worse``,
        the size of the ``effect``, ``p`` of Wilcoxon's signed-rank test, two-sided, and ``p_holm``, corrected for the number of
        rows (Holm 1979). The effect is the matched-pairs rank-biserial correlation (Kerby 2014, Comprehensive Psychology 3,
        11.IT.3.1): the share of the ranks for the method less the share against it; 1 = better everywhere, -1 = worse everywhere.
        Mean differences of heights (:data:`SIGNED`) are taken without their sign.

        Raises: ParameterError for a score or a method that is not in the table.
        Warns: if there are so few clouds that p cannot be below 0.05 whatever they say, with the correction or without.

        >>> compared = jf.compare({"SMRF": jf.SMRF(), "MSF": jf.MSF()}, {"scene": cloud}, repeats=0)
        >>> compared.significance("total", against="SMRF")[["method", "other", "clouds"]].values.tolist()
        [['MSF', 'SMRF', 1]]
        """
        names, wide = list(self.by_method(score, by)), self.by_method(score)
        wide = abs(wide) if score in SIGNED else wide
        check_choice((None, *names), against=against)
        pairs = [(a, against) for a in names if a != against] if against else list(itertools.combinations(names, 2))
        found = [
            {"method": one, "other": other}
            | paired(self._means(wide[[other, one]].dropna(), by), larger_is_better=score in LARGER_IS_BETTER)
            for one, other in pairs
        ]
        table = pandas.DataFrame(found)
        if len(table):
            table["p_holm"] = holm(table["p"].tolist())
            most = int(table["clouds"].max())
            needed = next(n for n in range(1, 99) if len(table) * 2.0 ** (1 - n) <= _LEVEL)
            if 0 < most < needed:
                least = 2.0 ** (1 - most)  # of the two-sided test: all differences have one sign
                limits = f"p below {least:.2g}, nor p_holm below {min(1.0, len(table) * least):.2g}"
                advice = f"for {len(table)} comparisons at the level {_LEVEL} at least {needed} {by}s are needed"
                warn(f"significance: {most} {by}s cannot give {limits}, by the exact signed-rank test; {advice}")
        return table

    def markdown(self, score: str | Sequence[str] | None = None) -> str:
        """The table as Markdown, the best in bold. Without a score all rows and figures; with a ``score``, that figure only,
        methods by clouds with their mean; with several, as the literature prints them: a row per cloud, for each method its
        scores side by side, and below the means of groups, if there are any, and of all clouds.

        A mean is absent where a cloud has no figure. Raises: ParameterError for an unknown score.

        >>> compared = jf.compare({"SMRF": jf.SMRF()}, {"scene": cloud}, repeats=0)
        >>> compared.markdown().startswith("| method | cloud"), compared.markdown("total").startswith("| method | scene | mean |")
        (True, True)
        >>> compared.markdown(["type1", "type2", "total", "kappa"]).splitlines()[0]
        '| cloud | SMRF T.I | SMRF T.II | SMRF TE | SMRF kappa |'
        """
        texts, best, align = self._laid_out(score, "–")
        texts = texts.mask(best, "**" + texts + "**")
        texts.columns = [" ".join(title).strip() if isinstance(title, tuple) else title for title in texts]
        columns = [(title, title, side.strip("l")) for title, side in zip(texts, align, strict=True)]
        return markdown(columns, texts.to_dict("records"))  # type: ignore[arg-type]

    def latex(self, score: str | Sequence[str] | None = None) -> str:
        """The same as a LaTeX ``tabular``; needs the package booktabs.

        >>> "tabular" in jf.compare({"SMRF": jf.SMRF()}, {"scene": cloud}, repeats=0).latex("kappa")
        True
        """
        texts, best, align = self._laid_out(score, "--")
        style = texts.style.hide(axis="index").apply(lambda _: np.where(best, "textbf:--rwrap;", ""), axis=None)
        style = style.format(escape="latex").format_index(escape="latex", axis=1)
        text = style.to_latex(hrules=True, column_format="".join(align), multicol_align="c")
        lines = str(text).splitlines(keepends=True)
        if texts.columns.nlevels > 1:  # a rule above the means
            lines.insert(lines.index("\\midrule\n") + 1 + self.table["cloud"].nunique(), "\\midrule\n")
        return "".join(lines)

    def _laid_out(
        self, score: str | Sequence[str] | None, absent: str
    ) -> tuple[pandas.DataFrame, pandas.DataFrame, list[str]]:
        """The texts of a table, bool of those that are best, and "l" or "r" for each column."""
        if score is None:
            columns = self._columns()
            cells = {title: [printed(value, spec, absent) for value in self.table[key]] for key, title, spec in columns}
            texts = pandas.DataFrame(cells)
            return texts, texts != texts, ["r" if spec else "l" for _, _, spec in columns]
        several, known = not isinstance(score, str), {key: (title, spec) for key, title, spec in _COLUMNS}
        found, wins = dict[str, pandas.DataFrame](), dict[str, pandas.DataFrame]()
        for one in score if several else [str(score)]:
            title, spec = known.get(one, (one, ".3f"))
            wide = self.by_method(one)
            under = [wide.mean(skipna=False).to_frame("mean").T]
            if several and self.table["group"].nunique() < len(wide):
                grouped = wide.groupby(self.table.groupby("cloud")["group"].first(), sort=False)
                under.insert(0, grouped.agg(lambda of: of.mean(skipna=False)).rename("mean, {}".format))
            wide = pandas.concat([wide, *under])
            sizes = abs(wide) if one in SIGNED else wide
            best = sizes.max(axis=1) if one in LARGER_IS_BETTER else sizes.min(axis=1)
            shown, found[title] = (frame.map(printed, spec=spec, absent=absent) for frame in (sizes, wide))
            equal = shown.eq(best.map(lambda value, spec=spec: printed(value, spec, absent)), axis=0)
            wins[title] = equal & wide.notna() & (wide.shape[1] > 1)
        if several:
            both = pandas.MultiIndex.from_product([wide.columns, found])
            texts, best = (pandas.concat(of, axis=1).swaplevel(axis=1).reindex(columns=both) for of in (found, wins))
        else:
            texts, best = found[title].T, wins[title].T
        for frame, first in ((texts, texts.index), (best, False)):
            frame.insert(0, ("", "cloud") if several else "method", first)
        return texts, best, ["l", *"r" * (texts.shape[1] - 1)]

    def _columns(self) -> list[Column]:
        """Scores only where there are any."""
        return [one for one in _COLUMNS if one[0] not in _OPTIONAL or self.table[one[0]].notna().any()]

    def __repr__(self) -> str:
        return self.table[[key for key, _, _ in self._columns()]].to_string(index=False, float_format="%.3f")


def markdown(columns: Sequence[Column], rows: Iterable[Mapping[str, Any]]) -> str:
    """A Markdown table. Values that are absent, None or NaN are shown as a dash; numbers are set to the right."""
    titles, rule = [title for _, title, _ in columns], ["---:" if spec else "---" for _, _, spec in columns]
    lines = [[printed(row.get(key), spec) for key, _, spec in columns] for row in rows]
    texts = ([text.replace("|", r"\|") for text in line] for line in (titles, *lines))
    heading, *body = (f"| {' | '.join(line)} |" for line in texts)
    return "\n".join([heading, f"|{'|'.join(rule)}|", *body])


def printed(value: Any, spec: str, absent: str = "–") -> str:
    """A value as it is printed."""
    if value is None or value == "" or (isinstance(value, float) and math.isnan(value)):
        return absent
    return value if isinstance(value, str) else format(value, spec)


def compare(
    filters: Any,
    clouds: Any,
    *,
    groups: Mapping[str, Any] | None = None,
    choose: str = "total",
    repeats: int = 1,
    cell: float | None = 1.0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Classify every cloud with every filter, score against the clouds' references, and time.

    Args:
        filters: a list, or a mapping from names. Filters are taken as they are; classes and names ("smrf") stand for
            ``for_cloud(cloud)`` of the method. In a list filters are named by what differs from the defaults. A value of a
            mapping may be a list, such as presets: each group of clouds is filtered with the one of them that is best in the
            mean of the clouds of the *other* groups. So no parameter is chosen on labels that it is scored on.
            A value of a mapping may also be labels from elsewhere, such as those of a network or another program: those of one
            cloud, a list like the clouds, or a mapping from names of clouds. Labels of a cloud are an array [n] in the order of
            its points: True or 1 = ground, False or 0 = object, and of scores between those of 0.5 and more are ground; or a
            FilterResult; or the same points with labels or class 2 = ground in any order, as a PointCloud or a file that
            :func:`jaxfilter.read` takes (in text ISPRS's 0 = ground); or a file ``.npy`` of an array, or ``.npz`` by
            :meth:`FilterResult.save`. All are scored as filters are: on all points of the cloud with a reference.
        clouds: one, a list, or a mapping from names, as for :func:`jaxfilter.sweep`.
        groups: name of each cloud (of a list its number) to its group, such as the site; by default each cloud is a group.
        choose: the score by which filters of a list are chosen.
        repeats: timed calls after the first one, whose median counts; 0 leaves the first one's time only.
        cell: side, in metres, of the cells on which terrain models are compared with that of the reference; outside of its hull
            a model is as high as at its nearest ground point. None: no terrain models.
        workers: threads for triangulation; by default one per core.
        progress: called with the fraction done and what is being done.

    Returns: Comparison.
    Raises: ParameterError for filters that are none or have one name, and InputError for reference labels of one class only, and
        for labels that do not fit their cloud, before anything runs.

    >>> compared = jf.compare(["smrf", jf.MSF(slope=0.3)], cloud, repeats=0)
    >>> bool(compared.table.total.max() < 30)
    True
    >>> theirs = jf.compare({"theirs": truth, "SMRF": "smrf"}, cloud, repeats=0)
    >>> theirs.by_method("total")["theirs"].tolist()
    [0.0]
    """
    check_choice(SCORES, choose=choose)
    check_resources(workers)
    check_positive(" of metres, or None", cell=cell)
    check_whole(0, repeats=repeats)
    of_name = clouds if isinstance(clouds, Labelled) else named_clouds(clouds, "compare")[1]
    named = _named_filters(filters, of_name)
    given = {str(name): str(its) for name, its in (groups or {}).items()}
    group = {name: given.get(name, name) for name in of_name}
    if strange := set(given) - set(of_name):
        raise ParameterError(f"groups: there is no cloud {min(strange)!r}; there are {', '.join(of_name)}")
    if len(set(group.values())) < 2 and any(len(some) > 1 for some in named.values() if isinstance(some, list)):
        raise ParameterError("filters: one of a list is chosen on other groups of clouds; there is one group only")
    digests = dict[str, str]()
    for place in of_name:
        cloud = of_name[place]
        check_reference(place, cloud, "compare")
        for name, some in named.items():
            _on(some, name, place, cloud)
        digests[place] = cloud.digest()
    found, report = {}, progress or silent
    for done, place in enumerate(of_name):
        cloud = of_name[place]
        for part, (name, some) in enumerate(named.items()):
            report((done + part / len(named)) / len(of_name), f"{place}, {name}")
            facts = {"method": name, "cloud": place, "points": len(cloud)}
            end = {"group": group[place]}
            tries = _on(some, name, place, cloud)
            found[name, place] = [facts | _row(one, cloud, repeats, cell, workers) | end for one in tries]
    report(1.0, "done")
    rows = []
    for name, place in itertools.product(named, of_name):
        tried, best = found[name, place], 0
        if len(tried) > 1:
            others = [found[name, other] for other in of_name if group[other] != group[place]]
            costs = np.array([[cost(row[choose], choose) for row in other] for other in others])
            costs = costs[~np.isnan(costs).all(axis=1)]  # the others have no reference
            if not len(costs):
                raise InputError(f"compare: no cloud outside group {group[place]} has a reference to choose {name} by")
            best = int(np.argmin(np.nan_to_num(costs, nan=np.inf).mean(axis=0)))
        rows.append(tried[best])
    provenance = {"jaxfilter": __version__, "choose": choose, "repeats": repeats, "cell": cell, "clouds": digests}
    return Comparison(pandas.DataFrame(rows), provenance)


def timed(
    filter_: Filter, cloud: PointCloud, repeats: int, workers: int | None = None
) -> tuple[FilterResult, float, float]:
    """The result, the seconds of a first call, and the median seconds of ``repeats`` calls after it; without any, the first."""
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        result = filter_(cloud, workers=workers)
        seconds.append(time.perf_counter() - start)
    return result, seconds[0], statistics.median(seconds[1:] or seconds)


def paired(pairs: Any, *, larger_is_better: bool = False) -> dict[str, Any]:
    """A method against another over the same clouds.

    Args:
        pairs: f64[n, 2]: a figure of the other, and of the method.
        larger_is_better: False for errors and seconds, True for kappa.

    Returns: ``clouds``; ``mean``, ``mean_other``; ``difference`` and ``median_difference`` of method less other; ``better`` and
        ``worse``, numbers of clouds; ``effect``, the matched-pairs rank-biserial correlation, and ``p`` of Wilcoxon's signed-rank
        test, two-sided, 0 and 1 where nothing differs. Figures of no clouds are NaN.
    """
    other, own = np.asarray(pairs, np.float64).reshape(-1, 2).T
    gain = np.round(own - other if larger_is_better else other - own, 9)  # so that equal ones are equal
    better, worse = int((gain > 0).sum()), int((gain < 0).sum())
    figures = dict.fromkeys(("mean", "mean_other", "difference", "median_difference"), math.nan)
    effect = p = math.nan
    if len(own):
        means = own.mean(), other.mean(), (own - other).mean(), np.median(own - other)
        figures = dict(zip(figures, map(float, means), strict=True))
        rank = rankdata(np.abs(gain[gain != 0]))
        effect = float(rank @ np.sign(gain[gain != 0]) / rank.sum()) if better + worse else 0.0
        p = float(wilcoxon(gain).pvalue) if better + worse else 1.0
    return {"clouds": len(own), **figures, "better": better, "worse": worse, "effect": effect, "p": p}


def holm(p: Sequence[float]) -> list[float]:
    """p-values of several tests corrected by Holm's step-down procedure (Scand. J. Stat. 6, 65-70, 1979); NaN stays."""
    given = np.asarray(p, np.float64)
    order = np.argsort(given)  # NaN last
    steps = np.count_nonzero(~np.isnan(given)) - np.arange(len(given))
    out = np.empty(len(given))
    out[order] = np.minimum(np.maximum.accumulate(steps * given[order]), 1.0)
    return out.tolist()


def _on(some: _Given, name: str, place: str, cloud: PointCloud) -> list[_Tried]:
    """What is scored on a cloud. Raises: InputError for labels that do not fit it."""
    return some if isinstance(some, list) else [ground_labels(some[place], cloud, f"compare: {name} on {place}")]


def _row(one: _Tried, cloud: PointCloud, repeats: int, cell: float | None, workers: int | None) -> dict[str, Any]:
    """Figures of a filter, of the method ``for_cloud``, or of labels, on a cloud."""
    row: dict[str, Any] = dict.fromkeys(("ground", *_OPTIONAL, *_TIMES), math.nan)
    try:
        if isinstance(one, np.ndarray):
            parameters, (result, first, seconds) = "labels", (FilterResult.of_labels(one), math.nan, math.nan)
        else:
            filter_ = one.for_cloud(cloud) if isinstance(one, type) else one
            parameters, (result, first, seconds) = repr(filter_), timed(filter_, cloud, repeats, workers)
    except JaxfilterError as error:
        return row | {"status": f"{type(error).__name__}: {error}", "parameters": repr(one)}
    row |= {"ground": int(result.ground.sum()), "seconds": seconds, "first_seconds": first}
    if cloud.reference is not None:
        scores = evaluate(result, cloud)
        row |= {name: getattr(scores, name) for name in SCORES}
        if cell is not None:
            with contextlib.suppress(InputError):  # too few ground points for a model
                errors = dtm_rmse(cloud, result, cell=cell / cloud.units.xy, interpolation=Interpolation(fill=True))
                row |= errors.as_dict()
    return row | {"status": result.status.name, "parameters": parameters}


def _named_filters(filters: Any, clouds: Iterable[str]) -> dict[str, _Given]:
    """Filters and methods by name, several where one is to be chosen; of labels those of each cloud. Raises: ParameterError;
    InputError for labels of other clouds."""
    if isinstance(filters, Mapping):
        pairs = [(str(name), some) for name, some in filters.items()]
    else:
        several = isinstance(filters, Iterable) and not isinstance(filters, str)
        pairs = [(_label(one), one) for one in map(_known, filters if several else [filters])]
    if not pairs:
        raise ParameterError("filters: there is none; pass filters, classes of filters or their names")
    out: dict[str, _Given] = {}
    for name, value in pairs:
        some = list(value) if isinstance(value, (list, tuple)) else [value]
        if not some:
            raise ParameterError(f"filters: the list of {name} is empty")
        if name in out:
            raise ParameterError(f"filters: there are two of the name {name}: pass a mapping from names of your own")
        labels = [isinstance(value, Mapping) or are_labels(one) for one in some]
        if any(labels) and not all(labels):
            raise ParameterError(f"filters: the list of {name} has filters and labels: give them names of their own")
        if labels[0]:
            out[name] = named_labels(value if isinstance(value, Mapping) else some, True, clouds, f"compare: {name}")
        else:
            out[name] = [_known(one) for one in some]
    return out


def _known(one: Any) -> Filter | type[Filter]:
    if isinstance(one, str) and one in FILTERS:
        one = FILTERS[one]
    if isinstance(one, Filter) or (isinstance(one, type) and issubclass(one, Filter)):
        return one
    if are_labels(one):
        raise ParameterError("filters: labels need a name: pass a mapping, such as {'theirs': labels, 'SMRF': 'smrf'}")
    raise ParameterError(f"filters: {one!r} is no filter; choose from {', '.join(FILTERS)}")


def _label(filter_: Filter | type[Filter]) -> str:
    """The class, and the fields that are not as by default."""
    if isinstance(filter_, type):
        return filter_.__name__
    changed = [f.name for f in declared(filter_) if getattr(filter_, f.name) != f.default]
    fields = ", ".join(f"{name}={getattr(filter_, name)}" for name in changed)
    return type(filter_).__name__ + (f"({fields})" if fields else "")
