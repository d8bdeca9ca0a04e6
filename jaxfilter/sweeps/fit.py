"""Thresholds fitted to labelled clouds by gradient, and stopped by clouds that took no part."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, ParameterError, check_whole
from ..core.filter import Filter
from ..core.params import declared
from ..core.result import Progress, silent
from ..steps.grid_filter import GridFilter, fit_data, soft_errors
from .best import word
from .calibrate import CrossValidation, deal, known_labels, ranges_of
from .inference import evenly
from .ranges import Range, check_filter
from .sweep import Subject, SweepOptions, about, named_clouds, named_labels

if TYPE_CHECKING:
    import xarray

POINTS = 1 << 14
"""At most so many points of each cloud, spread evenly, have a part in the gradient. All count where labels are scored."""
RATE = 0.03
"""Length of a step, as a share of the range of each parameter."""
WIDTHS = 0.1, 0.02
"""Metres over which soft labels change, at the first step and at the last; they shrink by the same share in each."""
EVERY = 2
"""After so many steps the labels of clouds that are held out are scored."""
# These four were chosen on eight simulated scenes and on the samples without site 5, of three settings that were tried.


@dataclasses.dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of :func:`fit`. Errors in percent, means over the clouds.

    Attributes:
        filter: the filter with the fitted parameters; the start, if nothing better was found.
        moved: whether it is another one than the start.
        before: total error of the start.
        after: that of fits in which each cloud took no part, at the step where it is lowest.
        spread: standard error of the difference, over the groups that were held out.
        curves: over ``step``: ``fitted``, the total error of soft labels on the clouds that took part; ``held_out``, that on
            clouds that took none; ``total``, that of the labels of these, NaN where they were not scored; and the fields.

    >>> found = jf.fit(jf.SMRF(), cloud, truth, steps=4, validation=jf.CrossValidation(2, block=10.0))
    >>> found.curves.sizes["step"], found.moved or found.filter == jf.SMRF()
    (5, True)
    """

    filter: Filter
    moved: bool
    before: float
    after: float
    spread: float
    curves: xarray.Dataset

    def __str__(self) -> str:
        fields = ", ".join(f"{field}={word(getattr(self.filter, field))}" for field in self.curves.attrs["fields"])
        return (
            f"{type(self.filter).__name__}({fields}): {'' if self.moved else 'no better than the start: '}{self.before:.2f} % "
            f"total error, {self.after:.2f} +- {self.spread:.2f} % fitted, on clouds held out"
        )


