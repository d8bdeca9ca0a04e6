"""All clouds: tiles and scenes, what is known of each, and what is measured on it with which methods."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import ndtr

import jaxfilter as jf
from experiments.defaults import clouds as defaults
from experiments.defaults.clouds import Known, tile
from experiments.report import Row
from experiments.scenes import water
from jaxfilter.surveys.tiles import part_of

FILLED = jf.Interpolation(fill=True)
"""Every cell has a height, so that none is left out where ground was lost."""
ERRORS, CUTS = [("errors", name) for name in jf.FILTERS], [("cuts", name) for name in ("ost", "smrf")]
PLACES, WATER = [("places", "ost")], [("water", "ost")]
SOME = [("errors", name) for name in ("ost", "iptd", "smrf", "msf", "csf", "ptd")]
"""What is measured, and with which method."""

JUNGLE = dataclasses.replace(jf.scenes.LAYOUTS["canopy"], tilt=0.6, forest=0.95, penetration=0.01)
LAYOUTS = jf.scenes.LAYOUTS | {"jungle": JUNGLE}
HARD = ("coast", "gorge", "benches", "vineyard", "canopy", "jungle")
SIZES = {0.5: (400.0, 300.0), 2.0: (400.0, 300.0), 8.0: (400.0, 160.0)}
"""Extents in metres by density in pulses per square metre."""
SEED = 101
SENSORS = {
    "image matching": (("town", "city", "hills"), 90.0, 40.0),
    "drone lidar": (("forest", "town", "hills"), 50.0, 100.0),
    "mobile": (("town", "city", "hills"), 100.0, 30.0),
}
"""Layouts of each sensor, metres along a side, and pulses or pixels per m2."""
VILLAGE = dataclasses.replace(
    jf.scenes.LAYOUTS["town"], cutting=0.0, houses=3.0, rows=0.3, blocks=0.0, halls=0.0, walls=0.6, low_vegetation=0.2
)
PIT = dataclasses.replace(jf.scenes.LAYOUTS["quarry"], low_vegetation=0.05)
PHOTOGRAPHS = {
    "town": (jf.scenes.LAYOUTS["town"], (0, 100, 0, 100), 40.0, 400),
    "village": (VILLAGE, (0, 90, 0, 90), 55.0, 90),
    "quarry": (PIT, (140, 240, 100, 230), 25.0, 0),
}
"""Layout, west, east, south and north border in metres, pixels per m2, and m2 for each hedge, of scenes from photographs."""
NOISES, BLOCKS, STEEP = (0.03, 0.15), (0.1, 0.3), 0.6
"""Standard deviations in metres of matching, and of broken rock, from the best to the worst patch; slope of faces and heaps."""
ROOFS = ("flat", "gable", "levels", "sawtooth", "annex")
WOODED = dataclasses.replace(jf.scenes.LAYOUTS["canopy"], tilt=0.3, forest=0.95, penetration=0.15)
"""A forest on slopes."""
LOW_SHARE, LOW_DEPTH = 1e-3, (2.0, 30.0)
"""Low outliers that are added to a tile, in terms of its points, and their depth below the ground, metres."""
LOW_TILES = (
    "geo1101_Delft_manual", "3dfier_ahn3_cropped_2", "ign_semis_2023_0292_6833", "lff_2_67", "zf_veluwezoom_ahn3",
    "lidR_Topography",
)  # fmt: skip
"""A city, blocks, countryside, a steep, a hilly and a boreal forest: those of experiments/tiles, but for the steep one."""
SLOPES = {"hilly": 0.3, "steep": 0.6}
"""Rise over run of the slopes of forests with low outliers."""


@dataclasses.dataclass(frozen=True, eq=False)
class Site(Known):
    """A cloud, and more that is known of it than its ground (nowhere True if that is not known).

    Attributes:
        parts: bool[n] by name, points of which the share that becomes ground is looked at.
        beside: f64[k, 3], ground of another survey, file units, against which the terrain is held.
        area: where water and decks are.
    """

    parts: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    beside: np.ndarray | None = None
    area: water.Place | None = None


class Cloud(NamedTuple):
    """A cloud before it is read or made.

    Attributes:
        name: unlike that of all others. measured: measures and methods. facts: by which means are taken.
        simulated: it is a scene of the library, and another one if the simulator changes.
    """

    kind: str
    name: str
    make: Callable[[], Site]
    measured: list[tuple[str, str]]
    facts: Row = {}  # noqa: RUF012
    simulated: bool = False


def every(folder: Path) -> Iterator[Cloud]:
    """All clouds. ``folder``: with isprs, tiles, tiles_hard and other_sensors."""
    for kind, part in (("tiles", "tiles"), ("hard tiles", "tiles_hard")):
        for path in sorted((folder / part).glob("*.la[sz]")):
            yield Cloud(kind, path.stem, partial(labelled, kind, path), ERRORS + CUTS + PLACES + WATER)
    for density, layout in itertools.product(SIZES, LAYOUTS):
        hard, middle = layout in HARD, density == 2
        measured = ERRORS * hard + CUTS * (hard and middle) + PLACES * (middle and layout != "jungle")
        make = partial(scene, layout, density)
        yield Cloud("scenes", f"{layout} {density:g}", make, measured, {"density": density}, True)
    yield from _each("layouts", general, ERRORS, scene=defaults.LAYOUTS, density=(0.3, 1.0, 4.0, 15.0))
    for path in sorted((folder / "other_sensors").glob("*.laz")):
        yield Cloud("sensors", path.stem, partial(real, path), ERRORS)
    sensors = [f"{sensor}, {layout}" for sensor, (layouts, _, _) in SENSORS.items() for layout in layouts]
    yield from _each("sensors", imitated, ERRORS, scene=sensors, seed=(SEED,))
    yield from _each("drawn anew", imitated, ERRORS, scene=sensors, seed=(11, 12))
    yield from _each("photographs", photographed, ERRORS, scene=PHOTOGRAPHS, seed=(21, 22))
    yield from _each("photographs anew", photographed, ERRORS, scene=PHOTOGRAPHS, seed=(23,))
    places = ("inside", "edge", "corner")
    yield from _each("halls", hall, ERRORS, density=(1.0, 2.0, 8.0), roof=ROOFS, place=places, seed=(100, 101))
    shapes = {"height": (3.0, 8.0), "width": (3.0, 5.0, 9.0), "slope": (0.5, 0.67, 0.8)}
    yield from _each("dikes", dike, ERRORS, density=(0.5, 2.0, 8.0), **shapes)
    shares = {"density": (0.05, 0.1, 0.2, 0.5), "share": (5, 10, 20)}
    yield from _each("sparse forests", sparse, ERRORS, **shares, seed=(101, 102))
    yield from _each("sparse forests anew", sparse, SOME, **shares, seed=(201, 202))
    for name, seed in itertools.product(LOW_TILES, (1, 2, 3)):
        for path in (folder / "tiles").glob(f"{name}.la[sz]"):
            yield Cloud("low outliers", f"{name}, seed {seed}", partial(lowered, path, seed), [], facts={"seed": seed})
    yield from _each(
        "forests with low outliers", lowered_forest, [], slope=SLOPES, density=(1.0, 4.0), seed=(301, 302, 303)
    )
    yield from _each("water", crossed, WATER, scene=water.SCENES, density=SIZES)
    for path in sorted((folder / "isprs").glob("samp*.txt")):
        yield Cloud("samples", path.stem, partial(real, path), PLACES)


def _each(
    kind: str, make: Callable[..., Site], measured: list[tuple[str, str]], **axes: Iterable[Any]
) -> Iterator[Cloud]:
    """A cloud for each combination of arguments of ``make``."""
    for values in itertools.product(*axes.values()):
        facts = dict(zip(axes, values, strict=True))
        name = f"{kind}: {', '.join(f'{key} {value}' for key, value in facts.items())}"
        yield Cloud(kind, name, partial(make, **facts), measured, facts, make not in (hall, dike))


def load(folder: Path, name: str) -> Site:
    """The cloud of this name."""
    return next(cloud for cloud in every(folder) if cloud.name == name).make()


def labelled(kind: str, path: Path) -> Site:
    """A labelled tile."""
    return Site(**vars(tile(path.stem, kind, path)))


def scene(layout: str, density: float) -> Site:
    """One of :data:`LAYOUTS`, in strips of 250 m, so that rock faces are seen from both sides. Last echoes are scored."""
    made = jf.scenes.make(LAYOUTS[layout], size=SIZES[density], density=density, seed=SEED, swath=250.0)
    return Site(f"{layout} {density:g}", "scenes", made.cloud, made.truth, made.cloud.candidate)


def general(scene: str, density: float) -> Site:
    """One of the scenes that defaults are chosen on."""
    made = jf.scenes.make(scene, size=defaults.SIZES[density], density=density, seed=defaults.SEED)
    return Site(scene, "layouts", made.cloud, made.truth, made.cloud.candidate)


def imitated(scene: str, seed: int) -> Site:
    """A scene as one of :data:`SENSORS` sees it."""
    sensor, layout = scene.split(", ")
    _, side, density = SENSORS[sensor]
    made = jf.scenes.make(layout, size=side, density=density, seed=seed, sensor=sensor)
    return Site(scene, "sensors", made.cloud, made.truth, made.cloud.candidate)


def photographed(scene: str, seed: int) -> Site:
    """One of :data:`PHOTOGRAPHS`. Noise differs from patch to patch, as shade and texture do, and is mostly shared by neighbours.
    Steep terrain and patches beside it are broken rock. Hedges and bushes are round, and nothing is seen beneath them.
    """
    layout, (west, east, south, north), density, area = PHOTOGRAPHS[scene]
    made = jf.scenes.make(layout, size=(east, north), density=density, seed=seed, noise=0.0, sensor="image matching")
    at = made.xyz[:, :2] - made.origin[:2]
    left = np.flatnonzero((at >= (west, south)).all(axis=1))
    (x, y), ground, rng = at[left].T, made.truth[left], np.random.default_rng(seed)

    def field(metres: float, cell: float = 0.25) -> np.ndarray:
        """f64[n]: normal noise that is alike within this distance."""
        values = gaussian_filter(rng.standard_normal((round(east / cell) + 2, round(north / cell) + 2)), metres / cell)
        return map_coordinates(values / values.std(), (x / cell, y / cell), order=1)

    def between(least: float, most: float) -> np.ndarray:
        """f64[n]: from the least to the most, by patches."""
        return least * (most / least) ** ndtr(field(5.0))

    noise = between(*NOISES)
    z = noise * (0.9 * field(0.6) + 0.43 * rng.standard_normal(len(x)))
    if not area:
        rises = [made.terrain(*(made.xyz[left, :2] + step).T) for step in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        steep = np.hypot(rises[0] - rises[1], rises[2] - rises[3]) / 2 + 0.3 * field(4.0)
        z += np.clip(2 * (steep / STEEP - 0.5), 0, 1) * between(*BLOCKS) * (0.8 * field(0.5) + 0.6 * field(1.5))
    hedge = np.zeros(len(x))
    for _ in range(round((east - west) * (north - south) / area) if area else 0):
        (cx, cy), turn = rng.uniform((west, south), (east, north)), rng.integers(2) * np.pi / 2 + 0.3
        half, width, height = rng.integers(2) * rng.uniform(3, 10), rng.uniform(0.5, 1.5), rng.uniform(0.5, 2.0)
        along = np.abs((x - cx) * np.cos(turn) + (y - cy) * np.sin(turn))
        away = np.hypot(np.maximum(along - half, 0), (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)) / width
        hedge = np.maximum(hedge, height * np.exp(-(away**4)) * (1 + 0.15 * field(0.5)))
    hedge = np.where(ground & (hedge > 0.01), hedge, 0)
    xyz = made.xyz[left] + np.column_stack([0 * x, 0 * x, z + hedge])
    truth = ground & (hedge < 0.15)
    cloud = jf.PointCloud.from_arrays(xyz.round(2), reference=truth)
    return Site(scene, "photographs", cloud, truth, cloud.candidate)


def real(path: Path, anchor: tuple[float, float] = (0.0, 0.0)) -> Site:
    """A sample, or a cloud of another sensor. Class 0 is not scored where others are. ``anchor``: from where grids count."""
    cloud = jf.read(path, units="m", ignore_classes=(7, 18), anchor=anchor)
    truth, beside, classes = cloud.reference, None, cloud.classification
    scored = cloud.candidate if classes is None else cloud.candidate & (classes != 0)
    if truth is None or not truth.any():
        truth, scored = np.zeros(len(cloud), bool), cloud.candidate
    if path.stem == "spanner_UAS":
        other = jf.read(path.with_stem("spanner_ALS"), units="m")
        beside = other.coordinates()[other.reference & other.candidate]
    return Site(path.stem, "sensors", cloud, truth, scored, beside=beside)


def crossed(scene: str, density: float) -> Site:
    """One of the scenes with water and decks, of the seed that is only scored."""
    place = water.place(scene, density, water.CHECK)
    return Site(scene, "water", place.cloud, place.truth, place.cloud.candidate, area=place)


def hall(density: float, roof: str, place: str, seed: int) -> Site:
    """A hall of 70 to 140 m, 5.5 to 12 m high, and 60 trees, on a slope of 2 % with waves of 1.5 m."""
    rng, side = np.random.default_rng(seed), 260.0 if density < 8 else 200.0
    (wide, deep), height, turn = rng.uniform(70, 140, 2), rng.uniform(5.5, 12), rng.uniform(0, np.pi) * (seed % 2)
    x, y = rng.uniform(0, side, (2, int(side**2 * density)))
    left, low = side / 2 if place != "corner" else 0.35 * wide, side / 2 if place == "inside" else 0.35 * deep
    along = (x - left) * np.cos(turn) + (y - low) * np.sin(turn)
    across = (y - low) * np.cos(turn) - (x - left) * np.sin(turn)

    def terrain(x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        return np.asarray(0.02 * x + 1.5 * np.sin(np.divide(x, 60)) * np.cos(np.divide(y, 45)))

    z, top = terrain(x, y), terrain(left, low) + height
    if roof == "gable":
        top = top + 0.12 * (deep / 2 - np.abs(across))
    elif roof == "levels":
        top = top + np.floor(along / 12) % 2
    elif roof == "sawtooth":
        top = top + 0.25 * (along % 10)
    built = (np.abs(along) < wide / 2) & (np.abs(across) < deep / 2)
    z = np.where(built, top, z)
    if roof == "annex":
        beside = (np.abs(along - wide / 2 - 6) < 6) & (np.abs(across) < deep / 3)
        z, built = np.where(beside & ~built, terrain(left, low) + 3.5, z), built | beside
    objects = built.copy()
    for cx, cy in rng.uniform(0, side, (60, 2)):
        crown = (np.hypot(x - cx, y - cy) < 3) & ~objects & (rng.random(len(x)) < 0.8)
        z, objects = z + crown * rng.uniform(2, 8, len(x)), objects | crown
    z += rng.normal(0, 0.03, len(x))
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, z]))
    return Site("hall", "halls", cloud, ~objects, cloud.candidate, {"hall": built})


def sparse(density: float, share: int, seed: int) -> Site:
    """A square of 500 m of forest on slopes, of which so few last echoes are left, points per m2, and this percentage of them is
    ground."""
    made = jf.scenes.make(WOODED, size=500.0, density=2.0, seed=seed, swath=250.0)
    rng, count = np.random.default_rng(seed), round(density * 500**2)
    last, on_ground = made.return_number == made.number_of_returns, round(count * share / 100)
    parts = [(last & made.truth, on_ground), (last & ~made.truth, count - on_ground)]
    left = np.sort(np.concatenate([rng.choice(np.flatnonzero(of), many, replace=False) for of, many in parts]))
    cloud = part_of(made.cloud, left)
    return Site("forest", "sparse forests", cloud, made.truth[left], cloud.candidate)


def lowered(path: Path, seed: int) -> Site:
    """A labelled tile with low outliers at random places, below the triangulation of its ground."""
    known = labelled("low outliers", path)
    rng, cloud, truth = np.random.default_rng(seed), known.cloud, known.ground
    count, at = round(LOW_SHARE * len(cloud)), cloud.coordinates()
    surface = scipy.interpolate.LinearNDInterpolator(at[truth, :2] - at[0, :2], at[truth, 2])
    x, y = rng.uniform(*np.percentile(at[truth, :2], (0, 100), axis=0), (4 * count, 2)).T
    z = surface(x - at[0, 0], y - at[0, 1])
    below = np.column_stack([x, y, z - rng.uniform(*LOW_DEPTH, len(z))])[np.isfinite(z)][:count]
    facts = {"return_number": 1, "number_of_returns": 1, "classification": 1, "candidate": True}
    columns = {
        name: np.append(values, np.full(len(below), value, values.dtype))
        for name, value in facts.items()
        if (values := getattr(cloud, name)) is not None
    }
    more = jf.PointCloud.from_arrays(np.concatenate([at, below]), units=cloud.units, **columns)
    no, yes = np.zeros(len(below), bool), np.ones(len(below), bool)
    return Site(path.stem, known.group, more, np.append(truth, no), np.append(known.scored, yes))


def lowered_forest(slope: str, density: float, seed: int) -> Site:
    """A forest on slopes, in which one of 1,000 pulses has an echo 2 to 30 m too low."""
    layout = dataclasses.replace(WOODED, tilt=SLOPES[slope], low_outliers=1e-3)
    made = jf.scenes.make(layout, size=250.0, density=density, seed=seed, swath=250.0)
    return Site(slope, "forests with low outliers", made.cloud, made.truth, made.cloud.candidate)


def dike(density: float, height: float, width: float, slope: float) -> Site:
    """A plain with waves of 0.3 m, a straight dike across it, and plants of 0.5 to 3 m on a twentieth of the points."""
    rng, side = np.random.default_rng(7), {0.5: 200.0, 2.0: 160.0, 8.0: 100.0}[density]
    x, y = rng.uniform(-side / 2, side / 2, (2, int(side**2 * density)))
    across = np.abs(x * np.cos(0.5) + y * np.sin(0.5))
    z = np.maximum(height - slope * np.maximum(across - width / 2, 0), 0) + 0.3 * np.sin(x / 25)
    z += rng.normal(0, 0.03, len(x))
    ground = rng.random(len(x)) >= 0.05
    z = np.where(ground, z, z + rng.uniform(0.5, 3, len(x)))
    cloud = jf.PointCloud.from_arrays(np.column_stack([x, y, z]))
    return Site("dike", "dikes", cloud, ground, cloud.candidate, {"crest": ground & (across < width / 2)})
