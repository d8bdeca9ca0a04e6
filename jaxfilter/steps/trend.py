"""A smooth surface through the low parts of a point cloud."""

from __future__ import annotations

import numpy as np

from ..core.frame import ends
from ..core.grid import Grid
from ..core.points import pieces
from ..engines.grid.cells import lowest_in_cells
from ..engines.grid.sparse import CellSet

_MARGIN = 3  # cells around those with points: one each for interpolation, mean and median


def low_trend(xyz: np.ndarray, x0: float, y0: float, size: float) -> np.ndarray:
    """f32[m], metres: the trend of the low terrain at f32[m, 3] local points, none of them west or south of (x0, y0).

    The minima of cells of ``size`` metres are replaced by the median and then by the mean of three by three of them, and
    interpolated bilinearly. Lone low cells and buildings up to about ``size`` across do not bend it.
    """
    corner, high = np.array([x0, y0], np.float32), ends(xyz[:, :2])[1]

    def steps(xy: np.ndarray, lag: float) -> tuple[np.ndarray, np.ndarray]:
        x, y = ((xy[..., axis] - corner[axis]) / np.float32(size) + np.float32(lag) for axis in range(2))
        return y, x

    def cells(lag: float) -> tuple[CellSet, np.ndarray]:
        def places(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            y, x = steps(part, lag)
            return y.astype(np.int32), x.astype(np.int32)

        rows, columns = (int(last) + 1 for last in steps(high, lag))
        return CellSet.of(Grid(x0 - lag * size, y0 - lag * size, size, columns, rows), xyz, places)

    occupied, at = cells(0.0)
    low, _ = lowest_in_cells(at, xyz[:, 2], len(occupied), rows=False)
    smooth, level = _smoothed(occupied, np.append(low, np.float32(np.inf)))
    between, at = cells(0.5)  # the squares between four centres
    nodes = [
        level[_clamped(smooth, between.row + dy, between.column + dx)]
        for dy, dx in ((-1, -1), (-1, 0), (0, -1), (0, 0))
    ]
    trend = np.empty(len(xyz), np.float32)
    for part in pieces(len(xyz)):
        y, x = steps(xyz[part], 0.5)
        x -= x.astype(np.int32).astype(np.float32)
        y -= y.astype(np.int32).astype(np.float32)
        southwest, southeast, northwest, northeast = (node[at[part]] for node in nodes)
        south = southwest * (1 - x) + southeast * x
        north = northwest * (1 - x) + northeast * x
        trend[part] = south * (1 - y) + north * y
    return trend


def _smoothed(occupied: CellSet, low: np.ndarray) -> tuple[CellSet, np.ndarray]:
    """The cells with points and those beside them, and f32[n], the smooth level of each; ``low``: f32[cells + 1].

    Cells without points have the value of the nearest with points, of equally near ones the westernmost, then the
    southernmost. What is beyond the border of the grid is as its nearest cell inside.
    """
    wide = occupied.grown(_MARGIN)
    filled = np.full(len(wide), np.inf, np.float32)
    missing = np.arange(len(wide))
    for dy, dx in _OFFSETS:
        filled[missing] = low[occupied.find(wide.row[missing] + dy, wide.column[missing] + dx)]
        missing = missing[np.isinf(filled[missing])]
    middle = occupied.grown(_MARGIN - 1)
    nine = [filled[_clamped(wide, middle.row + dy, middle.column + dx)] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    median = np.sort(np.stack(nine), axis=0)[4]
    smooth = occupied.grown(_MARGIN - 2)
    columns = []
    for dx in (-1, 0, 1):
        three = [median[_clamped(middle, smooth.row + dy, smooth.column + dx)].astype(np.float64) for dy in (-1, 0, 1)]
        columns.append(((three[0] + three[1] + three[2]) / 3).astype(np.float32).astype(np.float64))
    return smooth, ((columns[0] + columns[1] + columns[2]) / 3).astype(np.float32)


def _clamped(cells: CellSet, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return cells.find(np.clip(row, 0, cells.grid.ny - 1), np.clip(column, 0, cells.grid.nx - 1))


def _near_first(reach: int) -> list[tuple[int, int]]:
    """Offsets (rows, columns) to all cells that may be nearest to one with another at most ``reach`` rows and columns away."""
    far = 2 * reach**2
    steps = range(-int(far**0.5), int(far**0.5) + 1)
    offsets = [(dy, dx) for dy in steps for dx in steps if dy * dy + dx * dx <= far]
    return sorted(offsets, key=lambda s: (s[0] ** 2 + s[1] ** 2, s[1], s[0]))


_OFFSETS = _near_first(_MARGIN)


def quadratic_trend(xyz: np.ndarray, size: float) -> np.ndarray:
    """f32[m], metres: one surface of second order through f32[m, 3] local points, after Uray & Varlik (2024).

    It has the least squares of vertical distances from the mean points of the cells of ``size`` metres. With fewer than
    six cells, or cells on a line, which do not determine it, the surface of least coefficients is taken.
    """
    cell = np.floor(xyz[:, :2] / np.float32(size)).astype(np.int64)
    _, member = np.unique(cell[:, 0] * (int(cell[:, 1].max()) + 1) + cell[:, 1], return_inverse=True)
    count = np.bincount(member)
    mean = np.column_stack([np.bincount(member, xyz[:, axis]) / count for axis in range(3)])
    centre, scale = mean[:, :2].mean(axis=0), max(float(np.ptp(mean[:, :2], axis=0).max()), size)

    def terms(xy: np.ndarray) -> np.ndarray:
        x, y = ((xy - centre) / scale).T
        return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    coefficient = np.linalg.lstsq(terms(mean[:, :2]), mean[:, 2], rcond=None)[0]
    return (terms(xyz[:, :2].astype(np.float64)) @ coefficient).astype(np.float32)
