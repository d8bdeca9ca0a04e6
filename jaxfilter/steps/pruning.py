"""Vertices that stick out of a triangulation of ground, by the scatter of the scene and of their neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engines.tin.ground import GroundTin
from ..engines.tin.triangulation import Tin

VEIL = 2.0
"""Points that are no ground for each vertex, above which the ground is veiled."""
EDGES_AROUND = 3
"""Edges from a vertex to the farthest of those around it."""
PASSES = 3
"""Times that vertices are judged where plants hide the ground: beside high plants those that are less high do not stick out."""
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
    def from_vertices(cls, tin: Tin) -> Scatter:
        """Measure all vertices of a triangulation with threads at work."""
        return cls(*(np.zeros(len(tin.xyz), np.float32) for _ in cls._fields)).measure_again(tin, tin.vertex)

    def measure_again(self, tin: Tin, among: np.ndarray) -> Scatter:
        """With the vertices ``among``, bool[m], measured once more."""
        from ..engines.tin.rings import residuals, roughness  # imports Numba

        out, nodes = Scatter(*(values.copy() for values in self)), np.flatnonzero(tin.vertex & among)
        tables = tin.triangles, tin.neighbours, tin.where
        parts = np.array_split(nodes, len(nodes) // _AT_ONCE + tin.workers)
        list(tin.pool.map(lambda part: residuals(tin.xyz, *tables, part, out.residual), parts))
        list(tin.pool.map(lambda part: roughness(*tables, part, *out), parts))
        return out

    def at_all_points(self, ground: GroundTin) -> Scatter:
        """Over the triangulation as it is: points that are no vertex have no residual, and the mean roughness at the corners of
        their facet."""
        around, tin = self.roughness.copy(), ground.tin
        tin.locate(np.flatnonzero(ground.ground & ~tin.vertex))  # the others are up to date
        ground.locate_outside()
        rows = np.flatnonzero(~tin.vertex)
        around[rows] = around[tin.corners(tin.where[rows])].mean(axis=1)
        return Scatter(np.where(tin.vertex, self.residual, 0), around)

    def deviation(self, tin: Tin) -> float:
        """Metres: the standard deviation of the residuals of vertices, as 1.4826 times their median absolute value."""
        return 1.4826 * float(np.median(np.abs(self.residual[np.flatnonzero(tin.vertex)])))


def overgrown(ground: GroundTin, scatter: Scatter, least: np.ndarray) -> np.ndarray:
    """f32[m]: metres by which vertices stick out more than those beside them, and more than ``least``, f32[m], metres, where
    there are more than :data:`VEIL` points that are no ground for each vertex at most :data:`EDGES_AROUND` edges away. Elsewhere
    zero or less."""
    from ..engines.tin.rings import surroundings  # imports Numba

    tin, over = ground.tin, scatter.residual - np.maximum(least, scatter.roughness)
    nodes = np.flatnonzero(tin.vertex & (over > 0))
    if len(nodes) == 0:
        return over
    others = ground.rest
    tin.locate(others)
    above = np.bincount(tin.corners(tin.where[others])[:, 0], minlength=len(over)).astype(np.float32)
    means = np.empty(len(nodes), np.float32)
    surroundings(tin.triangles, tin.neighbours, tin.where, nodes, EDGES_AROUND, above, means)
    over[nodes[means <= VEIL]] = 0
    return over


def prune(ground: GroundTin, scatter: Scatter, scene: float, local: float, least: np.ndarray) -> int:
    """Drop vertices that stick out of the plane of their neighbours, but those on the hull; how many.

    Those are dropped that lie more than ``scene`` metres above it, and more than ``local`` times the root mean square among
    the neighbours. Where plants hide the ground, those that are :func:`overgrown`: ``least``: f32[m], metres, infinite elsewhere.
    They are judged :data:`PASSES` times, by the vertices that are left.
    """
    tin, dropped = ground.tin, 0
    inner = np.ones(len(tin.xyz), bool)
    ghosts = tin.triangles[np.flatnonzero(tin.triangles.ravel() == -1) // 3]
    inner[ghosts[ghosts >= 0]] = False
    over = scatter.residual - np.maximum(np.float32(scene), np.float32(local) * scatter.roughness)
    for left in range(PASSES, 0, -1):
        over = np.maximum(over, overgrown(ground, scatter, least))
        drop = np.flatnonzero(tin.vertex & inner & (over > 0))
        ground.margin[drop], dropped = over[drop], dropped + len(drop)
        ground.drop(drop)
        if left == 1 or len(drop) == 0 or not np.isfinite(least).any():
            break
        scatter, over = scatter.measure_again(tin, np.isfinite(least)), np.zeros_like(over)
    return dropped
