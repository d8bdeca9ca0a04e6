"""The slider of a report: which points are ground at which value of a threshold."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..core.filter import Filter, ground_each, passed
from ..core.params import declared
from ..core.result import FilterResult, Progress, Status
from ..steps.grid_filter import GridFilter
from ..sweeps.ranges import RANGES, Range, around, search_ranges

USUAL_EXACT, MOST_EXACT = 49, 250
"""Of a threshold that is applied last of all, by default and at most: a step costs next to nothing."""
MOST_CLASSIFIED = 15
"""Of other thresholds; one bit per set."""
_WORK = 4_000_000
"""Points times sets that a slider may cost by default, where each set is a classification of its own."""
_FEWEST = 3
_MEMORY = 2e9


class Steps(NamedTuple):
    """Labels at every position of a slider.

    Attributes:
        field: the threshold, a field of the filter; None without a slider, when there is one step.
        values: of the field, ascending.
        now: the number of the step that is the result as it stands.
        code: u8[n] or u16[n]. Nested: the first step at which a point is ground, or their number; else bit k is the label at
            step k.
        nested: what is ground at one step is so at all later ones.
        reason: why there is no slider, in words.
    """

    field: str | None
    values: list[float]
    now: int
    code: np.ndarray
    nested: bool
    reason: str = ""

    @property
    def table(self) -> np.ndarray:
        """bool[codes, steps]: the label of every code at every step."""
        steps = np.arange(len(self.values))
        if self.nested:
            return np.arange(len(steps) + 1)[:, None] <= steps
        return (np.arange(1 << len(steps))[:, None] >> steps & 1).astype(bool)


def keep_labels(ground: np.ndarray, reason: str) -> Steps:
    """No slider: the labels bool[n] as they are."""
    return Steps(None, [math.nan], 0, (~ground).astype(np.uint8), True, reason)


def steps_of(result: FilterResult, count: int | None, workers: int | None, progress: Progress) -> Steps:
    """The labels of a result at ``count`` values of its threshold, or at as many as are quick; see :func:`keep_labels`.

    Without a slider are: labels that no filter of ours made, degenerate clouds, filters whose thresholds have no range, and
    what a random key or the like made in another way than the filter does by itself.
    """
    ground, run = result.ground, result.run
    if run is None or not isinstance(run.filter, Filter):
        return keep_labels(ground, "the filter is not known")
    if result.status not in (Status.CONVERGED, Status.ROUND_LIMIT):
        return keep_labels(ground, "no threshold had a part in the labels")
    filter_, field = run.filter, swept_field(run.filter)
    if field is None or not math.isfinite(getattr(filter_, field)):
        return keep_labels(ground, "no threshold has a range to move in")
    quick = count is None
    last, tested = field in filter_.LAST, isinstance(filter_, GridFilter) and field in filter_.TESTED
    usual, most = USUAL_EXACT, MOST_EXACT
    if not last and not tested:
        usual, most = _WORK // max(int(result.info.get("candidates", len(ground))), 1), MOST_CLASSIFIED
    count = min(usual if count is None else count, most)
    if count < _FEWEST:
        why = "each step would be a classification of its own" if quick else "fewer than three steps were asked for"
        return keep_labels(ground, why)
    values = step_values(filter_, field, count)
    sets = [filter_.replace(**{field: value}) for value in values]
    now = values.index(float(getattr(filter_, field)))
    nested, points = last or tested, None
    each: Iterator[tuple[int, np.ndarray]] = ((number, passed(one, result)) for number, one in enumerate(sets))
    if not last:
        points = filter_.points_of(run.cloud)
        each = ground_each(filter_, points, sets, key=None, workers=workers, memory=_MEMORY)
    code: np.ndarray = np.zeros(len(ground if points is None else points), np.uint8 if nested else np.uint16)
    counts = [0] * len(sets)
    for done, (number, now_ground) in enumerate(each, 1):
        code += (~now_ground if nested else now_ground * (1 << number)).astype(code.dtype)
        counts[number] = now_ground.sum()
        progress(done / len(sets), "slider")
    if nested and not np.array_equal(np.cumsum(np.bincount(code, minlength=len(sets)))[: len(sets)], counts):
        return keep_labels(ground, "what is ground at one value is not so at all larger ones")
    if points is not None:
        code = points.spread(code, len(sets) if nested else 0)
    steps = Steps(field, values, now, code, nested)
    if not np.array_equal(steps.table[code, now], ground):
        return keep_labels(ground, "the filter by itself gives other labels")
    return steps


def swept_field(filter_: Filter) -> str | None:
    """The threshold that a slider moves: what is applied last if there is such, else the one that matters most."""
    last = filter_.LAST or (filter_.TESTED if isinstance(filter_, GridFilter) else ())
    return next(iter(last or search_ranges(filter_)), None)


def step_values(filter_: Filter, field: str, count: int) -> list[float]:
    """About ``count`` values of a field, ascending, the present one among them."""
    value = float(getattr(filter_, field))
    declaration = next(one for one in declared(filter_) if one.name == field)
    known = RANGES.get(field) or around(declaration) or Range(0.0, 1.0)
    low, high = min(known.low, value), max(known.high, value)
    if count <= MOST_CLASSIFIED:  # few: near the present one
        low, high = max(low, value / 2) if value > 0 else low, min(high, 2 * value) if value > 0 else high
    scale = known.scale if known.scale != "log" or low > 0 else "linear"
    drawn = {float(f"{Range(low, high, scale).at(u):.3g}") for u in np.linspace(0, 1, count)}
    nearest = min(drawn, key=lambda one: abs(one - value))
    return sorted(drawn - {nearest} | {value})
