"""OST: openings that follow the landscape, whole segments, and a triangulation. The library's own method."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy

from ..core.cloud import PointCloud
from ..core.filter import Filter, Labels, of_scene, stage
from ..core.grid import period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points, has_area
from ..core.result import Decision, Progress
from ..core.water import WaterCells
from ..engines.grid.inpaint import fill_nearest
from ..engines.grid.morphology import dilation, roomy
from ..engines.ground import grow
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Beyond, Growth, Outliers, Vertices, lowest_of_each
from ..engines.tin.network import one_network
from ..engines.tin.triangulation import triangulated
from ..steps.crowd import Crowd, spacing_of
from ..steps.decks import decks
from ..steps.doubt import doubts
from ..steps.ground_rules import AngleRule, HeightRule
from ..steps.landscape import Landscape
from ..steps.objects import Roofs, Segments
from ..steps.outliers import low_clusters, lowest_few, pits, scattered
from ..steps.overhangs import overhangs
from ..steps.pruning import Scatter, prune
from ..steps.seeds import rising, veiled
from ..steps.sensors import AIRBORNE, DRONE, KINDS, MATCHING, MOBILE, SensorFacts
from ..steps.surfaces import Cells, cell_for, highest_in, look_up, lowest_cells, number_in, steepest_drops
from ..steps.voids import fill_voids, lower_voids
from ..steps.water import AFLOAT, SURFACE, waters
from .papers import bibtex

SLOPE_PASSES = 2
"""How often the slope of the landscape is estimated: from the cells that are left by a fixed slope, then by its own."""
FIRST_SLOPE = 0.15
"""That fixed slope, rise over run."""
LOW_DEPTH = 2.0
"""Few points around a low point are less than so many metres above it, or lower."""
LOW_SPACINGS = 8.0
"""They are counted within the radius of the largest building, and of so many point spacings at least."""
VOID_RIM = 4.0
"""Metres around the corners of a triangle over a void, within which the lowest point counts."""
EDGE = 3
"""Cells along the edge of the data in which a surface is known only where there are points, when decks are looked for."""
MAX_TOLERANCE = 0.3
"""The tolerance does not grow beyond this, metres."""
STEEPEST_ANGLE = 80.0
"""Degrees that the largest angle counts as at most where points lie outside the hull of the ground."""
TESTED = 60.0
"""Metres around what labels are asked for in which points are tested; further away the lowest ones alone are vertices."""
_SAMPLE = 2_000_000
"""Points from which the scatter of a scene is measured that is too large to be one tile."""
SHEET_TOLERANCE = {AIRBORNE: 0.0, MATCHING: 4.0, DRONE: 6.0, MOBILE: 6.0}
"""The tolerance in terms of the thickness of the sheet: the lowest of 100 points lies 2.5 below its middle, the highest above.
Errors of photographs are mostly shared by neighbours."""
THINNEST = 0.03
"""Metres that it is at least: terrain is rough."""
MATCHED_ROUNDS = 3
"""Of densification, which climbs the ramps that photographs make of walls."""
CLUSTER = 2.0
"""Square metres that few points around a low one cover in dense clouds."""
NO_VOID = 1e4
"""Metres: longer than any edge of a triangle that spans a void."""
PITS = {MATCHING: (0.3, 12.0), DRONE: (1.0, 4.0)}
"""Metres that wrong matches, or echoes, lie below what surrounds them, at least, and square metres of their cells at most: a
cluster of echoes 1 m wide is in four cells."""
BESIDE, STEEP, STEEPER = 10.0, 1.0, 1.25
"""Metres, and rise over run: a suspect seed must not lie above such a slope from another seed that is so near. In photographs and
scans from a car those beside an object or a void are suspect: ramps, crowns and walls at the edge of what was seen rise so."""
SIDES, PLANTS = 2, 2.0
"""In lidar from the air those where plants hide the ground are suspect. They must not lie above the steeper slope on so many
sides: the upper edge of a step does on one. Plants are looked for in cells of so many point spacings, which hold four points."""
OUT = 0.3
"""Metres per metre of point spacing that vertices may stick out on level land where plants hide the ground."""
TILTS = (0.1, 1.0)
"""Least and largest tolerance per slope of the facet, metres."""


@filter_params
class OST(Filter):
    """Openings, segments, triangulation: decides about cells, then about points, with tolerances that the data give.

    1. Low points are barred: at most ``low_points`` others within ``window`` metres lie less than 2 m above them or lower, and
       more lie higher (:func:`jaxfilter.steps.outliers.lowest_few`). In lidar from the air points below all around them are
       barred as well, if they are alone or in clusters that scatter (:func:`jaxfilter.steps.outliers.scattered`), and if plants
       do not hide the ground.
    2. The lowest point of each cell; empty cells get the elevation of the triangulation of these points. Triangles with an
       edge longer than ``void`` hang at the lowest elevation around their corners, so that a roof at the edge of a void, such
       as water, stands out from it.
    3. Progressive openings with disks of 1, 2, ... cells (after Zhang et al. 2003 and Pingel et al. 2013). Each cell
       remembers its steepest drop S: metres that the k-th opening lowers it by, over k cells.
    4. The slope of the landscape, G: that between means of blocks of cells that are no objects, averaged with a Gaussian of
       ``landscape`` metres. Cells with S > ``slope`` + ``relief`` G are marked.
    5. Segments of cells that differ by less than ``roof_step`` from one to the next are objects as a whole if ``roof_share``
       of their cells are marked, or if the surface falls by ``roof_drop`` along ``roof_drop_share`` of their border; so are
       groups of them, as roofs of several levels are. Parts of all these cells that are bare and steep without walls are
       terrain, and so are smooth ones that fall on banks, as the crests of dikes do. Steps 4 and 5 are repeated once, since G
       needs to know what is an object.
    6. Seeds are the lowest points of the cells that are neither marked nor in such a segment. Where plants hide the ground, and
       in photographs and scans from a car beside objects and voids, they must not rise steeply from others. On their
       triangulation all points within ``tolerance`` + ``scaling`` x slope become ground, where both grow with the point spacing.
    7. Points join in ``rounds`` of densification if distance and angle to their facet are small (after Axelsson 2000);
       limits grow with G. Within ``noise`` of the plane of the facet angles do not count. Outside the hull a point must
       be within the angle of the nearest place on it, too.
    8. Vertices that stick out of the plane of their neighbours, measured by the scatter of the scene and of those
       neighbours, are dropped; sooner, and in three passes, where plants hide the ground.

    Rock over a void beside steep terrain is ground as well, though the triangulation does not hold it
    (:mod:`jaxfilter.steps.overhangs`).

    Of more than 30 points per m2 one for each square of 0.25 m goes through these steps, from the middle of the lowest sheet
    there. The others are tested once, over the final triangulation, by the limits of step 7.

    Of lidar from the air, points of bridge decks are marked as ``deck`` and never become ground, nor does what stands on water;
    points of the surface of water are marked as ``water`` and stay ground (:mod:`jaxfilter.steps.decks`,
    :mod:`jaxfilter.steps.water`).

    The result's ``height`` and ``slope`` are metres and degrees over the final triangulation, for ground over the facet that
    took it in; ``margin`` is metres from the limit of the last test, above zero for what is no ground. ``doubt`` is the
    probability that the label is wrong (docs/doubt.md). ``info`` counts ``seeds``, ``objects`` (cells) and
    ``pruned``, and holds the ``scatter`` of the scene. Lengths in metres, angles in degrees.

    Not published. The steps, and where their constants come from, stand in docs/filters/ost.md.

    >>> result = jf.OST.for_cloud(cloud)(cloud)
    >>> jf.evaluate(result, cloud).kappa > 80
    True
    >>> wrong = np.nansum(result.doubt)  # expected number of errors
    >>> bool(0 < wrong < 0.2 * len(cloud))
    True
    """

    cell: float = static("a grid cell is this wide", "> 0 m", default=1.0)
    window: float = static(
        "the largest disk has this radius: half the largest building", "> 0 m", default=25.0, cells=1000
    )
    spacing: float | None = static(
        "tolerances follow this point spacing; None = the measured one", "> 0 m", default=None, optional=True
    )
    sensor: str = static("what the cloud is of", default=AIRBORNE, choices=KINDS)
    low_points: int = static(
        "a point is barred if this many others around it, or fewer, are as low; 0 = none is barred", ">= 0", default=30
    )
    slope: float = param(
        "a cell is marked as an object if it drops more steeply than this on level land", ">= 0 rise/run", default=0.09
    )
    relief: float = param("this share of the slope of the landscape is added to that slope", ">= 0", default=0.4)
    landscape: float = param("the landscape around a place is a mean with weights of this sigma", "> 0 m", default=30.0)
    roof_step: float = param(
        "neighbouring cells are one segment if they differ by less than this", "> 0 m", default=0.42
    )
    roof_area: float = param("a segment is judged as a whole if it is at least this large", "> 0 m2", default=30.0)
    roof_share: float = param(
        "a segment is an object if at least this share of its cells is marked", "> 0 and <= 1", default=0.55
    )
    roof_drop: float = param("the surface falls by more than this at the border of an object", "> 0 m", default=1.8)
    roof_drop_share: float = param(
        "a segment is an object if the surface falls along this share of its border", "> 0 and <= 1", default=0.53
    )
    void: float = param(
        "a triangle spans a void if an edge is longer than this and than 4 spacings", "> 0 m", default=8.0
    )
    tolerance: float = param(
        "ground is at most this far above or below the triangulation of the seeds", ">= 0 m", default=0.09
    )
    tolerance_spacing: float = param(
        "the tolerance grows by this per metre of point spacing, up to 0.3 m", ">= 0 m/m", default=0.2
    )
    scaling: float = param(
        "the tolerance grows by this times the spacing and the slope of the facet", ">= 0 m/m", default=1.0
    )
    max_distance: float = param(
        "a point joins if it is at most this far from the plane of its facet", "> 0 tolerances", default=1.25
    )
    distance_relief: float = param(
        "the distance grows by this times the spacing and the slope of the landscape", ">= 0 m/m", default=0.8
    )
    max_angle: float = param(
        "a point joins if its angle to its facet is less than this", "> 0 and < 90 degrees", default=8.0
    )
    angle_relief: float = param(
        "the largest angle grows by this times the slope of the landscape", ">= 0 degrees", default=60.0
    )
    noise: float = param(
        "a point joins at any angle if it is this near to the plane of its facet", ">= 0 m", default=0.1
    )
    rounds: int = static("densification takes at most this many rounds", ">= 0", default=6)
    scene_spread: float = param(
        "a vertex is dropped if its residual exceeds this many times the scatter of the scene", "> 0 sigma", default=6.0
    )
    local_spread: float = param(
        "a vertex is dropped only beyond this many times the scatter around it, too, times the spacing (at most 1 m)",
        "> 0 sigma/m",
        default=3.0,
    )

    DOUBTS: ClassVar[bool] = True
    BIBTEX: ClassVar[str] = bibtex("axelsson2000dem", "pingel2013improved")
    PRESETS: ClassVar[dict[str, Preset]] = {
        "paper": Preset("as reported in docs/filters/ost.md: the default, since the method is the library's own"),
        "recommended": Preset("the default: found by hand, see experiments/default"),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """The spacing itself, to which tolerances are fitted, and a cell of a quarter of it, 1 m at least."""
        own = {} if largest_building is None else {"window": largest_building / 2}
        return own | {"spacing": spacing, "cell": cell_for(spacing, 1 / 4)}

    @classmethod
    def from_points(cls, points: Points, largest_building: float | None) -> dict[str, Any]:
        """As by the spacing, and the sensor. Where it is not airborne lidar, tolerances follow the thickness of its sheet, and
        voids of photographs and of scans from a car are no water at which roofs end."""
        kind, thickness, sparse = SensorFacts.from_points(points)
        own = super().from_points(points, largest_building) | {"sensor": kind}
        sheet = max(SHEET_TOLERANCE[kind] * thickness, THINNEST)
        if kind in (MATCHING, MOBILE):
            own["void"] = NO_VOID
        if kind in (MATCHING, DRONE):
            own["low_points"] = max(cls.low_points, round(CLUSTER / spacing_of(points) ** 2))
        if kind == MATCHING:
            own |= {"tolerance": max(cls.tolerance, sheet), "noise": max(cls.noise, sheet), "rounds": MATCHED_ROUNDS}
        elif kind != AIRBORNE:
            own |= {"tolerance": sheet, "tolerance_spacing": 0.0, "noise": sheet}
        return own | ({"spacing": sparse} if kind == MOBILE else {})

    def halo(self) -> float:
        """The largest disk, there and back, or three sigmas of the landscape, whichever is more; a segment as wide as the largest
        building, which is judged as a whole; and a facet over a roof."""
        return max(2 * self.window, 3 * self.landscape) + 4 * self.window

    def lattice(self) -> float:
        """The cells, and whole ones of those that plants are looked for in, where the spacing is given."""
        return period(self.cell, max(self.cell, cell_for(self.spacing or 0.0, PLANTS)))

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        spacing = points.spacing() if self.spacing is None else self.spacing
        crowd, every = Crowd.from_points(points), points
        points = points if crowd is None else crowd.points
        scene = self.scene(points, spacing, workers, progress)
        objects, drop, bare, landscape = self.objects(scene)
        inside, steepness = look_up(points.xyz, scene.cells, objects.astype(np.float32), drop)
        rough: np.ndarray | np.float32 = np.float32(0)
        rock = np.zeros(len(every), bool)
        if bare.any():
            reach = min(math.ceil(self.window / self.cell - 1e-6), sum(bare.shape))
            rough = look_up(points.xyz, scene.cells, dilation(bare.astype(np.float32), reach, reach))[0]
            rock = overhangs(every.xyz, scene.cells, bare, float(self.roof_step), reach)
        in_object, around, marked = inside > 0.5, landscape.at(points.xyz), int(objects.sum())
        low, lowest = scene.low, scene.lowest
        crossed = self.crossed(scene, objects, points, spacing)
        deck, level, clear = crossed.at(points.xyz, scene.cells)
        wet = crossed.cells(points.cloud, scene.cells)
        apart = (points.xyz[:, 2] > deck - np.float32(self.roof_step)) | (np.abs(points.xyz[:, 2] - clear) > AFLOAT)
        seeds = lowest[~in_object[lowest] & ~apart[lowest]]
        plants = np.zeros(len(points), bool)
        if self.sensor in (AIRBORNE, DRONE):
            plants = self.hidden(points, spacing, low) & (np.broadcast_to(rough, len(points)) == 0)
        seeds = self.firm(points, seeds, scene, objects | bare, plants)
        del scene, objects, drop, bare, landscape, inside, crossed  # none is needed while the ground grows
        if not has_area(points.xyz[seeds]):
            seeds = lowest
        progress(0.4, "triangulation")
        limits, kept = self.limits(spacing, around, rough), ("margin", "height", "slope")
        height, distance = limits.height, np.where(apart, np.float32(-1), limits.distance)
        growth = Growth(limits.first, vertices=Vertices(sinks=False), beyond=limits.beyond, kept=kept)
        network = one_network(points, seeds, np.zeros((0, 2)), Outliers(low, np.zeros_like(low)))
        network = dataclasses.replace(network, open=network.open & points.near_core(TESTED))
        with GroundTin.start(network, growth, workers=workers) as ground:
            ground.margin.fill(0)
            ground.change(growth.rule, but=low | apart)
            ground.step()
            ground.change(limits.then._replace(distance=distance))
            grow(ground, self.rounds, lambda share, step: progress(0.5 + 0.3 * share, step))
            progress(0.8, "prune")
            scatter = Scatter.from_vertices(ground.tin)
            whole = points.cloud.whole
            spread = scatter.deviation(ground.tin) if whole is None or whole.scatter is None else whole.scatter
            scene_limit, local_limit = float(self.scene_spread) * spread, float(self.local_spread) * min(1.0, spacing)
            if self.sensor != AIRBORNE:
                scene_limit = max(scene_limit, height)
            pruned = prune(ground, scatter, scene_limit, local_limit, np.where(plants, limits.out, np.float32(np.inf)))
            if points.kept is None:  # a sweep asks for no more than what is ground
                ground.finish(ground.todo)
                scatter = scatter.at_all_points(ground)
            labels = Labels(ground.ground, ground.height, ground.slope, margin=ground.margin, barred=low)
            if crowd is not None:
                labels, seeds, own = crowd.labels(ground, low, LOW_DEPTH), crowd.rows[seeds], crowd.own
                in_object, steepness, around = in_object[own], steepness[own], around[own]
                points, deck, level = crowd.every, deck[own], level[own]
                scatter = Scatter(*(values[own] for values in scatter))
        if labels.margin is not None and labels.barred is not None and rock.any():
            rock &= ~(labels.ground | labels.barred) & ~(points.xyz[:, 2] > deck - np.float32(self.roof_step))
            labels.ground[rock], labels.margin[rock] = True, 0
        labels.deck = ~labels.ground & (np.abs(points.xyz[:, 2] - deck) < np.float32(self.roof_step))
        labels.water_cells = wet
        labels.water = labels.ground & (np.abs(points.xyz[:, 2] - level) < SURFACE)
        if points.kept is None:
            labels.doubt = doubts(labels, scatter, steepness, around, height)
        progress(1.0, "done")
        other = np.where(in_object, np.uint8(Decision.SURFACE), np.uint8(Decision.ELEVATION))
        labels.decision = np.where(labels.ground, np.uint8(Decision.ACCEPTED), other)
        labels.decision[seeds[labels.ground[seeds]]] = Decision.SEED
        labels.info = {
            "sensor": self.sensor,
            "seeds": len(seeds),
            "objects": marked,
            "pruned": pruned,
            "scatter": spread,
        }
        return labels

    def limits(self, spacing: float, around: np.ndarray, rough: np.ndarray | np.float32) -> Limits:
        """How far from the triangulation points are ground. ``spacing``: metres; ``around``: f32[m], slope of the landscape;
        ``rough``: f32[m], 1 where steep terrain was given back, or one for all."""
        height = min(self.tolerance + self.tolerance_spacing * spacing, MAX_TOLERANCE)
        tilt = min(max(self.scaling * spacing, TILTS[0]), TILTS[1])
        angle = np.float32(self.max_angle) + np.float32(self.angle_relief) * around
        beyond = Beyond(height, np.tan(np.radians(np.minimum(angle, STEEPEST_ANGLE))))
        relief = np.float32(self.distance_relief * spacing) + np.float32(self.cell) * rough
        distance = np.float32(self.max_distance * height) + relief * around
        out = np.float32(OUT * spacing) + np.float32(self.scaling * spacing) * around
        out = np.maximum(np.float32(self.noise), out)
        return Limits(
            height, distance, out, HeightRule(height, tilt), AngleRule(distance, angle, float(self.noise)), beyond
        )

    @stage
    def scene(self, points: Points, spacing: float, workers: int | None, progress: Progress) -> Openings:
        """Steps 1 to 3, which do not depend on what counts as steep."""
        progress(0.0, "outliers")
        low = self.low(points)
        progress(0.1, "lowest point per cell")
        cells, lowest = self.lowest_points(points, low)
        if self.sensor in PITS and (deep := pits(points.xyz, cells, *PITS[self.sensor])).any():
            low = low | deep
            cells, lowest = self.lowest_points(points, low)
        if not has_area(points.xyz[lowest]):  # a cloud of a few cells
            low = np.zeros_like(low)
            cells, _ = self.lowest_points(points, low)
            lowest = lowest_of_each(points.xyz, np.arange(len(points)))
        longest = max(float(self.void), 4 * spacing)
        z, inside = fill_voids(
            triangulated(points.xyz[lowest], workers), cells, math.ceil(VOID_RIM / self.cell - 1e-6), longest
        )
        progress(0.2, "openings")
        return Openings(low, lowest, cells, z, highest_in(points.xyz, cells), *self.drops(z, inside, cells))

    def crossed(self, scene: Openings, objects: np.ndarray, points: Points, spacing: float) -> Crossings:
        """Water and bridge decks. Photographs and scans from a car do not show what is beneath, nor what a void is."""
        segments = scene.segments
        rows, columns = segments.z.shape
        deck, level = (np.full(objects.shape, np.nan, np.float32) for _ in range(2))
        if self.sensor not in (AIRBORNE, DRONE):
            return Crossings(deck, level, level)
        inner, inside = (slice(0, rows), slice(0, columns)), segments.inside
        edge = ~scipy.ndimage.binary_erosion(inside, iterations=EDGE)  # where slim triangles go on to anywhere
        near = fill_nearest(scene.cells.lowest, scene.cells.seen, scene.cells.valid)
        z = np.where(edge & ~segments.seen, np.asarray(near)[inner], segments.z)
        z = lower_voids(z, segments.seen | ~inside, self.cell, spacing)
        lengths = self.cell, spacing, float(self.roof_step), 2 * self.window
        deck[inner] = decks(z, objects[inner], inside, lengths)
        others = objects[inner] & np.isnan(deck[inner])
        number = number_in(points, scene.cells)
        level[inner], apart = waters(z, inside & np.isnan(deck[inner]), number, others, self.cell)
        clear = np.full(objects.shape, np.nan, np.float32)
        clear[inner] = np.where(apart, level[inner], np.nan)
        return Crossings(deck, level, clear)

    def firm(
        self, points: Points, seeds: np.ndarray, scene: Openings, edges: np.ndarray, plants: np.ndarray
    ) -> np.ndarray:
        """i64: the ``seeds``, rows, without those that rise from others as what stands on plants, walls and ramps does (step 6).

        ``edges``: bool[rows, columns], cells beside which seeds of photographs and of scans from a car are suspect; ``plants``:
        bool[m], where those of lidar from the air are.
        """
        high, limits = plants[seeds], (STEEPER, SIDES)
        if self.sensor in (MATCHING, MOBILE):
            where = scipy.ndimage.binary_dilation(edges | ~np.asarray(scene.cells.seen))
            high, limits = look_up(points.xyz[seeds], scene.cells, where.astype(np.float32))[0] > 0.5, (STEEP, 1)
        high[high] = rising(points.xyz, seeds[high], seeds, BESIDE, *limits)
        return seeds[~high]

    def hidden(self, points: Points, spacing: float, low: np.ndarray) -> np.ndarray:
        """bool[m]: points where plants hide the ground, by cells without the points ``low``, bool[m]."""
        cells = lowest_cells(points, max(self.cell, cell_for(spacing, PLANTS)), "OST(cell)", barred=low)
        return look_up(points.xyz, cells, veiled(points, cells, BESIDE).astype(np.float32))[0] > 0.5

    def low(self, points: Points) -> np.ndarray:
        """bool[m]: low outliers (step 1)."""
        radius = max(float(self.window), LOW_SPACINGS * points.spacing())
        low = lowest_few(points, radius, LOW_DEPTH, self.low_points)
        if self.sensor != AIRBORNE or self.low_points == 0:
            return low
        below = scattered(points, low_clusters(points, depth=LOW_DEPTH, max_points=self.low_points).barred)
        if (below & ~low).any():
            low |= below & ~self.hidden(points, points.spacing() if self.spacing is None else self.spacing, low)
        return low

    def lowest_points(self, points: Points, low: np.ndarray) -> tuple[Cells, np.ndarray]:
        """The grid without the points ``low``, bool[m], and i64: rows of the points that are lowest in their cell (step 2)."""
        cells = self.cells(points, low)
        return cells, np.flatnonzero((points.xyz[:, 2] == look_up(points.xyz, cells, cells.lowest)[0]) & ~low)

    def cells(self, points: Points, low: np.ndarray) -> Cells:
        """The lowest elevation per cell, without the points ``low``, bool[m]. Cells are centred on the lattice's nodes."""
        x, y = points.offset(self.cell)
        corner = x - self.cell / 2, y - self.cell / 2
        return lowest_cells(points, self.cell, "OST(cell)", corner=corner, barred=low)

    def drops(self, z: np.ndarray, inside: np.ndarray, cells: Cells) -> tuple[np.ndarray, Segments, Landscape]:
        """f32[rows, columns], the steepest drop of each cell, metres per cell (step 3); the segments; and the first landscape.

        ``z``: f32[rows, columns], elevations of the padded shape of ``cells``, none missing; ``inside``: bool, not padded, cells
        inside the hull of the lowest points.
        """
        rows, columns = cells.grid.shape
        reach = min(math.ceil(self.window / self.cell - 1e-6), rows + columns)  # wider ones are no steeper
        steepest = np.asarray(steepest_drops(z, cells.valid, reach, most=roomy(reach)))
        roofs = Roofs(*(float(getattr(self, f"roof_{name}")) for name in Roofs._fields))
        surface, seen = (np.ascontiguousarray(np.asarray(a)[:rows, :columns]) for a in (z, cells.seen))
        segments = Segments(surface, inside, seen, self.cell, roofs, (2 * self.window) ** 2)
        objects = steepest > np.float32(FIRST_SLOPE * self.cell)
        return steepest, segments, Landscape.from_elevations(z, cells, objects, float(self.landscape))

    def objects(self, scene: Openings) -> tuple[np.ndarray, np.ndarray, np.ndarray, Landscape]:
        """bool[rows, columns]: cells that are objects; f32[rows, columns]: their steepest drops, in terms of the limit from which
        on they are marked; bool[rows, columns]: steep terrain that was given back; and the slope of the landscape
        (steps 4 and 5)."""
        _, _, cells, z, _, steepest, segments, landscape = scene
        rows, columns = cells.grid.shape
        inner = slice(0, rows), slice(0, columns)
        objects, bare = np.zeros(z.shape, bool), np.zeros((rows, columns), bool)
        banked = np.zeros_like(bare)
        for number in range(SLOPE_PASSES):
            if number > 0:
                landscape = Landscape.from_elevations(z, cells, objects, float(self.landscape))
            around = np.asarray(landscape.in_cells())
            limit = np.float32(self.relief) * around
            limit += np.float32(self.slope)
            limit *= np.float32(self.cell)
            marked = steepest[inner] > limit[inner]
            whole = segments.objects(marked, around[inner])
            marked |= whole
            marked &= ~(bare | banked)
            bare |= segments.terrain(marked, whole, scene.high)
            if self.sensor in (AIRBORNE, DRONE):
                banked |= segments.embankments(marked & ~bare)
            objects = np.zeros(z.shape, bool)
            objects[inner] = marked & ~(bare | banked)
        padded = np.zeros(z.shape, bool)
        padded[inner] = bare
        return objects, steepest / np.maximum(limit, np.float32(1e-6)), padded, landscape


