"""A grid of lowest elevations without empty cells: from the triangulation of the lowest points."""

from __future__ import annotations

import math

import numpy as np

from ..engines.grid.extremes import highest, lowest

VOID_REACH = 25.0
"""Metres around a place in a void within which the lowest point counts, where it may be water."""


def lower_voids(z: np.ndarray, seen: np.ndarray, cell: float, spacing: float) -> np.ndarray:
    """f32[rows, columns]: ``z`` with the lowest elevation within :data:`VOID_REACH` in voids: water is below what is around it.

    Args:
        z: f32[rows, columns], metres, none missing. seen: bool[rows, columns], cells with points.
        cell, spacing: metres; voids are wider than four spacings.
    """
    size = 2 * max(2, math.ceil(2 * spacing / cell)) + 1
    void = ~lowest(highest(seen, size, outside=True), size)
    return np.where(void, lowest(z, 2 * round(VOID_REACH / cell) + 1), z) if void.any() else z
