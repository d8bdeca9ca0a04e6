"""PPDF: progressive plane detection filtering of forested landscapes (Cai, Liang & Yu 2023)."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..core.errors import ParameterError
from ..core.filter import Filter, Labels, passed
from ..core.grid import Grid, grid_over, period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Decision, FilterResult, Progress
from ..engines.grid.inpaint import fill_membrane
from ..engines.grid.morphology import raised_cells
from ..engines.ground import grow
from ..steps.outliers import bar_outliers
from ..steps.references import Compared, GroundReferences, NearestReferences, QuadrantReferences
from ..steps.scaled_planes import PlaneSearch, progressive_planes
from ..steps.seeds import lowest_seeds, under_canopy
from ..steps.surfaces import MAX_SURFACE_CELLS, check_openings, look_up, lowest_cells
from .papers import bibtex

HYPOTHESES = 128  # planes tried per cell
INLIER_DISTANCE = 0.5  # metres of interior points from their plane


@filter_params
class PPDF(Filter):
    """Planes found in ever smaller cells give the seeds; planes through the nearest ground in four quadrants the rest.

    S. Cai, X. Liang, S. Yu (2023): A progressive plane detection filtering method for airborne LiDAR data in forested
    landscapes. Forests 14 (3), 498. doi:10.3390/f14030498

    1. Points under the canopy: less than ``canopy_height`` above the lowest of their ``canopy_cell`` (Sec. 2.3).
    2. In each ``cell`` of these, the plane with most points near it (RANSAC), if it has ``min_points``. Where a point lies
       ``division_distance`` or more below the plane, the cell is divided into four, and so on (Sec. 2.4, eq. 2).
    3. Seeds: points within ``buffer`` of the plane of their cell (Sec. 2.5).
    4. A point is compared with the least-squares plane through the nearest reference points, one in each quadrant around
       it (eq. 3), and is ground within ``max_distance``. This is repeated until nothing is added.

    "paper" is that to the letter: every ground point is a reference. On clouds with undergrowth it floods: a shrub within
    1.5 m of the ground becomes a reference, which lifts the plane under its neighbour. In "recommended", the default,
    (a) only one point in each ``reference_cell`` can be a reference, its lowest seed, or without one its lowest point;
    (b) it becomes one within ``reference_distance``, the width of the seeds' buffer; (c) all other points are judged once,
    at the end, seeds that are no references included; (d) planes that an opening of the seeds with disks of up to
    ``window`` lowers too much, as those on roofs, make no seeds; (e) clusters of low outliers are left to the end.

    Departures (docs/filters/ppdf.md): equally good hypotheses are settled by their order and all cells share their random
    numbers, so labels depend on the points alone; references farther than ``reach`` do not count.

    >>> result = jf.PPDF(max_distance=0.3)(cloud)
    >>> result.status.message
    'finished'
    >>> jf.evaluate(result, cloud).total < 10
    True
    """

    canopy_cell: float = static(
        "the lowest point of a cell that is this wide is under the canopy", "> 0 m", default=2.0
    )
    canopy_height: float = param(
        "a point is under the canopy if it is less than this above the lowest point of its cell",
        "T_h > 0 m",
        default=5.0,
    )
    cell: float = static("the first planes are searched for in cells that are this wide", "> 0 m", default=10.0)
    min_points: int = static("a plane has at least this many points within 0.5 m", "N_i >= 3", default=20)
    max_slope: float = param("planes that are steeper than this are not tried", "> 0 and <= 90 degrees", default=75.0)
    division_distance: float = param(
        "a cell is divided if a point is this far below its plane", "T_d > 0 m", default=1.0
    )
    buffer: float = param(
        "a point is a seed if it is at most this far from the plane of its cell", "> 0 m", default=0.5
    )
    window: float = static(
        "seeds are opened with disks up to this radius: half a building; 0 = none", ">= 0 m", default=18.0
    )
    slope: float = param("a disk lowers objects by more than this times its radius", "> 0 rise/run", default=0.3)
    max_step: float = param(
        "a point is no seed if a disk lowers its cell by more than this, or if it is so much above the lowest point there",
        "> 0 m",
        default=2.5,
    )
    low_clusters: bool = static("clusters of low outliers take no part in the planes", default=True)
    reach: float = static(
        "references are at most this far away; inf = at any distance", "> 0 m", default=30.0, endless=True
    )
    reference_cell: float = static(
        "a cell this wide has one reference, its lowest point; 0 = no such limit", ">= 0 m", default=1.0
    )
    reference_distance: float = param(
        "a point becomes a reference if it is at most this far from its local plane", ">= 0 m", default=0.5
    )
    max_distance: float = param(
        "a point is ground if it is at most this far from its local plane", "> 0 m", default=0.3
    )
    max_rounds: int = static("references are added in at most this many rounds", ">= 1", default=100)
    seeds: str = static(
        "seeds are near planes, or the lowest point of a cell", default="planes", choices=("planes", "lowest")
    )
    references: str = static(
        "a local plane goes through one reference in each quadrant, or through the nearest four",
        default="quadrants",
        choices=("quadrants", "nearest"),
    )

    BIBTEX: ClassVar[str] = bibtex("cai2023progressive")
    LAST: ClassVar[tuple[str, ...]] = ("max_distance",)
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: one reference per square metre, its lowest; roofs and low outliers make no seeds"
        ),
        "paper": Preset(
            "as printed, except that a plane needs at least N_i points, not less, that points due north, east, south and "
            "west belong to a quadrant, and that 0.5 m and 128 hypotheses for the planes are not printed",
            max_slope=90.0,
            window=0.0,
            low_clusters=False,
            reach=math.inf,
            reference_cell=0.0,
            reference_distance=1.5,
            max_distance=1.5,
        ),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Cells that hold enough points where they are sparser than in the paper (2 to 22 per m2)."""
        half = None if largest_building is None else largest_building / 2
        return ({} if half is None else {"window": half, "reach": max(30.0, half)}) | {
            "canopy_cell": max(2.0, 1.5 * spacing),
            "cell": max(10.0, 7.0 * spacing),
            "min_points": 20 if spacing <= 0.75 else 10,
            "reference_cell": max(1.0, spacing),
        }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.window > 1000 * self.canopy_cell:
            raise ParameterError(
                f"PPDF(window={self.window!r}): more than 1000 cells of canopy_cell={self.canopy_cell:g} m; use larger cells"
            )

    def halo(self) -> float:
        """Reach of a cell, of all openings one after the other, and of a reference, metres, but at most twice the reach of a
        reference, or half a building if that is more, and four of the first cells: openings hardly ever add up to more.

        Growth goes on from reference to reference, but that is not how far a border is felt in practice.
        """
        all_openings = self.cell + self.canopy_cell * self._disks * (self._disks + 1) + self.reach
        return min(all_openings, 2.0 * max(min(self.reach, 30.0), self.window) + 4.0 * self.cell)

    @property
    def _disks(self) -> int:
        """Radius of the largest disk, cells."""
        return math.ceil(self.window / self.canopy_cell - 1e-6)

    def lattice(self) -> float:
        """The first cells of the planes, and whole ones of the others."""
        return period(self.cell, self.canopy_cell, self.reference_cell or self.cell)

    def _near(self, reference: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """bool[m]: references, and points that are near to their local planes."""
        return reference | (np.abs(distance) <= self.max_distance)

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see the class for the steps and :class:`jaxfilter.core.filter.Filter` for the call.

        ``key`` draws the hypotheses; without one they are the same in every call.
        """
        xyz = points.xyz
        progress(0.0, "points under the canopy")
        grid = self._grid(points, "canopy_cell")
        barred = bar_outliers(points, clusters=self.low_clusters, workers=workers).barred
        under = ~barred & under_canopy(xyz, ~barred, grid, self.canopy_height)

        progress(0.1, "planes")
        draws = jax.random.uniform(jax.random.key(0) if key is None else key, (HYPOTHESES, 3), jnp.float32)
        search = PlaneSearch(self.cell, self.min_points, INLIER_DISTANCE, self.division_distance, self.max_slope)
        counted = under if self.seeds == "planes" else np.zeros_like(under)
        planes = progressive_planes(points, counted, draws, search)
        over = Compared(planes.distance, planes.height, planes.slope)

        seed = ~barred & (np.abs(over.distance) <= self.buffer)
        found = seed.any()
        if not found:
            seed = lowest_seeds(points, self._grid(points, "cell"), seed, ~barred)
            over.distance[seed], over.height[seed], over.slope[seed] = 0, 0, 0
        if self.window > 0 and (found or self.seeds == "lowest"):
            seed &= ~self._raised(points, lowest_seeds(points, grid, seed, ~barred))
        if self.reference_cell > 0:
            side = self.reference_cell
            may_be = lowest_seeds(points, self._grid(points, "reference_cell"), seed, ~barred)
        else:
            may_be, side = ~barred, points.spacing()

        reference = seed & may_be
        for values in over:  # a plane of the cloud is none of the ground: without references near there is none
            values[may_be & ~reference] = np.nan
        around = self._around(xyz, np.flatnonzero(may_be & ~reference), side)
        growing = GroundReferences(
            around, reference, over, lambda distance: np.abs(distance) <= self.reference_distance, workers
        )
        status = grow(growing, self.max_rounds, lambda share, step: progress(0.3 + 0.4 * share, step), trace)
        reference = growing.ground

        progress(0.7, "classifying")
        around = self._around(xyz, np.flatnonzero(~may_be), side)
        around.add(np.flatnonzero(reference), workers)
        over.update(xyz, around.query, around.row)
        ground = self._near(reference, over.distance)
        decision = np.where(ground, Decision.ACCEPTED, np.where(over.distance < 0, Decision.LOW, Decision.ELEVATION))
        decision[reference & seed] = Decision.SEED
        limit = np.where(reference, max(self.buffer, self.reference_distance), self.max_distance)
        progress(1.0, "done")
        return Labels(
            ground,
            height=over.height,
            slope=over.slope,
            elevation=over.distance,
            margin=(np.abs(over.distance) - limit).astype(np.float32),
            decision=decision.astype(np.uint8),
            barred=barred,
            settled=reference,
            status=status,
            info={
                "under_canopy": int(under.sum()),
                "planes": planes.accepted,
                "divided_cells": planes.divided,
                "seeds": int(seed.sum()),
                "references": int(reference.sum()),
                "rounds": len(growing.trace),
            },
            trace=growing.trace,
        )

    def _grid(self, points: Points, name: str) -> Grid:
        """The cells whose side is the field of this name."""
        side = getattr(self, name)
        return grid_over(points.xyz, side, points.offset(side), f"PPDF({name})", MAX_SURFACE_CELLS)

    def _around(self, xyz: np.ndarray, query: np.ndarray, side: float) -> NearestReferences:
        diagonal = float(np.hypot(*np.ptp(xyz[:, :2], axis=0)))
        reach = diagonal + 1.0 if math.isinf(self.reach) else self.reach
        if self.references == "nearest":
            return NearestReferences(xyz, query, reach)
        return QuadrantReferences(xyz, query, side, reach)

    def _raised(self, points: Points, lowest: np.ndarray) -> np.ndarray:
        """bool[m]: points in cells whose ``lowest`` point, bool[m], stands on an object, or ``max_step`` above that point.

        The surface of these points, with a membrane over empty cells, is opened with disks of 1, 2, ... cells. Cells that
        the k-th opening lowers by more than slope x k x cell are objects, as in Pingel et al. (2013), Sec. 2.2, or by more
        than ``max_step``: a hill loses little from one disk to the next, a roof all its height at once.
        """
        cell, radii = self.canopy_cell, np.arange(1, self._disks + 1)
        cells = lowest_cells(points, cell, "PPDF(canopy_cell)", barred=~lowest)
        check_openings(cells, len(radii), points, f"PPDF(canopy_cell={cell:g}, window={self.window:g})")
        surface = fill_membrane(cells.lowest, cells.seen, cells.valid).z
        rises = np.minimum(np.float32(self.slope * cell) * radii.astype(np.float32), np.float32(self.max_step))
        raised = raised_cells(surface, cells.valid, radii, rises, reach=len(radii))
        lowest_of = np.where(cells.seen, cells.lowest, np.float32(np.inf))
        on_object, low = look_up(points.xyz, cells, np.asarray(raised, np.float32), lowest_of)
        return (on_object > 0) | (points.xyz[:, 2] - low > self.max_step)


@passed.register(PPDF)
def _passed(filter_: PPDF, labels: Labels | FilterResult) -> np.ndarray:
    """Sets that differ in the distance to the local plane share the references."""
    assert labels.settled is not None and labels.elevation is not None
    return filter_._near(labels.settled, labels.elevation)
