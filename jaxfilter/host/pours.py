"""Compiled steps of :mod:`jaxfilter.host.depressions`: where water runs, and which basins join as it rises."""

from __future__ import annotations

import numpy as np

from .compiled import compiled


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
def passes(z, around, basin):
    """Pairs of touching cells in different basins: i64[p], i64[p] the basins, and f32[p] the level of the pass between."""
    a, b, level = np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024, np.float32)
    count = 0
    for cell in range(len(basin)):
        if basin[cell] < 0:
            continue
        for k in range(5, 9):  # each pair of touching cells once
            other = around[k, cell]
            if z[other] == np.inf or basin[other] == basin[cell]:
                continue
            if count == len(a):
                a = np.concatenate((a, np.empty_like(a)))
                b = np.concatenate((b, np.empty_like(b)))
                level = np.concatenate((level, np.empty_like(level)))
            a[count], b[count], level[count] = basin[cell], basin[other], max(z[cell], z[other])
            count += 1
    return a[:count].copy(), b[:count].copy(), level[:count].copy()


@compiled
def mergers(low, a, b, level, depth, most):
    """Depressions at least ``depth`` deep at the pass where they overflow, in ascending order of that pass.

    Passes ascend, and lead from basin ``a`` to ``b``; ``low``: f32[k], the bottom of each basin. Depressions that walls
    surround come last; those of more than ``most`` basins are left out. Returns spill levels f32[d], numbers of basins
    i64[d], and these basins, one depression after the other.
    """
    k = len(low)
    parent, lowest, formed = np.arange(k), low.copy(), np.full(k, -np.inf)
    size, last, after = (
        np.ones(k, np.int64),
        np.arange(k),
        np.full(k, -1),
    )  # members of a root: a chain that begins with
    first = np.arange(k)  # ``first``; size 0 = too many
    spill, count, members = np.empty(256, np.float32), np.empty(256, np.int64), np.empty(1024, np.int64)
    found = listed = 0
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
        if walled:
            if i != edge - len(a):
                continue
        elif i == j:
            continue
        if lowest[j] < lowest[i]:
            i, j = j, i
        for turn in range(1 if walled else 2):
            root = i if turn == 0 else j
            if size[root] == 0 or not (walled or (at - lowest[root] >= depth and formed[root] < at)):
                continue
            if found == len(spill):
                spill = np.concatenate((spill, np.empty_like(spill)))
                count = np.concatenate((count, np.empty_like(count)))
            while listed + size[root] > len(members):
                members = np.concatenate((members, np.empty_like(members)))
            spill[found], count[found] = at, size[root]
            found += 1
            member = first[root]
            while member >= 0:
                members[listed] = member
                listed += 1
                member = after[member]
        if walled:
            continue
        parent[j] = i
        formed[i] = at  # what forms and merges at one level has no cells below it but those of its parts
        if size[i] > 0 and size[j] > 0 and size[i] + size[j] <= most:
            after[last[i]] = first[j]
            last[i] = last[j]
            size[i] += size[j]
        else:
            size[i] = 0
    return spill[:found].copy(), count[:found].copy(), members[:listed].copy()
