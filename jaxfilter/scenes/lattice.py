"""Seeded random numbers on unbounded lattices, and smooth fields made of them.

A number belongs to its lattice node, not to the order of drawing, so a field has one value at a place whatever part of
it is asked for. That makes a scene independent of its extent, density and chunks.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
from collections.abc import Callable

import numpy as np

_BLOCK = 64

Box = tuple[float, float, float, float]
"""x and y of the lower left, then of the upper right corner, metres in the scene's frame."""


class Layer(enum.IntEnum):
    """The independent sources of randomness of one seed."""

    RELIEF = 0
    ROUGHNESS = 1
    SETTLEMENT = 2
    TERRACES = 3
    FOREST = 4
    SHRUBS = 5
    COURSE = 6
    QUARTERS = 7
    PLOTS = 8
    TREES = 9
    KERB_EAST = 10
    KERB_NORTH = 11
    LOW_CLUSTERS = 12
    PITS = 13
    PULSES = 14


def uniform(
    seed: int, layer: Layer, i0: int, j0: int, ni: int, nj: int, *, fields: int = 1, level: int = 0
) -> np.ndarray:
    """f64[ni, nj, fields] uniform in [0, 1): nodes i0.. and j0.. of the random lattice ``layer`` at ``level``."""
    out = np.empty((ni, nj, fields))
    for bi in range(i0 // _BLOCK, (i0 + ni - 1) // _BLOCK + 1):
        for bj in range(j0 // _BLOCK, (j0 + nj - 1) // _BLOCK + 1):
            key = (seed, layer, level, bi & 0xFFFFFFFF, bj & 0xFFFFFFFF)  # seeds are unsigned, node indices are not
            block = np.random.default_rng(key).random((_BLOCK, _BLOCK, fields))
            a0, b0 = bi * _BLOCK, bj * _BLOCK
            i, j = slice(max(i0, a0), min(i0 + ni, a0 + _BLOCK)), slice(max(j0, b0), min(j0 + nj, b0 + _BLOCK))
            out[i.start - i0 : i.stop - i0, j.start - j0 : j.stop - j0] = block[
                i.start - a0 : i.stop - a0, j.start - b0 : j.stop - b0
            ]
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Sheet:
    """Values f64[ni, nj] at nodes ((i0 + i) * cell, (j0 + j) * cell) in x and y, bilinear between them."""

    i0: int
    j0: int
    cell: float
    values: np.ndarray

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """f64[n] at x, y f64[n]; beyond the nodes, the nearest cell is extended."""
        ni, nj = self.values.shape
        u, v = x / self.cell, y / self.cell
        i = np.clip(np.floor(u).astype(np.intp), self.i0, self.i0 + ni - 2)
        j = np.clip(np.floor(v).astype(np.intp), self.j0, self.j0 + nj - 2)
        u -= i
        v -= j
        flat, k = self.values.reshape(-1), (i - self.i0) * nj + (j - self.j0)
        south = flat[k] + u * (flat[k + nj] - flat[k])
        k += 1
        north = flat[k] + u * (flat[k + nj] - flat[k])
        return south + v * (north - south)


Detail = Callable[[np.ndarray, Callable[[], np.ndarray], int], np.ndarray]
"""(surface so far, function drawing unit white noise at its nodes, level) -> surface with the detail of this level."""


def refine(seed: int, layer: Layer, box: Box, coarsest: int, finest: int, detail: Detail) -> Sheet:
    """A smooth surface over ``box`` by repeated cubic B-spline subdivision, with random detail added at every scale.

    Node spacing halves from 2**coarsest to 2**finest metres. This is midpoint displacement by successive random
    additions (Saupe, "Algorithms for random fractals", in The Science of Fractal Images, 1988, section 2.3), with
    B-spline instead of linear interpolation, which leaves no creases along the coarse nodes.
    """
    cell = 2.0**finest
    low = [math.floor(v / cell) for v in box[:2]]
    high = [math.floor(v / cell) + 1 for v in box[2:]]
    windows = [(low, high)]
    for _ in range(coarsest - finest):
        low, high = [v // 2 - 1 for v in low], [-(-v // 2) + 1 for v in high]
        windows.append((low, high))
    parent, surface = low, np.zeros([b - a + 1 for a, b in zip(low, high, strict=True)])
    for level in range(coarsest, finest - 1, -1):
        low, high = windows.pop()
        shape = [b - a + 1 for a, b in zip(low, high, strict=True)]
        if level < coarsest:
            surface = _subdivide(_subdivide(surface, low[0], shape[0], parent[0]).T, low[1], shape[1], parent[1]).T
        surface = detail(surface, functools.partial(_white, seed, layer, low, shape, level), level)
        parent = low
    return Sheet(low[0], low[1], cell, np.ascontiguousarray(surface))


def _white(seed: int, layer: Layer, low: list[int], shape: list[int], level: int) -> np.ndarray:
    """Noise of mean 0 and standard deviation 1 at the nodes of a window, f64[shape]."""
    return (uniform(seed, layer, *low, *shape, level=level)[..., 0] - 0.5) * math.sqrt(12)


def _subdivide(coarse: np.ndarray, i0: int, n: int, parent: int) -> np.ndarray:
    """Rows i0 .. i0 + n - 1 of the cubic B-spline subdivision of rows parent .. of ``coarse``."""
    first = parent + 1
    fine = np.empty((2 * len(coarse) - 4, coarse.shape[1]))
    fine[0::2] = (coarse[:-2] + coarse[2:] + 6 * coarse[1:-1]) / 8
    fine[1::2] = (coarse[1:-1] + coarse[2:]) / 2
    return fine[i0 - 2 * first : i0 - 2 * first + n]


SPLINE_STD = 0.479
"""Standard deviation of unit white noise after cubic B-spline interpolation in two dimensions."""


def smooth_noise(seed: int, layer: Layer, box: Box, scale: int) -> Sheet:
    """Noise of mean 0 and standard deviation 1 that varies over 2**scale metres, with nodes an eighth of that apart."""

    def once(surface: np.ndarray, white: Callable[[], np.ndarray], level: int) -> np.ndarray:
        return white() / SPLINE_STD if level == scale else surface

    return refine(seed, layer, box, scale, scale - 3, once)


def smoothstep(t: np.ndarray) -> np.ndarray:
    """0 below 0, 1 above 1, a cubic with level ends between."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def box_of(x: np.ndarray, y: np.ndarray) -> Box:
    """The smallest box that holds the points x, y f64[n]."""
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())