class Limits(NamedTuple):
    """The rules of OST's growth: the ``first`` round, those ``then``, and outside the hull (step 6); ``height``: metres, and
    ``distance``: f32[m], metres, in them; ``out``: f32[m], metres by which vertices may stick out under plants (step 8)."""

    height: float
    distance: np.ndarray
    out: np.ndarray
    first: HeightRule
    then: AngleRule
    beyond: Beyond


class Openings(NamedTuple):
    """What OST finds out about a cloud whatever counts as steep (steps 1 to 3).

    Attributes:
        low: bool[m], low outliers. lowest: i64, rows of the lowest points of cells.
        cells: the cells; z: f32[rows, columns], their elevations, metres, none missing.
        high: f32[rows, columns], the highest point in each cell, metres, without padding.
        steepest: f32[rows, columns], their steepest drops, metres per cell.
        segments: of the elevations.
        landscape: without the cells that drop by more than :data:`FIRST_SLOPE`.
    """

    low: np.ndarray
    lowest: np.ndarray
    cells: Cells
    z: np.ndarray
    high: np.ndarray
    steepest: np.ndarray
    segments: Segments
    landscape: Landscape


class Crossings(NamedTuple):
    """Bridge decks, and water.

    Attributes:
        deck: f32[rows, columns], of the padded shape of the cells: elevations of decks, metres, NaN where there is none.
        level: f32[rows, columns], those of the surface of water, also below what stands on it; clear: NaN at the shore, too.
    """

    deck: np.ndarray
    level: np.ndarray
    clear: np.ndarray

    def cells(self, cloud: PointCloud, cells: Cells) -> WaterCells | None:
        """Where the water is."""
        if np.isnan(self.level).all():
            return None
        x, y, side = (float(v) for v in (cells.grid.x0, cells.grid.y0, cells.grid.cell))
        return WaterCells.from_levels(cloud, self.level, (x, y), side)

    def at(self, xyz: np.ndarray, cells: Cells) -> list[np.ndarray]:
        """f32[n] each: elevations of decks, of water, and of water without the shore, at points f32[n, 3]."""
        if np.isnan(self.deck).all() and np.isnan(self.level).all():
            return [np.full(len(xyz), np.nan, np.float32)] * 3
        return look_up(xyz, cells, self.deck, self.level, self.clear)


@of_scene.register(OST)
def _of_scene(filter_: OST, some: Callable[[int], list[PointCloud]]) -> dict[str, Any]:
    """The scatter of the vertices: the median over windows of the scene."""
    found = [filter_(cloud).info.get("scatter") for cloud in some(_SAMPLE)]
    known = [scatter for scatter in found if scatter is not None]
    return {"scatter": float(np.median(known))} if known else {}
