"""Lowest value among the points in a square box around every point, exactly; compiled.

Points are binned. The bins that lie wholly inside a box form a rectangle, whose minimum is that of four overlapping
windows of bins; the points in the ring of bins around it are tested one by one.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled


@compiled
def box_minima(xy, values, start, windows, run, corner, side, half, first, last, out):
    """The lowest of ``values`` among the points within ``half`` metres of each point in x and in y.

    Args:
        xy: f32[n, 2], local metres, sorted along rows of bins; values: f32[n], +inf for points that do not count.
        start: i32[rows * columns + 1], the first point of each bin. There are so many empty rows and columns of bins around
            the points that no box reaches beyond the grid.
        windows: f32[rows, columns], the lowest values in ``run`` x ``run`` bins from each one on, as many as lie inside every
            box along each axis: one fewer than lie along it wholly, and one at least.
        corner: f32[2], x and y of the first bin; side: f32, of a bin; half: f32, of a box, which is closed; metres.
        first, last: the points to ask for; out: f32[n], written to for these; +inf where no point counts.
    """
    columns = windows.shape[1]
    for i in range(first, last):
        x, y = xy[i, 0], xy[i, 1]
        west, east = int(np.floor((x - half - corner[0]) / side)), int(np.floor((x + half - corner[0]) / side))
        south, north = int(np.floor((y - half - corner[1]) / side)), int(np.floor((y + half - corner[1]) / side))
        low = min(
            min(windows[south + 1, west + 1], windows[south + 1, east - run]),
            min(windows[north - run, west + 1], windows[north - run, east - run]),
        )
        for row in range(south, north + 1):
            across = row in (south, north)
            for end in range(1 if across else 2):
                left = row * columns + (east if end == 1 else west)
                right = row * columns + (east if across else left - row * columns)
                for k in range(start[left], start[right + 1]):
                    if values[k] < low and abs(xy[k, 0] - x) <= half and abs(xy[k, 1] - y) <= half:
                        low = values[k]
        out[i] = low
