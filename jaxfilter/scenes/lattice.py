"""Seeded random numbers on unbounded lattices, and smooth fields made of them.

A number belongs to its lattice node, not to the order of drawing, so a field has one value at a place whatever part of
it is asked for. That makes a scene independent of its extent, density and chunks.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates

_BLOCK = 64

Box = tuple[float, float, float, float]
"""x and y of the lower left, then of the upper right corner, metres in the scene's frame."""


Layer = enum.IntEnum(
    "Layer",
    "RELIEF ROUGHNESS SETTLEMENT TERRACES FOREST SHRUBS COURSE QUARTERS PLOTS TREES KERB_EAST KERB_NORTH LOW_CLUSTERS PITS "
    "PULSES CRAGS MATCHING BLUNDERS RAYS BOATS RIPPLES",
    start=0,
)
"""The independent sources of randomness of one seed."""


class Nodes(NamedTuple):
    """A rectangle of ``ni`` by ``nj`` nodes of a lattice, from (``i0``, ``j0``) on; each stands for a cell as well."""

    i0: int
    j0: int
    ni: int
    nj: int

    @classmethod
    def over(cls, box: Box, side: float = 1.0) -> Nodes:
        """The cells of ``side`` metres that a box touches."""
        i0, j0, i1, j1 = (math.floor(v / side) for v in box)
        return cls(i0, j0, i1 - i0 + 1, j1 - j0 + 1)

    @property
    def shape(self) -> tuple[int, int]:
        """Of arrays with a value for each node."""
        return self.ni, self.nj

    def mesh(self) -> tuple[np.ndarray, ...]:
        """i64[ni, nj], i64[ni, nj]: the numbers of the nodes in both directions."""
        return tuple(np.meshgrid(self.i0 + np.arange(self.ni), self.j0 + np.arange(self.nj), indexing="ij"))


def uniform(seed: int, layer: Layer, nodes: Nodes, *, fields: int = 1, level: int = 0) -> np.ndarray:
    """f64[ni, nj, fields] uniform in [0, 1): nodes of the random lattice ``layer`` at ``level``."""
    i0, j0, ni, nj = nodes
    out = np.empty((ni, nj, fields))
    for bi in range(i0 // _BLOCK, (i0 + ni - 1) // _BLOCK + 1):
        for bj in range(j0 // _BLOCK, (j0 + nj - 1) // _BLOCK + 1):
            key = (seed, layer, level, bi & 0xFFFFFFFF, bj & 0xFFFFFFFF)  # seeds are unsigned, node indices are not
            block = np.random.default_rng(key).random((_BLOCK, _BLOCK, fields))
            a, b = bi * _BLOCK - i0, bj * _BLOCK - j0  # where the block begins in ``out``
            part = block[max(0, -a) : ni - a, max(0, -b) : nj - b]
            out[max(0, a) : a + _BLOCK, max(0, b) : b + _BLOCK] = part
    return out


@dataclasses.dataclass(frozen=True, eq=False)
class Sheet:
    """Values f64[ni, nj] at nodes ((i0 + i) * cell, (j0 + j) * cell) in x and y, bilinear between them."""

    i0: int
    j0: int
    cell: float
    values: np.ndarray

    def __call__(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """f64[n] at x, y f64[n]; beyond the nodes, that of the nearest one."""
        at = x / self.cell - self.i0, y / self.cell - self.j0
        return map_coordinates(self.values, at, order=1, mode="nearest")


Detail = Callable[[np.ndarray, Callable[[], np.ndarray], int], np.ndarray]
"""(surface so far, function drawing unit white noise at its nodes, level) -> surface with the detail of this level."""


def refine(seed: int, layer: Layer, box: Box, coarsest: int, finest: int, detail: Detail) -> Sheet:
    """A smooth surface over ``box`` by repeated cubic B-spline subdivision, with random detail added at every scale.

    Node spacing halves from 2**coarsest to 2**finest metres. This is midpoint displacement by successive random
    additions (Saupe, "Algorithms for random fractals", in The Science of Fractal Images, 1988, section 2.3), with
    B-spline instead of linear interpolation, which leaves no creases along the coarse nodes.
    """

    def surface(nodes: Nodes, level: int) -> np.ndarray:
        values = np.zeros(nodes.shape)
        if level < coarsest:
            coarse = _coarser(nodes)
            values = surface(coarse, level + 1)
            for axis in range(2):  # each turn ends with the other axis first
                values = _subdivide(values, nodes[axis], nodes.shape[axis], coarse[axis]).T

        def white() -> np.ndarray:
            return (uniform(seed, layer, nodes, level=level)[..., 0] - 0.5) * math.sqrt(12)

        return detail(values, white, level)

    cells = Nodes.over(box, 2.0**finest)
    values = surface(Nodes(cells.i0, cells.j0, cells.ni + 1, cells.nj + 1), finest)
    return Sheet(cells.i0, cells.j0, 2.0**finest, np.ascontiguousarray(values))


def _coarser(nodes: Nodes) -> Nodes:
    """The nodes of twice the spacing that a subdivision needs to make these."""
    low = nodes.i0 // 2 - 1, nodes.j0 // 2 - 1
    high = (-(-(first + n - 1) // 2) + 1 for first, n in zip(nodes[:2], nodes.shape, strict=True))
    return Nodes(*low, *(last - first + 1 for first, last in zip(low, high, strict=True)))


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
