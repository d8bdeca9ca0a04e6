"""Filters against each other on the same clouds: errors, seconds, and whether the differences are more than chance."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import statistics
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, JaxfilterError, ParameterError
from ..core.filter import Filter, check_resources
from ..core.params import declared
from ..core.result import FilterResult, Progress, silent
from ..methods import FILTERS
from ..scoring import evaluate
from ..terrain.accuracy import FIGURES, dtm_rmse
from ..terrain.interpolation import Interpolation
from .best import SCORES
from .sweep import check_reference, named_clouds
from .tables import Column, latex, markdown

if TYPE_CHECKING:
    import pandas

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
_OPTIONAL = (*SCORES, *FIGURES)  # what takes a reference


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """The outcome of :func:`compare`.

    Attributes:
        table: a row per method and cloud: ``method``, ``cloud``, ``points``, ``ground``; ``type1``, ``type2``, ``total`` and
            ``kappa`` in percent, NaN without a reference; the figures of :func:`jaxfilter.dtm_rmse` by the names of ``as_dict``,
            NaN without a terrain model; ``seconds`` of a call, median, and ``first_seconds`` of the first one, compilation
            included; ``status``, and ``parameters``. A method that failed has NaN and the error as status.

    >>> compared = jf.compare({"SMRF": jf.SMRF(), "MSF": jf.MSF()}, {"scene": cloud}, repeats=0)
    >>> compared.table[["method", "cloud"]].values.tolist()
    [['SMRF', 'scene'], ['MSF', 'scene']]
    """

    table: pandas.DataFrame

    def by_method(self, score: str = "total") -> pandas.DataFrame:
        """One figure, a row per cloud and a column per method.

        >>> compared = jf.compare({"SMRF": jf.SMRF(), "MSF": jf.MSF()}, {"scene": cloud}, repeats=0)
        >>> compared.by_method("kappa").columns.tolist()
        ['SMRF', 'MSF']
        """
        if score not in (known := (*_OPTIONAL, *_TIMES)):
            raise ParameterError(f"score={score!r}: choose one of {', '.join(known)}")
        wide = self.table.pivot(index="cloud", columns="method", values=score)
        return wide.loc[list(dict.fromkeys(self.table["cloud"])), list(dict.fromkeys(self.table["method"]))]

    def significance(self, score: str = "total", against: str | None = None) -> pandas.DataFrame:
        """Every two methods on the clouds that both have a figure for; with ``against``, every other against that one.

        A row has ``method`` and ``other``, the ``clouds``, the means of both (``mean``, ``mean_other``), mean and median of
        ``method`` less ``other`` (``difference``, ``median_difference``), on how many clouds it is ``better`` and ``worse``,
        ``p`` of Wilcoxon's signed-rank test, two-sided, and ``p_holm``, corrected for the number of rows (Holm 1979).

        Raises: ParameterError for a score or a method that is not in the table.

        >>> compared = jf.compare({"SMRF": jf.SMRF(), "MSF": jf.MSF()}, {"scene": cloud}, repeats=0)
        >>> compared.significance("total", against="SMRF")[["method", "other", "clouds"]].values.tolist()
        [['MSF', 'SMRF', 1]]
        """
        import pandas

        wide = self.by_method(score)
        names = list(wide.columns)
        if against is not None and against not in names:
            raise ParameterError(f"against={against!r}: choose one of {', '.join(names)}")
        pairs = [(a, against) for a in names if a != against] if against else list(itertools.combinations(names, 2))
        rows = []
        for one, other in pairs:
            both = wide[[other, one]].dropna()
            found = paired(both.to_numpy(), larger_is_better=score == "kappa")
            rows.append({"method": one, "other": other, **found})
        table = pandas.DataFrame(rows)
        if len(table):
            table["p_holm"] = holm(table["p"].tolist())
        return table

    def markdown(self) -> str:
        """The table as Markdown.

        >>> jf.compare({"SMRF": jf.SMRF()}, {"scene": cloud}, repeats=0).markdown().startswith("| method")
        True
        """
        return markdown(self._columns(), self.table.to_dict("records"))  # type: ignore[arg-type]

    def latex(self) -> str:
        """The table as a LaTeX ``tabular``; needs the package booktabs.

        >>> "tabular" in jf.compare({"SMRF": jf.SMRF()}, {"scene": cloud}, repeats=0).latex()
        True
        """
        return latex(self._columns(), self.table.to_dict("records"))  # type: ignore[arg-type]

    def _columns(self) -> list[Column]:
        """Scores only where there are any."""
        return [one for one in _COLUMNS if one[0] not in _OPTIONAL or self.table[one[0]].notna().any()]

    def __str__(self) -> str:
        return self._shown().to_string(index=False, float_format="%.3f")

    def _repr_html_(self) -> str:
        return self._shown().to_html(index=False, float_format="%.3f")

    def _shown(self) -> pandas.DataFrame:
        return self.table[[key for key, _, _ in self._columns()]]


def compare(
    filters: Any,
    clouds: Any,
    *,
    repeats: int = 1,
    cell: float | None = 1.0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Classify every cloud with every filter, score against the clouds' references, and time.

    Args:
        filters: a list, or a mapping from names. Filters are taken as they are; classes and names ("smrf") stand for
            ``for_cloud(cloud)`` of the method. In a list filters are named by what differs from the defaults.
        clouds: one, a list, or a mapping from names, as for :func:`jaxfilter.sweep`.
        repeats: timed calls after the first one, whose median counts; 0 leaves the first one's time only.
        cell: side, in metres, of the cells on which terrain models are compared with that of the reference; outside of its hull
            a model is as high as at its nearest ground point. None: no terrain models.
        workers: threads for triangulation; by default one per core.
        progress: called with the fraction done and what is being done.

    Returns: Comparison.
    Raises: ParameterError for filters that are none or have one name, and InputError for reference labels of one class only,
        before anything runs.

    >>> compared = jf.compare(["smrf", jf.MSF(slope=0.3)], cloud, repeats=0)
    >>> bool(compared.table.total.max() < 30)
    True
    """
    import pandas

    named = _named_filters(filters)
    check_resources(workers)
    if cell is not None and not 0 < cell < math.inf:
        raise ParameterError(f"cell={cell!r}: a positive number of metres is needed, or None")
    if isinstance(repeats, bool) or not isinstance(repeats, int) or repeats < 0:
        raise ParameterError(f"repeats={repeats!r}: a whole number from 0 on is needed")
    of_name = named_clouds(clouds, "compare")[1]
    for name, cloud in of_name.items():
        check_reference(name, cloud, "compare")
    rows, report = [], progress or silent
    for done, ((name, one), (place, cloud)) in enumerate(itertools.product(named.items(), of_name.items())):
        report(done / (len(named) * len(of_name)), f"{name}, {place}")
        rows.append({"method": name, "cloud": place, "points": len(cloud), **_row(one, cloud, repeats, cell, workers)})
    report(1.0, "done")
    return Comparison(pandas.DataFrame(rows))


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
        ``worse``, numbers of clouds; ``p`` of Wilcoxon's signed-rank test, two-sided, 1 where nothing differs. Figures of no
        clouds are NaN.
    """
    from scipy.stats import wilcoxon

    other, own = np.asarray(pairs, np.float64).reshape(-1, 2).T
    gain = own - other if larger_is_better else other - own
    better, worse = int((gain > 0).sum()), int((gain < 0).sum())
    figures = dict.fromkeys(("mean", "mean_other", "difference", "median_difference", "p"), math.nan)
    if len(own):
        means = own.mean(), other.mean(), (own - other).mean(), np.median(own - other)
        figures = dict(zip(figures, map(float, means), strict=False))
        figures["p"] = float(wilcoxon(gain).pvalue) if better + worse else 1.0
    p = figures.pop("p")
    return {"clouds": len(own), **figures, "better": better, "worse": worse, "p": p}


def holm(p: Sequence[float]) -> list[float]:
    """p-values of several tests corrected by Holm's step-down procedure (Scand. J. Stat. 6, 65-70, 1979); NaN stays."""
    known = sorted((value, i) for i, value in enumerate(p) if not math.isnan(value))
    out, largest = [math.nan] * len(p), 0.0
    for rank, (value, i) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        out[i] = largest
    return out


