"""The parameters that suit a cloud, from a few labelled points."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import xarray
from scipy.spatial import cKDTree

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import InputError, ParameterError, check_choice, check_positive, check_whole, warn
from ..core.filter import Filter, group_equal
from ..core.params import declared, is_number
from ..core.result import Progress, silent
from ..core.version import __version__
from ..scoring import Scores, reference_labels
from .best import SCORE_NAMES, word
from .design import MAX_SETS, make_design, sobol
from .inference import Sample
from .ranges import Range, around, check_filter, fields_of, search_ranges
from .sweep import Subject, SweepOptions, about

DECIDING_SCORES = ("total", "kappa")
"""What is minimised, or maximised: the total error, or kappa, in percent."""
_NEIGHBOURS = 8
"""Sets near a set whose scores count with its own when the best is chosen."""


@dataclasses.dataclass(frozen=True, eq=False)
class Calibration:
    """The outcome of :func:`calibrate`.

    Attributes:
        filter: the filter with the best parameters; call it on the cloud.
        score: cross-validated total error or kappa, percent: every block scored with the set that the others would have
            chosen, of those that were tried (where later rounds look is decided with all labels).
        spread: standard deviation of that score over the folds, percent; for kappa over those with both classes.
        before: the score of the filter as it was given, on the same labelled points.
        trials: the sets that were tried, in order, over the dimension ``set``: coordinates are the fields, variables
            ``total`` and ``kappa`` on all labelled points, ``confusion`` per fold, and ``expected``, which decided: the
            score to expect on the whole cloud (:meth:`Study.expected`).
        searched: the fields that differ between them.

    >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)
    >>> found = jf.calibrate(
    ...     jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)}, size=4, rounds=1, folds=2, block=10.0)
    >>> found.searched, found.trials.sizes["set"], 0 <= found.score <= 100
    (('threshold',), 4, True)
    """

    filter: Filter
    score: float
    spread: float
    before: float
    trials: xarray.Dataset
    searched: tuple[str, ...]

    def __repr__(self) -> str:
        name = SCORE_NAMES[self.trials.attrs["score"]]
        changed = ", ".join(f"{field}={word(getattr(self.filter, field))}" for field in self.searched)
        scores = f"{name} {self.score:.2f} +- {self.spread:.2f} %, cross-validated; {self.before:.2f} % before"
        return f"{type(self.filter).__name__}({changed}): {scores}; {self.trials.sizes['set']} sets tried"


@dataclasses.dataclass(frozen=True)
class CrossValidation:
    """How labelled points are cut into parts that are held out in turn.

    Attributes:
        folds: number of parts, each of whole blocks.
        block: side of the square blocks, metres; by default as large as leaves two blocks for each fold.

    Raises: ParameterError for fewer than 2 folds, and for blocks without a size.

    >>> jf.CrossValidation(folds=2, block=10.0).folds
    2
    """

    folds: int = 5
    block: float | None = None

    def __post_init__(self) -> None:
        check_whole(2, folds=self.folds)
        check_positive(" of metres", block=self.block)

    def assign(self, xyz: np.ndarray) -> np.ndarray:
        """i64[n]: the fold of each point f[n, >=2], metres; all folds are about as large. Raises: InputError for one block.

        >>> np.unique(jf.CrossValidation(folds=2, block=10.0).assign(cloud.xyz)).tolist()
        [0, 1]
        """

        def blocks(side: float) -> np.ndarray:
            cell = np.floor(xyz[:, :2].astype(np.float64) / side).astype(np.int64)
            return np.unique(cell, axis=0, return_inverse=True)[1].ravel()

        side = self.block or max(float(np.ptp(xyz[:, :2], axis=0).max()), 1.0)
        while self.block is None and blocks(side).max() + 1 < 2 * self.folds and side > 1.0:
            side /= 2
        owner = blocks(side)
        count = np.bincount(owner)
        if len(count) < 2:
            raise InputError("labels: all of them lie in one block; label points in several places, or pass block=")
        fold_of, full = np.zeros(len(count), np.int64), np.zeros(min(self.folds, len(count)))
        for number in np.argsort(-count, kind="stable"):  # the largest first, each to the fold that has least
            fold_of[number] = int(np.argmin(full))
            full[fold_of[number]] += count[number]
        return fold_of[owner]


class Study:
    """Labelled points of a cloud, which sets of parameters are scored against, many at a time.

    It is what :func:`calibrate` searches with. Another optimiser drives it in batches: ask it for some sets, ``evaluate``
    them together, tell it the scores. ``result`` chooses among all sets that were evaluated.

    Args:
        filter_: fields that are not searched stay as they are.
        cloud: the cloud that the filter sees, all of it.
        labels: integers [n], 1 = ground, 0 = object, -1 = unlabelled; or bool[n], if all are known.
        axes: field name to (low, high), or to a :class:`Range`; by default those of
            :func:`jaxfilter.sweeps.ranges.search_ranges`.
        score: one of :data:`DECIDING_SCORES`.
        validation: how the labelled points are cut into folds.
        options: how sets are computed.

    Raises: InputError for labels of the wrong length or of one class only; ParameterError for the other arguments.

    >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)
    >>> study = jf.Study(jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)})
    >>> study.evaluate([{"threshold": 0.3}, {"threshold": 0.5}]).shape
    (2,)
    >>> 0.2 <= study.result().filter.threshold <= 1.0
    True
    """

    def __init__(
        self,
        filter_: Filter,
        cloud: Any,
        labels: Any,
        *,
        axes: Mapping[str, Any] | None = None,
        score: str = "total",
        validation: CrossValidation = CrossValidation(),
        options: SweepOptions = SweepOptions(),
    ) -> None:
        filter_ = check_filter(filter_)
        check_choice(DECIDING_SCORES, score=score)
        self.filter, self.score = filter_, score
        cloud = as_cloud(cloud)
        self.ranges = _ranges_of(filter_, axes)
        truth, known = _known_labels(cloud, labels)
        for name, kind in (("ground", truth), ("object", ~truth)):
            if not (known & kind).any():
                raise InputError(f"labels: no point is labelled {name}; both classes are needed")
        if not (known & cloud.candidate).any():
            raise InputError("labels: all labelled points are set aside before filtering (no last echoes, or noise)")
        self.subject = Subject(filter_, cloud, options)
        points = self.subject.points
        if self.subject.same is not None:
            warn(f"{type(filter_).__name__}: {self.subject.same.status.message}")
        fold = validation.assign(cloud.xyz[known])
        self.folds = int(fold.max()) + 1
        self.truth, self.fold = truth[known], fold
        self.cell = (2 * fold + ~self.truth) * 2 + 1  # of the table fold by reference by label, for objects
        row = np.full(len(cloud), len(points))  # one more row: points that are set aside, never ground
        row[points.index] = points.member
        self.row = row[known]
        self.sample = Sample.of(cloud.xyz, known, self.truth, fold, points.spacing())
        self.sets: list[dict[str, Any]] = []
        self.confusion = np.zeros((0, self.folds, 2, 2), np.int64)
        self.row_of_sample = row[self.sample.index]
        self.bits = np.zeros((0, (len(self.row_of_sample) + 7) // 8), np.uint8)

    def evaluate(self, sets: Sequence[Mapping[str, Any]], progress: Progress | None = None) -> np.ndarray:
        """f64[s], percent: the score of every set on all labelled points. Sets are kept for :meth:`result`.

        What decides there is not this but :meth:`expected`. Points that are set aside before filtering count as called objects.
        Raises: ParameterError naming a field that does not exist or a value out of range.

        >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)
        >>> study = jf.Study(jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)})
        >>> scores = study.evaluate([{"threshold": 0.3}, {"threshold": 0.5}])
        >>> bool(((scores >= 0) & (scores <= 100)).all())
        True
        """
        report = progress or silent
        if isinstance(sets, Mapping):
            raise ParameterError(f"sets={sets!r}: give a list of mappings from field to value")
        if len(sets) == 0:
            return np.zeros(0)
        names = list(sets[0])
        for one in sets:
            if set(one) != set(names):
                raise ParameterError(f"sets: all need the same fields; one has {sorted(one)}, another {sorted(names)}")
        plan = make_design(self.filter, {name: [one[name] for one in sets] for name in names}, "list")
        found = np.zeros((len(sets), self.folds, 2, 2), np.int64)
        bits = np.zeros((len(sets), self.bits.shape[1]), np.uint8)
        each = (one for group in plan.groups for one in self.subject.ground_each(plan.filters, group))
        for done, (number, ground) in enumerate(each, 1):
            called = np.append(ground, False)
            found[number] = self._counts(called)
            if plan.filters[number] == self.filter:
                self._given = ground
            bits[number] = np.packbits(called[self.row_of_sample])
            report(done / len(sets), f"{len(sets)} sets")
        self.sets += plan.sets
        self.confusion = np.concatenate([self.confusion, found])
        self.bits = np.concatenate([self.bits, bits])
        return self._of(found.sum(axis=1))

    def _counts(self, called: np.ndarray) -> np.ndarray:
        """i64[folds, 2, 2] of labels bool[m + 1]."""
        return np.bincount(self.cell - called[self.row], minlength=4 * self.folds).reshape(self.folds, 2, 2)

    def _of(self, confusion: np.ndarray) -> np.ndarray:
        """f64[...]: the score of counts [..., 2, 2]; those to expect are no whole numbers."""
        (a, b), (c, d) = np.moveaxis(confusion.astype(np.float64), (-2, -1), (0, 1))
        n = a + b + c + d
        with np.errstate(invalid="ignore"):
            if self.score == "total":
                return 100 * (b + c) / n
            by_chance = (a + b) * (a + c) + (c + d) * (b + d)
            return 100 * (n * (a + d) - by_chance) / (n * n - by_chance)

    def expected(self, without: Sequence[int] = (-1,)) -> np.ndarray:
        """f64[v, s], percent: the score of each set to expect on the whole cloud.

        Labels count as they are; of the other points, see :mod:`jaxfilter.sweeps.inference`. If there are more than sixteen
        sets, the score is a mean over each set and the seven most like it, so that luck counts less.

        Args:
            without: per view the fold whose labels are left out; -1 for none.

        >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)
        >>> study = jf.Study(jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)})
        >>> _ = study.evaluate([{"threshold": 0.3}, {"threshold": 0.5}])
        >>> study.expected().shape
        (1, 2)
        """
        if not self.sets:
            raise ParameterError("Study: no set has been evaluated")
        counts = self.sample.expected(self.bits, np.append(self._given, False)[self.row_of_sample], without)
        whole = self.confusion.sum(axis=1)
        for view, fold in enumerate(without):
            counts[view] += whole if fold < 0 else whole - self.confusion[:, fold]
        scores = self._of(counts)
        for kind, place in self._places():
            distinct, first, which = np.unique(place, axis=0, return_index=True, return_inverse=True)
            if len(distinct) > 2 * _NEIGHBOURS:
                near = cKDTree(distinct).query(distinct, _NEIGHBOURS)[1]
                scores[:, kind] = scores[:, kind[first[near]]].mean(axis=2)[:, which.ravel()]
        return scores

    def _places(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Sets that agree in all fields that are no numbers, i64[k], and where they lie, f64[k, fields]."""
        tried = self._tried()
        rows = zip(*tried.values(), strict=True)
        for kind in group_equal(tuple("number" if is_number(v) else v for v in row) for row in rows):
            columns = [np.zeros(len(kind))]
            for name, values in tried.items():
                column = [values[number] for number in kind]
                if not is_number(column[0]):
                    continue
                finite = [v for v in column if math.isfinite(v)]
                r = self.ranges.get(name)
                if r is None and finite and min(finite) < max(finite):
                    r = Range(min(finite), max(finite))
                columns.append(np.array([r.position(v) if r else float(math.isfinite(v)) for v in column]))
            yield np.array(kind), np.column_stack(columns)

    def _tried(self) -> dict[str, list[Any]]:
        """The value of each field in every set, the given filter's where a set does not name the field."""
        names = dict.fromkeys(name for one in self.sets for name in one)
        return {name: [one.get(name, getattr(self.filter, name)) for one in self.sets] for name in names}

    def best(self, expected: np.ndarray) -> np.ndarray:
        """i64[...]: numbers of the best sets by scores f64[..., s], percent; of equal ones the first.

        >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)
        >>> study = jf.Study(jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)})
        >>> _ = study.evaluate([{"threshold": 0.3}, {"threshold": 0.5}])
        >>> study.best(np.array([[4.0, 2.5]])).tolist()
        [1]
        """
        cost = expected if self.score == "total" else -expected
        return np.argmin(np.where(np.isnan(cost), np.inf, cost), axis=-1)

    def result(self) -> Calibration:
        """The best of the sets evaluated so far. Raises: ParameterError if there are none.

        >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)
        >>> study = jf.Study(jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)})
        >>> _ = study.evaluate([{"threshold": 0.3}, {"threshold": 0.5}])
        >>> study.result().filter.threshold in (0.3, 0.5)
        True
        """
        whole = self.confusion.sum(axis=1)
        views = self.expected([-1, *range(self.folds)])  # raises if there is no set
        chosen = self.best(views)
        held_out = self.confusion[chosen[1:], np.arange(self.folds)]
        both = (held_out.sum(axis=2) > 0).all(axis=1) | (self.score == "total")
        columns, fields = self._tried(), {f.name: f for f in declared(self.filter)}
        scores = [Scores.from_confusion(counts) for counts in whole]
        trials = xarray.Dataset(
            {
                "total": ("set", [s.total for s in scores]),
                "kappa": ("set", [s.kappa for s in scores]),
                "expected": ("set", views[0]),
                "confusion": (("set", "fold", "reference", "labelled"), self.confusion),
            },
            {"set": np.arange(len(self.sets))}
            | {name: ("set", values, about(fields[name])) for name, values in columns.items()},
            {"method": type(self.filter).__name__, "score": self.score}
            | {"jaxfilter": __version__, "cloud": self.subject.points.cloud.digest()},
        )
        return Calibration(
            filter=self.filter.replace(**self.sets[chosen[0]]),
            score=float(self._of(held_out.sum(axis=0))),
            spread=float(np.nanstd(np.where(both, self._of(held_out), np.nan))) if both.any() else math.nan,
            before=float(self._of(self._counts(np.append(self._given, False)).sum(axis=0))),
            trials=trials,
            searched=tuple(columns),
        )

    @functools.cached_property
    def _given(self) -> np.ndarray:
        """bool[m]: ground among the candidates, by the filter as it was given."""
        ((_, ground),) = self.subject.ground_each([self.filter], [0])
        return ground


