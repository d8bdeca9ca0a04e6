"""Heights above ground of points that may be plants, and which of these lie on roofs."""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy

from ..core.cloud import PointCloud
from ..core.grid import grid_over
from ..core.points import canonical_points
from ..engines.neighbours import nearest, tree_of
from ..engines.tin.linear import Linear

RADIUS = 20.0
"""Metres: radius of the circles through the corners of triangles of the ground that count; wider voids have no height."""
REACH = 2 * RADIUS
"""Metres within which all ground lies that decides a height."""
_SIDE, _SPACINGS, _TOP, _LEAST, _SMOOTH, _ROOF = 1.0, 1.5, 1.0, 8, 0.2, 2.0
"""Of roofs: side of a cell in metres, or in spacings, to half a metre, where that is more; metres below the highest point of its
cell down to which a point is of the surface on top; points of it in a block of 3 x 3 cells; metres by which these scatter about a
plane at most; and metres above the ground. ``_TOP`` and ``_SMOOTH`` are the best of seven settings on eleven labelled tiles."""


def heights_near(cloud: PointCloud, ground: np.ndarray, rows: np.ndarray, workers: int | None = None) -> np.ndarray:
    """f64[k]: metres above the ground, bool[n], of the points ``rows``, i64[k]; NaN over voids of the ground.

    Linear in the triangles of the ground points whose circles are no larger than :data:`RADIUS`, and elsewhere above the nearest
    ground point as near as that. So no ground farther than :data:`REACH` counts, and tiles give the heights of the whole.
    """
    points = canonical_points(dataclasses.replace(cloud, candidate=ground))
    if not len(points):
        return np.full(len(rows), np.nan)
    xyz = points.xyz[np.append(True, (np.diff(points.xyz[:, :2], axis=0) != 0).any(axis=1))]  # the lowest of a position
    at, z = cloud.xyz[rows, :2].astype(np.float64), np.full(len(rows), np.nan)
    if points.has_area():
        low, high = xyz[:, :2].min(axis=0) - 1.0, xyz[:, :2].max(axis=0) + 1.0
        z = Linear(xyz, workers).within(np.clip(at, low, high), RADIUS)
    rest = np.flatnonzero(np.isnan(z))
    distance, index = nearest(tree_of(xyz[:, :2]), at[rest], 1, RADIUS, workers)
    found = np.isfinite(distance[:, 0])
    z[rest[found]] = xyz[index[found, 0], 2]
    return np.asarray(cloud.xyz[rows, 2] - z)


def on_planes(cloud: PointCloud, rows: np.ndarray, height: np.ndarray) -> np.ndarray:
    """bool[k]: which of the points ``rows``, i64[k], with heights above ground f[k], lie as high as roofs and in a block of cells
    whose surface on top is smooth: its points scatter little about the plane of least squares through them, however steep it is.

    Cells count from the anchor. A cell at the edge of a roof, or at its ridge, is in one of nine blocks that holds one plane.
    """
    high = np.flatnonzero(height >= _ROOF)
    out = np.zeros(len(rows), bool)
    if len(high) < _LEAST:
        return out
    side = max(_SIDE, round(2 * _SPACINGS * canonical_points(cloud).spacing()) / 2)  # the same for all parts
    xyz = cloud.xyz[rows[high]].astype(np.float64)
    grid = grid_over(xyz, side, cloud.grid_offset(side), name="cells of roofs")
    cell = grid.flat(xyz)
    top = np.full(grid.ny * grid.nx, -np.inf)
    np.maximum.at(top, cell, xyz[:, 2])
    above = xyz[:, 2] >= top[cell] - _TOP
    x, y, z = (xyz[above] - xyz.mean(axis=0)).T

    def block(values: np.ndarray | None) -> np.ndarray:
        sums = np.bincount(cell[above], values, minlength=len(top)).astype(np.float64).reshape(grid.shape)
        for axis in range(2):
            sums = scipy.ndimage.convolve1d(sums, [1.0, 1.0, 1.0], axis, mode="constant")
        return sums

    n = block(None)
    count = np.maximum(n, 1)
    mx, my, mz = (block(values) / count for values in (x, y, z))
    xx, yy, zz = block(x * x) / count - mx**2, block(y * y) / count - my**2, block(z * z) / count - mz**2
    xy, xz, yz = block(x * y) / count - mx * my, block(x * z) / count - mx * mz, block(y * z) / count - my * mz
    area = xx * yy - xy**2
    wide = (n >= _LEAST) & (area > (side / 4) ** 4)
    rest = zz - (xz**2 * yy - 2 * xz * yz * xy + yz**2 * xx) / np.where(wide, area, 1.0)
    smooth = wide & (rest * n <= _SMOOTH**2 * (n - 3))
    out[high] = scipy.ndimage.maximum_filter(smooth, 3, mode="constant").ravel()[cell]
    return out
