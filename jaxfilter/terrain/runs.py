"""Cells side by side in the rows of a lattice of any extent: unions, gaps, and what touches."""

from __future__ import annotations

import numpy as np

from ..engines.neighbours import groups
from .raster import RasterGrid

_WIDE = 1 << 32
"""More than there are columns."""


def keys(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """i64[n]: one number for each cell, row by row."""
    return row.astype(np.int64) * _WIDE + column


def union(run: np.ndarray) -> np.ndarray:
    """i64[m, 3]: runs [k, 3] of row, first column and the column after the last one, in order; those that meet are one."""
    if not len(run):
        return run
    order = np.argsort(keys(run[:, 0], run[:, 1]))
    first, stop = keys(run[order, 0], run[order, 1]), np.maximum.accumulate(keys(run[order, 0], run[order, 2]))
    start = np.flatnonzero(np.append(True, first[1:] > stop[:-1]))
    row, column = run[order[start], 0].astype(np.int64), run[order[start], 1]
    return np.column_stack([row, column, stop[np.append(start[1:], len(run)) - 1] - keys(row, np.zeros(1, np.int64))])


def bodies(run: np.ndarray) -> np.ndarray:
    """i64[k]: which body each of the runs [k, 3], in order, is in: those that share the side of a cell are one."""
    first, stop = keys(run[:, 0], run[:, 1]), keys(run[:, 0], run[:, 2])
    beside = np.flatnonzero(stop[:-1] == first[1:])
    above = np.searchsorted(stop, first + _WIDE, "right"), np.searchsorted(first, stop + _WIDE, "left")
    number = np.maximum(above[1] - above[0], 0)
    lower = np.repeat(np.arange(len(run)), number)
    upper = np.arange(len(lower)) + np.repeat(above[0] - np.cumsum(number) + number, number)
    return groups(np.append(beside, lower), np.append(beside + 1, upper), len(run))


def runs_in(mask: np.ndarray, grid: RasterGrid) -> np.ndarray:
    """i64[k, 3]: the cells of a mask, bool[rows, columns] from the north, as the whole lattice counts them from the south."""
    row, at = np.nonzero(np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1))
    found = np.column_stack([grid.bottom + grid.rows - 1 - row[::2], grid.left + at[::2], grid.left + at[1::2]])
    return found[::-1]


def mask_of(run: np.ndarray, grid: RasterGrid) -> np.ndarray:
    """bool[rows, columns], from the north: cells of a grid that are in runs [k, 3], which are in order and do not meet."""
    ends = np.zeros((grid.rows, grid.columns + 1), np.int8)
    some = run[slice(*np.searchsorted(run[:, 0], (grid.bottom, grid.bottom + grid.rows)))]
    row = grid.bottom + grid.rows - 1 - some[:, 0]
    first, stop = (np.clip(some[:, k] - grid.left, 0, grid.columns) for k in (1, 2))
    met = first < stop
    ends[row[met], first[met]], ends[row[met], stop[met]] = 1, -1
    return np.cumsum(ends, axis=1)[:, :-1] > 0


def gaps(run: np.ndarray, grid: RasterGrid) -> np.ndarray:
    """i64[m, 3]: the cells of a grid that are in none of the runs [k, 3], in order."""
    row = np.arange(grid.bottom, grid.bottom + grid.rows)
    west, east = np.full(len(row), grid.left), np.full(len(row), grid.left + grid.columns)
    ends = np.concatenate([np.column_stack([row, west - 1, west]), np.column_stack([row, east, east + 1])])
    solid = union(np.concatenate([run, ends]))
    between = solid[1:, 0] == solid[:-1, 0]
    return np.column_stack([solid[:-1, 0], solid[:-1, 2], solid[1:, 1]])[between]
