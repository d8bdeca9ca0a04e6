"""A grid of lowest elevations without empty cells: from the triangulation of the lowest points."""

from __future__ import annotations

import math

import numpy as np

from ..engines.grid.extremes import highest, lowest
from ..engines.grid.inpaint import fill_nearest
from ..engines.tin.triangulation import Tin
from .surfaces import Cells

VOID_REACH = 25.0
"""Metres around a place in a void within which the lowest point counts, where it may be water."""


def fill_voids(tin: Tin, cells: Cells, reach: int, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """f32[rows, columns], padded: lowest elevations, and in empty cells those of a triangulation of the lowest points; and
    bool[rows, columns], not padded: cells inside its hull.

    Across voids, in triangles with an edge over ``longest`` metres, the corners have the lowest elevation within ``reach``
    cells: so a roof at the edge of a void has an edge there. Outside the hull the nearest cell decides.
    """
    from ..engines.grid.shapes import draw

    z, seen = np.array(cells.lowest), np.array(cells.seen)
    rows, columns = cells.grid.shape
    x0, y0, cell = (float(v) for v in (cells.grid.x0, cells.grid.y0, cells.grid.cell))
    low = lowest(np.where(seen, z, np.float32(np.inf)), 2 * reach + 1)
    x, y = ((tin.xyz[:, axis].astype(np.float64) - corner) / cell - 0.5 for axis, corner in enumerate((x0, y0)))
    column = np.clip(np.rint(x).astype(np.int64), 0, columns - 1)
    row = np.clip(np.rint(y).astype(np.int64), 0, rows - 1)
    beneath = np.minimum(low[row, column], tin.xyz[:, 2])
    draw(x, y, tin.triangles, tin.xyz[:, 2], beneath, longest / cell, z[:rows, :columns], seen[:rows, :columns])
    return np.asarray(fill_nearest(z, seen, cells.valid)), seen[:rows, :columns]


def lower_voids(z: np.ndarray, seen: np.ndarray, cell: float, spacing: float) -> np.ndarray:
    """f32[rows, columns]: ``z`` with the lowest elevation within :data:`VOID_REACH` in voids: water is below what is around it.

    Args:
        z: f32[rows, columns], metres, none missing. seen: bool[rows, columns], cells with points.
        cell, spacing: metres; voids are wider than four spacings.
    """
    size = 2 * max(2, math.ceil(2 * spacing / cell)) + 1
    void = ~lowest(highest(seen, size, outside=True), size)
    return np.where(void, lowest(z, 2 * round(VOID_REACH / cell) + 1), z) if void.any() else z
