"""Rock that overhangs what is below: ground above a void."""

from __future__ import annotations

import itertools

import numpy as np
import scipy

from .sensors import spreads
from .surfaces import Cells

VOID = 4.0
"""Metres without points between rock and what is beneath it, at least."""
SHEET_SPREAD = 0.6
"""Metres, standard deviation at most, that points of rock lie from their plane in a cell. Leaves scatter by more."""


def overhangs(xyz: np.ndarray, cells: Cells, bare: np.ndarray, step: float, reach: int) -> np.ndarray:
    """bool[n]: points of rock over a void, which a surface with one elevation at a place cannot have beside what is beneath.

    Of the points in a cell those above the highest void count. They must be a sheet, and go on in a cell beside it: some points
    there, of bare steep terrain or of such a sheet, are as high as some of them.

    Args:
        xyz: f32[n, 3], metres. bare: bool[rows, columns], cells of steep terrain.
        step: metres; so far apart in elevation points of two cells still go on. reach: cells from that terrain, at most.
    """
    rows, columns = bare.shape
    at = cells.grid.flat(xyz, columns)
    own = np.flatnonzero(scipy.ndimage.binary_dilation(bare, iterations=reach).ravel()[at])
    own = own[np.lexsort((xyz[own, 2], at[own]))]
    cell, z, number = at[own], xyz[own, 2], np.arange(len(own))
    first = np.diff(cell, prepend=-1) > 0
    void = ~first & (np.diff(z, prepend=z[:1]) > VOID)
    start, known = np.zeros(rows * columns, np.int64), cell[first]
    np.maximum.at(start, cell, np.where(first | void, number, 0))
    upper = number >= start[cell]
    low, high = np.full((2, rows * columns), np.nan, np.float32)
    low[known], high[known] = z[start[known]], np.maximum.reduceat(z, number[first])
    above, sheet = np.zeros((2, rows * columns), bool)
    above[cell[void]] = True
    sheet[known] = spreads(xyz[own[upper]].astype(np.float64), cell[upper]) < SHEET_SPREAD
    low, high, above, sheet = (np.pad(values.reshape(rows, columns), 1) for values in (low, high, above, sheet))
    rock = np.pad(bare, 1) & ~above
    for _ in range(reach):
        beside = np.zeros_like(rock)
        for shift in itertools.product((-1, 0, 1), repeat=2):
            there, bottom, top = (np.roll(values, shift, (0, 1)) for values in (rock, low, high))
            beside |= there & (low <= top + np.float32(step)) & (bottom <= high + np.float32(step))
        more = beside & above & sheet & ~rock
        if not more.any():
            break
        rock |= more
    found = np.zeros(len(xyz), bool)
    found[own] = upper & (rock & above)[1:-1, 1:-1].ravel()[cell]
    return found