def fit(
    filter_: Filter,
    clouds: Any,
    labels: Any = None,
    *,
    axes: Mapping[str, Any] | None = None,
    groups: Mapping[str, Any] | None = None,
    validation: CrossValidation = CrossValidation(),
    steps: int = 16,
    progress: Progress | None = None,
) -> Fit:
    """Fit thresholds of SMRF, of PMF on a grid, or of a filter like them, by gradient.

    What goes down is the total error of :func:`jaxfilter.soft_labels`, mean over the clouds, by Adam (Kingma and Ba 2015, from
    optax). Such fits easily suit the clouds that they see, and no others. So the clouds are dealt into folds. For each fold there
    is a fit that does not see it, in step with the fit to all clouds. The fit to all stops at the step at which the labels of
    the clouds were best in the mean while they were held out. The start is returned where that gain is not larger than its
    standard error over the groups. A single cloud is cut into blocks. Needs optax: ``pip install 'jaxfilter[fit]'``.

    Args:
        filter_: the start; fields that are not fitted stay as they are.
        clouds: one, a list, or a mapping from names, as for :func:`jaxfilter.sweep`.
        labels: as of :class:`jaxfilter.Study`; a list or mapping like that of the clouds; by default the clouds' own reference.
        axes: traced fields to fit and their ranges, as for :class:`jaxfilter.Study`.
        groups: name of each cloud (of a list its number) to its group. Clouds of one group (a site) are held out together.
        validation: the number of folds, and the blocks that a single cloud is cut into.
        steps: of Adam, each over all clouds; soft labels get narrower from step to step.
        progress: called with the fraction done and what is being done.

    Returns: Fit.
    Raises: ParameterError for a filter or fields without a gradient, and without optax; InputError for labels of the wrong
        length, or where nothing can be held out.

    >>> found = jf.fit(jf.SMRF(), cloud, truth, steps=4, validation=jf.CrossValidation(2, block=10.0))
    >>> str(found).startswith("SMRF(slope=")
    True
    """
    try:
        import optax
    except ImportError as error:
        raise ParameterError("fit: optax is not installed: pip install 'jaxfilter[fit]'") from error
    check_whole(steps=steps)
    filter_, report = check_filter(filter_), progress or silent
    if not isinstance(filter_, GridFilter) or getattr(filter_, "reading", "grid") != "grid":
        raise ParameterError(f"filter_={filter_!r}: only filters on a grid have soft labels: SMRF, PMF(reading='grid')")
    space = _Space(filter_, ranges_of(filter_, axes))
    known = _all_known(space, clouds, labels, groups, validation)
    folds, places = known[0].held.shape[0] - 1, [np.tile(space.start, (known[0].held.shape[0], 1))]
    rule = optax.adam(RATE)  # of the fits without a fold, and of that to all, which stands last
    state, curves = rule.init(places[0]), []
    for step in range(steps + 1):
        report(step / (steps + 2), f"{len(known)} clouds, step {step} of {steps}")
        soft, gradient = space.downhill(known, places[-1], WIDTHS[0] * (WIDTHS[1] / WIDTHS[0]) ** (step / steps))
        curves.append(soft)
        update, state = rule.update(gradient, state)
        places.append(np.clip(places[-1] + np.asarray(update), space.low, space.high))
    report((steps + 1) / (steps + 2), "labels of the clouds that are held out")

    scored = sorted({*range(0, steps, EVERY), steps})
    along = [[space.at(places[step][k]) if step else filter_ for step in scored] for k in range(folds + 1)]
    totals = np.concatenate([one.totals(along) for one in known])
    group = np.concatenate([[one.group] if len(known) > 1 else one.folds for one in known])
    mean = totals.mean(axis=0)
    best = int(np.argmin(mean))
    gain = np.array([(totals[group == g, 0] - totals[group == g, best]).mean() for g in np.unique(group)])
    spread = float(gain.std(ddof=1) / math.sqrt(len(gain)))
    moved = bool(mean[0] - mean[best] > spread + 1e-9)  # of two groups, one that gains is not enough
    made = space.dataset(np.array(places)[:-1, folds], np.array(curves), dict(zip(scored, mean, strict=True)))
    report(1.0, "done")
    return Fit(along[folds][best] if moved else filter_, moved, float(mean[0]), float(mean[best]), spread, made)


class _Space:
    """The parameters of a filter as places f64[fields] in their ranges; the start, which may lie outside, is inside of ``low``
    and ``high``."""

    def __init__(self, filter_: GridFilter, ranges: dict[str, Range]) -> None:
        traced = [f.name for f in declared(filter_) if not f.metadata["static"]]
        for name, r in ranges.items():
            if name not in traced or r.scale == "whole":
                raise ParameterError(f"axes: {name} has no gradient; choose from {', '.join(traced)}")
        self.filter, self.ranges = filter_, ranges
        self.start = np.array([r.position(getattr(filter_, name)) for name, r in ranges.items()])
        self.low, self.high = np.minimum(self.start, 0.0), np.maximum(self.start, 1.0)

    def at(self, place: np.ndarray) -> Any:
        pairs = zip(self.ranges.items(), place.tolist(), strict=True)
        return self.filter.replace(**{name: r.at(u) for (name, r), u in pairs})

    def downhill(self, known: list[_Known], place: np.ndarray, width: float) -> tuple[list[float], np.ndarray]:
        """Errors of soft labels on the clouds that the fit to all sees, and on those that are held out; and the gradient of the
        former by the places f64[fits, fields], for each fit."""
        values = {name: np.float32(r.value(place[:, i])) for i, (name, r) in enumerate(self.ranges.items())}
        rate = [v * math.log(r.high / r.low) if r.scale == "log" else r.high - r.low for v, r in zip(values.values(), self.ranges.values(), strict=True)]  # fmt: skip # noqa: E501
        seen, unseen, gradient = [], [], np.zeros_like(place)
        for one in known:
            try:
                (inside, outside), slopes = soft_errors(self.filter, one.data, one.held, values, width)
            except ValueError as error:
                raise ParameterError(f"axes: no gradient in {', '.join(values)}: {error}") from error
            along = np.stack([np.asarray(slopes[name]) * by for name, by in zip(values, rate, strict=True)], axis=1)
            gradient += np.where(np.isfinite(np.asarray(inside))[:, None], along, 0.0) / len(known)
            seen.append(float(inside[-1]))
            unseen += np.asarray(outside)[one.folds].tolist()
        return [float(np.mean(seen)), float(np.nanmean(unseen))], gradient

    def dataset(self, places: np.ndarray, soft: np.ndarray, mean: dict[int, float]) -> xarray.Dataset:
        import xarray as xr

        field, facts = {f.name: f for f in declared(self.filter)}, {"long_name": "total error", "units": "%"}
        totals = [mean.get(i, math.nan) for i in range(len(soft))]
        errors = {"fitted": soft[:, 0], "held_out": soft[:, 1], "total": totals}
        made: dict[str, Any] = {name: ("step", values, facts) for name, values in errors.items()}
        made |= {n: ("step", r.value(places[:, i]), about(field[n])) for i, (n, r) in enumerate(self.ranges.items())}
        attrs = {"method": type(self.filter).__name__, "fields": list(self.ranges)}
        return xr.Dataset(made, {"step": np.arange(len(soft))}, attrs)


