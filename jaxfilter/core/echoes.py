"""Return numbers: the echoes that are judged, and numbers that are not as the format wants them."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from typing import Any

import numpy as np

from .errors import warn

_RUN, _RUNS, _CHUNK = 1 << 14, 8, 50_000
"""Points of a run of the sample, runs, and points of a chunk of LAZ: runs begin where chunks do, so that little is decoded."""
_ENOUGH, _PAIRS, _FEW, _FIRST = 100, 50, 0.001, 0.05
"""Points of pulses of several, and pairs of echoes, by which numbers are judged; the share of points that may be damaged, and of
first echoes at least: a pulse has 15 echoes at most."""
_RISING = 0.75
"""Share of pairs whose heights rise with the number, in data numbered from the last echo. In sound data it is .25 at most (a
drone over steep slopes), and about .5 where the pairs are of different pulses."""
_ADJACENT, _SORTED = 0.1, 0.8
"""Pairs per point that there are at least where echoes of a pulse follow one another, and by how much more heights rise than fall
from point to point, or fall than rise, in points sorted by height."""


class Numbering(enum.Enum):
    """How echoes are numbered; the value is what a warning says."""

    SOUND = ""
    EMPTY = "return number and number of returns are 0 throughout, so all points are candidates"
    FROM_ZERO = "return numbers count from 0, so each is taken as one more"
    UNFILLED = "no point is the last echo of a pulse of several, so return numbers are not filled in, and all echoes are judged"
    REVERSED = "heights rise with return numbers, so these count from the last echo, and all echoes are judged"


def sample(n: int) -> list[slice]:
    """The rows of n by which numbers are judged: all of a few, and of more some runs, spread evenly, and the end."""
    if n <= _RUNS * _RUN:
        return [slice(0, n)]
    last = (n - _RUN) // _CHUNK * _CHUNK
    starts = np.unique(np.linspace(0, last // _CHUNK, _RUNS).astype(int)) * _CHUNK
    return [slice(start, n if start == last else start + _RUN) for start in starts.tolist()]


def numbering(columns: Mapping[str, Any], z: np.ndarray, time: np.ndarray | None = None) -> Numbering:
    """How the echoes of n points are numbered, by a :func:`sample` of them.

    Args:
        columns: ``return_number`` and ``number_of_returns``, u8[n], if they are known. z: [n], heights in any unit.
        time: f64[n], GPS times, which echoes of one pulse share; None = they follow one another.
    """
    number, total = columns.get("return_number"), columns.get("number_of_returns")
    if number is None or total is None or not len(number):
        return Numbering.SOUND
    rows = np.concatenate([np.arange(run.start, run.stop) for run in sample(len(number))])
    number, total, z = number[rows], total[rows], np.asarray(z)[rows]
    several, how = total > 1, Numbering.SOUND
    if not (number.any() or total.any()):
        return Numbering.EMPTY
    judged = several if several.any() else total > 0
    if judged.any() and (number == 0)[judged].mean() > _FIRST and (number >= total)[judged].mean() <= _FEW:
        number, how = number + (number < total), Numbering.FROM_ZERO
    if several.sum() >= _ENOUGH and (number >= total)[several].mean() <= _FEW:
        return Numbering.UNFILLED
    return Numbering.REVERSED if _rises(number, total, z, None if time is None else np.asarray(time)[rows]) else how


def _rises(number: np.ndarray, total: np.ndarray, z: np.ndarray, time: np.ndarray | None) -> bool:
    """Whether heights rise with the number, in pairs of successive echoes of one pulse."""
    several = np.flatnonzero(total > 1)
    if time is not None:
        order = several[np.lexsort((number[several], time[several]))]
        rising = _rising(number[order], total[order], z[order], np.diff(time[order]) == 0)
        if len(rising) >= _PAIRS:
            return bool(rising.mean() > _RISING)
    steps = np.diff(z[several].astype(np.float64))
    up, down = int((steps > 0).sum()), int((steps < 0).sum())
    if abs(up - down) > _SORTED * (up + down):
        return False
    rising = _rising(number[several], total[several], z[several], True)
    return len(rising) >= max(_PAIRS, _ADJACENT * len(several)) and bool(rising.mean() > _RISING)


def _rising(number: np.ndarray, total: np.ndarray, z: np.ndarray, one_pulse: np.ndarray | bool) -> np.ndarray:
    """bool of each two neighbours that may be successive echoes of one pulse: whether height rises with the number."""
    step, rise = np.diff(number.astype(np.int8)), np.diff(z.astype(np.float64))
    pair = one_pulse & (abs(step) == 1) & (np.diff(total) == 0) & (rise != 0)
    return (step * rise > 0)[pair]


def renumbered(columns: Mapping[str, Any], how: Numbering, name: str) -> np.ndarray | None:
    """Return numbers u8[n] as the format wants them, None where they say nothing. Warns: of what is done to them."""
    number: np.ndarray | None = columns.get("return_number")
    if how is Numbering.SOUND or number is None or not len(number):
        return number
    warn(f"{name}: {how.value}")
    return number + (number < columns["number_of_returns"]) if how is Numbering.FROM_ZERO else None


def echo_mask(number: np.ndarray | None, total: np.ndarray | None, returns: str, n: int, name: str) -> np.ndarray:
    """bool[n]: which points are among these echoes. Damaged echo numbers are treated as last, with a warning."""
    wanted = returns.split(",")
    if "all" in wanted or number is None or total is None or n == 0:
        return np.ones(n, bool)
    odd = (number == 0) | (total == 0) | (number > total)
    if odd.any():
        warn(f"{name}: {int(odd.sum())} points have impossible return numbers and are treated as last returns")
    is_last = number == total
    kinds = {"only": is_last & (total == 1), "last": is_last & (total > 1), "first": ~is_last & (number == 1)}
    kinds["intermediate"] = ~is_last & (number > 1)
    mask = np.logical_or.reduce([kinds[kind] for kind in wanted]) & ~odd
    return mask | odd if "last" in wanted else mask
