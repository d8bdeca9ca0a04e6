"""From file coordinates to the local metric frame, and what coordinates are believed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from .errors import InputError, warn
from .units import Units

QUANTUM = 2.0**-10
"""Local coordinates are multiples of this many metres (about 1 mm).

Below 16 km from the origin such values, and all differences between them, are exact in float32. A power of two never
lies half-way between two decimal centimetres or millimetres, so clouds that differ by a shift become equal bit for bit.
"""
_RESOLVED = QUANTUM * 2.0**53
"""Below this many metres float64 resolves the quantum."""
LARGEST_SPAN = (1e7, 1e7, 1e5)
"""Metres in X, Y and Z that a cloud may extend over; more is a stray point, or a wrong unit or scale."""
COARSE = 0.005
"""Metres: steps of float32 coordinates above which a warning is given. Half of it is an error of height that does not count."""
SCALE_LIMITS = (1e-12, 100.0)
"""Scale factors of LAS files that are believed: above the first, up to the second."""
_ROWS = 1 << 15  # points that are converted at a time: what is made of them stays in the cache


@dataclasses.dataclass(frozen=True)
class Coordinates:
    """Coordinates of points in file units, and room for local ones.

    Attributes:
        raw: numbers [n, 3], NaN for points that do not count; times ``scales`` plus ``offsets``, f64[3], they are file units.
        local: f32[n, 3], which :meth:`place` fills; it may be the memory of ``raw``.
        kind: their own type, where it may be too coarse.
    """

    raw: np.ndarray
    local: np.ndarray
    scales: np.ndarray = dataclasses.field(default_factory=lambda: np.ones(3))
    offsets: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3))
    kind: np.dtype[Any] | None = None

    def column(self, rows: slice, axis: int) -> np.ndarray:
        """f64, the coordinates of some rows on an axis, file units."""
        return self.raw[rows, axis] * self.scales[axis] + self.offsets[axis]

    def ends(self, valid: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """f64[3] least and f64[3] largest coordinates of the ``valid`` points, bool[n] or None for all; NaN if there are none."""
        known = self.raw if valid is None else self.raw[valid]
        least, largest = ends(known) if len(known) else (np.full(3, np.nan), np.full(3, np.nan))
        return least * self.scales + self.offsets, largest * self.scales + self.offsets

    def place(
        self, valid: np.ndarray | None, units: Units, anchor: Iterable[float], name: str, drop: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Remove a float64 origin and quantise: the only place where raw coordinates become local ones.

        The origin is the lower corner in x, y, z, rounded down to whole metres from the anchor, f64[2], and from elevation zero,
        so that clouds with one anchor share one lattice of quantised coordinates. Rows that are not ``valid`` become zero.

        Returns: the origin, f64[3], and which points are valid, bool[n] or None for all.
        Raises: InputError unless points far off may be dropped (``drop``), and where float64 does not resolve coordinates.
        """
        (low, high), factor = self.ends(valid), units.factor
        if (near := self._near(low, high, factor, name, drop)) is not None:
            valid, (low, high) = near, self.ends(near)
        self._check_resolution(low, high, factor, name)
        if np.isnan(low).any():
            self.local[:] = 0
            return np.zeros(3), valid
        base = np.array([*anchor, 0.0])
        origin = base + np.floor((low - base) * factor) / factor
        for start in range(0, len(self.local), _ROWS):
            rows = slice(start, start + _ROWS)
            for axis in range(3):
                steps = np.rint((self.column(rows, axis) - origin[axis]) * (factor[axis] / QUANTUM))
                self.local[rows, axis] = steps * QUANTUM
        if valid is not None:
            self.local[~valid] = 0
        return origin, valid

    def _near(self, low: np.ndarray, high: np.ndarray, factor: np.ndarray, name: str, drop: bool) -> np.ndarray | None:
        """None if a cloud from ``low`` to ``high`` is of possible size; else bool[n], the points that are left of it. Medians
        are taken only of clouds that are too large. Raises: InputError unless points may be dropped (``drop``)."""
        with np.errstate(over="ignore", invalid="ignore"):
            spans = (high - low) * factor
        near = None
        for axis in np.flatnonzero(spans > LARGEST_SPAN).tolist():
            limit, letter = LARGEST_SPAN[axis], "XYZ"[axis]
            values = self.column(slice(None), axis)
            known = values[~np.isnan(values)]
            median = np.partition(known, len(known) // 2)[len(known) // 2]
            with np.errstate(over="ignore"):
                distance = abs(values - median) * factor[axis]
            if not drop:
                worst = int(np.nanargmax(distance))
                place = ", ".join(f"{self.column(slice(worst, worst + 1), i)[0]:.10g}" for i in range(3))
                raise InputError(
                    f"{name}: {letter} spans {spans[axis]:.4g} m, more than the {limit:g} m that are possible; farthest from "
                    f"the median is point {worst} of {len(values)} (counted from 0) at ({place}): remove stray points or pass "
                    "drop_invalid=True to label them non-ground, or, if it is not stray, correct scale and offset or pass units="
                )
            far = distance > limit / 2
            stray = f"{int(far.sum())} points more than {limit / 2:g} m from the median of {letter}"
            warn(f"{name}: {stray} are labelled non-ground")
            near = distance <= limit / 2 if near is None else near & (distance <= limit / 2)
        return near

    def _check_resolution(self, low: np.ndarray, high: np.ndarray, factor: np.ndarray, name: str) -> None:
        """Raises: InputError for coordinates that float64 holds less exactly than local ones are. Warns: where their own type
        has steps of more than :data:`COARSE`."""
        largest = np.fmax(abs(low), abs(high))
        if self.kind is not None and self.kind.kind == "f" and self.kind.itemsize < 8:
            steps = np.spacing(largest.astype(self.kind)).astype(np.float64) * factor
            if (coarse := steps > COARSE).any():
                axis = int(np.nanargmax(steps))
                warn(
                    f"{name}: {', '.join(np.array(list('XYZ'))[coarse])} came as {self.kind}, which at {largest[axis]:.10g} has "
                    f"steps of {steps[axis]:.3g} m: points lie on a lattice of that size, and labels suffer; give them as "
                    "float64, from where they were read on"
                )
        if (wrong := largest * factor >= _RESOLVED).any():
            axis = int(np.argmax(wrong))
            value = low[axis] if abs(low[axis]) > abs(high[axis]) else high[axis]
            wrong = f"{'XYZ'[axis]} reaches {value:.10g} units, where float64 does not resolve {QUANTUM:.2g} m"
            raise InputError(f"{name}: {wrong}: correct scale and offset, or subtract a constant from the coordinates")


def checked_anchor(anchor: Iterable[float]) -> np.ndarray:
    """f64[2]. Raises InputError."""
    try:
        x, y = (float(v) for v in anchor)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"anchor={anchor!r}: two numbers (x, y) in file units are needed") from error
    if not max(abs(x), abs(y)) < _RESOLVED:
        raise InputError(f"anchor={anchor!r}: must be two finite numbers below {_RESOLVED:g}")
    return np.array([x, y])


