"""What people have decided at places, and the labels that follow: ground grows again there, from what they say."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from ..core.cloud import PointCloud
from ..core.errors import InputError, warn
from ..core.points import Points, has_area
from ..engines.ground import grow
from ..engines.neighbours import groups
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Growth, Outliers, Vertices
from ..engines.tin.network import corner_positions, one_network, with_elevation
from ..engines.tin.triangulation import triangulated
from ..files.disk import Bounds
from ..files.vectors import in_system, read_shapes
from ..methods.ost import OST
from ..reports.places import OFF, SIDE, STEEPEST_TERRAIN
from ..steps.seeds import rising

GROUND, OBJECT, BRIDGE, WATER, FINE = WORDS = ("ground", "object", "bridge", "water", "fine")
"""What may be said of a place."""
RIM = 2 * SIDE
"""Metres around a place in which points are tested again: two of the cells that places are made of."""
BESIDE = 3 * SIDE
"""Metres: the lowest point of a cell of :data:`SIDE` is a seed if it rises from none so near by more than terrain does."""
HALO = 40.0
"""Metres around that whose ground takes part, as around the tiles of terrain models."""
LEVEL = 0.3
"""Metres above and below the plane through the lowest points of a body of water that are its surface."""
_OVERLAP = 1.0
"""Square units of the file that two places with different verdicts may share."""
_BLOCK = 5.0
"""Metres: ground is averaged in such squares before its slope is taken, as in the landscape of OST."""


class PlaceVerdict(NamedTuple):
    """What is said of a place.

    Attributes:
        word: one of :data:`WORDS`. shape: polygons in file coordinates. name: the place in words. key: tells it from others.
    """

    word: str
    shape: shapely.Geometry
    name: str
    key: str

    @classmethod
    def of(cls, word: str, shape: shapely.Geometry, name: str) -> PlaceVerdict:
        """With a key that word and shape decide, to a millimetre."""
        plain = shapely.set_precision(shape, 0.001).normalize()
        return cls(word, shape, name, hashlib.sha256(word.encode() + shapely.to_wkb(plain)).hexdigest()[:24])


def read_verdicts(places: Any, crs: Any, bounds: Bounds, name: str = "places") -> tuple[list[PlaceVerdict], list[str]]:
    """The verdicts in a file or table of places that can be carried out, in coordinates of the data; in words why others cannot.

    Args:
        places: name of a GeoPackage or GeoJSON, or a GeoDataFrame, with a column ``verdict``; empty ones are passed over.
        crs, bounds: of the data.

    Raises: InputError if it cannot be read, or has no such column. Warns: if it is transformed, and of the others.
    """
    import geopandas
    import pandas

    table: Any = places
    if isinstance(places, (str, os.PathLike)):
        table = read_shapes(name := os.fspath(places), "places")
    elif not isinstance(places, geopandas.GeoDataFrame):
        raise InputError(f"{name}: a GeoDataFrame or the name of a file is needed, not {type(places).__name__}")
    if not len(table):  # an empty GeoJSON has no columns
        return [], []
    if "verdict" not in table:
        raise InputError(
            f"{name}: has no column verdict; it has {', '.join(map(str, table.columns))}: add it, with one of {', '.join(WORDS)}"
        )
    table = in_system(table, crs, name)
    verdicts, problems = [], []
    rows = np.arange(1, len(table) + 1)
    ranks = pandas.to_numeric(table["rank"], errors="coerce") if "rank" in table else rows
    names = [
        f"place {rank:.0f}" if np.isfinite(rank) else f"the place in row {row}"
        for rank, row in zip(ranks, rows, strict=True)
    ]
    every = table["verdict"].where(table["verdict"].notna(), "")
    for which, said, shape in zip(names, every, table.geometry, strict=True):
        word = str(said).strip().lower()
        if not word:
            continue
        if word not in WORDS:
            problems.append(f"{name}: {which}: {said!r} is no verdict: choose one of {', '.join(WORDS)}")
        elif shape is None or "Polygon" not in shape.geom_type or not (valid := shapely.make_valid(shape)).area:
            problems.append(f"{name}: {which}: is no polygon")
        elif not shape.intersects(shapely.box(*bounds)):
            problems.append(f"{name}: {which}: lies outside of the data: is it in another CRS?")
        else:
            verdicts.append(PlaceVerdict.of(word, valid, which))
    wrong = _contradictions(verdicts)
    problems += [f"{name}: {verdicts[a].name} is {verdicts[a].word} and {verdicts[b].name}, which overlaps it, "
                 f"{verdicts[b].word}: neither is carried out" for a, b in wrong]  # fmt: skip
    left_out = {row for pair in wrong for row in pair}
    for problem in problems:
        warn(problem)
    return [one for row, one in enumerate(verdicts) if row not in left_out], problems


def _contradictions(verdicts: Sequence[PlaceVerdict]) -> list[tuple[int, int]]:
    """Pairs that overlap and say different things."""
    shapes = np.array([one.shape for one in verdicts], object)
    pairs = shapely.STRtree(shapes).query(shapes, predicate="intersects").T.tolist()
    return [(a, b) for a, b in sorted(map(tuple, pairs)) if a < b and verdicts[a].word != verdicts[b].word
            and shapes[a].intersection(shapes[b]).area > _OVERLAP]  # fmt: skip


class Repair(NamedTuple):
    """Verdicts that are carried out together, since points are in the rims of several.

    Attributes:
        verdicts: of these places. touched: box around them and their rims. window: box whose points take part. File coordinates.
    """

    verdicts: list[PlaceVerdict]
    touched: Bounds
    window: Bounds


def sites(verdicts: Sequence[PlaceVerdict], metre: float) -> list[Repair]:
    """Places whose rims meet are a site; where nothing is to be changed there is none. ``metre``: metres per unit of the file."""
    if not verdicts:
        return []
    rims = [one.shape.buffer(RIM / metre) for one in verdicts]
    one, other = shapely.STRtree(rims).query(rims, predicate="intersects")
    of, found = groups(one, other, len(rims)), []
    for number in range(int(of.max()) + 1):
        own = sorted((verdicts[row] for row in np.flatnonzero(of == number).tolist()), key=lambda one: one.key)
        acting = [one.shape for one in own if one.word != FINE]
        if acting:
            box = shapely.union_all(acting).bounds
            found.append(Repair(own, _wider(box, RIM / metre), _wider(box, (RIM + HALO) / metre)))
    return found


def _wider(box: Bounds, by: float) -> Bounds:
    return box[0] - by, box[1] - by, box[2] + by, box[3] + by


@dataclasses.dataclass(frozen=True, eq=False)
class Repaired:
    """Labels of n points after verdicts, bool[n] each: ``changed``; ``ground``; ``water``, the surface of water where that was
    said; ``deck``: points of bridges that were ground."""

    changed: np.ndarray
    ground: np.ndarray
    water: np.ndarray
    deck: np.ndarray


def repaired(cloud: PointCloud, ground: np.ndarray, site: Repair, filter_: OST) -> Repaired:
    """Carry out the verdicts of a site on the points of its window.

    In an object and its rim, ground that sticks out of the plane of its neighbours by more than :data:`OFF` goes, from the
    outside inwards, until none does. Points of a bridge are no ground. In water those near the plane of its lowest points are.
    In ground the lowest points of cells are seeds as well. Then the ground grows by the rules of ``filter_`` through objects,
    ground, and the rims of all places. In the rim of a bridge it must pass again. Points elsewhere, and those of places that
    are fine, keep their labels.

    Args:
        cloud: n points, of the window. ground: bool[n]. filter_: with a ``spacing``, metres.
    """
    points = filter_.points_of(cloud)
    word, rim = _zones(points, site)
    was = points.gather(ground)
    seeds = was & ~np.isin(word, (BRIDGE, WATER)) & (rim != BRIDGE)
    for one in site.verdicts:
        if one.word == WATER:
            inside = np.flatnonzero(_inside(points, one.shape) & (word == WATER))
            seeds[inside[_level(points.xyz[inside])]] = True
    water = seeds & (word == WATER)
    if (places := word == GROUND).any():
        seeds[_lowest(points, places & ~filter_.low(points), seeds)] = True
    barred = _sticking_out(points, seeds, (word == OBJECT) | (rim == OBJECT))
    seeds &= ~barred
    grows = (np.isin(word, (GROUND, OBJECT)) | (rim != "")) & ~barred
    now = _grown(points, seeds, grows, filter_) if grows.any() and has_area(points.xyz[seeds]) else seeds
    changed = points.spread(now != was, False)
    after = np.where(changed, points.spread(now, False), ground)
    deck = points.spread((word == BRIDGE) & was, False) & ground
    return Repaired(changed, after, points.spread(water, False), deck)


def _inside(points: Points, shape: shapely.Geometry) -> np.ndarray:
    """bool[m]: points in a shape or on its border."""
    shapely.prepare(shape)
    cloud = points.cloud
    x, y = (cloud.origin[axis] + points.xyz[:, axis].astype(np.float64) / cloud.units.xy for axis in range(2))
    return np.asarray(shapely.intersects_xy(shape, x, y))


def _zones(points: Points, site: Repair) -> tuple[np.ndarray, np.ndarray]:
    """What is said of each point, U[m], "" = nothing; and of a place in whose rim it lies, U[m]."""
    word, rim = (np.full(len(points), "", "U6") for _ in range(2))
    for said in (WATER, GROUND, BRIDGE, OBJECT, FINE):  # in a rim the last one counts
        for one in site.verdicts:
            if one.word == said:
                word[_inside(points, one.shape)] = said
                if said != FINE:
                    rim[_inside(points, one.shape.buffer(RIM / points.cloud.units.xy))] = said
    rim[word != ""] = ""
    return word, rim


def _lowest(points: Points, counted: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """i64: rows of the lowest of the points ``counted``, bool[m], in each cell of :data:`SIDE` metres from the anchor, but for
    those that rise from another, or from one of ``seeds``, bool[m], more steeply than :data:`STEEPEST_TERRAIN`."""
    rows = np.flatnonzero(counted)
    cell = np.floor((points.xyz[rows, :2] + points.anchored()) / SIDE).astype(np.int64)
    order = np.lexsort((rows, points.xyz[rows, 2], cell[:, 0], cell[:, 1]))
    first = np.ones(len(rows), bool)
    first[1:] = (np.diff(cell[order], axis=0) != 0).any(axis=1)
    low = np.sort(rows[order[first]])
    others = np.union1d(low, np.flatnonzero(seeds))
    return low[~rising(points.xyz, low, others, BESIDE, STEEPEST_TERRAIN)]


def _level(xyz: np.ndarray) -> np.ndarray:
    """bool[k]: points f32[k, 3] of a place that are the surface of its water."""
    if len(xyz) == 0:
        return np.zeros(0, bool)
    near = xyz.astype(np.float64) - xyz.mean(axis=0, dtype=np.float64)
    columns, z = np.column_stack([near[:, :2], np.ones(len(near))]), near[:, 2]
    kept = z <= np.quantile(z, 0.25) + LEVEL
    for _ in range(5):  # the plane of the lower half, as far as it is level
        plane = np.linalg.lstsq(columns[kept], z[kept], rcond=None)[0]
        kept = np.abs(z - columns @ plane) <= LEVEL
        if kept.sum() < 3:
            return np.asarray(np.abs(z - z.min()) <= LEVEL)
    return np.asarray(kept)


def _slope(xyz: np.ndarray, anchored: np.ndarray) -> float:
    """Rise over run between means of squares of ground points f32[k, 3], averaged. The squares count from the anchor."""
    at = np.floor((xyz[:, :2] + anchored) / _BLOCK).astype(np.int64)
    at -= at.min(axis=0)
    shape = tuple((at.max(axis=0) + 1).tolist())
    key = at[:, 0] * shape[1] + at[:, 1]
    size = shape[0] * shape[1]
    with np.errstate(invalid="ignore"):
        z = (np.bincount(key, xyz[:, 2], size) / np.bincount(key, minlength=size)).reshape(shape)
    rises = [(z[2:, 1:-1] - z[:-2, 1:-1]), (z[1:-1, 2:] - z[1:-1, :-2])] if min(shape) > 2 else []
    slopes = np.hypot(*rises) / (2 * _BLOCK) if rises else np.zeros(0)
    known = slopes[np.isfinite(slopes)]
    return float(known.mean()) if len(known) else 0.0


def _sticking_out(points: Points, ground: np.ndarray, among: np.ndarray) -> np.ndarray:
    """bool[m]: points of the ``ground``, bool[m], that stick out of the plane of their neighbours.

    They do so by more than :data:`OFF` and what terrain rises by between two points. Of points ``among``, bool[m], half of those
    that do are dropped at a time, the worst first, until none does. What is then cut off from all others, such as the middle of a
    roof, is dropped as well if it is higher. With corners around the points, those at the edge of the data have neighbours on
    all sides.
    """
    from ..engines.tin.rings import residuals  # imports Numba

    rows, out = np.flatnonzero(ground), np.zeros(len(points), bool)
    if not (ground & among).any() or not has_area(points.xyz[rows]):
        return out
    place = (points.xyz[rows, :2] + np.float32(0)).view(np.int64).ravel()  # no zero has a sign
    _, first, of = np.unique(place, return_index=True, return_inverse=True)  # the first is the lowest
    xyz = points.xyz[rows[first]]
    corners = corner_positions(xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0), HALO)
    tin = triangulated(np.concatenate([xyz, with_elevation(corners, xyz)]), workers=1)
    over, dropped = np.zeros(len(tin.xyz), np.float32), np.zeros(len(first), bool)
    most, among = OFF + points.spacing() * _slope(xyz, points.anchored()), among[rows[first]]
    facets = tin.triangles[((tin.triangles >= 0) & (tin.triangles < len(first))).all(axis=1)].copy()
    while len(nodes := np.flatnonzero(among & ~dropped)):
        residuals(tin.xyz, tin.triangles, tin.neighbours, tin.where, nodes, over)
        high = nodes[over[nodes] > most]
        if not len(high):
            break
        high = high[over[high] >= np.median(over[high])]
        tin.remove(high)
        dropped[high] = True
    one, other = facets.ravel(), np.roll(facets, 1, axis=1).ravel()
    both = ~dropped[one] & ~dropped[other] & (among[one] | among[other])  # other links decide nothing
    island = groups(one[both], other[both], len(first))
    rest = np.bincount(island, ~among & ~dropped) > 0
    dropped |= ~rest[island] & (np.bincount(island, over[: len(first)])[island] > 0)
    out[rows] = dropped[of]
    return out


def _grown(points: Points, seeds: np.ndarray, grows: np.ndarray, filter_: OST) -> np.ndarray:
    """bool[m]: ground from ``seeds`` on, among the points that it ``grows`` over."""
    rows = np.flatnonzero(seeds | grows)
    some = dataclasses.replace(points, xyz=points.xyz[rows], weight=points.weight[rows])
    seed, none = seeds[rows], np.zeros(len(rows), bool)
    around = np.full(len(rows), _slope(some.xyz[seed], points.anchored()), np.float32)
    spacing = points.spacing() if filter_.spacing is None else filter_.spacing
    limits = filter_.limits(spacing, around, np.float32(0))
    kept = ("margin", "height", "slope")
    growth = Growth(limits.first, vertices=Vertices(sinks=False), beyond=limits.beyond, kept=kept)
    network = one_network(some, np.flatnonzero(seed), np.zeros((0, 2)), Outliers(none, none))
    network = dataclasses.replace(network, open=grows[rows])
    with GroundTin.start(network, growth, workers=1) as ground:
        ground.margin.fill(0)
        ground.step()
        ground.change(limits.then)
        grow(ground, filter_.rounds)
        now = np.zeros(len(points), bool)
        now[rows] = ground.ground
    return now
