"""Depressions of a gridded surface: sets of cells from which no path leads out without climbing."""

from __future__ import annotations

import dataclasses

import numpy as np


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

        ``around``: i[9, n], each cell among its neighbours, as from :meth:`jaxfilter.engines.grid.sparse.Cells.around`.
        """
        from . import pours  # imports Numba

        self.z, self._pours = z, pours
        walled = np.append(z, np.float32(np.inf))
        self.basin, self.bottom = pours.descend(walled, around)
        a, b, level = pours.passes(walled, around, self.basin, len(self.bottom))
        order = _ascending(level)
        self.a, self.b, self.level = a[order], b[order], level[order]

    def depressions(self, points: np.ndarray, depth: float, max_points: int) -> Depressions:
        """The largest depressions that are at least ``depth`` deep and hold at most ``max_points``.

        ``points``: i64[n], how many points each cell counts for.

        A depression is a maximal 8-connected set of cells below its spill level, the lowest pass that leads out of it. They
        form a tree, since two merge at their pass into another one. Those returned are disjoint: the outermost that
        qualify, so that a small pit at the bottom of a qualifying one is not listed apart. The tree is that of single
        linkage of the basins: they are joined over the passes between them, the lowest first.
        """
        outermost, spill, held = self._pours.mergers(
            self.z[self.bottom], self.a, self.b, self.level, depth, max_points, self.z, self.basin, points
        )
        cell = np.flatnonzero(outermost >= 0)
        kept, owner = np.unique(outermost[cell], return_inverse=True)
        order = np.argsort(owner, kind="stable")
        return Depressions(cell[order], owner[order], spill[kept], held[kept])


def _ascending(level: np.ndarray) -> np.ndarray:
    """i64[n]: the stable order of f32[n], by sorting whole numbers made of value and place; argsort takes twice as long."""
    bits = (level + np.float32(0)).view(np.int32).astype(np.int64)  # no negative zero
    key = (np.where(bits < 0, bits ^ 0x7FFFFFFF, bits) << 32) | np.arange(len(level))
    key.sort()
    return key & 0xFFFFFFFF
