"""Bridge decks: surfaces that fall upright on both flanks and join the ground at both ends."""

from __future__ import annotations

import math

import numpy as np

from ..engines.grid.extremes import highest

DROP, HIGH = 0.8, 1.8
"""Metres that a deck falls by at its flanks, at least: anywhere, and at half of its cells."""
NEAR = 4.0
"""Metres from where it falls by :data:`HIGH` up to which :data:`DROP` is enough: a deck comes down to the land at its ends."""
AREA, LENGTH, STEADY = 15.0, 4.0, 0.5
"""Square metres and metres of a deck, at least, and how alike the directions across it are: 1 if all are the same."""
ENDS, MOST = 0.3, 2.0
"""Of the width of a deck that joins the ground at each of its ends, and at most: else its flanks join it too."""
JOIN = 0.6
"""Metres from one cell to the next that are no fall: less than what a fall of :data:`HIGH` has where it takes three cells."""
LAND = 20.0
"""Square metres of ground that are more than a gap between objects."""


def decks(
    z: np.ndarray, objects: np.ndarray, inside: np.ndarray, lengths: tuple[float, float, float, float]
) -> np.ndarray:
    """f32[rows, columns]: elevation of the bridge decks in a surface of lowest points, metres, NaN where there is none.

    Cells of a deck lie between two upright edges, on a line across. Cells that differ by less than a step from one to the next
    are judged together: along the mean direction there are two ends, and at both the surface goes on to land without a fall,
    or at one and the border of the data cuts the other. So roofs, which fall all around, are none, nor are headlands, jetties
    and terraces, which join on one side or all along. Cells beside a deck whose lowest point is beneath it hold points of its
    edge, and have its elevation.

    Args:
        z: f32[rows, columns], metres, none missing, voids at the lowest elevation around.
        objects: bool[rows, columns], cells that are none of the ground.
        inside: bool[rows, columns], cells that the data surround.
        lengths: metres: side of a cell, spacing of the points, step between cells of one segment, width of the widest deck.
    """
    from ..engines.grid.shapes import flanks, segments  # imports Numba

    cell, spacing, step, widest = lengths
    none = np.full(z.shape, np.nan, np.float32)
    back = max(2, math.ceil(1.5 * spacing / cell))
    if back >= max(z.shape):  # each flank would be wider than the data
        return none
    across, width, fall = flanks(z, back, np.float32(widest / cell), np.float32(DROP))
    core = inside & (fall > HIGH)
    if not core.any():
        return none
    on = (across > 0) & inside & highest(core, 2 * round(NEAR / cell) + 1)
    part, count = segments(np.where(on, z, np.float32(np.nan)), np.float32(step), AREA / cell**2)
    row, column = np.nonzero(part)
    name = part[row, column]

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(name, values, count + 1)

    cells = np.maximum(total(np.ones(len(name))), 1)
    turn = np.pi / 4 * (across[row, column] - 1)  # twice the angle, since a line has no sense
    sine, cosine = total(np.sin(turn)) / cells, total(np.cos(turn)) / cells
    wide = total(width[row, column]) / cells
    good = (np.hypot(sine, cosine) >= STEADY) & (cells * cell >= LENGTH * wide)
    good &= 2 * total(fall[row, column] > HIGH) >= cells
    good[0] = False
    if not good.any():
        return none
    axis = (np.arctan2(sine, cosine) + np.pi) / 2
    along = row * np.sin(axis)[name] + column * np.cos(axis)[name]
    ahead = along > (total(along) / cells)[name]
    rest, many = segments(np.where((part > 0) | ~inside, np.float32(np.nan), z), np.float32(JOIN), 1)
    land = np.bincount(rest[~objects & inside], minlength=many + 1) * cell**2 > LAND
    land[0] = False
    rest, around, joins = np.pad(rest, 1), np.pad(z, 1), np.zeros(len(name), bool)
    for r, c in ((0, 1), (2, 1), (1, 0), (1, 2)):
        other = row + r, column + c
        joins |= land[rest[other]] & (np.abs(around[other] - z[row, column]) < JOIN)
    beyond = np.pad(~inside, 1, constant_values=True)
    cut = highest(beyond, 2 * back + 3)[1:-1, 1:-1][row, column]
    ends = [[total(what & side) / (wide + 2) for side in (ahead, ~ahead)] for what in (joins, cut)]
    join, edge = (np.array(both) for both in ends)
    met = (join >= ENDS) | ((edge >= ENDS) & (join[::-1] >= ENDS))
    good &= met.all(axis=0) & (join <= MOST).all(axis=0)
    if not good.any():
        return none
    level = np.where(good[part], z, np.float32(-np.inf))
    beside = highest(level, 3)
    return np.where(good[part], z, np.where(beside - z > DROP, beside, none))