def ends(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[k] least and [k] largest of every column of [n, k]. By columns: across rows NumPy takes many times as long."""
    least, largest = (np.array([pick(rows[:, k]) for k in range(rows.shape[1])]) for pick in (np.min, np.max))
    return least, largest


def check_scales(scales: np.ndarray, offsets: np.ndarray, name: str) -> None:
    """Scales and offsets of integer coordinates, f64[3] each. Raises InputError naming the field."""
    low, high = SCALE_LIMITS
    for axis, scale, offset in zip("XYZ", scales, offsets, strict=True):
        if not low < scale <= high:
            limits = f"it must be above {low:g} and at most {high:g}"
            raise InputError(f"{name}: {axis} scale factor is {scale:g}; {limits}, the header is damaged")
        if not math.isfinite(offset):
            raise InputError(f"{name}: {axis} offset is {offset:g}; the header is damaged")


def perturbed(xy: np.ndarray) -> np.ndarray:
    """f64[n, 2] of local f32[n, >=2]: each position moved by less than half a quantum, decided by the position. Of the moved
    positions no two are equally near to a third one, so that the nearest is one and the same in any order."""
    lattice = np.rint(xy[:, :2].astype(np.float64) / QUANTUM).astype(np.int64).view(np.uint64)
    h = lattice[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ lattice[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
    out = np.empty((len(xy), 2))
    for axis in range(2):  # finaliser of splitmix64: every input bit reaches every output bit
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
        out[:, axis] = xy[:, axis] + ((h >> np.uint64(11)) * 2.0**-53 - 0.5) * QUANTUM
    return out
