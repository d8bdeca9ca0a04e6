"""The lowest points of grid cells, by plain passes: a scatter on the device takes several times as long on a CPU."""

from __future__ import annotations

import numpy as np

from ...core.points import by_position, pieces


def places_in(xyz: np.ndarray, frame: np.ndarray, extent: np.ndarray, columns: int) -> np.ndarray:
    """i64[n]: the row-major cells of points f32[n, >=2], as :func:`jaxfilter.engines.grid.cells.cell_index` gives them.

    ``frame``: f32[3], x and y of the lower left corner and side of a cell; ``extent``: i32[2], rows and columns that are taken;
    ``columns``: of the array.
    """
    column, row = (((xyz[:, axis] - frame[axis]) / frame[2]).astype(np.int64) for axis in range(2))
    np.clip(row, 0, int(extent[0]) - 1, out=row)
    np.clip(column, 0, int(extent[1]) - 1, out=column)
    row *= columns
    row += column
    return row


def cell_minima(
    xyz: np.ndarray, z: np.ndarray, frame: np.ndarray, extent: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """f32[cells]: the lowest of the elevations ``z``, f32[n], of the points in each cell of an array of ``shape``, else +inf.

    Other arguments: see :func:`places_in`.
    """
    lowest = np.full(shape[0] * shape[1], np.inf, np.float32)
    for part in pieces(len(xyz)):
        np.minimum.at(lowest, places_in(xyz[part], frame, extent, shape[1]), z[part])
    return lowest


def lowest_points(
    xyz: np.ndarray, z: np.ndarray, frame: np.ndarray, extent: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """:func:`cell_minima`; i32[cells], the first of the points that have them; and i64[k], rows of these points, in the order of
    :func:`jaxfilter.core.points.by_position`. They are numbered in this order; cells without a finite elevation have k."""
    lowest, found, cells = cell_minima(xyz, z, frame, extent, shape), [], []
    for part in pieces(len(xyz)):
        at = places_in(xyz[part], frame, extent, shape[1])
        rows = np.flatnonzero((z[part] == lowest[at]) & (z[part] < np.inf))
        found.append(part.start + rows)
        cells.append(at[rows])
    rows = np.concatenate(found)
    order = by_position(xyz[rows])
    first, last = np.full(len(lowest), len(rows), np.int32), np.arange(len(rows))[::-1]
    first[np.concatenate(cells)[order[last]]] = last  # of repeated cells the last one written stays
    return lowest, first, rows[order]
