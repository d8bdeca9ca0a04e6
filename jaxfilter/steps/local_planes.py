"""Planes fitted to neighbouring seeds and moved down to the lowest of them (Zhao et al. 2016)."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..core.grid import lattice_over
from .quadrants import Buckets

TRANSLATIONS = ("lowest", "none")
"""Where the plane is moved, without turning: down to the lowest seed of the neighbourhood, or nowhere."""
_SEEDS_AT_ONCE = 8192
_CELLS = 4
"""So many cells of the search are about as wide as the square of as many seeds as a plane takes."""


def over_local_planes(
    xyz: np.ndarray, cell: float, k: int, translation: str = "lowest", workers: int | None = None
) -> np.ndarray:
    """f32[s]: metres, along the normal, of each seed over the plane of its neighbourhood.

    A plane z = a x + b y + c is fitted by least squares to the ``k`` seeds nearest in x and y, the seed itself included, and
    those as near as the last of them. Fewer than ``k`` seeds are all taken. With fewer than three, or all on one line, the
    plane is level.

    Args:
        xyz: f32[s, 3], local metres, at positions of their own.
        cell: metres, of the cells that seeds are the lowest points of.
        translation: one of :data:`TRANSLATIONS`.
    """
    from .nearest_planes import over_planes  # imports Numba, which takes longer than all the rest

    if len(xyz) == 0:
        return np.zeros(0, np.float32)
    side = 2.0 ** max(math.ceil(math.log2(cell)), round(math.log2(cell * math.sqrt(k) / _CELLS)))
    grid = lattice_over(xyz, side)
    buckets = Buckets.of(xyz, np.arange(len(xyz)), grid.flat(xyz), grid.shape)
    found = np.empty(len(xyz), np.float32)
    few, corner = min(k, len(xyz)), (grid.x0, grid.y0)

    def part(first: int) -> None:
        last = min(first + _SEEDS_AT_ONCE, len(xyz))
        over_planes(
            buckets.xy, buckets.start, grid.shape, corner, side, few, translation == "lowest", first, last, found
        )

    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        list(pool.map(part, range(0, len(xyz), _SEEDS_AT_ONCE)))
    out = np.empty(len(xyz), np.float32)
    out[buckets.row] = found
    return out
