"""Depressions of a gridded surface: sets of cells from which no path leads out without climbing; compiled."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..compiled import compiled
from .shapes import root

_MET = 4  # basins that each one has met last, whose passes are remembered


@dataclasses.dataclass(frozen=True, eq=False)
class Depressions:
    """Cells in depressions, grouped by depression.

    Attributes:
        cell: i64[c], cell numbers, ascending within a depression.
        owner: i64[c], the depression of each, ascending.
        spill: f32[k], the level at which each overflows, +inf where walls surround it; all its cells are lower.
        points: i64[k], what the cells of each count for.
    """

    cell: np.ndarray
    owner: np.ndarray
    spill: np.ndarray
    points: np.ndarray

    def __len__(self) -> int:
        return len(self.spill)


class Basins:
    """The basins of steepest descent of a surface, and the passes between them, in which depressions are found.

    Attributes:
        z: f32[n], the surface. basin: i64[n], the basin of each cell, -1 for walls; bottom: i64[k], the lowest cell of each.
        a, b: i64[p], the basins that each pass joins, and level: f32[p], the lowest first.
    """

    def __init__(self, z: np.ndarray, around: np.ndarray) -> None:
        """``z``: f32[n], the surface in the cells that there are; others, and those at +inf, are walls.

        ``around``: i[9, n], each cell among its neighbours, as from :meth:`jaxfilter.engines.grid.sparse.CellSet.around`.
        """
        walled = np.append(z, np.float32(np.inf))
        self.z, (self.basin, self.bottom) = z, descend(walled, around)
        a, b, level = passes(walled, around, self.basin, len(self.bottom))
        order = np.argsort(level, kind="stable")
        self.a, self.b, self.level = a[order], b[order], level[order]

    def depressions(self, points: np.ndarray, depth: float, max_points: int) -> Depressions:
        """The largest depressions that are at least ``depth`` deep and hold at most ``max_points``.

        ``points``: i64[n], how many points each cell counts for.

        A depression is a maximal 8-connected set of cells below its spill level, the lowest pass that leads out of it. They
        form a tree, since two merge at their pass into another one. Those returned are disjoint: the outermost that
        qualify, so that a small pit at the bottom of a qualifying one is not listed apart. The tree is that of single
        linkage of the basins: they are joined over the passes between them, the lowest first.
        """
        outermost, spill, held = mergers(
            self.z[self.bottom], self.a, self.b, self.level, depth, max_points, self.z, self.basin, points
        )
        cell = np.flatnonzero(outermost >= 0)
        kept, owner = np.unique(outermost[cell], return_inverse=True)
        order = np.argsort(owner, kind="stable")
        return Depressions(cell[order], owner[order], spill[kept], held[kept])


@compiled(allocates=True)
def descend(z, around):
    """i64[n], the basin that steepest descent leads each cell to (-1: wall), and the lowest cell of each basin, i64[k].

    ``z``: f32[n + 1], the last one +inf. Descent goes to the lowest of nine cells, of equal ones to that with the lowest
    number.
    """
    n = len(z) - 1
    down = np.empty(n, np.int64)
    for cell in range(n):
        lowest, to = np.float32(np.inf), cell
        for k in range(9):
            other = around[k, cell]
            if z[other] < lowest:
                lowest, to = z[other], other
        down[cell] = to
    basin, bottom = np.full(n, -1, np.int64), np.empty(n, np.int64)
    count = 0
    for cell in range(n):
        if down[cell] == cell and z[cell] < np.inf:
            basin[cell], bottom[count] = count, cell
            count += 1
    for cell in range(n):
        if z[cell] < np.inf:
            end = cell
            while basin[end] < 0:
                end = down[end]
            while basin[cell] < 0:
                basin[cell], cell = basin[end], down[cell]
    return basin, bottom[:count].copy()


@compiled(allocates=True)
def passes(z, around, basin, basins):
    """Passes between basins that touch: i64[p], i64[p] the basins, the lower number first, and f32[p] the level.

    The lowest of two basins is among them; most of the others, which join nothing, are not.
    """
    a, b, level = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024, np.float32)
    met, place = np.full((basins, _MET), -1, np.int32), np.empty((basins, _MET), np.int64)
    count = 0
    for cell in range(len(basin)):
        if basin[cell] < 0:
            continue
        for k in range(5, 9):  # each pair of touching cells once
            other = around[k, cell]
            if z[other] == np.inf or basin[other] == basin[cell]:
                continue
            low, high = min(basin[cell], basin[other]), max(basin[cell], basin[other])
            at, slot = max(z[cell], z[other]), high % _MET
            if met[low, slot] == high:
                known = place[low, slot]
                level[known] = min(level[known], at)
                continue
            if count == len(a):
                a = np.concatenate((a, np.empty_like(a)))
                b = np.concatenate((b, np.empty_like(b)))
                level = np.concatenate((level, np.empty_like(level)))
            a[count], b[count], level[count] = low, high, at
            met[low, slot], place[low, slot] = high, count
            count += 1
    return a[:count].copy(), b[:count].copy(), level[:count].copy()


@compiled(allocates=True)
def mergers(low, a, b, level, depth, most, z, basin, points):
    """Depressions at least ``depth`` deep at the pass where they overflow, of at most ``most`` basins and points.

    Passes ascend, and lead from basin ``a`` to ``b``; ``low``: f32[k], the bottom of each basin; ``z``: f32[n], ``basin`` and
    ``points``: i64[n], of the cells. Returns i64[n], the outermost depression of each cell or -1, and of each depression its
    spill level f32[d] and its points i64[d]. They are numbered in ascending order of the pass; those that walls surround
    come last.
    """
    k = len(low)
    parent, lowest, formed = np.arange(k), low.copy(), np.full(k, -np.inf)
    size = np.ones(k, np.int64)  # basins of a root; 0 = too many, or too many points
    last, after = np.arange(k), np.full(k, -1)  # they are a chain from the root to ``last``
    first, beside = np.full(k, -1), np.full(len(z), -1)  # cells of a basin: a chain from ``first`` on
    for cell in range(len(z) - 1, -1, -1):
        if basin[cell] >= 0:
            beside[cell] = first[basin[cell]]
            first[basin[cell]] = cell
    owner = np.full(len(z), -1)
    spill, held = np.empty(256, np.float32), np.empty(256, np.int64)
    found = 0
    for edge in range(len(a) + k):
        walled = edge >= len(a)
        at = np.float32(np.inf) if walled else level[edge]
        i, j = (edge - len(a), edge - len(a)) if walled else (a[edge], b[edge])
        i, j = root(parent, i), root(parent, j)
        if (walled and i != edge - len(a)) or (not walled and i == j):
            continue
        if lowest[j] < lowest[i]:
            i, j = j, i
        for turn in range(1 if walled else 2):
            top = i if turn == 0 else j
            # what forms and merges at one level has no cells below it but those of its parts
            if size[top] == 0 or not (walled or (at - lowest[top] >= depth and formed[top] < at)):
                continue
            if found == len(spill):
                spill, held = np.concatenate((spill, np.empty_like(spill))), np.concatenate((held, np.empty_like(held)))
            spill[found], held[found] = at, 0
            for count in range(2):  # first how many points it holds
                member = top
                while member >= 0 and held[found] <= most:
                    cell = first[member]
                    while cell >= 0:
                        if z[cell] < at and count == 0:
                            held[found] += points[cell]
                        elif z[cell] < at:
                            owner[cell] = found
                        cell = beside[cell]
                    member = after[member]
            if held[found] <= most:
                found += 1
            else:
                size[top] = 0
        if not walled:
            parent[j], formed[i] = i, at
            if size[i] > 0 and size[j] > 0 and size[i] + size[j] <= most:
                after[last[i]] = j
                last[i] = last[j]
                size[i] += size[j]
            else:
                size[i] = 0
    return owner, spill[:found].copy(), held[:found].copy()
