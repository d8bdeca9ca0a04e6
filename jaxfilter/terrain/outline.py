"""Cells and points: where the cells of a raster are, which of them hold points, and how far they lie from the outline of all."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import scipy

from ..core.cloud import PointCloud
from ..core.points import pieces
from .raster import RasterGrid

SNAP = 2.0**-20
"""Metres: corners of clouds and centres of cells are multiples of it, so that a shift of the cloud changes no bit of a raster."""
CELLS_AT_ONCE = 1 << 18
"""Cells whose values are found at a time."""
_FAR = 2.0**20  # metres from the corner: no point is as far, and the lattice of triangulations reaches twice as far
INLET = 10.0
"""Metres: voids that are up to twice as wide are no outside of the data, even where they open to it."""


def cells_of(cloud: PointCloud, grid: RasterGrid) -> np.ndarray:
    """i64[n]: the cell of each point, row by row from the north; points outside go to the nearest cell."""
    out = np.empty(len(cloud), np.int64)
    for part in pieces(len(cloud)):
        columns, rows = places_of(cloud, grid, part)
        out[part] = np.clip(rows, 0, grid.rows - 1) * grid.columns + np.clip(columns, 0, grid.columns - 1)
    return out


def places_of(cloud: PointCloud, grid: RasterGrid, part: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """i64[n], i64[n]: column, from the west, and row, from the north, of each point of a ``part``; it may lie outside the grid.
    They follow from the coordinates alone, not from the corner of the cloud."""
    factor = cloud.units.xy
    metres = np.rint(cloud.origin[:2] * factor / SNAP) * SNAP + cloud.xyz[part, :2]
    x, y = np.floor(metres / (grid.cell * factor)).astype(np.int64).T
    return x - grid.left, grid.bottom + grid.rows - 1 - y


def count_in(cloud: PointCloud, which: np.ndarray, grid: RasterGrid) -> np.ndarray:
    """i64[rows, columns]: how many of the points ``which``, bool[n], are in each cell."""
    columns, rows = (place[which] for place in places_of(cloud, grid))
    own = (columns >= 0) & (columns < grid.columns) & (rows >= 0) & (rows < grid.rows)
    cells = rows[own] * grid.columns + columns[own]
    return np.bincount(cells, minlength=grid.rows * grid.columns).reshape(grid.shape)


def occupied(cloud: PointCloud, grid: RasterGrid) -> np.ndarray:
    """bool[rows, columns]: cells that hold valid points."""
    out = np.zeros(grid.shape, bool)
    at = cells_of(cloud, grid)
    out.flat[at if cloud.valid is None else at[cloud.valid]] = True
    return out


def inward(data: np.ndarray, side: float) -> np.ndarray:
    """f64[rows, columns]: metres from the centres of cells to the outline of the data, negative outside of it.

    Outside is what is further than :data:`INLET` from all cells with ``data``, bool[rows, columns], and connected to the
    surroundings. ``side``: of a cell, metres.
    """
    inlet = math.ceil(INLET / side)
    free = np.pad(~data, inlet + 2, constant_values=True)
    filled = scipy.ndimage.binary_fill_holes(scipy.ndimage.distance_transform_edt(free) <= inlet)
    within = np.s_[inlet + 2 : -inlet - 2, inlet + 2 : -inlet - 2]
    return np.asarray((scipy.ndimage.distance_transform_edt(filled)[within] - inlet - 0.5) * side)


def blocks_of(cloud: PointCloud, grid: RasterGrid) -> Iterator[tuple[slice, np.ndarray]]:
    """Some rows of a grid at a time, and the centres of their cells, f64[q, 2], local metres."""
    x, y = _local(cloud, grid.left, grid.columns, 0, grid.cell), _local(cloud, grid.bottom, grid.rows, 1, grid.cell)
    step = max(1, CELLS_AT_ONCE // grid.columns)
    for top in range(0, grid.rows, step):
        rows = y[::-1][top : top + step]
        yield slice(top, top + len(rows)), np.column_stack([np.tile(x, len(rows)), np.repeat(rows, len(x))])


def _local(cloud: PointCloud, first: int, count: int, axis: int, cell: float) -> np.ndarray:
    """f64[count]: the centres of the cells along an axis, local metres; those farther than any point as :data:`_FAR`."""
    centre = (first + np.arange(count) + 0.5) * cell
    return np.clip(np.rint((centre - cloud.origin[axis]) * (cloud.units.xy / SNAP)) * SNAP, -_FAR, _FAR)
