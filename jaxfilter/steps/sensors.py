"""What sensor a cloud is of, and how thick the sheet of its ground is, told from the points and their echoes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..core.points import Points, pieces
from ..engines.plane_sums import slopes_by_sums

AIRBORNE, DRONE, MATCHING, MOBILE = KINDS = "airborne lidar", "drone lidar", "image matching", "mobile"
"""The kinds of sensors."""
_FEW = 1000
"""Points."""
_MANY = 1_000_000
"""About so many points are looked at in cells: of more some runs in canonical order, which are compact."""
_SIDE = 3.0
"""Point spacings along the side of a cell."""
_BLOCK = 16.0
"""Spacings, and 2 m at least, along the side of a block in which points are counted."""
_CROWDED = 2.8
"""A point of a scan from a car sees so many times the mean density: it falls with the square of the distance."""
_DENSE = 0.13
"""Spacing of drone lidar at most, metres: 60 pulses per m2."""
_SPARSE = 0.4
"""Spacing of photographs at most, metres."""
_GAP = 2.0
"""Metres without points in a cell, between points above and below."""
_OPEN = 0.1
"""Share of the cells with such gaps at most in a cloud of one surface: leaves of photographs hide what is below."""
_SHEET = 0.3
"""Metres above the lowest point of a cell, and one side more, within which points are taken for its sheet."""


class SensorFacts(NamedTuple):
    """``kind``: one of :data:`KINDS`; ``thickness``: metres, standard deviation of ground from planes a few spacings wide;
    ``sparse``: metres, the spacing in the quarter of the area with fewest points."""

    kind: str
    thickness: float
    sparse: float

    @classmethod
    def from_points(cls, points: Points) -> SensorFacts:
        """Of distinct candidates.

        The sheet is measured in cells: the points near the lowest, over their plane of least squares; the lowest quartile of
        cells counts. A scan from a car is far denser at its way than in the mean. Several echoes are those of lidar. A cloud of
        single echoes with one surface, without gaps above one another, is made of photographs. Of few points nothing can be
        told: they count as airborne lidar.
        """
        spacing, xyz = points.spacing(), points.xyz
        if len(xyz) < _FEW:
            return cls(AIRBORNE, 0.0, spacing)
        block = max(_BLOCK * spacing, 2.0)
        _, count = np.unique(_groups(xyz, block), return_counts=True)
        xyz = np.concatenate([xyz[part] for part in list(pieces(len(xyz)))[:: math.ceil(len(xyz) / _MANY)]])
        cells = _groups(xyz, _SIDE * spacing)
        order = np.lexsort((xyz[:, 2], cells))
        start = np.flatnonzero(np.diff(cells[order], prepend=-1))
        z, number = xyz[order, 2].astype(np.float64), np.diff(np.append(start, len(xyz)))
        gap = np.diff(z, prepend=z[:1])
        gap[start] = 0
        several = number >= 4
        open_ = float((np.maximum.reduceat(gap, start)[several] > _GAP).mean()) if several.any() else 1.0
        low = z - np.repeat(z[start], number) < _SHEET + _SIDE * spacing
        spread = spreads(xyz[order[low]].astype(np.float64), cells[order[low]])
        spread = spread[np.isfinite(spread)]
        thickness = round(float(np.percentile(spread, 25)), 4) if len(spread) else 0.0
        echoes = points.cloud.number_of_returns
        if len(count) >= 16 and (count.astype(float) ** 2).mean() / count.mean() ** 2 > _CROWDED:
            kind = MOBILE
        elif (echoes is not None and bool((echoes > 1).any())) or open_ > _OPEN or spacing > _SPARSE:
            kind = DRONE if spacing < _DENSE else AIRBORNE
        else:
            kind = MATCHING
        return cls(kind, thickness, block / float(np.sqrt(np.percentile(count, 25))))


def _groups(xyz: np.ndarray, side: float) -> np.ndarray:
    """i64[m]: the square, of this side, of each point."""
    i, j = np.floor(xyz[:, :2].astype(np.float64) / side).astype(np.int64).T
    return (i << 32) + j


def spreads(xyz: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """f64 of each cell: the standard deviation of its points from their plane of least squares; NaN of less than six points, or
    of some in a line. ``cells``, i64[m], are sorted."""
    start = np.flatnonzero(np.diff(cells, prepend=-1))
    number = np.diff(np.append(start, len(xyz)))
    xyz = xyz - np.repeat(np.add.reduceat(xyz, start) / number[:, None], number, axis=0)
    x, y, z = xyz.T
    xx, xy, yy, xz, yz, zz = (np.add.reduceat(v, start) for v in (x * x, x * y, y * y, x * z, y * z, z * z))
    along_x, along_y, det = slopes_by_sums(xx, xy, yy, xz, yz)
    with np.errstate(invalid="ignore", divide="ignore"):
        rest = zz - (xz * along_x + yz * along_y) / det
        spread = np.sqrt(np.maximum(rest, 0) / (number - 3))
    return np.where((number >= 6) & (det > 1e-3 * xx * yy), spread, np.nan)
