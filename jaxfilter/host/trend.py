"""A smooth surface through the low parts of a point cloud."""

from __future__ import annotations

import numpy as np

from .cells import Cells

_MARGIN = 3  # cells around those with points: one each for interpolation, mean and median


def low_trend(xyz: np.ndarray, x0: float, y0: float, size: float) -> np.ndarray:
    """f32[m], metres: the trend of the low terrain at f32[m, 3] local points, none of them west or south of (x0, y0).

    The minima of cells of ``size`` metres are replaced by the median and then by the mean of three by three of them, and
    interpolated bilinearly. Lone low cells and buildings up to about ``size`` across do not bend it.
    """
    x = (xyz[:, 0] - np.float32(x0)) / np.float32(size)
    y = (xyz[:, 1] - np.float32(y0)) / np.float32(size)
    row, column = y.astype(np.int32), x.astype(np.int32)
    occupied, at = Cells.of(row, column, (int(row.max()) + 1, int(column.max()) + 1))
    low = np.full(len(occupied) + 1, np.inf, np.float32)
    np.minimum.at(low, at, xyz[:, 2])
    smooth, level = _smoothed(occupied, low)
    x += np.float32(0.5)
    y += np.float32(0.5)
    row, column = y.astype(np.int32), x.astype(np.int32)
    x -= column.astype(np.float32)
    y -= row.astype(np.float32)
    between, at = Cells.of(row, column, (int(row.max()) + 1, int(column.max()) + 1))  # the squares between four centres

    def node(dy: int, dx: int) -> np.ndarray:
        return level[_clamped(smooth, between.row + (dy - 1), between.column + (dx - 1))][at]

    south = node(0, 0) * (1 - x) + node(0, 1) * x
    north = node(1, 0) * (1 - x) + node(1, 1) * x
    return south * (1 - y) + north * y


def _smoothed(occupied: Cells, low: np.ndarray) -> tuple[Cells, np.ndarray]:
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


def _clamped(cells: Cells, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return cells.find(np.clip(row, 0, cells.shape[0] - 1), np.clip(column, 0, cells.shape[1] - 1))


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