def _row(
    one: Filter | type[Filter], cloud: PointCloud, repeats: int, cell: float | None, workers: int | None
) -> dict[str, Any]:
    """Figures of a filter, or of the method ``for_cloud``, on a cloud."""
    row: dict[str, Any] = dict.fromkeys(("ground", *_OPTIONAL, *_TIMES), math.nan)
    try:
        filter_ = one.for_cloud(cloud) if isinstance(one, type) else one
        result, first, seconds = timed(filter_, cloud, repeats, workers)
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
    return row | {"status": result.status.name, "parameters": repr(filter_)}


def _named_filters(filters: Any) -> dict[str, Filter | type[Filter]]:
    """Filters and methods by name. Raises ParameterError."""
    if isinstance(filters, Mapping):
        out = {str(name): _known(one) for name, one in filters.items()}
    else:
        several = isinstance(filters, Iterable) and not isinstance(filters, str)
        out = {}
        for one in map(_known, filters if several else [filters]):
            name = one.__name__ if isinstance(one, type) else _label(one)
            if name in out:
                raise ParameterError(
                    f"filters: there are two of the name {name}: pass a mapping from names of your own"
                )
            out[name] = one
    if not out:
        raise ParameterError("filters: there is none; pass filters, classes of filters or their names")
    return out


def _known(one: Any) -> Filter | type[Filter]:
    if isinstance(one, str) and one in FILTERS:
        one = FILTERS[one]
    if isinstance(one, Filter) or (isinstance(one, type) and issubclass(one, Filter)):
        return one
    raise ParameterError(f"filters: {one!r} is no filter; choose from {', '.join(FILTERS)}")


def _label(filter_: Filter) -> str:
    """The class, and the fields that are not as by default."""
    changed = [f.name for f in declared(filter_) if getattr(filter_, f.name) != f.default]
    fields = ", ".join(f"{name}={getattr(filter_, name)}" for name in changed)
    return type(filter_).__name__ + (f"({fields})" if fields else "")
