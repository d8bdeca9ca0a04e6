"""Compiled steps of :mod:`jaxfilter.engines.grid.depressions`: where water runs, and which basins join as it rises."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled

_MET = 4  # basins that each one has met last, whose passes are remembered


@compiled
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


@compiled
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


@compiled
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
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        while parent[j] != j:
            parent[j] = parent[parent[j]]
            j = parent[j]
        if (walled and i != edge - len(a)) or (not walled and i == j):
            continue
        if lowest[j] < lowest[i]:
            i, j = j, i
        for turn in range(1 if walled else 2):
            root = i if turn == 0 else j
            # what forms and merges at one level has no cells below it but those of its parts
            if size[root] == 0 or not (walled or (at - lowest[root] >= depth and formed[root] < at)):
                continue
            if found == len(spill):
                spill, held = np.concatenate((spill, np.empty_like(spill))), np.concatenate((held, np.empty_like(held)))
            spill[found], held[found] = at, 0
            for count in range(2):  # first how many points it holds
                member = root
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
                size[root] = 0
        if not walled:
            parent[j], formed[i] = i, at
            if size[i] > 0 and size[j] > 0 and size[i] + size[j] <= most:
                after[last[i]] = j
                last[i] = last[j]
                size[i] += size[j]
            else:
                size[i] = 0
    return owner, spill[:found].copy(), held[:found].copy()
