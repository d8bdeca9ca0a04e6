"""Vertices that stick out of a triangulation of ground, by the scatter of the scene and of their neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engines.tin.ground import GroundTin
from ..engines.tin.triangulation import Tin

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

    def deviation(self, tin: Tin) -> float:
        """Metres: the standard deviation of the residuals of vertices, as 1.4826 times their median absolute value."""
        return 1.4826 * float(np.median(np.abs(self.residual[np.flatnonzero(tin.vertex)])))


def drop_vertices(ground: GroundTin, over: np.ndarray) -> int:
    """Drop the vertices that stick out by more than zero metres, but those on the hull; how many. ``over``: f32[m], their
    margins."""
    tin, inner = ground.tin, np.ones(len(over), bool)
    ghosts = tin.triangles[np.flatnonzero(tin.triangles.ravel() == -1) // 3]
    inner[ghosts[ghosts >= 0]] = False
    drop = np.flatnonzero(tin.vertex & inner & (over > 0))
    ground.margin[drop] = over[drop]
    ground.drop(drop)
    return len(drop)
