"""The surface that is linear in the triangles of points."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import shapely

from ...core.points import morton
from .triangulation import triangulated


class Linear:
    """Linear on the triangles of the Delaunay triangulation; NaN outside the convex hull.

    Positions are located to a quantum. One that is inside the hull and by that just outside its triangles belongs to the
    triangle behind the nearest edge, as does one that is on the hull.
    """

    def __init__(self, xyz: np.ndarray, workers: int | None) -> None:
        """``xyz``: f32[m, 3], the ground points. Raises: InputError if they are too far apart."""
        self._threads = workers or os.cpu_count() or 1
        code = morton(xyz)
        self._order = np.argsort(code, kind="stable")  # points of a cloud with an anchor are in another order
        self._code = code[self._order]
        self._tin = triangulated(xyz, workers)
        self._tin.workers = self._threads
        self._inside = inside_hull(xyz)
        self._found: tuple[np.ndarray, bool, tuple[np.ndarray, ...]] | None = None  # of the positions asked for last
        self._xy, self._z = xyz[:, :2].astype(np.float64), xyz[:, 2].astype(np.float64)

    def __call__(self, at: np.ndarray) -> np.ndarray:
        """f64[q]: the heights at f64[q, 2]."""
        return self._heights(at, *self._triangles(at))

    def circles(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres f64[q, 2] and radii f64[q] of the circles through the corners of the triangles at f64[q, 2]: further ground
        points change heights only from inside of these. Infinite radii outside the convex hull."""
        return self._circles(*self._triangles(at))

    def within(self, at: np.ndarray, radius: float) -> np.ndarray:
        """f64[q]: the heights at f64[q, 2] in triangles whose circle through the corners has at most a radius, metres; NaN in
        others, and on the convex hull. No point farther from a position than twice the radius has a part in it."""
        found = self._triangles(at, on_hull=False)
        return np.where(self._circles(*found)[1] <= radius, self._heights(at, *found), np.nan)

    def _heights(self, at: np.ndarray, nodes: np.ndarray, outside: np.ndarray, *corners: np.ndarray) -> np.ndarray:
        first, (x1, y1), (x2, y2) = corners
        level, (x, y) = self._z[nodes], (at - first).T
        area = x1 * y2 - x2 * y1
        second, third = (x * y2 - x2 * y) / area, (x1 * y - x * y1) / area
        out = level[:, 0] + second * (level[:, 1] - level[:, 0]) + third * (level[:, 2] - level[:, 0])
        out[outside] = np.nan
        return np.clip(out, level.min(axis=1), level.max(axis=1))

    @staticmethod
    def _circles(_: np.ndarray, outside: np.ndarray, *corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first, (x1, y1), (x2, y2) = corners
        one, two, area = x1 * x1 + y1 * y1, x2 * x2 + y2 * y2, 2 * (x1 * y2 - x2 * y1)
        middle = np.column_stack([(y2 * one - y1 * two) / area, (x1 * two - x2 * one) / area])
        radius = np.hypot(middle[:, 0], middle[:, 1])
        radius[outside] = np.inf
        return middle + first, radius

    def _triangles(self, at: np.ndarray, on_hull: bool = True) -> tuple[np.ndarray, ...]:
        """i64[q, 3], the corners of the triangles at f64[q, 2]; the numbers of positions outside the hull, and unless ``on_hull``
        of those on it; f64[q, 2], the first corners, and f64[2, q] from these to the second and to the third."""
        if self._found is not None and self._found[0] is at and self._found[1] == on_hull:
            return self._found[2]
        start = np.searchsorted(self._code, morton(np.maximum(at, 0.0)))
        with ThreadPoolExecutor(self._threads) as self._tin.pool:
            near = self._order[np.minimum(start, len(self._xy) - 1)]
            tri = self._tin.walk(at, self._tin.where[near])
            beyond = np.flatnonzero(tri < 0)
            tri[beyond] = -1 - tri[beyond]
            nodes = self._tin.corners(tri)
        first, second, third = np.take(self._xy, nodes.T, axis=0)
        outside = beyond[~self._inside(at[beyond])] if on_hull else beyond
        found = nodes, outside, first, (second - first).T, (third - first).T
        self._found = at, on_hull, found
        return found


def inside_hull(xyz: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A function from positions f64[q, 2] to bool[q]: within the convex hull of the points [m, >=2], or on its edge."""
    xy = xyz[:, :2].astype(np.float64)
    near = 1e-9 * float(np.ptp(xy, axis=0).max())
    hull = shapely.linestrings(xy).convex_hull.buffer(near, join_style="mitre")
    shapely.prepare(hull)
    return lambda at: shapely.intersects_xy(hull, at)
