"""What densification is told: the network it starts from, and the policies in which methods differ."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...core.filter import Labels
from ...core.grid import Grid
from ...core.points import Points
from .facets import Rule


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
        late: bool[k], suspected low outliers: they take part when the others are done, and are tested on both sides.
        barred: bool[m], points that are no seeds; None = none.
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
    barred: np.ndarray | None = None
    info: dict[str, Any] = dataclasses.field(default_factory=dict)
    before: Labels | None = None

    def repeated(self, times: int) -> Network:
        """So many sheets for each one."""
        sheet = np.concatenate([self.sheet + i * (self.sheet[-1] + 1) for i in range(times)])
        xyz = np.tile(self.xyz, (times, 1))
        alike: dict[str, Any] = {name: np.tile(getattr(self, name), times) for name in ("row", "seed", "open", "late")}
        return dataclasses.replace(self, xyz=xyz, sheet=sheet, **alike)

    @functools.cached_property
    def virtual(self) -> np.ndarray:
        """i64[b], simulated border nodes."""
        return np.flatnonzero(~self.real)

    @functools.cached_property
    def real(self) -> np.ndarray:
        """bool[k], nodes that are points."""
        return self.row >= 0


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
        grids: from coarse to fine. A lower point that is accepted later takes the place of the vertex of its cell.
        stop_share: go on to the next grid, or end, when a round accepts fewer than this share of all points; below any
            share it still has to accept one.
        rounds: in place of ``stop_share``, rounds on each grid, and with the suspected low outliers.
    """

    spacing: float = 0.0
    grids: Sequence[Grid] = ()
    stop_share: float = 0.0
    rounds: Sequence[int] | None = None


@dataclasses.dataclass(frozen=True)
class Adaptive:
    """Thresholds that follow the ground found so far.

    Attributes:
        rule: from unsigned distances f32[s], metres, and angles f32[s], degrees, to thresholds. Not called without any.
        sample: "ground" = of ground points that are no vertices, in their facets; "neighbours" = of vertices over the plane
            of the facet beyond the edge opposite them (a sample of them, which does not depend on the order of points).
        every: "round", or "grid" = each time that :class:`Vertices` change to a finer grid.
    """

    rule: Callable[[np.ndarray, np.ndarray], Rule]
    sample: str = "neighbours"
    every: str = "round"


@dataclasses.dataclass(frozen=True)
class Growth:
    """How the ground grows from the seeds.

    Attributes:
        rule: thresholds; those that differ between sheets are f32[sheets].
        mirror: mirror points over steep facets; None = never.
        adaptive: how thresholds change as the ground grows; None = they are constant.
        border_follows: after each round simulated border nodes take the elevation of the ground vertex nearest to them in the
            plane (Li et al. 2021, Sec. II-E, step 6).
        one_per_facet: a round adds, of the points over a facet that pass and may become vertices, only the one that lies
            lowest over it (after Nie et al. 2017); the others are tested again over the new facets.
        max_rounds: give up after so many rounds.
    """

    rule: Rule
    mirror: Mirror | None = None
    vertices: Vertices = Vertices()
    adaptive: Adaptive | None = None
    border_follows: bool = False
    one_per_facet: bool = False
    max_rounds: int = 100
