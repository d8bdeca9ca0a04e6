"""A smooth surface through the low parts of a point cloud."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def low_trend(xyz: np.ndarray, x0: float, y0: float, size: float) -> np.ndarray:
    """f32[m], metres: the trend of the low terrain at f32[m, 3] local points, none of them west or south of (x0, y0).

    The minima of cells of ``size`` metres are replaced by the median and then by the mean of three by three of them, and
    interpolated bilinearly. Lone low cells and buildings up to about ``size`` across do not bend it.
    """
    x = (xyz[:, 0] - np.float32(x0)) / np.float32(size)
    y = (xyz[:, 1] - np.float32(y0)) / np.float32(size)
    nx, ny = int(x.max()) + 1, int(y.max()) + 1
    low = np.full((ny, nx), np.inf, np.float32)
    np.minimum.at(low, (y.astype(np.int32), x.astype(np.int32)), xyz[:, 2])
    empty = ~np.isfinite(low)
    if empty.any():
        row, column = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
        low = low[row, column]
    low = ndimage.uniform_filter(ndimage.median_filter(low, 3, mode="nearest"), 3, mode="nearest")
    node = np.pad(low, 1, mode="edge").ravel()
    x += np.float32(0.5)
    y += np.float32(0.5)
    column, row = x.astype(np.int32), y.astype(np.int32)
    x -= column
    y -= row
    corner = row * (nx + 2) + column
    south = node[corner] * (1 - x) + node[corner + 1] * x
    north = node[corner + nx + 2] * (1 - x) + node[corner + nx + 3] * x
    return south * (1 - y) + north * y


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
