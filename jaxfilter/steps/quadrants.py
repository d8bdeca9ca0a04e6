"""The nearest points in the four quadrants around other points of the plane, by rings of grid cells; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engines.compiled import compiled


class Buckets(NamedTuple):
    """Points sorted by grid cell.

    Attributes:
        xy: f32[n, 2], local metres.
        row: i32[n], what each is called.
        start: i32[cells + 1], where each cell begins in them; cells row by row.
        shape: rows and columns of cells.
    """

    xy: np.ndarray
    row: np.ndarray
    start: np.ndarray
    shape: tuple[int, int]

    @classmethod
    def of(cls, xy: np.ndarray, row: np.ndarray, cell: np.ndarray, shape: tuple[int, int]) -> Buckets:
        """The points f32[n, 2], called ``row``, i[n], in their cells, i[n]."""
        order = np.argsort(cell, kind="stable")
        empty = np.diff(cell[order], prepend=-1, append=shape[0] * shape[1])
        start = np.repeat(np.arange(len(cell) + 1, dtype=np.int32), empty)
        return cls(xy[order], row[order].astype(np.int32), start, shape)


def rings(radius: int) -> np.ndarray:
    """i64[steps, 3]: columns and rows of cells into a quadrant, and the square of the least distance, in cells, of points
    so far apart; what may hold nearer points comes first. The last is where to end: ``radius`` cells away."""
    column, row = (axis.ravel() for axis in np.mgrid[: radius + 1, : radius + 1])
    gap = np.maximum(column - 1, 0) ** 2 + np.maximum(row - 1, 0) ** 2
    order = np.lexsort((row, column, gap))
    steps = np.stack([column, row, gap], axis=1)[order]
    return np.append(steps[steps[:, 2] < radius**2], [[radius, radius, radius**2]], axis=0)


@compiled(fused=True, allocates=True)
def nearest_in_quadrants(xy, row, start, shape, query, home, steps, side, found, square, changed, todo):
    """Put points of the buckets (``xy``, ``row``, ``start``, ``shape``) that are nearer in the place of those ``found``.

    Quadrants count counter-clockwise from the north-east and are half-open, so that each point is in one: the first holds
    the eastern axis and the query's own position, the second the northern axis, and so on. Of equally near points the one
    that was found before stays, else that in the nearer ring of cells, else the first of the bucket.

    Args:
        query: f32[q, 2], local metres; home: i32[q], the cell of each.
        steps: of :func:`rings`; side: f32, of a cell, metres. The search ends at the last ring.
        found: i32[q, 4], rows; square: f32[q, 4], their squared distances, m2, or how far to search where there is none.
        changed: bool[q], set for queries with a nearer point.
        todo: i64[t], the queries to search for; neighbours should follow each other.
    """
    rows, columns = shape
    gaps = steps[:, 2].astype(np.float32) * side * side
    for i in todo:
        x, y = query[i]
        own_row, own_column = home[i] // columns, home[i] % columns
        for quadrant in range(4):
            east, north = quadrant in (0, 3), quadrant < 2
            best = square[i, quadrant]
            across = min(int(np.sqrt(best) / side) + 1, steps[-1, 0])
            if _is_empty(start, rows, columns, own_row, own_column, east, north, across):
                continue
            for k in range(len(steps) - 1):
                if best <= gaps[k]:
                    break
                column = own_column + steps[k, 0] if east else own_column - steps[k, 0]
                line = own_row + steps[k, 1] if north else own_row - steps[k, 1]
                if not (0 <= column < columns and 0 <= line < rows):
                    continue
                cell = line * columns + column
                for n in range(start[cell], start[cell + 1]):
                    dx, dy = xy[n, 0] - x, xy[n, 1] - y
                    away = dx * dx + dy * dy
                    if away < best and quadrant == _quadrant(dx, dy):
                        best, changed[i] = away, True
                        found[i, quadrant], square[i, quadrant] = row[n], away


@compiled
def _is_empty(start, rows, columns, row, column, east, north, across):
    """Whether the square of ``across`` more cells into a quadrant holds no points."""
    first, last = (column, min(column + across, columns - 1)) if east else (max(column - across, 0), column)
    for n in range(min(across, rows - 1 - row if north else row) + 1):
        line = (row + n if north else row - n) * columns
        if start[line + first] < start[line + last + 1]:
            return False
    return True


@compiled
def _quadrant(dx, dy):
    if dy > 0:
        return 0 if dx > 0 else 1
    if dx < 0:
        return 2
    return 3 if dy < 0 else 0
