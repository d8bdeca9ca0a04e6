"""Vertices that stick out of a triangulation of ground, by the scatter of the scene and of their neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engines.tin.ground import GroundTin
from ..engines.tin.triangulation import Tin

ROUGH, ROUGHLY = 0.4, 0.6
"""A vertex is rough by such a share of its limit of distance, and overgrown where such a share of those around it are rough."""
VEIL = 3.0
"""Points that are no ground for each vertex, above which the ground is veiled."""
AROUND = 3
"""Edges from a vertex to the farthest of those around it."""
_AT_ONCE = 2**17
"""Vertices that are measured by one call."""


class Scatter(NamedTuple):
    """How the vertices of a triangulation scatter, f32[m] each, metres; zero for points that are no vertices.

    Attributes:
        residual: above the plane of the neighbours in the triangulation, and those across the edges that face the vertex.
        roughness: root mean square of that among these neighbours.
    """

    residual: np.ndarray
    roughness: np.ndarray

    @classmethod
    def of(cls, tin: Tin) -> Scatter:
        """Measure all vertices of a triangulation with threads at work."""
        from ..engines.tin.rings import residuals, roughness  # imports Numba

        out, nodes = cls(*(np.zeros(len(tin.xyz), np.float32) for _ in cls._fields)), np.flatnonzero(tin.vertex)
        tables = tin.triangles, tin.neighbours, tin.where
        parts = np.array_split(nodes, len(nodes) // _AT_ONCE + tin.workers)
        list(tin.pool.map(lambda part: residuals(tin.xyz, *tables, part, out.residual), parts))
        list(tin.pool.map(lambda part: roughness(*tables, part, *out), parts))
        return out

    def of_all(self, ground: GroundTin) -> Scatter:
        """Over the triangulation as it is: points that are no vertex have no residual, and the mean roughness at the corners of
        their facet."""
        around, tin = self.roughness.copy(), ground.tin
        tin.locate(np.flatnonzero(ground.ground & ~tin.vertex))  # the others are up to date
        ground.locate_outside()
        rows = np.flatnonzero(~tin.vertex)
        around[rows] = around[tin.corners(tin.where[rows])].mean(axis=1)
        return Scatter(np.where(tin.vertex, self.residual, 0), around)

    def of_scene(self, tin: Tin) -> float:
        """Metres: the standard deviation of the residuals of vertices, as 1.4826 times their median absolute value."""
        return 1.4826 * float(np.median(np.abs(self.residual[np.flatnonzero(tin.vertex)])))


def overgrown(ground: GroundTin, scatter: Scatter, limit: np.ndarray) -> np.ndarray:
    """f32[m]: metres by which vertices stick out more than those beside them where even the lowest points scatter as plants do.

    There most vertices within three edges are rough: they lie farther from the plane of their neighbours, above or below, than
    :data:`ROUGH` times ``limit``, f32[m], metres, from which on points are too far to join; and most points are no ground.
    Elsewhere, and of vertices that are not rough, it is zero or less.
    """
    from ..engines.tin.rings import surroundings  # imports Numba

    tin, least = ground.tin, np.float32(ROUGH) * limit
    nodes = np.flatnonzero(tin.vertex & (scatter.residual > np.maximum(least, scatter.roughness)))
    others = ground.rest
    values = np.zeros((len(tin.xyz), 2), np.float32)
    values[:, 0] = np.abs(scatter.residual) > least
    values[:, 1] = np.bincount(tin.corners(tin.where[others])[:, 0], minlength=len(values))
    means, over = np.empty((len(nodes), 2), np.float32), np.zeros(len(values), np.float32)
    surroundings(tin.triangles, tin.neighbours, tin.where, nodes, AROUND, values, means)
    nodes = nodes[(means[:, 0] > ROUGHLY) & (means[:, 1] > VEIL)]
    over[nodes] = (scatter.residual - np.maximum(least, scatter.roughness))[nodes]
    return over


def prune(
    ground: GroundTin, scatter: Scatter, scene: float, local: float, limit: np.ndarray, among: np.ndarray | bool = True
) -> int:
    """Drop vertices that stick out of the plane of their neighbours, but those on the hull; how many.

    Those are dropped that lie more than ``scene`` metres above it, and more than ``local`` times the root mean square among
    the neighbours. ``among``: bool[m], the others stay.
    """
    tin = ground.tin
    nodes = np.flatnonzero(tin.vertex)
    inner = np.ones(len(tin.xyz), bool)
    ghosts = tin.triangles[np.flatnonzero(tin.triangles.ravel() == -1) // 3]
    inner[ghosts[ghosts >= 0]] = False
    over = scatter.residual - np.maximum(np.float32(scene), np.float32(local) * scatter.roughness)
    over = np.maximum(over, overgrown(ground, scatter, limit))
    drop = nodes[(inner & among)[nodes] & (over[nodes] > 0)]
    ground.margin[drop] = over[drop]
    ground.drop(drop)
    return len(drop)