class _Known:
    """A cloud whose labels are known, in the shapes that fits need."""

    held: np.ndarray
    """bool[fits, rows]: which rows of ``data`` a fit does not see."""

    def __init__(self, name: str, group: str, space: _Space, cloud: PointCloud, labels: Any) -> None:
        self.truth, self.counted = known_labels(cloud, labels)
        self.subject, self.cloud, self.group = Subject(space.filter, cloud, SweepOptions()), cloud, group
        if self.subject.same is not None or not (self.counted & cloud.candidate).any():
            why = self.subject.same.status.message if self.subject.same else "no point that is judged has a label"
            raise InputError(f"fit: nothing can be fitted to {name}: {why}")

    def prepare(self, space: _Space, fold: np.ndarray, folds: int) -> None:
        """``fold``: i64[n] of the points, -1 without a label."""
        points, weight = self.subject.points, self.subject.of_kinds(self.truth, self.counted)
        rows = np.flatnonzero(weight.any(axis=0))
        rows = evenly(rows[np.lexsort(points.xyz[rows].T)], POINTS)
        ends = space.at(space.low), space.at(space.high)
        self.data = fit_data(space.filter, points, ends, rows, weight[:, rows])
        self.fold, self.folds = fold, np.unique(fold[fold >= 0])
        of_row = np.pad(points.gather(fold)[rows], (0, len(self.data[1]) - len(rows)), constant_values=-1)
        self.held = np.arange(folds + 1)[:, None] == of_row

    def totals(self, along: list[list[Filter]]) -> np.ndarray:
        """f64[folds of the cloud, sets], percent: total errors of the sets of each fold on its points."""
        found = np.zeros((len(self.folds), len(along[0])))
        for row, k in enumerate(self.folds):
            for number, ground in self.subject.ground_each(along[k]):
                wrong = self.subject.points.spread(ground) != self.truth
                found[row, number] = 100 * wrong[self.fold == k].mean()
        return found


def _all_known(space: _Space, clouds: Any, labels: Any, groups: Any, validation: CrossValidation) -> list[_Known]:
    """The clouds, dealt into folds."""
    several, named = named_clouds(clouds, "fit")
    labels = (
        dict.fromkeys(named, labels) if not several or labels is None else named_labels(labels, several, named, "fit")
    )
    group = {str(name): str(its) for name, its in (groups or {name: name for name in named}).items()}
    if other := set(group) ^ set(named):
        what = "has no group" if min(other) in named else "is no cloud"
        raise InputError(f"fit: groups: {min(other)} {what}: name the group of every cloud")
    known = [_Known(name, group[name], space, cloud, labels[name]) for name, cloud in named.items()]
    kinds, which = np.unique([one.group for one in known], return_inverse=True)
    if len(known) == 1:
        fold = [np.full(len(known[0].cloud), -1)]
        fold[0][known[0].counted] = validation.assign(known[0].cloud.xyz[known[0].counted])
    elif len(kinds) > 1:
        dealt = deal(np.bincount(which, [one.counted.sum() for one in known]), validation.folds)[which]
        fold = [np.where(one.counted, its, -1) for one, its in zip(known, dealt, strict=True)]
    else:
        raise InputError(f"fit: all clouds are of the group {kinds[0]}, so none can be held out; two groups are needed")
    for one, its in zip(known, fold, strict=True):
        one.prepare(space, its, 1 + max(int(part.max()) for part in fold))
    return known
