"""Of the points of each small square one that stands for the lowest sheet of them; compiled."""

from __future__ import annotations

import numpy as np

from .compiled import compiled


@compiled(allocates=True)
def middles(xyz, side, depth, rows, own):
    """Find the point of each square that stands for it: of the middle half, by elevation, of its lowest sheet, the one nearest
    to its centre. Of equally near ones it is the first.

    Args:
        xyz: f32[m, 3], metres; the points of a square follow each other. side: f32, of the squares, metres: a power of two.
        depth: f32, metres from the lowest point of a square to the top of its lowest sheet.
        rows: i64[m], written to: the points that stand for a square come first, ascending.
        own: i32[m], written to: which of these stands for the square of each point.

    Returns: how many squares there are.
    """
    count, first, z = 0, 0, np.empty(64, np.float32)
    while first < len(xyz):
        x0, y0 = np.floor(xyz[first, 0] / side), np.floor(xyz[first, 1] / side)
        end, top = first, xyz[first, 2] + depth
        while end < len(xyz) and np.floor(xyz[end, 0] / side) == x0 and np.floor(xyz[end, 1] / side) == y0:
            top = min(top, xyz[end, 2] + depth)
            own[end] = count
            end += 1
        if len(z) < end - first:
            z = np.empty(2 * (end - first), np.float32)
        size = 0
        for i in range(first, end):
            if xyz[i, 2] <= top:
                z[size] = xyz[i, 2]
                size += 1
        sheet = np.sort(z[:size])
        quarter, nearest = (size - 1) // 4, np.float32(np.inf)
        x, y = (x0 + np.float32(0.5)) * side, (y0 + np.float32(0.5)) * side
        for i in range(first, end):
            square = (xyz[i, 0] - x) ** 2 + (xyz[i, 1] - y) ** 2
            if sheet[quarter] <= xyz[i, 2] <= sheet[size - 1 - quarter] and square < nearest:
                rows[count], nearest = i, square
        count, first = count + 1, end
    return count
