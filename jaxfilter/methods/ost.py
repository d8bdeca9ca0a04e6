"""OST: openings that follow the landscape, whole segments, and a triangulation. The library's own method."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..core.filter import Filter, Labels
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points, has_area
from ..core.result import Decision, Progress
from ..steps.doubt import evidence, probability
from ..steps.ground_tin import GroundTin, lowest_of_each
from ..steps.landscape import Landscape
from ..steps.objects import Roofs, Segments
from ..steps.outliers import low_clusters, ring_low
from ..steps.surfaces import Cells, cell_for, look_up, lowest_cells, steepest_drops
from ..steps.voids import filled_by
from . import papers

PASSES = 2
"""How often the slope of the landscape is estimated: from the cells that are left by a fixed slope, then by its own."""
FIRST_SLOPE = 0.15
"""That fixed slope, rise over run."""
LOW_DEPTH = 1.0
"""A point so many metres below the ring around it is low."""
RIM = 4.0
"""Metres around the corners of a triangle over a void, within which the lowest point counts."""
MAX_TOLERANCE = 0.3
"""The tolerance does not grow beyond this, metres."""
TILTS = (0.1, 1.0)
"""Least and largest tolerance per slope of the facet, metres."""


@filter_params
class OST(Filter):
    """Openings, segments, triangulation: decides about cells, then about points, with tolerances that the data give.

    1. Low points are barred: those more than a metre below all cells of a ring around theirs, and clusters of at most
       ``low_points``, or four times as many that are deep (:func:`jaxfilter.steps.outliers.low_clusters`).
    2. The lowest point of each cell; empty cells get the elevation of the triangulation of these points. Triangles with an
       edge longer than ``void`` hang at the lowest elevation around their corners, so that a roof at the edge of a void, such
       as water, stands out from it.
    3. Progressive openings with disks of 1, 2, ... cells (after Zhang et al. 2003 and Pingel et al. 2013). Each cell
       remembers its steepest drop S: metres that the k-th opening lowers it by, over k cells.
    4. The slope of the landscape, G: that between means of blocks of cells that are no objects, averaged with a Gaussian of
       ``landscape`` metres. Cells with S > ``slope`` + ``relief`` G are marked.
    5. Segments of cells that differ by less than ``roof_step`` from one to the next are objects as a whole if ``roof_share``
       of their cells are marked, or if the surface falls by ``roof_drop`` along ``roof_drop_share`` of their border. Steps 4
       and 5 are repeated once, since G needs to know what is an object.
    6. Seeds are the lowest points of the cells that are neither marked nor in such a segment. On their triangulation all
       points within ``tolerance`` + ``scaling`` x slope become ground, where both grow with the point spacing.
    7. Points join in ``rounds`` of densification if distance and angle to their facet are small (after Axelsson 2000);
       limits grow with G. Within ``noise`` of the plane of the facet angles do not count.
    8. Vertices that stick out of the plane of their neighbours, measured by the scatter of the scene and of those
       neighbours, are dropped.

    The result's ``height`` and ``slope`` are metres and degrees over the final triangulation, for ground over the facet that
    took it in; ``margin`` is metres from the limit of the last test, above zero for what is no ground. ``doubt`` is the
    probability that the label is wrong (docs/doubt.md). ``info`` counts ``seeds``, ``objects`` (cells) and ``pruned``.
    Lengths in metres, angles in degrees.

    Not published. The steps, and where their constants come from, stand in docs/filters/ost.md.

    >>> result = jf.OST.for_cloud(cloud)(cloud)
    >>> jf.evaluate(result, cloud).kappa > 80
    True
    >>> wrong = np.nansum(result.doubt)  # expected number of errors
    >>> bool(0 < wrong < 0.2 * len(cloud))
    True
    """

    cell: float = static(default=1.0, unit="m", gt=0, doc="a grid cell is this wide")
    window: float = static(
        default=25.0, unit="m", gt=0, cells=1000, doc="the largest disk has this radius: half the largest building"
    )
    spacing: float | None = static(
        default=None, unit="m", gt=0, optional=True, doc="tolerances follow this point spacing; None = the measured one"
    )
    low_points: int = static(
        default=30, ge=0, doc="a cluster of low points is barred up to this size, a deep one up to four times; 0 = none"
    )
    slope: float = param(
        default=0.09,
        unit="rise/run",
        ge=0,
        doc="a cell is marked as an object if it drops more steeply than this on level land",
    )
    relief: float = param(default=0.4, ge=0, doc="this share of the slope of the landscape is added to that slope")
    landscape: float = param(
        default=30.0, unit="m", gt=0, doc="the landscape around a place is a mean with weights of this sigma"
    )
    roof_step: float = param(
        default=0.42, unit="m", gt=0, doc="neighbouring cells are one segment if they differ by less than this"
    )
    roof_area: float = param(
        default=30.0, unit="m2", gt=0, doc="a segment is judged as a whole if it is at least this large"
    )
    roof_share: float = param(
        default=0.55, gt=0, le=1, doc="a segment is an object if at least this share of its cells is marked"
    )
    roof_drop: float = param(
        default=1.8, unit="m", gt=0, doc="the surface falls by more than this at the border of an object"
    )
    roof_drop_share: float = param(
        default=0.53, gt=0, le=1, doc="a segment is an object if the surface falls along this share of its border"
    )
    void: float = param(
        default=8.0, unit="m", gt=0, doc="a triangle spans a void if an edge is longer than this and than 4 spacings"
    )
    tolerance: float = param(
        default=0.09, unit="m", ge=0, doc="ground is at most this far above or below the triangulation of the seeds"
    )
    tolerance_spacing: float = param(
        default=0.2, unit="m/m", ge=0, doc="the tolerance grows by this per metre of point spacing, up to 0.3 m"
    )
    scaling: float = param(
        default=1.0, unit="m/m", ge=0, doc="the tolerance grows by this times the spacing and the slope of the facet"
    )
    max_distance: float = param(
        default=1.25, unit="tolerances", gt=0, doc="a point joins if it is at most this far from the plane of its facet"
    )
    distance_relief: float = param(
        default=0.8, unit="m/m", ge=0, doc="the distance grows by this times the spacing and the slope of the landscape"
    )
    max_angle: float = param(
        default=8.0, unit="degrees", gt=0, lt=90, doc="a point joins if its angle to its facet is less than this"
    )
    angle_relief: float = param(
        default=60.0, unit="degrees", ge=0, doc="the largest angle grows by this times the slope of the landscape"
    )
    noise: float = param(
        default=0.1, unit="m", ge=0, doc="a point joins at any angle if it is this near to the plane of its facet"
    )
    rounds: int = static(default=6, ge=0, doc="densification takes at most this many rounds")
    scene_spread: float = param(
        default=6.0,
        unit="sigma",
        gt=0,
        doc="a vertex is dropped if its residual exceeds this many times the scatter of the scene",
    )
    local_spread: float = param(
        default=3.0,
        unit="sigma/m",
        gt=0,
        doc="a vertex is dropped only beyond this many times the scatter around it, too, times the spacing (at most 1 m)",
    )

    DOUBTS: ClassVar[bool] = True
    BIBTEX: ClassVar[str] = papers.AXELSSON_2000 + "\n\n" + papers.PINGEL_2013
    PRESETS: ClassVar[dict[str, Preset]] = {
        "paper": Preset("as reported in docs/filters/ost.md: the default, since the method is the library's own"),
        "recommended": Preset("the default: found by hand, see experiments/default"),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """The spacing itself, to which tolerances are fitted, and a cell of a quarter of it, 1 m at least."""
        own = {} if largest_building is None else {"window": largest_building / 2}
        return own | {"spacing": spacing, "cell": cell_for(spacing, 1 / 4)}

    def halo(self) -> float:
        """The largest disk, there and back, or three sigmas of the landscape, whichever is more; a segment as wide as the largest
        building, which is judged as a whole; and a facet over a roof."""
        return max(2 * self.window, 3 * self.landscape) + 4 * self.window

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        spacing = points.spacing() if self.spacing is None else self.spacing
        progress(0.0, "outliers")
        low = self.low(points)
        progress(0.1, "lowest point per cell")
        cells, lowest = self.lowest_points(points, low)
        if not has_area(points.xyz[lowest]):  # a cloud of a few cells
            low = np.zeros_like(low)
            cells, _ = self.lowest_points(points, low)
            lowest = lowest_of_each(points.xyz, np.arange(len(points)))
        longest = max(float(self.void), 4 * spacing)
        with GroundTin(points.xyz[lowest], np.arange(len(lowest)), workers) as all_lowest:
            z = filled_by(all_lowest.tin, cells, math.ceil(RIM / self.cell - 1e-6), longest)
        progress(0.2, "openings")
        objects, drop, landscape = self.objects(z, cells)
        in_object, steepness = look_up(points.xyz, cells, jnp.asarray(objects, jnp.float32), drop)
        is_object = in_object[lowest] > 0.5
        around = landscape.at(points.xyz)
        seeds = lowest[~is_object]
        if not has_area(points.xyz[seeds]):
            seeds = lowest
        progress(0.4, "triangulation")
        with GroundTin(points.xyz, seeds, workers) as ground:
            height = min(self.tolerance + self.tolerance_spacing * spacing, MAX_TOLERANCE)
            tilt = min(max(self.scaling * spacing, TILTS[0]), TILTS[1])
            ground.admit(np.full(len(points), height, np.float32), tilt, but=low)
            distance = np.float32(self.max_distance * height) + np.float32(self.distance_relief * spacing) * around
            angle = np.float32(self.max_angle) + np.float32(self.angle_relief) * around
            progress(0.5, "densify")
            ground.densify(distance, angle, float(self.noise), self.rounds)
            progress(0.8, "prune")
            pruned = ground.prune(float(self.scene_spread), float(self.local_spread) * min(1.0, spacing))
            ground.finish()
            doubt = probability(evidence(ground, steepness, around, height), ground.ground)
            progress(1.0, "done")
            labels = Labels(ground.ground, ground.height, ground.slope, margin=ground.margin, barred=low, doubt=doubt)
        other = np.where(in_object > 0.5, Decision.SURFACE, Decision.ELEVATION)
        labels.decision = np.where(labels.ground, Decision.ACCEPTED, other).astype(np.uint8)
        labels.decision[seeds[labels.ground[seeds]]] = Decision.SEED
        labels.info = {"seeds": len(seeds), "objects": int(objects.sum()), "pruned": pruned}
        return labels

    def low(self, points: Points) -> np.ndarray:
        """bool[m]: low outliers (step 1)."""
        cells = self.cells(points, np.zeros(len(points), bool))
        low = ring_low(points.xyz, cells, LOW_DEPTH, max(1, round(3 / self.cell)))
        if self.low_points:
            low |= low_clusters(points, max_points=self.low_points).barred
        return low

    def lowest_points(self, points: Points, low: np.ndarray) -> tuple[Cells, np.ndarray]:
        """The grid without the points ``low``, bool[m], and i64: rows of the points that are lowest in their cell (step 2)."""
        cells = self.cells(points, low)
        return cells, np.flatnonzero((points.xyz[:, 2] == look_up(points.xyz, cells, cells.lowest)[0]) & ~low)

    def cells(self, points: Points, low: np.ndarray) -> Cells:
        """The lowest elevation per cell, without the points ``low``, bool[m]. Cells are centred on the lattice's nodes."""
        x, y = points.offset(self.cell)
        corner = x - self.cell / 2, y - self.cell / 2
        return lowest_cells(points, self.cell, "OST(cell)", corner=corner, barred=low, least=(1, 1))

    def objects(self, z: np.ndarray, cells: Cells) -> tuple[np.ndarray, jax.Array, Landscape]:
        """bool[rows, columns]: cells that are objects; f32[rows, columns]: their steepest drops, in terms of the limit from which
        on they are marked; and the slope of the landscape (steps 3 to 5).

        ``z``: f32[rows, columns], elevations of the padded shape of ``cells``, none missing.
        """
        rows, columns = (int(n) for n in cells.extent)
        inner = slice(0, rows), slice(0, columns)
        reach = min(math.ceil(self.window / self.cell - 1e-6), rows + columns)  # wider ones are no steeper
        steepest = steepest_drops(jnp.asarray(z), cells.valid, reach)
        roofs = Roofs(*(float(getattr(self, f"roof_{name}")) for name in Roofs._fields))
        segments = Segments(np.ascontiguousarray(z[inner]), self.cell, roofs)
        objects = np.asarray(steepest > FIRST_SLOPE * self.cell)
        for _ in range(PASSES):
            landscape = Landscape.of(z, cells, objects, float(self.landscape))
            around = landscape.in_cells()
            limit = (self.slope + self.relief * around) * self.cell
            marked = np.asarray(steepest > limit)
            objects = np.zeros(z.shape, bool)
            objects[inner] = marked[inner]
            objects[inner] |= segments.objects(marked[inner], np.asarray(around)[inner])
        return objects, steepest / jnp.maximum(limit, 1e-6), landscape
