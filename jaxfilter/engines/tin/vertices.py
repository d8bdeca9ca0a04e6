"""Which of the ground points become vertices of the network: the two ways to carry out :class:`Vertices`."""

from __future__ import annotations

import numpy as np

from ...core.grid import Grid
from .growth import Network, Vertices
from .triangulation import Tin


def choice_of(network: Network, vertices: Vertices) -> Spaced | LowestPerCell:
    """What carries out a policy on a network, from the seeds on."""
    return LowestPerCell(network, vertices) if vertices.grids else Spaced(network, vertices)


class _Choice:
    """The lowest nodes of squares.

    Attributes:
        seeds: i64[.], the seeds that are vertices.
        square: i64[k], the square of each node (those of border nodes do not count); None = no squares.
        level, vertex: f32 and i32 per square, elevation and node of its vertex; inf and -1 without one.
    """

    seeds: np.ndarray
    square: np.ndarray | None = None

    def __init__(self, network: Network) -> None:
        self.network = network

    def divide(self, square: np.ndarray) -> None:
        """Begin with squares, i64[k], that have no vertices."""
        self.square = square
        count = int(square.max(initial=0)) + 1
        self.level, self.vertex = np.full(count, np.inf, np.float32), np.full(count, -1, np.int32)

    def lowest(self, nodes: np.ndarray) -> np.ndarray:
        """The lowest of nodes, ascending, that may be vertices, in each square (of equals the first): they are its vertices."""
        assert self.square is not None
        at, z = self.square[nodes], self.network.xyz[nodes, 2]
        np.minimum.at(self.level, at, z)
        least = z == self.level[at]
        nodes, at = nodes[least], at[least]
        self.vertex[at[::-1]] = nodes[::-1]  # of equals the first in order is written last, and stays
        return nodes[self.vertex[at] == nodes]


class Spaced(_Choice):
    """All points, one per position; with a spacing in metres, one per square of a sheet: the first, of these the lowest."""

    finer = ()

    def __init__(self, network: Network, vertices: Vertices) -> None:
        super().__init__(network)
        if vertices.spacing > 0:
            x, y = (np.floor(network.xyz[:, axis] / np.float32(vertices.spacing)).astype(np.int64) for axis in range(2))
            key = (network.sheet * (np.ptp(y) + 1) + y - y.min()) * (np.ptp(x) + 1) + x - x.min()
            self.divide(key if key.max() <= 8 * len(key) else np.unique(key, return_inverse=True)[1])
        self.seeds = self._pick(np.flatnonzero(network.seed & network.real))

    def could(self, nodes: np.ndarray, tin: Tin) -> np.ndarray:
        """bool[n]: located nodes that may become vertices: their position, and their square, have none."""
        return (tin.twins(nodes) < 0) & self._free(nodes)

    def _free(self, nodes: np.ndarray) -> np.ndarray:
        return np.ones(len(nodes), bool) if self.square is None else self.vertex[self.square[nodes]] < 0

    def _pick(self, nodes: np.ndarray) -> np.ndarray:
        """Those of nodes (ascending, that may) that become vertices together."""
        if self.square is not None:
            return self.lowest(nodes)
        x, y, sheet = self.network.xyz[nodes, 0], self.network.xyz[nodes, 1], self.network.sheet[nodes]
        first = np.ones(len(nodes), bool)  # canonical order: equal positions follow each other, lowest first
        first[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1]) | (sheet[1:] != sheet[:-1])
        return nodes[first]

    def add(self, accepted: np.ndarray, tin: Tin) -> np.ndarray:
        """Bring located ground points, ascending, into the network; i64[v], the new vertices.

        The elevation of a vertex sinks to that of a lower one of them at its position.
        """
        twin, z = tin.twins(accepted), self.network.xyz[accepted, 2]
        lower = np.flatnonzero(twin >= 0)
        lower = lower[z[lower] < tin.xyz[twin[lower], 2]]
        np.minimum.at(tin.xyz[:, 2], twin[lower], z[lower])
        tin.touch(twin[lower])
        fresh = accepted[twin < 0]
        new = self._pick(fresh[self._free(fresh)])
        tin.insert(new)
        return new


class LowestPerCell(_Choice):
    """The lowest ground point in each cell of a grid, on finer and finer grids; border nodes stay."""

    square: np.ndarray

    def __init__(self, network: Network, vertices: Vertices) -> None:
        super().__init__(network)
        self.finer = list(vertices.grids)
        self._next_grid()
        self.seeds = self.lowest(np.flatnonzero(network.seed & network.real))

    def _next_grid(self) -> None:
        grid: Grid = self.finer.pop(0)
        self.cell = grid.cell
        self.divide(self.network.sheet.astype(np.int64) * (grid.nx * grid.ny) + grid.flat(self.network.xyz))

    def refine(self, ground: np.ndarray, tin: Tin) -> None:
        """Change to the next grid and make the lowest of all ground nodes, bool[k], its vertices."""
        self._next_grid()
        after = ~self.network.real
        after[self.lowest(np.flatnonzero(ground & self.network.real))] = True
        tin.remove(np.flatnonzero(tin.vertex & ~after))
        tin.insert(np.flatnonzero(after & ~tin.vertex))

    def could(self, nodes: np.ndarray, tin: Tin) -> np.ndarray:
        """bool[n]: nodes in a cell without a vertex, or lower than it (of equals, the first in order)."""
        at, z = self.square[nodes], self.network.xyz[nodes, 2]
        return (z < self.level[at]) | ((z == self.level[at]) & (nodes < self.vertex[at]))

    def add(self, accepted: np.ndarray, tin: Tin) -> np.ndarray:
        """Bring ground points, ascending, into the network, in the place of higher ones; i64[v], the new vertices."""
        before = self.vertex.copy()
        new = self.lowest(accepted[self.could(accepted, tin)])
        replaced = before[self.square[new]]
        tin.remove(np.sort(replaced[replaced >= 0]))
        tin.insert(new)
        return new