def calibrate(
    filter_: Filter,
    cloud: Any,
    labels: Any,
    *,
    labelled: np.ndarray | None = None,
    axes: Mapping[str, Any] | None = None,
    size: int = 256,
    rounds: int = 2,
    score: str = "total",
    folds: int = 5,
    block: float | None = None,
    seed: int = 0,
    key: Any = None,
    workers: int | None = None,
    memory: float = 2e9,
    progress: Progress | None = None,
) -> Calibration:
    """Find the parameters that suit a cloud from a few labelled points or patches of it.

    ``size`` sets are spread over the ranges by a Sobol sequence; then, ``rounds`` - 1 times, as many over a quarter of each
    range around the best. A set is judged by the score to expect on the whole cloud, and by those of sets like it: labels
    count as they are and say what points without a label are likely to be, and where they say little the given filter is
    believed (:mod:`jaxfilter.sweeps.inference`). The score that is returned, percent, is cross-validated: labelled points are cut
    into folds of whole blocks, and each fold is scored with the set that the other folds would have chosen among those that
    were tried, since points next to each other share their fate. With ``rounds`` above 1 all labels decide where the search
    goes on, so that it is a little too good.

    Args: as for :class:`Study`, :class:`CrossValidation` and :class:`SweepOptions`; and
        labelled: bool[n], where ``labels`` are known; by default everywhere, or where they are not -1.
        size: sets in each round.
        rounds: how often sets are drawn.
        seed: of the Sobol sequences.
        progress: called with the fraction done and what is being done.

    Returns: Calibration; ``.filter`` is the filter with the best parameters.
    Raises: InputError for labels of the wrong length or of one class only; ParameterError for the other arguments.

    >>> labels = np.where(cloud.xyz[:, 0] < 20, truth, -1)  # a strip of 20 m, 1 = ground
    >>> found = jf.calibrate(
    ...     jf.SMRF(), cloud, labels, axes={"threshold": (0.2, 1.0)}, size=4, rounds=1, folds=2, block=10.0)
    >>> 0.2 <= found.filter.threshold <= 1.0, found.filter.slope
    (True, 0.15)
    """
    check_whole(1, MAX_SETS, size=size, rounds=rounds)
    check_whole(0, seed=seed)
    options, validation = SweepOptions(key, workers, memory), CrossValidation(folds, block)
    cloud = as_cloud(cloud)
    if labelled is not None:
        mask, (truth, known) = np.asarray(labelled), _known_labels(cloud, labels)
        if mask.shape != (len(cloud),) or mask.dtype != bool:
            raise InputError(f"labelled must be bool[{len(cloud)}], not {mask.dtype} of shape {mask.shape}")
        labels = np.where(known & mask, truth, -1).astype(np.int8)
    study = Study(filter_, cloud, labels, axes=axes, score=score, validation=validation, options=options)
    report = progress or silent
    ranges, low, width = study.ranges, np.zeros(len(study.ranges)), np.ones(len(study.ranges))
    for turn in range(rounds):
        place = low + width * sobol(size, len(ranges), [seed, turn])
        sets = [{name: r.at(u) for u, (name, r) in zip(row, ranges.items(), strict=True)} for row in place]
        if turn == 0:
            sets[0] = {name: getattr(study.filter, name) for name in ranges}
        study.evaluate(sets, lambda done, step, turn=turn: report((turn + done) / rounds, step))  # type: ignore[misc]
        best = study.sets[study.best(study.expected()[0])]
        centre = np.array([r.position(best[name]) for name, r in ranges.items()])
        width = width / 4
        low = np.clip(centre - width / 2, 0, 1 - width)
    return study.result()


