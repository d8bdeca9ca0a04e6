"""Verdicts on places are carried out on a result in memory: ground grows again there, from what people say."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import shapely

from ..core.cloud import PointCloud
from ..core.errors import InputError
from ..core.grid import lattice_over
from ..core.points import Points, has_area
from ..core.result import Decision, FilterResult
from ..engines.ground import grow
from ..engines.neighbours import groups
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Growth, Outliers, Vertices
from ..engines.tin.network import corner_positions, one_network, with_elevation
from ..engines.tin.triangulation import triangulated
from ..methods.default import default_filter
from ..methods.ost import OST
from ..reports.places import SIDE, STEEPEST_TERRAIN
from ..steps.seeds import lowest_on_grid, rising
from ..surveys.tiles import inside, part_of
from ..terrain.accuracy import OFF
from ..terrain.layer import extent_of
from ..terrain.models import heights_of
from .verdicts import BRIDGE, FINE, GROUND, HALO, OBJECT, PLACE_RIM, WATER, VerdictSite, read_verdicts, sites_of

BESIDE = 3 * SIDE
"""Metres: the lowest point of a cell of :data:`SIDE` is a seed if it rises from none so near by more than terrain does."""
WAVES = 0.3
"""Metres above and below the plane through the lowest points of a body of water that are its surface."""
_BLOCK = 5.0
"""Metres: ground is averaged in such squares before its slope is taken, as in the landscape of OST."""


def apply(result: FilterResult, places: Any) -> FilterResult:
    """Carry out what people have decided at places: labels inside these and at their rim become what follows from it.

    ============  ========================================================================================================
    verdict       what is done
    ============  ========================================================================================================
    ``ground``    the lowest points of cells of 2 m are ground as well, unless they stand on something steeper than terrain
    ``object``    ground goes that sticks out of the plane of its neighbours by more than 0.5 m, and stands as much above the
                  terrain that grows into the place from around it
    ``bridge``    no point is ground; points that were are marked as ``deck``
    ``water``     ground are the points within 0.3 m of the plane of its lowest points, which are marked as ``water``
    ``fine``      nothing changes, here and where the rim of another place meets it
    ============  ========================================================================================================

    The ground around the place is known. From it and from what is left or new, the ground grows again through the place and the
    4 m around it, by the rules of OST. Around a bridge, ground in these 4 m must pass again. All other labels stay as they are.
    Places whose rims meet are done together, and each sees the ground up to 40 m away.

    Args:
        result: of any filter; the limits are those of OST, as set up for the cloud if another method has found the ground.
        places: what :func:`jaxfilter.review` returns or has written, with its column ``verdict`` filled in; or any other polygons
            with such a column. Empty ones are passed over. Places in another CRS are transformed.

    Returns: FilterResult with other ``ground`` and ``decision``, ``water`` and ``deck``; ``doubt`` is NaN where labels changed.
    Raises: InputError for places that cannot be read or have no such column, and for a result without its cloud. Warns: of each
        verdict that is left out, since it is none, lies beside the data, or contradicts one that overlaps it.

    >>> places = jf.review(cloud, result)
    >>> places["verdict"] = "fine"
    >>> bool((jf.apply(result, places).ground == result.ground).all())
    True
    """
    if result.run is None:
        raise InputError("result: was put together by hand, so its points are unknown: pass what a filter has returned")
    cloud = result.run.cloud
    verdicts, _ = read_verdicts(places, cloud.crs, extent_of(cloud))
    filter_: Any = result.run.filter
    filter_ = filter_.replace() if isinstance(filter_, OST) else default_filter(cloud)
    if filter_.spacing is None:
        filter_ = filter_.replace(spacing=filter_.points_of(cloud).spacing())
    ground, decision = result.ground.copy(), np.array(result.decision)
    doubt = None if result.doubt is None else result.doubt.copy()
    water, deck = (np.zeros(len(cloud), bool) if old is None else old.copy() for old in (result.water, result.deck))
    for site in sites_of(verdicts, cloud.units.xy):
        rows = np.flatnonzero(inside(cloud, site.window))
        found = repair(part_of(cloud, rows), result.ground[rows], site, filter_)
        changed = rows[found.changed]
        ground[changed] = found.ground[found.changed]
        decision[changed] = np.where(ground[changed], Decision.ACCEPTED, Decision.SURFACE)
        water[rows[found.water]], deck[rows[found.deck]] = True, True
        if doubt is not None:
            doubt[changed] = np.nan
    return dataclasses.replace(
        result, ground=ground, decision=decision, doubt=doubt, water=water & ground, deck=deck & ~ground
    )


class Repair(NamedTuple):
    """Labels of n points after verdicts, bool[n] each: ``changed``; ``ground``; ``water``, the surface of water where that was
    said; ``deck``: points of bridges that were ground."""

    changed: np.ndarray
    ground: np.ndarray
    water: np.ndarray
    deck: np.ndarray


def repair(cloud: PointCloud, ground: np.ndarray, site: VerdictSite, filter_: OST) -> Repair:
    """Carry out the verdicts of a site on the points of its window.

    In an object and its rim, ground goes that sticks out of the plane of its neighbours by more than :data:`OFF`, from the
    outside inwards, until none does; but what is at most so far above the terrain that grows from around the rim stays. Points
    of a bridge are no ground. In water those near the plane of its lowest points are. In ground the lowest points of cells are
    seeds as well. Then the ground grows by the rules of ``filter_`` through objects, ground, and the rims of all places. In the
    rim of a bridge it must pass again. Points elsewhere, and those of places that are fine, keep their labels.

    Args:
        cloud: n points, of the window. ground: bool[n]. filter_: with a ``spacing``, metres.
    """
    points = filter_.points_of(cloud)
    word, rim = _find_zones(points, site)
    was = points.gather(ground)
    seeds = was & ~np.isin(word, (BRIDGE, WATER)) & (rim != BRIDGE)
    for shape in (one.shape for one in site.verdicts if one.word == WATER):
        if len(wet := np.flatnonzero(_find_inside(points, shape) & (word == WATER))):
            seeds[wet[_find_surface(points.xyz[wet])]] = True
    water = seeds & (word == WATER)
    if (places := word == GROUND).any():  # the lowest of each cell, unless it rises steeply from another
        counted = places & ~filter_.bar(points).low
        low = lowest_on_grid(points, lattice_over(points.xyz, SIDE, points.offset(SIDE)), ~counted)
        others = np.union1d(low, np.flatnonzero(seeds))
        seeds[low[~rising(points.xyz, low, others, BESIDE, STEEPEST_TERRAIN)]] = True
    among = (word == OBJECT) | (rim == OBJECT)
    barred = _find_sticking_out(points, seeds, among)
    barred &= _find_standing(points, seeds & ~among, among, filter_)
    seeds &= ~barred
    grows = (np.isin(word, (GROUND, OBJECT)) | (rim != "")) & ~barred
    now = _grow_through(points, seeds, grows, filter_) if grows.any() and has_area(points.xyz[seeds]) else seeds
    changed = points.spread(now != was, False)
    after = np.where(changed, points.spread(now, False), ground)
    deck = points.spread((word == BRIDGE) & was, False) & ground
    return Repair(changed, after, points.spread(water, False), deck)


def _find_inside(points: Points, shape: shapely.Geometry) -> np.ndarray:
    """bool[m]: points in a shape or on its border."""
    shapely.prepare(shape)
    cloud = points.cloud
    x, y = (cloud.origin[axis] + points.xyz[:, axis].astype(np.float64) / cloud.units.xy for axis in range(2))
    return np.asarray(shapely.intersects_xy(shape, x, y))


def _find_zones(points: Points, site: VerdictSite) -> tuple[np.ndarray, np.ndarray]:
    """What is said of each point, U[m], "" = nothing; and of a place in whose rim it lies, U[m]."""
    word, rim = (np.full(len(points), "", "U6") for _ in range(2))
    for said in (WATER, GROUND, BRIDGE, OBJECT, FINE):  # in a rim the last one counts
        for one in site.verdicts:
            if one.word == said:
                word[_find_inside(points, one.shape)] = said
                if said != FINE:
                    rim[_find_inside(points, one.shape.buffer(PLACE_RIM / points.cloud.units.xy))] = said
    rim[word != ""] = ""
    return word, rim


def _find_surface(xyz: np.ndarray) -> np.ndarray:
    """bool[k]: points f32[k, 3] of a place that are the surface of its water."""
    near = xyz.astype(np.float64) - xyz.mean(axis=0, dtype=np.float64)
    columns, z = np.column_stack([near[:, :2], np.ones(len(near))]), near[:, 2]
    kept = z <= np.quantile(z, 0.25) + WAVES
    for _ in range(5):  # the plane of the lower half, as far as it is level
        plane = np.linalg.lstsq(columns[kept], z[kept], rcond=None)[0]
        kept = np.abs(z - columns @ plane) <= WAVES
        if kept.sum() < 3:
            return np.asarray(np.abs(z - z.min()) <= WAVES)
    return np.asarray(kept)


def _slope_of(xyz: np.ndarray, anchored: np.ndarray) -> float:
    """Rise over run between means of squares of ground points f32[k, 3], averaged. The squares count from the anchor."""
    at = np.floor((xyz[:, :2] + anchored) / _BLOCK).astype(np.int64)
    at -= at.min(axis=0)
    shape = tuple((at.max(axis=0) + 1).tolist())
    if min(shape) < 3:
        return 0.0
    key, size = np.ravel_multi_index(tuple(at.T), shape), shape[0] * shape[1]
    with np.errstate(invalid="ignore"):
        z = (np.bincount(key, xyz[:, 2], size) / np.bincount(key, minlength=size)).reshape(shape)
    slopes = np.hypot(*np.gradient(z, _BLOCK))[1:-1, 1:-1]
    known = slopes[np.isfinite(slopes)]
    return float(known.mean()) if len(known) else 0.0


def _find_sticking_out(points: Points, ground: np.ndarray, among: np.ndarray) -> np.ndarray:
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
    most, among = OFF + points.spacing() * _slope_of(xyz, points.anchored()), among[rows[first]]
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


def _find_standing(points: Points, seeds: np.ndarray, among: np.ndarray, filter_: OST) -> np.ndarray:
    """bool[m]: those of the points ``among``, bool[m], that stand more than :data:`OFF` above the terrain that grows from
    ``seeds``, bool[m], through them; all of them, if there is no such terrain."""
    if not among.any() or not has_area(points.xyz[seeds]):
        return among
    terrain, rows = _grow_through(points, seeds, among, filter_), np.flatnonzero(among)
    at = np.empty(len(points), np.int64)
    at[points.member] = points.index
    cloud, found = points.cloud, np.zeros(len(points), bool)
    heights = heights_of(cloud, points.spread(terrain, False), at[rows], workers=1)
    found[rows] = heights * cloud.units.z > OFF
    return found


def _grow_through(points: Points, seeds: np.ndarray, grows: np.ndarray, filter_: OST) -> np.ndarray:
    """bool[m]: ground from ``seeds`` on, among the points that it ``grows`` over."""
    rows = np.flatnonzero(seeds | grows)
    some = dataclasses.replace(points, xyz=points.xyz[rows], weight=points.weight[rows])
    seed, none = seeds[rows], np.zeros(len(rows), bool)
    around = np.full(len(rows), _slope_of(some.xyz[seed], points.anchored()), np.float32)
    spacing = points.spacing() if filter_.spacing is None else filter_.spacing
    limits = filter_.limits(spacing, around)
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
