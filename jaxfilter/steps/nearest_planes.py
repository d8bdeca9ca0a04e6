"""Planes through the nearest of points in the plane, by rows of grid cells; compiled."""

from __future__ import annotations

import numpy as np

from ..engines.compiled import compiled

_DEGENERATE = 1e-6  # share of the squared spread below which positions count as lying on a line
_SLACK = 1e-3  # of a cell: more than rounding takes away
_CROWD = 8
"""A circle with so many times as many points in its cells as are wanted is too large to begin with."""


@compiled(allocates=True)
def over_planes(xyz, start, shape, corner, side, k, lowest, first, last, out):
    """Residuals of points ``first`` to ``last`` to the planes through the points nearest to each, into ``out``, f32[n].

    Distances and sums of products are exact for coordinates in steps of a quantum, so that the order of the points in a cell
    decides nothing. Those as near as the k-th count, too.

    Args:
        xyz: f32[n, 3], local metres, sorted by grid cell; start: i32[cells + 1], where each cell begins, row by row.
        shape: rows and columns of cells; corner: x and y of the first, metres; side: of a cell, metres, a power of two.
        k: how many points, at most n; lowest: whether the planes are moved down to the lowest of them.
    """
    near, square, ranked = np.empty(0, np.int64), np.empty(0), np.empty(0)
    bound = side * side
    for i in range(first, last):
        x, y, z = np.float64(xyz[i, 0]), np.float64(xyz[i, 1]), np.float64(xyz[i, 2])
        x0, y0 = x - corner[0], y - corner[1]
        room = _room(start, shape, side, x0, y0, bound)
        while room > _CROWD * k and bound > side * side:
            bound /= 2
            room = _room(start, shape, side, x0, y0, bound)
        found = 0
        while True:
            if room > len(near):
                near, square, ranked = np.empty(2 * room, np.int64), np.empty(2 * room), np.empty(2 * room)
            if room >= k:
                found = _within(xyz, start, shape, side, x0, y0, x, y, bound, near, square)
            if found >= k:
                break
            bound *= 2
            room = _room(start, shape, side, x0, y0, bound)
        ranked[:found] = square[:found]
        farthest = _smallest(ranked, found, k)
        bound = 1.25 * farthest + 0.0625 * side * side  # for the next, which is near
        count, sx, sy, sz, xx, xy, yy, xz, yz = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for m in range(found):
            if square[m] <= farthest:
                dx, dy, dz = xyz[near[m], 0] - x, xyz[near[m], 1] - y, xyz[near[m], 2] - z
                near[count] = near[m]
                count += 1
                sx, sy, sz = sx + dx, sy + dy, sz + dz
                xx, xy, yy, xz, yz = xx + dx * dx, xy + dx * dy, yy + dy * dy, xz + dx * dz, yz + dy * dz
        xx, xy, yy = xx - sx * sx / count, xy - sx * sy / count, yy - sy * sy / count
        xz, yz = xz - sx * sz / count, yz - sy * sz / count
        a, b, determinant = 0.0, 0.0, xx * yy - xy * xy
        if count >= 3 and determinant > _DEGENERATE * (xx + yy) ** 2:
            a, b = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
        level = (sz - a * sx - b * sy) / count  # of the plane over the point itself, less its elevation
        down = np.inf if lowest else 0.0
        if lowest:
            for m in near[:count]:
                down = min(down, xyz[m, 2] - z - level - a * (xyz[m, 0] - x) - b * (xyz[m, 1] - y))
        out[i] = (-level - down) / np.sqrt(1 + a * a + b * b)


@compiled
def _lines(shape, side, y, bound):
    """The first and the last row of cells that points may be in within the root of ``bound`` of a position."""
    radius = np.sqrt(bound) + _SLACK * side
    return max(int((y - radius) / side), 0), min(int((y + radius) / side), shape[0] - 1)


@compiled
def _run(start, shape, side, x, y, bound, line):
    """The first of these points in one of the rows, and the first after them."""
    gap = max(line * side - y, y - (line + 1) * side, 0.0)
    across = np.sqrt(max(bound - gap * gap, 0.0)) + _SLACK * side
    left, right = max(int((x - across) / side), 0), min(int((x + across) / side), shape[1] - 1)
    return start[line * shape[1] + left], start[line * shape[1] + right + 1]


@compiled
def _room(start, shape, side, x, y, bound):
    """How many points lie in the cells around a position that may hold one within the root of ``bound``."""
    count = 0
    low, high = _lines(shape, side, y, bound)
    for line in range(low, high + 1):
        begin, end = _run(start, shape, side, x, y, bound, line)
        count += end - begin
    return count


@compiled
def _within(xyz, start, shape, side, x0, y0, x, y, bound, near, square):
    """How many points lie within the root of ``bound`` of a position; which, and their squared distances."""
    count = 0
    low, high = _lines(shape, side, y0, bound)
    for line in range(low, high + 1):
        begin, end = _run(start, shape, side, x0, y0, bound, line)
        for m in range(begin, end):
            dx, dy = xyz[m, 0] - x, xyz[m, 1] - y
            near[count], square[count] = m, dx * dx + dy * dy
            count += square[count] <= bound
    return count


@compiled
def _smallest(values, count, k):
    """The k-th smallest, from 1, of the first ``count`` values, which are put into another order (Hoare's selection)."""
    low, high = 0, count - 1
    while low < high:
        pivot = values[k - 1]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < k - 1:
            low = i
        if k - 1 < i:
            high = j
    return values[k - 1]