def _ranges_of(filter_: Filter, axes: Mapping[str, Any] | None) -> dict[str, Range]:
    ranges = search_ranges(filter_)
    if axes is not None:
        if not isinstance(axes, Mapping):
            raise ParameterError(f"axes={axes!r}: map fields of {type(filter_).__name__} to their ranges")
        fields = fields_of(filter_, axes)
        known, ranges = ranges, {}
        for name, given in axes.items():
            if isinstance(given, Range):
                ranges[name] = given
                continue
            try:
                low, high = (float(v) for v in given)
            except (TypeError, ValueError):
                raise ParameterError(f"axes: {name}={given!r}: give a pair (low, high)") from None
            usual = known.get(name) or around(fields[name])
            scale = usual.scale if usual is not None else "linear"
            if isinstance(fields[name].default, int) and math.isfinite(low) and math.isfinite(high):
                scale, low, high = "whole", math.ceil(low), math.floor(high)
            try:
                ranges[name] = Range(low, high, "linear" if scale == "log" and low <= 0 else scale)
            except ParameterError as error:
                raise ParameterError(f"axes: {name}={given!r}: {error}") from None
    if not ranges:
        raise ParameterError(f"axes: name at least one field of {type(filter_).__name__} and its range")
    for name, r in ranges.items():
        for value in (r.at(0.0), r.at(1.0)):
            filter_.replace(**{name: value})  # raises ParameterError, naming field and value
    return ranges


def _known_labels(cloud: PointCloud, labels: Any) -> tuple[np.ndarray, np.ndarray]:
    """bool[n] ground, bool[n] whether that is known. Raises InputError."""
    array = np.asanyarray(labels)
    if array.shape != (len(cloud),):
        raise InputError(f"labels: {len(cloud)} are needed, one per point of the cloud, not an array {array.shape}")
    return reference_labels(array)
