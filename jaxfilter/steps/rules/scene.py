"""The state of a scene that the steps of OST fill in, and what a rule is: something that changes one part of it."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ...core.filter import Labels
from ...core.points import Points
from ...engines.grid.inpaint import fill_nearest
from ...engines.tin.ground import GroundTin
from ...engines.tin.triangulation import Tin
from ..objects import Parts
from ..pruning import Scatter
from ..sensors import KINDS
from ..surfaces import Cells, lowest_cells, positions


class Sizes(NamedTuple):
    """Metres: side of a cell, ``spacing`` of the points, the ``widest`` deck, ``step`` between cells of one surface, ``drop`` at
    the flanks of a deck; and square metres of the smallest ``area`` of a deck and of the land at its ends."""

    cell: float
    spacing: float
    widest: float
    step: float
    drop: float
    area: float


class Flanked(NamedTuple):
    """A surface, and where it falls upright on both sides.

    Attributes:
        z: f32[rows, columns], metres, infinite where it is not known. points: i64[rows, columns], how many are in each cell.
        sizes: lengths and areas. gap: cells within which the surface falls at an upright edge.
        flanks: of :func:`jaxfilter.engines.grid.shapes.flanks`, [rows, columns] each; none where points are too far apart to
            show a deck.
    """

    z: np.ndarray
    points: np.ndarray
    sizes: Sizes
    gap: int
    flanks: tuple[np.ndarray, ...]


@dataclasses.dataclass(eq=False)
class OstScene:
    """What OST knows of a cloud, in the order in which it finds out. Grids are [rows, columns], without padding.

    Attributes:
        ost: the filter, whose fields rules may read. points: those that are classified, m of them. spacing: metres.
        low: bool[m], points that are too low to be seeds.
        plants: bool[m], where plants hide the ground. veil: bool[m], points of these that the surface is made without.
        cells: the grid. lowest: i64, rows of the points that are lowest in their cell; tin: their triangulation.
        z: f32, the lowest elevation of each cell, metres, none missing; inside: bool, cells inside the hull of these points.
        high: f32, the highest elevation of each cell; known to the rule for steep terrain alone.
        steepest: f32, metres per cell that openings lower a cell by. segments: of ``z``.
        slope: f32, rise over run of the landscape around each cell.
        joined: segments over larger steps; known to the rule for halls alone. flanked: to the rule for crossings alone.
        marked: bool, cells that openings take for objects. whole: bool, cells of segments that are objects as a whole.
        back: bool, cells of these that are ground all the same. rock: bool, steep ones among them.
        deck, level: f32, elevations of bridge decks and of water, metres, NaN elsewhere; known to the rule for crossings alone.
        seeds: i64, rows of the first ground. never: bool[m], points that may not become ground.
        distance: f32[m], metres from the plane of a facet within which a point joins.
    """

    ost: Any
    points: Points
    spacing: float
    low: np.ndarray = dataclasses.field(init=False)
    plants: np.ndarray = dataclasses.field(init=False)
    veil: np.ndarray = dataclasses.field(init=False)
    cells: Cells = dataclasses.field(init=False)
    lowest: np.ndarray = dataclasses.field(init=False)
    tin: Tin = dataclasses.field(init=False)
    z: np.ndarray = dataclasses.field(init=False)
    inside: np.ndarray = dataclasses.field(init=False)
    high: np.ndarray = dataclasses.field(init=False)
    steepest: np.ndarray = dataclasses.field(init=False)
    segments: Parts = dataclasses.field(init=False)
    slope: np.ndarray = dataclasses.field(init=False)
    joined: list[Parts] = dataclasses.field(init=False)
    flanked: Flanked = dataclasses.field(init=False)
    marked: np.ndarray = dataclasses.field(init=False)
    whole: np.ndarray = dataclasses.field(init=False)
    back: np.ndarray = dataclasses.field(init=False)
    rock: np.ndarray = dataclasses.field(init=False)
    deck: np.ndarray = dataclasses.field(init=False)
    level: np.ndarray = dataclasses.field(init=False)
    seeds: np.ndarray = dataclasses.field(init=False)
    never: np.ndarray = dataclasses.field(init=False)
    distance: np.ndarray = dataclasses.field(init=False)

    @property
    def objects(self) -> np.ndarray:
        """bool[rows, columns]: cells that are no ground."""
        return (self.marked | self.whole) & ~self.back

    @property
    def seen(self) -> np.ndarray:
        """bool[rows, columns]: cells with points."""
        rows, columns = self.z.shape
        return np.ascontiguousarray(np.asarray(self.cells.seen)[:rows, :columns])


@dataclasses.dataclass(frozen=True)
class OstRule:
    """A rule of OST: a frozen value that holds its constants. It defines one or more of these methods; each changes the scene
    after a step. All rules take their turn at a step, in the order of :data:`jaxfilter.steps.rules.RULES`.

    What ``bar``, ``fill`` and ``measure`` write is shared by the sets of a sweep: they replace an array, and do not write into
    it.
    """

    SENSORS: ClassVar[tuple[str, ...]] = KINDS
    """The kinds of clouds that the rule is for, where no rules are named."""

    def bar(self, scene: OstScene) -> None:
        """After low points: change ``low``, or ``plants`` and ``veil``."""

    def fill(self, scene: OstScene) -> None:
        """After the surface: change ``z``, or measure more of it."""

    def measure(self, scene: OstScene) -> None:
        """After openings and segments: measure what does not depend on which cells are objects."""

    def give_back(self, scene: OstScene) -> None:
        """After openings and segments, twice, since the slope of the landscape needs to know what is ground: change ``back``."""

    def judge(self, scene: OstScene) -> None:
        """After that: change ``whole``."""

    def seed(self, scene: OstScene) -> None:
        """After seeds: change ``seeds``, ``never`` or ``distance``."""

    def prune(self, scene: OstScene, ground: GroundTin, scatter: Scatter) -> int:
        """After pruning: drop more vertices of the triangulation; how many. ``scatter``: of the vertices before pruning."""
        return 0

    def label(self, scene: OstScene, labels: Labels) -> None:
        """At the end: change labels. ``scene.points`` are all points here, also those for which another stands."""


def grid_of(scene: OstScene, cell: float) -> Cells:
    """The lowest point of each square of ``cell`` metres, without those that are too low, or in the veil. Squares are centred on
    the lattice."""
    x, y = scene.points.offset(cell)
    return lowest_cells(
        scene.points, cell, "OST(cell)", corner=(x - cell / 2, y - cell / 2), barred=scene.low | scene.veil
    )


def filled(tin: Tin, cells: Cells) -> tuple[np.ndarray, np.ndarray]:
    """f32[rows, columns]: lowest elevations, and in empty cells those of a triangulation of the lowest points; outside its hull
    the nearest cell decides. bool[rows, columns]: cells inside its hull."""
    from ...engines.grid.shapes import draw  # imports Numba

    rows, columns = cells.grid.shape
    z, inside = (np.array(a)[:rows, :columns].copy() for a in (cells.lowest, cells.seen))
    draw(*positions(tin.xyz, cells), tin.triangles, tin.xyz[:, 2].copy(), z, inside)
    pad = [(0, wide - n) for wide, n in zip(cells.lowest.shape, z.shape, strict=True)]
    return np.array(fill_nearest(np.pad(z, pad), np.pad(inside, pad), cells.valid))[:rows, :columns], inside
