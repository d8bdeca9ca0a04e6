"""Depressions of a gridded surface: sets of cells from which no path leads out without climbing."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

_FORWARD = (5, 7, 8, 6)
"""The neighbours, of the nine cells around one, that meet each pair of touching cells once."""


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


def depressions(z: np.ndarray, around: np.ndarray, points: np.ndarray, depth: float, max_points: int) -> Depressions:
    """The largest depressions that are at least ``depth`` deep and hold at most ``max_points``.

    Args:
        z: f32[n], the surface in the cells that there are; others, and those at +inf, are walls.
        around: i[9, n], each cell among its neighbours, as from :meth:`jaxfilter.host.cells.Cells.around`.
        points: i64[n], how many points each cell counts for.

    A depression is a maximal 8-connected set of cells below its spill level, the lowest pass that leads out of it. They
    form a tree, since two merge at their pass into another one. Those returned are disjoint: the outermost that
    qualify, so that a small pit at the bottom of a qualifying one is not listed apart. The tree is that of single
    linkage of the basins of steepest descent, and comes from the minimum spanning tree of the passes between them.
    """
    label, low = _basins(z, around)
    spill, count, basin = _mergers(low, *_passes(z, around, label, len(low)), depth, max_points)
    order = np.argsort(label, kind="stable")  # cells, basin by basin; walls first
    start = np.searchsorted(label[order], np.arange(len(low) + 1))
    cells = start[basin + 1] - start[basin]
    within = np.arange(int(cells.sum())) - np.repeat(np.cumsum(cells) - cells, cells)
    cell = order[np.repeat(start[basin], cells) + within]
    owner = np.repeat(np.repeat(np.arange(len(spill)), count), cells)
    below = z[cell] < spill[owner]
    cell, owner = cell[below], owner[below]
    held = np.bincount(owner, weights=points[cell], minlength=len(spill)).astype(np.int64)
    fits = held <= max_points
    cell, owner = cell[fits[owner]], owner[fits[owner]]
    outermost = np.full(z.size, -1)
    np.maximum.at(outermost, cell, owner)  # mergers are listed from the lowest to the highest
    cell = np.flatnonzero(outermost >= 0)
    kept, owner = np.unique(outermost[cell], return_inverse=True)
    order = np.argsort(owner, kind="stable")
    return Depressions(cell[order], owner[order], spill[kept], held[kept])


def _basins(z: np.ndarray, around: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """i64[n], the basin that steepest descent leads each cell to (-1: wall), and the minimum of each basin, f32[k].

    Descent goes to the lowest of eight neighbours, of equal ones to that with the lowest number.
    """
    walled = np.append(z, np.float32(np.inf))
    lowest, down = np.full_like(z, np.inf), np.arange(len(z))
    for neighbour in around:
        level = walled[neighbour]
        lower = level < lowest
        np.copyto(lowest, level, where=lower)
        np.copyto(down, neighbour, where=lower)
    while not np.array_equal(further := down[down], down):
        down = further
    bottom = np.flatnonzero((down == np.arange(len(z))) & np.isfinite(z))
    number = np.full(len(z), -1)
    number[bottom] = np.arange(len(bottom))
    return np.where(np.isfinite(z), number[down], -1), z[bottom]


def _passes(
    z: np.ndarray, around: np.ndarray, label: np.ndarray, basins: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The passes that connect all basins at the lowest level: i64[p], i64[p] basins and f32[p] levels, ascending."""
    walled, labels = np.append(z, np.float32(np.inf)), np.append(label, -1)
    pairs, levels = [], []
    for neighbour in around[_FORWARD, :]:
        b = labels[neighbour]
        meet = np.flatnonzero((label != b) & (label >= 0) & (b >= 0))
        a, b = label[meet], b[meet]
        pairs.append(np.minimum(a, b) * basins + np.maximum(a, b))
        levels.append(np.maximum(z[meet], walled[neighbour[meet]]))
    pair, level = np.concatenate(pairs), np.concatenate(levels)
    order = np.lexsort((pair, level))
    pair, first = np.unique(pair[order], return_index=True)
    ascending = np.argsort(first)
    pair, level = pair[ascending], level[order][first[ascending]]
    a, b = np.divmod(pair, max(basins, 1))
    rank = np.arange(1.0, len(pair) + 1)  # as weights: all different, and none zero, which would mean no edge
    tree = minimum_spanning_tree(coo_array((rank, (a, b)), shape=(basins, basins)).tocsr())
    chosen = np.sort(tree.data).astype(np.int64) - 1
    return a[chosen], b[chosen], level[chosen]


def _mergers(
    low: np.ndarray, a: np.ndarray, b: np.ndarray, level: np.ndarray, depth: float, max_basins: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depressions at least ``depth`` deep at the pass where they overflow, in ascending order of that pass.

    Those that walls surround come last. Returns spill levels f32[k], number of basins i64[k], and their basins, one
    depression after the other. Depressions of more than ``max_basins`` basins are left out.
    """
    parent = list(range(len(low)))
    lowest = low.tolist()
    formed = [-np.inf] * len(low)
    members: list[list[int] | None] = [[i] for i in parent]
    spill: list[float] = []
    count: list[int] = []
    basin: list[int] = []

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for i, j, at in zip(a.tolist(), b.tolist(), level.tolist(), strict=True):
        i, j = root(i), root(j)
        if lowest[j] < lowest[i]:
            i, j = j, i
        mine, theirs = members[i], members[j]
        for k, part in ((i, mine), (j, theirs)):
            if part is not None and at - lowest[k] >= depth and formed[k] < at:
                spill.append(at)
                count.append(len(part))
                basin += part
        joined = None
        if mine is not None and theirs is not None and len(mine) + len(theirs) <= max_basins:
            joined = mine + theirs
        parent[j] = i
        formed[i] = at  # what forms and merges at one level has no cells below it but those of its parts
        members[i], members[j] = joined, None
    for part in members:
        if part is not None:
            spill.append(np.inf)
            count.append(len(part))
            basin += part
    return np.array(spill, np.float32), np.array(count, np.int64), np.array(basin, np.int64)
