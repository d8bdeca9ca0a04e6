"""Those cells of a grid that matter, in row-major order: memory for these, whatever the extent of the grid."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from ...core.grid import Grid
from ...core.points import pieces

Places: TypeAlias = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
_TABLE = 16  # a grid of so many cells per cell in use is looked up in a table


class CellSet:
    """A set of cells of a grid, numbered in row-major order.

    Attributes:
        grid: all cells.
        row, column: i64[c], where those of the set are.
        key: i64[c], ascending, (row + 1) x ``wide`` + column + 1: in the grid with a ring of empty cells around it.
    """

    def __init__(self, key: np.ndarray, grid: Grid) -> None:
        """``key``: i64[c], ascending and distinct."""
        self.grid, self.wide, self.key = grid, grid.nx + 2, key
        row, column = np.divmod(key, self.wide)
        self.row, self.column = row - 1, column - 1
        self._table: np.ndarray | None = None
        if (size := (grid.ny + 2) * self.wide) <= _TABLE * len(key) + 1000:
            self._table = np.full(size, len(key), np.int32)
            self._table[key] = np.arange(len(key), dtype=np.int32)

    def __len__(self) -> int:
        return len(self.key)

    @classmethod
    def of(cls, grid: Grid, xyz: np.ndarray, places: Places | None = None) -> tuple[CellSet, np.ndarray]:
        """The cells that points f32[n, >=2] are in, and i32[n], which one each is in. ``places``: from some of the points to
        row and column, i[m] each; by default :meth:`jaxfilter.core.grid.Grid.places`."""
        found: Places = places or grid.places
        wide, points = grid.nx + 2, len(xyz)
        if (size := (grid.ny + 2) * wide) > min(_TABLE * points, 2**31):
            distinct, member = np.unique(ringed(*found(xyz), wide), return_inverse=True)
            return cls(distinct, grid), member.astype(np.int32)
        seen, member = np.zeros(size, bool), np.empty(points, np.int32)
        for part in pieces(points):
            key = ringed(*found(xyz[part]), wide)
            seen[key] = True
            member[part] = key
        number = np.cumsum(seen, dtype=np.int32)
        number -= 1
        for part in pieces(points):
            member[part] = number[member[part]]
        return cls(np.flatnonzero(seen), grid), member

    def grown(self, steps: int = 1) -> CellSet:
        """With the cells of the grid that are at most so many rows and columns away."""
        key = self.key
        for _ in range(steps):
            key = merged(key - 1, key, key + 1)
            column = key % self.wide
            key = key[(column > 0) & (column <= self.grid.nx)]
            key = merged(key - self.wide, key, key + self.wide)
            key = key[slice(*np.searchsorted(key, (self.wide, (self.grid.ny + 1) * self.wide)))]
        return CellSet(key, self.grid)

    def find(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        """i[...]: the number of each cell; the number of cells for those that are not in the set."""
        inside = (row >= 0) & (row < self.grid.ny) & (column >= 0) & (column < self.grid.nx)
        return self._number(np.where(inside, ringed(row, column, self.wide), 0))

    def around(self) -> np.ndarray:
        """i[9, c]: the number of each cell and of its neighbours, row by row, the cell itself being the fifth."""
        return np.stack([self._number(self.key + dy * self.wide + dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)])

    def _number(self, key: np.ndarray) -> np.ndarray:
        if self._table is not None:
            return self._table[key]
        number = np.minimum(np.searchsorted(self.key, key), len(self) - 1)
        return np.where(self.key[number] == key, number, len(self))


def ringed(row: np.ndarray, column: np.ndarray, wide: int) -> np.ndarray:
    """i64: :attr:`CellSet.key` of cells."""
    return (row.astype(np.int64) + 1) * wide + (column + 1)


def merged(*sorted_keys: np.ndarray) -> np.ndarray:
    """What is in one of the sorted arrays at least, sorted."""
    key = np.sort(np.concatenate(sorted_keys), kind="stable")  # merges what is sorted
    fresh = np.ones(len(key), bool)
    fresh[1:] = key[1:] != key[:-1]
    return key[fresh]
