"""OST: openings that follow the landscape, whole segments, and a triangulation. The library's own method."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from ..core.cloud import PointCloud
from ..core.filter import Filter, Labels, of_scene, stage
from ..core.grid import period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points, has_area
from ..core.result import Decision, Progress
from ..engines.grid.morphology import roomy
from ..engines.ground import grow
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Beyond, Growth, Outliers, Vertices, lowest_of_each
from ..engines.tin.network import one_network
from ..engines.tin.triangulation import triangulated
from ..steps.crowd import Crowd
from ..steps.doubt import SPARSE, SPARSEST, doubts, mixture
from ..steps.ground_rules import STEEPEST, AngleRule, HeightRule
from ..steps.landscape import landscape_slope
from ..steps.objects import Parts
from ..steps.outliers import LOW_DEPTH, lowest_few
from ..steps.pruning import Scatter, drop_vertices
from ..steps.rules import RULES, OstRule, OstScene
from ..steps.rules.plants import sides_of
from ..steps.rules.scene import filled, grid_of
from ..steps.sensors import AIRBORNE, KINDS, MATCHING, MOBILE, SensorFacts
from ..steps.surfaces import cell_for, look_up, steepest_drops
from .papers import bibtex

SLOPE_PASSES = 2
"""How often the slope of the landscape is estimated: from the cells that are left by a fixed slope, then by its own."""
FIRST_SLOPE = 0.15
"""That fixed slope, rise over run."""
LEVEL = 1 / 128
"""Metres: steps of elevation in openings. A power of two, so that tiles of a survey have the same."""
LOW_SHARE, LEAST_LOW = 0.02, 2
"""Few low points are at most this share of the points in a disk of the radius ``window``, and so many at least."""
TESTED = 60.0
"""Metres around what labels are asked for in which points are tested; further away the lowest ones alone are vertices."""
SHEET_TOLERANCE = 6.0
"""The tolerance in terms of the thickness of the sheet, of all clouds but airborne lidar: the lowest of 100 points lies 2.5 below
its middle, the highest above."""
_SAMPLE = 2_000_000
"""Points from which the scatter of a scene is measured that is too large to be one tile."""


@filter_params
class OST(Filter):
    """Openings, segments, triangulation: decides about cells, then about points, with tolerances that the data give.

    The core has eight steps:

    1. Low points are no seeds: at most ``low_points`` others within ``window`` metres lie less than 2 m above them or lower, and
       more lie higher (:func:`jaxfilter.steps.outliers.lowest_few`).
    2. The lowest point of each cell; empty cells get the elevation of the triangulation of these points.
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
       limits grow with G. Within ``noise`` of the plane of the facet angles do not count. Outside the hull a point must
       be within the angle of the nearest place on it, too.
    8. Vertices that stick out of the plane of their neighbours, measured by the scatter of the scene and of those
       neighbours, are dropped.

    ``rules`` change what these steps have found: clusters, strays and pits of low points, voids, halls, steep terrain with
    overhangs, embankments, crossings (water and bridge decks), plants, ramps. Each is a value of its own
    (:mod:`jaxfilter.steps.rules`); ``rules=()`` is the core alone.

    Of more than 32 points per m2 one for each square of 0.25 m goes through these steps, from the middle of the lowest sheet
    there. The others are tested once, over the final triangulation, by the limits of step 7.

    The result's ``height`` and ``slope`` are metres and degrees over the final triangulation, for ground over the facet that
    took it in; ``margin`` is metres from the limit of the last test, above zero for what is no ground. ``doubt`` is the
    probability that the label is wrong (docs/doubt.md). ``deck`` marks points of bridge decks, which are no ground, and ``water``
    those of the surface of water, which are. ``info`` counts ``seeds``, ``objects`` (cells) and ``pruned``, and holds the
    ``scatter`` of the scene. Lengths in metres, angles in degrees.

    Not published. The steps, and where their constants come from, stand in docs/filters/ost.md.

    >>> result = jf.OST.for_cloud(cloud)(cloud)
    >>> jf.evaluate(result, cloud).kappa > 80
    True
    >>> wrong = np.nansum(result.doubt)  # expected number of errors
    >>> bool(0 < wrong < 0.2 * len(cloud))
    True
    >>> jf.OST(rules=["plants", "halls"]).rules
    ('halls', 'plants')
    """

    cell: float = static("a grid cell is this wide", "> 0 m", default=1.0)
    window: float = static(
        "the largest disk has this radius: half the largest building", "> 0 m", default=25.0, cells=1000
    )
    spacing: float | None = static(
        "tolerances follow this point spacing; None = the measured one", "> 0 m", default=None, optional=True
    )
    sensor: str = static("what the cloud is of", default=AIRBORNE, choices=KINDS)
    rules: tuple[str, ...] | None = static(
        "rules that act besides the core, by name; None = those for the sensor",
        default=None,
        choices=RULES,
        optional=True,
    )
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
    tolerance: float = param(
        "ground is at most this far above or below the triangulation of the seeds", ">= 0 m", default=0.09
    )
    tolerance_spacing: float = param(
        "the tolerance grows by this per metre of point spacing, of which 1 m at most counts", ">= 0 m/m", default=0.2
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
        """The spacing itself, to which tolerances are fitted, a cell of a quarter of it, 1 m at least, and fewer low points where
        points are few."""
        own = {} if largest_building is None else {"window": largest_building / 2}
        held = math.pi * (own.get("window", cls.window) / spacing) ** 2
        few = max(LEAST_LOW, min(cls.low_points, round(LOW_SHARE * held)))
        return own | {"spacing": spacing, "cell": cell_for(spacing, 1 / 4), "low_points": few}

    @classmethod
    def from_points(cls, points: Points, largest_building: float | None) -> dict[str, Any]:
        """As by the spacing, and the sensor. Where it is not airborne lidar, tolerances follow the thickness of its sheet."""
        kind, thickness, sparse = SensorFacts.from_points(points)
        own = super().from_points(points, largest_building) | {"sensor": kind}
        sheet = SHEET_TOLERANCE * thickness
        if kind == MATCHING:
            half = cls.rounds // 2  # densification climbs the ramps that photographs make of walls
            own |= {"tolerance": max(cls.tolerance, sheet), "noise": max(cls.noise, sheet), "rounds": half}
        elif kind != AIRBORNE:
            own |= {"tolerance": sheet, "tolerance_spacing": 0.0, "noise": sheet}
        return own | ({"spacing": sparse} if kind == MOBILE else {})

    def halo(self) -> float:
        """The largest disk, there and back, or three sigmas of the landscape, whichever is more; a segment as wide as the largest
        building, which is judged as a whole; and a facet over a roof."""
        return max(2 * self.window, 3 * self.landscape) + 4 * self.window

    def lattice(self) -> float:
        """The cells, and whole ones of those that plants are looked for in, where the spacing is given."""
        return period(self.cell, sides_of(self.cell, self.spacing or 0.0, self.window)[-1])

    def active(self) -> list[OstRule]:
        """The rules that take their turn, in the order of :data:`jaxfilter.steps.rules.RULES`."""
        named = self.rules
        return [
            rule for name, rule in RULES.items() if (self.sensor in rule.SENSORS if named is None else name in named)
        ]

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        crowd, rules = Crowd.from_points(points), self.active()
        progress(0.0, "surface and openings")
        scene = copy.copy(self.measured(points if crowd is None else crowd.points, workers))
        scene.ost = self
        progress(0.3, "objects")
        limit = self.judge(scene, rules)
        progress(0.4, "seeds")
        self.seed(scene, rules)
        labels, residual = self.grow(scene, crowd, rules, workers, progress)
        seeds = scene.seeds
        if crowd is not None:
            scene.points, scene.never, seeds = points, scene.never[crowd.own], crowd.rows[seeds]
        for rule in rules:
            rule.label(scene, labels)
        if points.kept is not None:  # a sweep asks for no more than what is ground
            return labels
        look = scene.objects, scene.steepest / limit, scene.slope
        in_object, drop, slope = look_up(points.xyz, scene.cells, *look)
        tolerance = self.tolerated(scene.spacing)
        counted = slice(None) if crowd is None else crowd.rows
        mixed = mixture(points.xyz, scene.cells, labels, counted, scene.spacing, tolerance)
        labels.doubt = doubts(labels, residual, drop, slope, mixed, tolerance)
        if SPARSEST * scene.spacing**2 > 1:
            labels.info["doubt"] = SPARSE
        other = np.where(in_object, np.uint8(Decision.SURFACE), np.uint8(Decision.ELEVATION))
        labels.decision = np.where(labels.ground, np.uint8(Decision.ACCEPTED), other)
        labels.decision[seeds[labels.ground[seeds]]] = Decision.SEED
        labels.info |= {"sensor": self.sensor, "seeds": len(seeds), "objects": int(scene.objects.sum())}
        progress(1.0, "done")
        return labels

    def bar(self, points: Points) -> OstScene:
        """A scene with its low points (step 1)."""
        scene = OstScene(self, points, points.spacing() if self.spacing is None else self.spacing)
        scene.low = lowest_few(points.xyz, float(self.window), LOW_DEPTH, self.low_points)
        scene.plants = scene.veil = np.zeros(len(points), bool)
        for rule in self.active():
            rule.bar(scene)
        return scene

    @stage
    def surface(self, points: Points, workers: int | None) -> OstScene:
        """Low points, the lowest point of each cell, and the surface through these (steps 1 and 2)."""
        scene = self.bar(points)
        self.grid(scene)
        if not has_area(points.xyz[scene.lowest]):  # a cloud of a few cells
            scene.low = scene.veil = np.zeros(len(points), bool)
            self.grid(scene)
            scene.lowest = lowest_of_each(points.xyz, np.arange(len(points)))
        scene.tin = triangulated(points.xyz[scene.lowest], workers)
        scene.z, scene.inside = filled(scene.tin, scene.cells)
        for rule in self.active():
            rule.fill(scene)
        return scene

    def grid(self, scene: OstScene) -> None:
        """Cells, and the points that are lowest in theirs."""
        scene.cells = grid_of(scene, self.cell)
        xyz = scene.points.xyz
        scene.lowest = np.flatnonzero(
            (xyz[:, 2] == look_up(xyz, scene.cells, scene.cells.lowest)[0]) & ~(scene.low | scene.veil)
        )

    @stage
    def opened(self, points: Points, workers: int | None) -> OstScene:
        """How steeply openings lower each cell, at most (step 3)."""
        scene = copy.copy(self.surface(points, workers))
        (rows, columns), wide = scene.z.shape, scene.cells.valid.shape
        reach = min(math.ceil(self.window / self.cell - 1e-6), rows + columns)  # wider ones are no steeper
        level = np.floor(scene.z / np.float32(LEVEL)).astype(np.int32)
        level -= level.min() + 2**15
        if level.max() < 2**15 - 1:  # processors compare these in half the time
            level = level.astype(np.int16)
        level = np.pad(level, [(0, wide[0] - rows), (0, wide[1] - columns)])
        drops = steepest_drops(level, scene.cells.valid, reach, most=roomy(reach))
        scene.steepest = np.asarray(drops)[:rows, :columns] * np.float32(LEVEL)
        return scene

    @stage
    def segmented(self, points: Points, workers: int | None) -> OstScene:
        """Segments of cells that differ little from one to the next (step 5)."""
        scene = copy.copy(self.opened(points, workers))
        step, area = float(self.roof_step), float(self.roof_area)
        scene.segments = Parts.from_elevations(scene.z, scene.inside, scene.seen, self.cell, step, area)
        return scene

    @stage
    def sloped(self, points: Points, workers: int | None) -> OstScene:
        """The slope of the landscape, from the cells that drop by less than a fixed slope (step 4)."""
        scene = copy.copy(self.segmented(points, workers))
        objects = scene.steepest > np.float32(FIRST_SLOPE * self.cell)
        scene.slope = landscape_slope(scene.z, scene.cells, objects, float(self.landscape))
        return scene

    @stage
    def measured(self, points: Points, workers: int | None) -> OstScene:
        """What rules measure on this surface before any cell is an object."""
        scene = copy.copy(self.sloped(points, workers))
        scene.ost = self
        for rule in self.active():
            rule.measure(scene)
        return scene

    def judge(self, scene: OstScene, rules: list[OstRule]) -> np.ndarray:
        """The slope of the landscape, and which cells are objects (steps 4 and 5); f32[rows, columns]: from which drop on cells
        are marked, metres per cell."""
        scene.back = scene.rock = np.zeros(scene.z.shape, bool)
        for number in range(SLOPE_PASSES):
            if number > 0:
                scene.slope = landscape_slope(scene.z, scene.cells, scene.objects, float(self.landscape))
            limit = np.float32(self.cell) * (np.float32(self.slope) + np.float32(self.relief) * scene.slope)
            scene.marked = scene.steepest > limit
            scene.whole = self.roofs(scene)
            for rule in rules:
                rule.give_back(scene)
        for rule in rules:
            rule.judge(scene)
        return np.maximum(limit, np.float32(1e-6))

    def roofs(self, scene: OstScene) -> np.ndarray:
        """bool[rows, columns]: cells of segments that are objects as a whole.

        What the edge of the data cuts is judged by the border that is inside, unless it is larger than the largest building: then
        the edge counts as border along which nothing falls, as that of a plateau above a cliff. Nor does it fall on faces of what
        is cut: headlands go on beyond the edge, and decks over a valley are seen with both ends.
        """
        segments, largest = scene.segments, (2 * self.window / self.cell) ** 2
        found = segments.census(scene.slope, float(self.roof_drop), np.inf)
        inside = np.bincount(segments.number[scene.marked], minlength=segments.last + 1)
        falling = found.falling - np.where(found.edge > 0, found.faces, 0)
        border = np.maximum(found.border + np.where(found.cells > largest, found.edge, 0), 1)
        whole = (inside >= self.roof_share * found.cells) | (falling >= self.roof_drop_share * border)
        return (whole & (found.cells > 0))[segments.number]

    def seed(self, scene: OstScene, rules: list[OstRule]) -> None:
        """The lowest points of cells that are no objects, and how near to the ground points join (steps 6 and 7)."""
        in_object, slope = look_up(scene.points.xyz, scene.cells, scene.objects, scene.slope)
        scene.seeds, scene.never = scene.lowest[~in_object[scene.lowest]], np.zeros(len(in_object), bool)
        scene.distance = np.asarray(self.limits(scene.spacing, slope).then.distance)
        for rule in rules:
            rule.seed(scene)
        if not has_area(scene.points.xyz[scene.seeds]):
            scene.seeds = scene.lowest

    def grow(
        self, scene: OstScene, crowd: Crowd | None, rules: list[OstRule], workers: int | None, progress: Progress
    ) -> tuple[Labels, np.ndarray]:
        """Ground grows from the seeds, and vertices that stick out are dropped (steps 6 to 8)."""
        points, slope = scene.points, look_up(scene.points.xyz, scene.cells, scene.slope)[0]
        limits = self.limits(scene.spacing, slope)
        kept = ("margin", "height", "slope")
        growth = Growth(limits.first, vertices=Vertices(sinks=False), beyond=limits.beyond, kept=kept)
        network = one_network(points, scene.seeds, np.zeros((0, 2)), Outliers(scene.low, np.zeros_like(scene.low)))
        network = dataclasses.replace(network, open=network.open & points.near_core(TESTED))
        progress(0.5, "triangulation")
        with GroundTin.start(network, growth, workers=workers) as ground:
            ground.margin.fill(0)
            ground.change(limits.first, but=scene.low | scene.never)
            ground.step()
            ground.change(limits.then._replace(distance=np.where(scene.never, np.float32(-1), scene.distance)))
            grow(ground, self.rounds, lambda share, step: progress(0.5 + 0.3 * share, step))
            progress(0.8, "prune")
            return self.pruned(scene, ground, crowd, rules)

    def pruned(
        self, scene: OstScene, ground: GroundTin, crowd: Crowd | None, rules: list[OstRule]
    ) -> tuple[Labels, np.ndarray]:
        """Vertices that stick out are dropped (step 8); labels of all points, and residuals, f32[m], metres."""
        scatter, whole = Scatter.from_vertices(ground.tin), scene.points.cloud.whole
        spread = scatter.deviation(ground.tin) if whole is None or whole.scatter is None else whole.scatter
        least = max(self.scene_spread * spread, 0.0 if self.sensor == AIRBORNE else self.tolerated(scene.spacing))
        local = np.float32(self.local_spread * min(1.0, scene.spacing)) * scatter.roughness
        dropped = drop_vertices(ground, scatter.residual - np.maximum(np.float32(least), local))
        dropped += sum(rule.prune(scene, ground, scatter) for rule in rules)
        if scene.points.kept is None:
            ground.finish(ground.todo)
        residual = np.where(ground.tin.vertex, scatter.residual, np.float32(0))
        labels = Labels(ground.ground, ground.height, ground.slope, margin=ground.margin, barred=scene.low)
        if crowd is not None:
            labels, residual = crowd.labels(ground, scene.low, LOW_DEPTH), residual[crowd.own]
        labels.info = {"pruned": dropped, "scatter": spread}
        return labels, residual

    def tolerated(self, spacing: float) -> float:
        """Metres from the triangulation up to which points are ground, t."""
        return float(self.tolerance + self.tolerance_spacing * min(spacing, 1.0))

    def limits(self, spacing: float, slope: np.ndarray) -> Limits:
        """How far from the triangulation points are ground. ``spacing``: metres; ``slope``: f32[m], of the landscape around them,
        rise over run."""
        height, tilt = self.tolerated(spacing), max(self.scaling * min(spacing, 1.0), self.noise)
        angle = np.float32(self.max_angle) + np.float32(self.angle_relief) * slope
        distance = np.float32(self.max_distance * height) + np.float32(self.distance_relief * spacing) * slope
        beyond = Beyond(height, np.tan(np.radians(np.minimum(angle, STEEPEST))))
        return Limits(HeightRule(height, tilt), AngleRule(distance, angle, float(self.noise)), beyond)


class Limits(NamedTuple):
    """The rules of OST's growth: the ``first`` round, those ``then``, and ``beyond`` the hull (steps 6 and 7)."""

    first: HeightRule
    then: AngleRule
    beyond: Beyond


@of_scene.register(OST)
def _of_scene(filter_: OST, some: Callable[[int], list[PointCloud]]) -> dict[str, Any]:
    """The scatter of the vertices: the median over windows of the scene."""
    found = [filter_(cloud).info.get("scatter") for cloud in some(_SAMPLE)]
    known = [scatter for scatter in found if scatter is not None]
    return {"scatter": float(np.median(known))} if known else {}
