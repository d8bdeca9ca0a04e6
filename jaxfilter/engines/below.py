"""Points that lie lower or higher than others around them, pair by pair; compiled."""

from __future__ import annotations

import numpy as np

from .compiled import compiled

_FEW = 64
"""Points that are counted without a look at whether they are enough."""


@compiled(allocates=True)
def few_below(out, xyz, at, key, wide, reach, radius, depth, most):
    """Mark the points of which at most ``most`` others within ``radius`` metres, in x and y, lie less than ``depth`` metres above
    them or lower, and more than ``most`` higher.

    Args:
        out: bool[n], written to; xyz: f32[n, 3], metres.
        at: i32[n], the cell that each point is in. No cell is empty.
        key: i64[c], ascending: row x ``wide`` + column of the cells, whose side is ``radius`` / ``reach``; ``reach``: 3 or more.
            No row has cells in its last ``reach`` columns.
    """
    start, order = _by_cell(at, len(key))
    x, y, z = np.empty(len(at), np.float32), np.empty(len(at), np.float32), np.empty(len(at), np.float32)
    for place in range(len(at)):
        x[place], y[place], z[place] = xyz[order[place], 0], xyz[order[place], 1], xyz[order[place], 2]
    square = radius * radius
    rows, touching = np.empty((2 * reach + 1, 2), np.int64), np.empty((3, 2), np.int64)
    for cell in range(len(key)):
        known = 0
        for lag in range(3):
            _places(touching[lag], start, key, key[cell] + (lag - 1) * wide, 1)
        for place in range(start[cell], start[cell + 1]):
            top, below = np.float64(z[place]) + depth, -1  # the point itself is not counted
            for lag in (1, 0, 2):  # cells that touch the own one are within the radius
                first, end = touching[lag]
                while first < end and below <= most:  # few at a time: of dense points most have enough others at once
                    for near in range(first, min(first + _FEW, end)):
                        below += z[near] < top
                    first += _FEW
            if below > most:
                continue
            below, above, step = -1, 0, 0
            while step <= 2 * reach and below <= most:
                if step == known:  # the row of the cell, those beside it, and so on
                    lag = (step + 1) // 2 if step % 2 else -(step // 2)
                    _places(rows[step], start, key, key[cell] + lag * wide, reach)
                    known += 1
                for near in range(rows[step, 0], rows[step, 1]):
                    dx, dy = np.float64(x[near] - x[place]), np.float64(y[near] - y[place])
                    inside = dx * dx + dy * dy <= square
                    below += inside & (z[near] < top)
                    above += inside & (z[near] >= top)
                step += 1
            out[order[place]] = below <= most < above


@compiled(allocates=True)
def rising(out, xyz, at, key, wide, reach, points, place, radius, steepest, level, sides):
    """Mark the points f32[k, 3] that lie more than ``level`` above a slope of ``steepest``, rise over run, from another within
    ``radius``, in so many ``sides`` at least of the four quadrants around them.

    Args:
        out: bool[k], written to; place: i64[k], row x ``wide`` + column of their cells.
        xyz: f32[j, 3], the others; at, key, wide, reach: as of :func:`few_below`, but any column may have cells: a point that is
            met twice changes nothing.
    """
    start, order = _by_cell(at, len(key))
    found, row = np.empty(4, np.bool_), np.empty(2, np.int64)
    square = radius * radius
    for point in range(len(points)):
        x, y, z = np.float64(points[point, 0]), np.float64(points[point, 1]), np.float64(points[point, 2])
        found[:] = False
        step, count = 0, 0
        while step <= 2 * reach and count < sides:
            lag = (step + 1) // 2 if step % 2 else -(step // 2)
            _places(row, start, key, place[point] + lag * wide, reach)
            for near in range(row[0], row[1]):
                other = order[near]
                dx, dy = x - np.float64(xyz[other, 0]), y - np.float64(xyz[other, 1])
                away = dx * dx + dy * dy
                quadrant = 2 * (dx < 0) + (dy < 0)
                if found[quadrant] or away > square:
                    continue
                if z > np.float64(xyz[other, 2]) + steepest * np.sqrt(away) + level:
                    found[quadrant] = True
                    count += 1
            step += 1
        out[point] = count >= sides


@compiled(allocates=True)
def _by_cell(at, cells):
    """i64[cells + 2], where the points of each cell begin among i32[n], the points in the order of the cells ``at``, i32[n]."""
    start, order = np.zeros(cells + 2, np.int64), np.empty(len(at), np.int32)
    for point in range(len(at)):
        start[at[point] + 2] += 1
    for cell in range(cells):
        start[cell + 2] += start[cell + 1]
    for point in range(len(at)):  # each start moves to where its cell ends, and the next one begins
        order[start[at[point] + 1]] = point
        start[at[point] + 1] += 1
    return start, order


@compiled
def _places(out, start, key, middle, reach):
    """Where the points of a row of cells begin and end, up to ``reach`` cells to both sides of that with the key ``middle``."""
    out[0] = start[np.searchsorted(key, middle - reach)]
    out[1] = start[np.searchsorted(key, middle + reach + 1)]
