"""Heights between scattered ground points: linear in a TIN, inverse distance, natural neighbour and kriging.

Positions are local metres. Ground points are distinct in x and y and in canonical order (``core/points.py``), three or
more and not on a line. Each interpolator is prepared once and then asked for heights at f64[q, 2], block by block.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from ..core.cloud import QUANTUM
from ..core.errors import ParameterError, check_choice, check_positive, check_whole
from ..core.filter import check_resources
from ..engines.neighbours import nearest, tree_of
from ..engines.tin.linear import Linear as Linear
from ..engines.tin.linear import inside_hull as inside_hull

Heights = Callable[[np.ndarray], np.ndarray]
"""From positions f64[q, 2] to heights f64[q], local metres; NaN where the method gives none."""

LARGEST_EDGE = 1000.0
"""Metres, of ``max_edge``."""
METHODS = ("tin", "idw", "natural", "kriging")


@dataclasses.dataclass(frozen=True)
class Interpolation:
    """How heights between ground points are found.

    Attributes:
        method: ``"tin"``, linear in the triangles of the Delaunay triangulation; ``"natural"``, natural neighbour (needs
            startinpy); ``"idw"``, inverse distance; ``"kriging"``, ordinary kriging with a linear variogram.
        max_gap: cells whose centre is farther than this from every ground point get no height, in units of the coordinates;
            None: the ground is bridged under buildings and water of any size.
        max_edge: metres: at the edge of the ground, the surface ends where points are farther apart than this; a disc of this
            diameter rolls around them from outside, and cells that it covers get no height. Voids that it does not reach are
            bridged. None: 5 m and three times the spacing of the ground points; ``math.inf``: it ends at the convex hull.
        fill: give cells outside the convex hull of the ground points a height too: that of the nearest ground point, or
            what ``"idw"`` and ``"kriging"`` find there.
        neighbours: of ``"idw"`` and ``"kriging"``: how many of the nearest ground points decide a height.
        power: of ``"idw"``: weights are distance to the power of -``power``.
        level_water: give water its level, where a filter has found it, or points of class 9 say where it is.

    Raises: ParameterError for values out of range.

    >>> jf.dtm_rmse(cloud, truth, cell=5.0, interpolation=jf.Interpolation("idw", neighbours=6)).rmse
    0.0
    """

    method: str = "tin"
    max_gap: float | None = None
    max_edge: float | None = None
    fill: bool = False
    neighbours: int = 12
    power: float = 2.0
    level_water: bool = True

    def __post_init__(self) -> None:
        check_choice(METHODS, method=self.method)
        check_positive(max_gap=self.max_gap, power=self.power)
        if self.max_edge != math.inf:
            check_positive(" of metres", max_edge=self.max_edge)
            if (self.max_edge or 0) > LARGEST_EDGE:
                raise ParameterError(
                    f"max_edge={self.max_edge!r}: is at most {LARGEST_EDGE:g} m; pass inf for no limit"
                )
        check_whole(neighbours=self.neighbours)

    @property
    def ends(self) -> bool:
        """Whether there is an edge, beyond which nothing has a value."""
        return not self.fill and self.max_edge != math.inf


def surface_through(xyz: np.ndarray, interpolation: Interpolation, workers: int | None = None) -> Heights:
    """The surface through ground points f32[m, 3]; ``workers``: threads, by default one per core.

    Raises: ParameterError for threads that are none; ImportError, naming the extra, if ``"natural"`` is asked for without
        startinpy.
    """
    check_resources(workers)
    if interpolation.method == "tin":
        return Linear(xyz, workers)
    if interpolation.method == "idw":
        return _inverse_distance(xyz, interpolation.neighbours, interpolation.power, workers)
    if interpolation.method == "natural":
        return _natural_neighbour(xyz)
    from scipy.interpolate import RBFInterpolator  # late: it takes a quarter of a second

    # Ordinary kriging in a moving neighbourhood, linear variogram without nugget: the kernel -|h| with an unknown constant. The
    # solution does not depend on the slope of the variogram: there is nothing to fit.
    near, xyz = min(interpolation.neighbours, len(xyz)), xyz.astype(np.float64)
    return RBFInterpolator(xyz[:, :2], xyz[:, 2], neighbors=near, kernel="linear", degree=0)


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


def nearest_point(
    xyz: np.ndarray, workers: int | None = None, radius: float = np.inf
) -> Callable[[np.ndarray], tuple[np.ndarray, ...]]:
    """A function from positions f64[q, 2] to the distance f64[q] and the index i64[q] of the nearest point within a radius; the
    distance is infinite where there is none. Raises: ParameterError for threads that are none."""
    check_resources(workers)
    tree = tree_of(xyz[:, :2])
    return lambda at: tuple(found[:, 0] for found in nearest(tree, at, 1, radius, workers))
