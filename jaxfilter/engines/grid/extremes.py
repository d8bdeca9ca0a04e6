"""Highest and lowest values within square windows of a grid, several times as fast as SciPy's filters, with the same values."""

from __future__ import annotations

from typing import Any

import numpy as np


def highest(z: np.ndarray, size: int, outside: Any = None) -> np.ndarray:
    """The highest value within ``size`` x ``size`` cells (odd) around each cell of [rows, columns].

    ``outside``: what lies beyond the edge; by default nothing. Cells are compared in pairs, then pairs, and so on.

    >>> from jaxfilter.engines.grid.extremes import highest, lowest
    >>> z = np.array([[0, 3, 0, 0]])
    >>> highest(z, 3).tolist(), lowest(z, 3).tolist()
    ([[3, 3, 3, 0]], [[0, 0, 0, 0]])
    """
    return _slide(np.maximum, z, size, _limits(z)[0] if outside is None else outside)


def lowest(z: np.ndarray, size: int, outside: Any = None) -> np.ndarray:
    """The same for the lowest value."""
    return _slide(np.minimum, z, size, _limits(z)[1] if outside is None else outside)


def _limits(z: np.ndarray) -> tuple[Any, Any]:
    if z.dtype.kind == "f":
        return -np.inf, np.inf
    return (False, True) if z.dtype.kind == "b" else (np.iinfo(z.dtype).min, np.iinfo(z.dtype).max)


def _slide(pick: np.ufunc, z: np.ndarray, size: int, outside: Any) -> np.ndarray:
    if z.dtype == np.bool_:  # NumPy compares bytes faster
        return _slide(pick, z.view(np.uint8), size, np.uint8(outside)).view(np.bool_)
    for axis in (0, 1):
        z = np.moveaxis(z, axis, 0)
        here, have = min(size, 2 * len(z) + 1), 1  # from each cell it sees all others, and the outside
        wide = np.full((len(z) + here - 1, z.shape[1]), outside, z.dtype, order="F" if axis else "C")  # as in memory
        wide[here // 2 : here // 2 + len(z)] = z
        while have < here:
            step = min(have, here - have)
            wide, have = pick(wide[:-step], wide[step:]), have + step
        z = np.moveaxis(wide, 0, axis)
    return z
