"""Which of the ground points become vertices of the network: the two ways to carry out :class:`Vertices`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.grid import Grid
from ..host.tin import Tin
from .growth import Network


class Spaced:
    """All points, one per position; with a spacing in metres, one per square of a sheet: the first, of these the lowest."""

    def __init__(self, network: Network, spacing: float) -> None:
        self.network, self.square = network, None
        if spacing > 0:
            x, y = (np.floor(network.xyz[:, axis] / np.float32(spacing)).astype(np.int64) for axis in range(2))
            key = (network.sheet * (np.ptp(y) + 1) + y - y.min()) * (np.ptp(x) + 1) + x - x.min()
            if key.max() > 8 * len(key):
                key = np.unique(key, return_inverse=True)[1]
            self.square = np.where(network.row < 0, -1, key)
            self.taken = np.zeros(int(self.square.max(initial=-1)) + 2, bool)  # the last is for border nodes

    def begin(self) -> np.ndarray:
        """i64[.]: the seeds that are vertices."""
        seeds = self.pick(np.flatnonzero(self.network.seed & (self.network.row >= 0)))
        self.took(seeds)
        return seeds

    def could(self, nodes: np.ndarray, tin: Tin) -> np.ndarray:
        """bool[n]: located nodes that may become vertices: their position, and their square, have none."""
        free = tin.twins(nodes) < 0
        return free if self.square is None else free & ~self.taken[self.square[nodes]]

    def pick(self, nodes: np.ndarray) -> np.ndarray:
        """Those of nodes (ascending, that may) that become vertices together."""
        x, y, sheet = self.network.xyz[nodes, 0], self.network.xyz[nodes, 1], self.network.sheet[nodes]
        first = np.ones(len(nodes), bool)  # canonical order: equal positions follow each other, lowest first
        first[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1]) | (sheet[1:] != sheet[:-1])
        nodes = nodes[first]
        if self.square is None:
            return nodes
        square = self.square[nodes]
        order = np.lexsort((nodes, self.network.xyz[nodes, 2], square))
        lowest = (np.diff(square[order], prepend=-2) != 0) | (square[order] < 0)
        return np.sort(nodes[order[lowest]])

    def add(self, accepted: np.ndarray, tin: Tin) -> np.ndarray:
        """Bring located ground points, ascending, into the network; i64[v], the new vertices.

        The elevation of a vertex sinks to that of a lower one of them at its position.
        """
        twin, z = tin.twins(accepted), self.network.xyz[accepted, 2]
        at = np.flatnonzero(twin >= 0)
        at = at[z[at] < tin.xyz[twin[at], 2]]
        np.minimum.at(tin.xyz[:, 2], twin[at], z[at])
        tin.touch(twin[at])
        new = self.pick(accepted[self.could(accepted, tin)])
        tin.insert(new)
        self.took(new)
        return new

    def add_each(self, nodes: np.ndarray, relied: np.ndarray, tin: Tin) -> np.ndarray:
        """Insert nodes that may become vertices one after the other, unless a triangle of i32[n, 2] that they rely on (-1 =
        none) has changed in this round: bool[n], those that were inserted."""
        chosen = np.isin(nodes, self.pick(np.sort(nodes)))
        chosen[chosen] = tin.insert_each(nodes[chosen], relied[chosen])
        self.took(nodes[chosen])
        return chosen

    def took(self, new: np.ndarray) -> None:
        """Remember the squares of vertices."""
        if self.square is not None:
            self.taken[self.square[new]] = True
            self.taken[-1] = False


class LowestPerCell:
    """The lowest ground point in each cell of a grid, on finer and finer grids; border nodes stay."""

    def __init__(self, network: Network, grids: Sequence[Grid]) -> None:
        self.network, self.finer = network, list(grids)
        self.next_grid()

    def next_grid(self) -> None:
        """Go on to the next grid, which has no vertices yet."""
        net, grid = self.network, self.finer.pop(0)
        self.cell = grid.cell
        square = net.sheet.astype(np.int64) * (grid.nx * grid.ny) + grid.flat(net.xyz)
        self.square = np.where(net.row < 0, -1, square)
        self.lowest = np.full(int(self.square.max(initial=-1)) + 1, -1, np.int64)

    def begin(self) -> np.ndarray:
        """i64[.]: the seeds that are vertices."""
        return self.pick(np.flatnonzero(self.network.seed & (self.network.row >= 0)))

    def refine(self, ground: np.ndarray, tin: Tin) -> None:
        """Change to the next grid and make the lowest of all ground nodes, bool[k], its vertices."""
        self.next_grid()
        after = np.zeros_like(tin.vertex)
        after[self.network.virtual] = True
        after[self.pick(np.flatnonzero(ground))] = True
        tin.remove(np.flatnonzero(tin.vertex & ~after))
        tin.insert(np.flatnonzero(after & ~tin.vertex))

    def could(self, nodes: np.ndarray, tin: Tin) -> np.ndarray:
        """bool[n]: nodes in a cell without a vertex, or lower than it (of equals, the first in order)."""
        at, z = self.square[nodes], self.network.xyz[:, 2]
        vertex = self.lowest[at]
        lower = (z[nodes] < z[vertex]) | ((z[nodes] == z[vertex]) & (nodes < vertex))
        return (at >= 0) & ((vertex < 0) | lower)

    def pick(self, nodes: np.ndarray) -> np.ndarray:
        """The lowest of nodes, ascending, in each cell; they are its vertices from now on."""
        nodes = nodes[self.square[nodes] >= 0]
        at, z = self.square[nodes], self.network.xyz[nodes, 2]
        low = np.full(len(self.lowest), np.inf, np.float32)
        np.minimum.at(low, at, z)
        least = z == low[at]
        nodes, at = nodes[least], at[least]
        self.lowest[at[::-1]] = nodes[::-1]  # of equals the first in order is written last, and stays
        return nodes[self.lowest[at] == nodes]

    def add(self, accepted: np.ndarray, tin: Tin) -> np.ndarray:
        """Bring ground points, ascending, into the network, in the place of higher ones; i64[v], the new vertices."""
        before = self.lowest.copy()
        new = self.pick(accepted[self.could(accepted, tin)])
        replaced = before[self.square[new]]
        tin.remove(np.sort(replaced[replaced >= 0]))
        tin.insert(new)
        return new
