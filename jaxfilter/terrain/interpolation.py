"""Heights between scattered ground points: linear in a TIN, inverse distance, natural neighbour and kriging.

Positions are local metres. Ground points are distinct in x and y and in canonical order (``core/points.py``), three or
more and not on a line. Each interpolator is prepared once and then asked for heights at f64[q, 2], block by block.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.spatial import ConvexHull, Delaunay

from ..core.cloud import QUANTUM
from ..core.errors import InputError, ParameterError
from ..core.points import morton
from ..engines.neighbours import nearest, tree_of
from ..engines.tin.triangulation import Tin

Heights = Callable[[np.ndarray], np.ndarray]
"""From positions f64[q, 2] to heights f64[q], local metres; NaN where the method gives none."""

METHODS = ("tin", "idw", "natural", "kriging")


@dataclasses.dataclass(frozen=True)
class Interpolation:
    """How heights between ground points are found.

    Attributes:
        method: ``"tin"``, linear in the triangles of the Delaunay triangulation; ``"natural"``, natural neighbour (needs
            startinpy); ``"idw"``, inverse distance; ``"kriging"``, ordinary kriging with a linear variogram.
        max_gap: cells whose centre is farther than this from every ground point get no height, in units of the coordinates;
            None: the ground is bridged under buildings and water of any size.
        fill: give cells outside the convex hull of the ground points a height too: that of the nearest ground point, or
            what ``"idw"`` and ``"kriging"`` find there.
        neighbours: of ``"idw"`` and ``"kriging"``: how many of the nearest ground points decide a height.
        power: of ``"idw"``: weights are distance to the power of -``power``.

    Raises: ParameterError for values out of range.

    >>> jf.dtm_rmse(cloud, truth, cell=5.0, interpolation=jf.Interpolation("idw", neighbours=6)).rmse
    0.0
    """

    method: str = "tin"
    max_gap: float | None = None
    fill: bool = False
    neighbours: int = 12
    power: float = 2.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ParameterError(f"method={self.method!r}: choose one of {', '.join(METHODS)}")
        for name in ("max_gap", "power"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ParameterError(f"{name}={value!r} must be a positive number")
        if self.neighbours < 1:
            raise ParameterError(f"neighbours={self.neighbours!r} must be at least 1")


def surface_through(xyz: np.ndarray, interpolation: Interpolation, workers: int | None = None) -> Heights:
    """The surface through ground points f32[m, 3]; ``workers``: threads, by default one per core.

    Raises: ImportError, naming the extra, if ``"natural"`` is asked for without startinpy.
    """
    if interpolation.method == "tin":
        return Linear(xyz, workers)
    if interpolation.method == "idw":
        return _inverse_distance(xyz, interpolation.neighbours, interpolation.power, workers)
    return _natural_neighbour(xyz) if interpolation.method == "natural" else _kriging(xyz, interpolation.neighbours)


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
        try:
            with ThreadPoolExecutor(self._threads) as pool:
                self._tin = Tin(xyz, np.zeros(len(xyz), np.int32), np.arange(len(xyz)), pool, self._threads)
        except ValueError as error:  # the corner of a cloud may be farther
            raise InputError(f"ground points: {error}, or leave out stray ones") from error
        self._inside = inside_hull(xyz)
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
        start = np.searchsorted(self._code, morton(np.maximum(at, 0.0)))
        with ThreadPoolExecutor(self._threads) as self._tin.pool:
            near = self._order[np.minimum(start, len(self._xy) - 1)]
            tri = self._tin.walk(at, self._tin.where[near])
            beyond = np.flatnonzero(tri < 0)
            tri[beyond] = -1 - tri[beyond]
            nodes = self._tin.corners(tri)
        first, second, third = np.take(self._xy, nodes.T, axis=0)
        outside = beyond[~self._inside(at[beyond])] if on_hull else beyond
        return nodes, outside, first, (second - first).T, (third - first).T


def _inverse_distance(xyz: np.ndarray, neighbours: int, power: float, workers: int | None) -> Heights:
    """Mean of the nearest ground points, weighted by a power of their distance (Shepard 1968); defined everywhere."""
    tree, z = tree_of(xyz[:, :2]), xyz[:, 2].astype(np.float64)
    count = min(neighbours, len(z))

    def heights(at: np.ndarray) -> np.ndarray:
        distance, index = nearest(tree, at, count, np.inf, workers)
        closest = np.maximum(distance[:, :1], QUANTUM / 1024)
        weight = (np.maximum(distance, closest) / closest) ** -power  # the nearest has weight 1: no overflow
        return (weight * z[index]).sum(axis=1) / weight.sum(axis=1)

    return heights


def _natural_neighbour(xyz: np.ndarray) -> Heights:
    """Natural neighbour interpolation (Sibson 1981) by startinpy; NaN outside the convex hull.

    Where the library finds no bounded Voronoi cell, at the very edge of the hull, the height is linear in the triangle.
    """
    try:
        import startinpy
    except ImportError as error:
        raise ImportError("method='natural' needs startinpy: pip install 'jaxfilter[natural]'") from error
    mesh = startinpy.DT()
    mesh.snap_tolerance = QUANTUM / 8  # its own default would merge points that are one quantum apart
    mesh.insert(xyz.astype(np.float64))

    def heights(at: np.ndarray) -> np.ndarray:
        out = mesh.interpolate({"method": "NNI"}, at)
        rest = np.isnan(out)
        if rest.any():
            out[rest] = mesh.interpolate({"method": "TIN"}, at[rest])
        return out

    return heights


def _kriging(xyz: np.ndarray, neighbours: int) -> Heights:
    """Ordinary kriging in a moving neighbourhood, linear variogram without nugget; defined everywhere.

    The kernel -|h| with an unknown constant is that kriging system, whose solution does not depend on the slope of the
    variogram: there is nothing to fit.
    """
    return RBFInterpolator(
        xyz[:, :2].astype(np.float64), xyz[:, 2].astype(np.float64),
        neighbors=min(neighbours, len(xyz)), kernel="linear", degree=0,
    )  # fmt: skip


def inside_hull(xyz: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """A function from positions f64[q, 2] to bool[q]: within the convex hull of the points [m, >=2]."""
    xy = xyz[:, :2].astype(np.float64)
    corners = xy[ConvexHull(xy - xy.mean(axis=0)).vertices]
    middle = corners.mean(axis=0)
    mesh = Delaunay(corners - middle)
    return lambda at: mesh.find_simplex(at - middle, tol=1e-9) >= 0


def nearest_point(
    xyz: np.ndarray, workers: int | None = None, radius: float = np.inf
) -> Callable[[np.ndarray], tuple[np.ndarray, ...]]:
    """A function from positions f64[q, 2] to the distance f64[q] and the index i64[q] of the nearest point within a radius; the
    distance is infinite where there is none."""
    tree = tree_of(xyz[:, :2])
    return lambda at: tuple(found[:, 0] for found in nearest(tree, at, 1, radius, workers))
