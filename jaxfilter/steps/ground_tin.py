"""A triangulation of ground points that takes in points close to it, and drops those that stick out of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket, on_same_device
from ..engines.tin.facets import facet_score
from ..engines.tin.triangulation import Tin

Tested = tuple[jax.Array, jax.Array, jax.Array]
_STEEPEST = 80.0
"""Degrees that facets are taken to slope at most: a wall of points is in the plane of a slim facet that stands upright."""
_AT_ONCE = 2**17
"""Points that are tested by one call."""


@jax.jit
def _close(xyz: jax.Array, corners: jax.Array, tolerance: jax.Array, scaling: jax.Array) -> Tested:
    """Points f32[n, 3] over facets f32[n, 3, 3]: margin and height in metres, slope in degrees."""
    s = jax.vmap(facet_score)(xyz, corners)
    limit = tolerance + scaling * jnp.minimum(jnp.tan(jnp.radians(s.slope)), 1.0)
    return jnp.where(s.planar, jnp.abs(s.height) - limit, jnp.inf), s.height, s.slope


@jax.jit
def _joins(xyz: jax.Array, corners: jax.Array, distance: jax.Array, angle: jax.Array, noise: jax.Array) -> Tested:
    """As :func:`_close`, by distance from the plane in metres and, beyond ``noise`` metres from it, angle in degrees."""
    s = jax.vmap(facet_score)(xyz, corners)
    away = jnp.abs(s.height) * jnp.cos(jnp.radians(jnp.minimum(s.slope, _STEEPEST)))
    margin = jnp.where((jnp.abs(s.angle) < angle) | (away <= noise), away - distance, jnp.inf)
    return jnp.where(s.planar, margin, jnp.inf), s.height, s.slope


def lowest_of_each(xyz: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """i64: of rows, ascending, the first at each position of points f32[m, 3] in canonical order, which is the lowest."""
    x, y = xyz[rows, 0], xyz[rows, 1]
    first = np.ones(len(rows), bool)
    first[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    return rows[first]


class GroundTin:
    """Ground points of a cloud, and the triangulation of their lowest per position.

    Attributes:
        xyz: f32[m, 3], all points in canonical order. ground: bool[m]. tin: the network.
        margin: f32[m], metres by which each point failed its last test, at most zero for ground.
        height, slope: f32[m], metres and degrees, over the facet of that test; after :meth:`finish`, of points that are no
            ground, over the triangulation as it is.
        residual, roughness: f32[m], metres, of vertices as they were when :meth:`prune` judged them: above the plane of
            their neighbours, and the root mean square of that among these; zero elsewhere.
    """

    def __init__(self, xyz: np.ndarray, seeds: np.ndarray, workers: int | None) -> None:
        """``seeds``: i64[s], ascending, with three positions that are not on a line; ``workers``: threads, None = cores."""
        self.workers = workers or os.cpu_count() or 1
        self.pool = ThreadPoolExecutor(self.workers)
        self.xyz, self.ground = xyz, np.zeros(len(xyz), bool)
        self.ground[seeds] = True
        self.margin, self.height, self.slope = (np.zeros(len(xyz), np.float32) for _ in range(3))
        self.residual, self.roughness = (np.zeros(len(xyz), np.float32) for _ in range(2))
        self.tin = Tin(xyz.copy(), np.zeros(len(xyz), np.int32), lowest_of_each(xyz, seeds), self.pool, self.workers)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.pool.shutdown()

    def _tested(self, test: Callable[..., Tested], rows: np.ndarray, *limits: np.ndarray) -> np.ndarray:
        """Margins of points over their facets, by limits f32[m], or f32[] for all points; what is found is kept."""
        self.tin.locate(rows)
        corner = self.tin.corners(self.tin.where[rows])
        size = bucket(min(len(self.xyz), _AT_ONCE))

        def one(start: int) -> None:
            part = slice(start, start + _AT_ONCE)
            own = rows[part]
            given = self.xyz[own], self.tin.xyz[corner[part]], *(v[own] for v in limits if v.ndim)
            padded = (np.concatenate([v, np.zeros((size - len(own), *v.shape[1:]), v.dtype)]) for v in given)
            tested = test(*padded, *(v for v in limits if not v.ndim))
            for out, values in zip((self.margin, self.height, self.slope), tested, strict=True):
                out[own] = np.asarray(values)[: len(own)]

        list(self.pool.map(on_same_device(one), range(0, len(rows), _AT_ONCE)))
        return self.margin[rows]

    def _take(self, rows: np.ndarray) -> None:
        """Make located points ground, and vertices of those at positions without any."""
        self.ground[rows] = True
        self.tin.insert(lowest_of_each(self.xyz, rows[self.tin.twins(rows) < 0]))

    def admit(self, tolerance: np.ndarray, scaling: float, but: np.ndarray) -> None:
        """Take in the points whose height over their facet is at most f32[m] metres and ``scaling`` times its slope, up to 1.

        ``but``: bool[m], points that are not tested.
        """
        rows = np.flatnonzero(~self.ground & ~but)
        if len(rows):
            self._take(rows[self._tested(_close, rows, tolerance, np.asarray(scaling, np.float32)) <= 0])

    def densify(self, distance: np.ndarray, angle: np.ndarray, noise: float, rounds: int) -> None:
        """Take in points at most ``distance`` metres from the plane of their facet, and below ``angle`` degrees, f32[m].

        Angles do not count within ``noise`` metres of the plane: between points that are near to each other, a few centimetres
        are many degrees. Planes steeper than 80 degrees count as that steep, and distances from these grow with the height
        over them.
        """
        limits = distance, angle, np.asarray(noise, np.float32)
        for _ in range(rounds):
            rows = np.flatnonzero(~self.ground)
            accepted = rows[self._tested(_joins, rows, *limits) <= 0] if len(rows) else rows
            if len(accepted) == 0:
                return
            self._take(accepted)

    def prune(self, scene: float, local: float) -> int:
        """Drop vertices that stick out of the plane of their neighbours, but those on the hull; how many.

        Metres above it are too many if they exceed ``scene`` times the standard deviation of the scene (1.4826 times the
        median absolute value), and ``local`` times the root mean square among the neighbours.
        """
        tin = self.tin
        nodes = np.flatnonzero(tin.vertex)
        self._scatter(nodes)
        e, around = self.residual, self.roughness
        spread = 1.4826 * float(np.median(np.abs(e[nodes])))
        inner = np.ones(len(self.xyz), bool)
        ghosts = tin.triangles[np.flatnonzero(tin.triangles.ravel() == -1) // 3]
        inner[ghosts[ghosts >= 0]] = False
        over = e - np.maximum(np.float32(scene * spread), np.float32(local) * around)
        drop = nodes[inner[nodes] & (over[nodes] > 0)]
        self.ground[drop], self.margin[drop] = False, over[drop]
        tin.remove(drop)
        return len(drop)

    def _scatter(self, nodes: np.ndarray) -> None:
        """Measure ``residual`` and ``roughness`` of vertices i64[k]."""
        from ..engines.tin.rings import residuals, roughness  # imports Numba

        tin = self.tin
        tables = tin.triangles, tin.neighbours, tin.where
        parts = np.array_split(nodes, len(nodes) // _AT_ONCE + self.workers)
        list(self.pool.map(lambda part: residuals(tin.xyz, *tables, part, tin.vertex, self.residual), parts))
        list(self.pool.map(lambda part: roughness(*tables, part, tin.vertex, self.residual, self.roughness), parts))

    def scatter_of_all(self) -> tuple[np.ndarray, np.ndarray]:
        """``residual`` and ``roughness``, f32[m] each; for points that are no vertex zero, and the mean roughness at the
        corners of their facet."""
        around = self.roughness.copy()
        rows = np.flatnonzero(~self.tin.vertex)
        self.tin.locate(rows)
        around[rows] = around[self.tin.corners(self.tin.where[rows])].mean(axis=1)
        return np.where(self.tin.vertex, self.residual, 0), around

    def finish(self) -> None:
        """Give points that are no ground their height and slope over the triangulation as it is; margins stay."""
        rows, margin = np.flatnonzero(~self.ground), self.margin.copy()
        if len(rows):
            self._tested(_close, rows, np.zeros((), np.float32), np.zeros((), np.float32))
        self.margin = margin
