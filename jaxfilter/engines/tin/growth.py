"""What densification is told: the network it starts from, and the policies in which methods differ; and what becomes a vertex."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...core.filter import Labels
from ...core.frame import ends
from ...core.grid import Grid
from ...core.points import Points, by_position, pieces
from .facets import Rule
from .triangulation import Tin


class Outliers(NamedTuple):
    """Points that must not be seeds of the ground.

    Attributes:
        barred: bool[m], all of them.
        late: bool[m], suspected low outliers among them: they take part when the others are done, tested on both sides.
        removed: whether barred points are never ground, either.
    """

    barred: np.ndarray
    late: np.ndarray
    removed: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Network:
    """What densification starts from: nodes of one or several sheets.

    Attributes:
        points: the points that are nodes.
        xyz: f32[k, 3], local metres, sheet by sheet, each in canonical order, simulated border nodes last.
        sheet: i32[k], ascending.
        row: i64[k], the point that each node is; -1 for simulated border nodes.
        seed: bool[k], ground from the start (border nodes too). Per sheet at least three, around all its nodes.
        open: bool[k], nodes to be classified in this sheet.
        late: bool[k], suspected low outliers, see :class:`Outliers`.
        outliers: points that are no seeds.
        info: counts for the result.
        before: labels of an earlier growth, the ground of which are the seeds; None = there was none.
    """

    points: Points
    xyz: np.ndarray
    sheet: np.ndarray
    row: np.ndarray
    seed: np.ndarray
    open: np.ndarray
    late: np.ndarray
    outliers: Outliers
    info: dict[str, Any] = dataclasses.field(default_factory=dict)
    before: Labels | None = None

    @functools.cached_property
    def virtual(self) -> np.ndarray:
        """i64[b], simulated border nodes."""
        return np.flatnonzero(~self.real)

    @functools.cached_property
    def real(self) -> np.ndarray:
        """bool[k], nodes that are points."""
        return self.row >= 0


KEPT_QUANTITIES = ("decision", "margin", "angle", "elevation")
"""What a result tells of the last test of each point."""


@dataclasses.dataclass(frozen=True)
class Mirror:
    """Mirroring of points over facets steeper than ``slope``, degrees: about the highest vertex, and the image is tested in
    place of the point (Zhang & Lin 2013); with ``nearest`` about the nearest vertex, as a second chance (Axelsson 2000)."""

    slope: float
    nearest: bool = False


@dataclasses.dataclass(frozen=True)
class Vertices:
    """Which ground points become vertices: all, one per position; or with ``spacing`` one per square of this size (metres),
    the first that is accepted, of these the lowest; or with ``grids`` the lowest in each cell (Uray & Varlik 2024).

    Attributes:
        sinks: the elevation of a vertex sinks to that of a lower ground point at its position.
        grids: from coarse to fine. A lower point that is accepted later takes the place of the vertex of its cell.
        stop_share: go on to the next grid, or end, when a round accepts fewer than this share of all points; below any
            share it still has to accept one.
        rounds: in place of ``stop_share``, rounds on each grid, and with the suspected low outliers.
    """

    spacing: float = 0.0
    sinks: bool = True
    grids: Sequence[Grid] = ()
    stop_share: float = 0.0
    rounds: Sequence[int] | None = None


@dataclasses.dataclass(frozen=True)
class Adaptive:
    """Thresholds that follow the ground found so far.

    Attributes:
        rule: from unsigned distances f32[s], metres, and angles f32[s], degrees, to thresholds. Not called without any.
        of_ground: of ground points that are no vertices, in their facets, each time that :class:`Vertices` change to a finer
            grid; else before each round, of vertices over the plane of the facet beyond the edge opposite them (a sample of
            them, which does not depend on the order of points).
    """

    rule: Callable[[np.ndarray, np.ndarray], Rule]
    of_ground: bool = False


class Beyond(NamedTuple):
    """Limits for points outside the hull, where planes of slim facets at the border go on to anywhere.

    Attributes:
        height: metres above or below the nearest place on the hull, at most; slope: f32[k], by which this grows per metre away.
    """

    height: float
    slope: np.ndarray


@dataclasses.dataclass(frozen=True)
class Growth:
    """How the ground grows from the seeds.

    Attributes:
        rule: thresholds; those that differ between nodes are f32[k].
        mirror: mirror points over steep facets; None = never.
        adaptive: how thresholds change as the ground grows; None = they are constant.
        border_follows: after each round simulated border nodes take the elevation of the ground vertex nearest to them in the
            plane (Li et al. 2021, Sec. II-E, step 6).
        one_per_facet: a round adds, of the points over a facet that pass and may become vertices, only the one that lies
            lowest over it (after Nie et al. 2017); the others are tested again over the new facets.
        beyond: how points join outside the hull of the vertices; None = as inside.
        triangulation: of :data:`jaxfilter.engines.tin.reference.TRIANGULATIONS`.
        kept: the tested quantities that are kept, of :data:`jaxfilter.engines.tin.facets.FACET_QUANTITIES`.
    """

    rule: Any
    mirror: Mirror | None = None
    vertices: Vertices = Vertices()
    adaptive: Adaptive | None = None
    border_follows: bool = False
    one_per_facet: bool = False
    beyond: Beyond | None = None
    triangulation: str = "own"
    kept: tuple[str, ...] = KEPT_QUANTITIES

    @property
    def moves(self) -> bool:
        """Whether vertices move up or down."""
        return self.border_follows or self.vertices.sinks


def lowest_of_each(xyz: np.ndarray, rows: np.ndarray, sheet: np.ndarray | None = None) -> np.ndarray:
    """i64: of rows, ascending, the first at each position of points f32[m, 3] in canonical order, which is the lowest.

    ``sheet``: i32[m], ascending; points of two are not at one position.
    """
    place = [xyz[rows, 0], xyz[rows, 1], *([] if sheet is None else [sheet[rows]])]
    first = np.ones(len(rows), bool)
    first[1:] = np.logical_or.reduce([along[1:] != along[:-1] for along in place])
    return rows[first]


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
        """The lowest of nodes, ascending, that may be vertices, in each square (of equals :func:`by_position`): its vertices."""
        assert self.square is not None
        at, z = self.square[nodes], self.network.xyz[nodes, 2]
        np.minimum.at(self.level, at, z)
        least = z == self.level[at]
        nodes, at = nodes[least], at[least]
        order = by_position(self.network.xyz[nodes])[::-1]
        self.vertex[at[order]] = nodes[order]  # of equals the first by position is written last, and stays
        return nodes[self.vertex[at] == nodes]


class Spaced(_Choice):
    """All points, one per position; with a spacing in metres, one per square of a sheet: the first, of these the lowest."""

    finer = ()

    def __init__(self, network: Network, vertices: Vertices) -> None:
        super().__init__(network)
        self._sinks = vertices.sinks
        if vertices.spacing > 0:
            side, key = np.float32(vertices.spacing), np.empty(len(network.xyz), np.int64)
            low, high = (np.floor(end / side).astype(np.int64) for end in ends(network.xyz[:, :2]))
            columns, rows = high - low + 1
            for part in pieces(len(key)):
                x, y = np.floor(network.xyz[part, :2].T / side).astype(np.int64) - low[:, None]
                key[part] = (network.sheet[part] * rows + y) * columns + x
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
        return lowest_of_each(self.network.xyz, nodes, self.network.sheet)

    def add(self, accepted: np.ndarray, tin: Tin) -> np.ndarray:
        """Bring located ground points, ascending, into the network; i64[v], the new vertices.

        The elevation of a vertex sinks to that of a lower one of them at its position, if the policy says so.
        """
        twin, z = tin.twins(accepted), self.network.xyz[accepted, 2]
        lower = np.flatnonzero((twin >= 0) & self._sinks)
        lower = lower[z[lower] < tin.xyz[twin[lower], 2]]
        np.minimum.at(tin.xyz[:, 2], twin[lower], z[lower])
        tin.touch(twin[lower])
        fresh = accepted[twin < 0]
        new = self._pick(fresh[self._free(fresh)])
        del twin, z, fresh  # memory is at its peak in what follows
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
        tin.become(np.append(self.network.virtual, self.lowest(np.flatnonzero(ground & self.network.real))))

    def could(self, nodes: np.ndarray, tin: Tin) -> np.ndarray:
        """bool[n]: nodes in a cell without a vertex, or lower than it (of equals, the first by position)."""
        at, (x, y, z) = self.square[nodes], self.network.xyz[nodes].T
        level, (there, north, _) = self.level[at], self.network.xyz[self.vertex[at]].T
        return (z < level) | ((z == level) & ((x < there) | ((x == there) & (y < north))))

    def add(self, accepted: np.ndarray, tin: Tin) -> np.ndarray:
        """Bring ground points, ascending, into the network, in the place of higher ones; i64[v], the new vertices."""
        before = self.vertex.copy()
        new = self.lowest(accepted[self.could(accepted, tin)])
        replaced = before[self.square[new]]
        tin.remove(np.sort(replaced[replaced >= 0]))
        tin.insert(new)
        return new
