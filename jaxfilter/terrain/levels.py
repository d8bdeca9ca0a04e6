"""The level of water: bodies are joined out of cells, and each has one height, or heights that fall along its course."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import scipy

from ..core.cloud import QUANTUM, PointCloud
from ..core.errors import warn
from ..core.reading import Bounds
from ..core.result import FilterResult
from ..core.water import WaterCells
from ..engines.neighbours import groups, touching
from .outline import SNAP
from .raster import RasterGrid
from .runs import bodies, keys

if TYPE_CHECKING:
    import geopandas

WATER = 9
"""ASPRS class of water."""
BED = 40
"""ASPRS class of the bed of waters, measured through them. Where it is named as ground, the terrain is the bed, and not level."""
WATER_REACH = 18.0
"""Metres from a point of water up to which water may be where nothing was returned."""
LEAST_WATER = 100.0
"""Square metres of a body."""
FALL = 0.1
"""Metres between the two ends of a body, from which on it falls."""
_BLOCK, _PIECE = 8, 24.0
"""Cells along the side of a block, in which one mean is taken, and metres along a river in which one level is found."""
_WEIR, _ROUNDS = 0.3, 8
"""Metres between two pieces, from which on it is a step, and times that others are made even."""
_MOST = 100_000_000
"""Cells that are looked at together."""


def labelled_water(cloud: PointCloud, ground: np.ndarray, side: float) -> WaterCells | None:
    """The water of points of class 9: cells whose nearest point of ground or water, within :data:`WATER_REACH`, is water, without
    those that reach further out than the water does. ``ground``: bool[n]; ``side``: of cells, metres. Warns: of stray points."""
    if cloud.classification is None:
        return None
    wet = cloud.classification == WATER
    for left_out in (cloud.withheld, None if cloud.valid is None else ~cloud.valid):
        wet &= True if left_out is None else ~left_out
    if not wet.any():
        return None

    lag, pad = (cloud.origin[:2] - cloud.anchor) * cloud.units.xy / side, 2 * math.ceil(WATER_REACH / side) + 2
    place = np.floor(cloud.xyz[:, 1::-1].astype(np.float64) / side + lag[::-1] + 0.5).astype(np.int64)
    low, high = place[wet].min(axis=0) - pad, place[wet].max(axis=0) + pad + 1
    shape = tuple((high - low).tolist())
    if shape[0] * shape[1] > _MOST:
        warn(f"points of class {WATER} are {max(shape) * side:,.0f} m apart: they make no water; cut stray points off")
        return None

    def cells(points: np.ndarray) -> np.ndarray:
        at = place[points] - low
        return at[((at >= 0) & (at < shape)).all(axis=1)] @ [shape[1], 1]

    at, size = cells(wet), shape[0] * shape[1]
    count = np.bincount(at, minlength=size).reshape(shape)
    z = np.bincount(at, cloud.xyz[wet, 2], size).reshape(shape) / np.maximum(count, 1)
    known = count > 0
    known.reshape(-1)[cells(ground & ~wet)] = True
    away, nearest = scipy.ndimage.distance_transform_edt(~known, return_indices=True)
    within = scipy.ndimage.distance_transform_edt(count == 0) * side <= WATER_REACH
    within = scipy.ndimage.distance_transform_edt(within) * side > WATER_REACH
    row, column = np.nonzero(within & (count[tuple(nearest)] > 0) & (away * side <= WATER_REACH))
    source = tuple(one[row, column] for one in nearest)
    wet_cells = np.stack([row + low[0], column + low[1]], axis=1).astype(np.int32)
    return WaterCells(side, wet_cells, cloud.origin[2] * cloud.units.z + z[source])


@dataclasses.dataclass(frozen=True, eq=False)
class WaterRuns:
    """Cells of water side by side: what is kept of the water of a tile, and, of all tiles, the bodies with their levels.

    Attributes:
        frame: f64[5]: side of a cell, metres; x and y of the anchor, file units; metres per unit of X and Y, and of Z.
        run: i32[k, 3]: row, first column, and the column after the last one, in order; none goes over the edge of a block.
        z: f64[k], metres: the level; as long as bodies are not joined, the sum of elevations of the cells, which is exact.
        body: i64[k], which body a run is in; empty as long as bodies are not joined.
    """

    frame: np.ndarray
    run: np.ndarray
    z: np.ndarray
    body: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def of(cls, cells: WaterCells | None, cloud: PointCloud, core: Bounds | None = None) -> Self | None:
        """The cells of a cloud whose middle is in ``core``; None if there are none."""
        if cells is None:
            return None
        at, z = cells.at, cells.z
        if core is not None:
            middle = cloud.anchor[::-1] + at * (cells.side / cloud.units.xy)
            inside = ((middle >= [core[1], core[0]]) & (middle < [core[3], core[2]])).all(axis=1)
            at, z = at[inside], z[inside]
        new = np.append(True, (np.diff(at[:, 0]) != 0) | (np.diff(at[:, 1]) != 1) | (at[1:, 1] % _BLOCK == 0))
        first = np.flatnonzero(new[: len(at)])
        if not len(first):
            return None
        length = np.diff(np.append(first, len(at)))
        run = np.column_stack([at[first], at[first, 1] + length]).astype(np.int32)
        frame = np.array([cells.side, *cloud.anchor, cloud.units.xy, cloud.units.z])
        return cls(frame, run, np.add.reduceat(np.rint(z / QUANTUM) * QUANTUM, first))

    @classmethod
    def joined(cls, parts: Iterable[Self | None]) -> Self | None:
        """The bodies of parts of a survey, joined where their cells touch, with one level each, or with levels that fall. None
        without any."""
        some = [part for part in parts if part is not None]
        if not some:
            return None
        run, z = np.concatenate([part.run for part in some]), np.concatenate([part.z for part in some])
        order = np.lexsort((run[:, 1], run[:, 0]))
        run, z, side = run[order], z[order], some[0].frame[0]
        cut = (run[1:, :2] == run[:-1, ::2]).all(axis=1) & (run[1:, 1] % _BLOCK != 0)  # by the edge of a tile
        start = np.flatnonzero(np.append(True, ~cut))
        end = np.append(start[1:], len(run)) - 1
        run, z = np.column_stack([run[start, :2], run[end, 2]]), np.add.reduceat(z, start)
        body = bodies(run)
        large = np.bincount(body, run[:, 2] - run[:, 1]) * side**2 >= LEAST_WATER
        kept = large[body]
        if not kept.any():
            return None
        run, z, body = run[kept], z[kept], (np.cumsum(large) - 1)[body[kept]]
        return cls(some[0].frame, run, _levels(run, z, body, side), body)

    @classmethod
    def together(cls, parts: Sequence[Self]) -> Self:
        """The bodies of surveys with one frame, as they are; where they overlap, those of the first."""
        number = np.cumsum([0, *(int(part.body.max()) + 1 for part in parts)])
        run, z = np.concatenate([part.run for part in parts]), np.concatenate([part.z for part in parts])
        body = np.concatenate([part.body + first for part, first in zip(parts, number, strict=False)])
        order = np.argsort(keys(run[:, 0], run[:, 1]), kind="stable")
        first, stop = (keys(run[order, 0], run[order, k]) for k in (1, 2))
        order = order[first >= np.append(0, np.maximum.accumulate(stop)[:-1])] if len(parts) > 1 else order
        return cls(parts[0].frame, run[order], z[order], body[order])

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The attributes by name."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """f64[...]: the level of water at places, file units, NaN on land; ``x``, ``y``: f64[...], file coordinates.

        A place is in water if half of the four cells around it are, by their distance, so that a slanting shore has no stairs of
        single cells. The level is linear between the middles of blocks, so that it falls evenly.
        """
        side, x0, y0, metre, factor = self.frame
        place = [np.rint((v - v0) * (metre / SNAP)) * (SNAP / side) for v, v0 in ((y, y0), (x, x0))]
        low = [np.floor(v).astype(np.int64) for v in place]
        first = keys(self.run[:, 0], self.run[:, 1])
        share, most, run = np.zeros(np.shape(x)), np.zeros(np.shape(x)), np.zeros(np.shape(x), np.int64)
        for way in _CORNERS:
            (row, column), weight = _corner(place, low, way)
            at = np.maximum(np.searchsorted(first, keys(row, column), "right") - 1, 0)
            wet = (self.run[at, 0] == row) & (self.run[at, 1] <= column) & (column < self.run[at, 2])
            share += weight * wet
            nearer = wet & (weight > most)
            run, most = np.where(nearer, at, run), np.where(nearer, weight, most)
        return np.where(share >= 0.5, self._even(place, run) / factor, np.nan)

    def _even(self, place: list[np.ndarray], run: np.ndarray) -> np.ndarray:
        """f64[...]: levels, metres, of rows and columns that are in the body of a run."""
        place = [(v + 0.5) / _BLOCK - 0.5 for v in place]
        low = [np.floor(v).astype(np.int64) for v in place]
        known, z = self._blocks
        own, more, total = self.z[run], np.zeros(np.shape(run)), np.zeros(np.shape(run))
        for way in _CORNERS:
            (row, column), weight = _corner(place, low, way)
            key = self._block_key(row, column, self.body[run])
            at = np.minimum(np.searchsorted(known, key), len(known) - 1)
            weight = weight * (known[at] == key)
            more, total = more + weight * (z[at] - own), total + weight
        return own + more / np.where(total > 0, total, 1.0)

    def _block_key(self, row: np.ndarray, column: np.ndarray, body: np.ndarray) -> np.ndarray:
        low, high = self.run.min(axis=0)[:2] // _BLOCK - 1, self.run.max(axis=0) // _BLOCK + 3
        return ((row - low[0]) * (high[2] - low[1]) + column - low[1]) * (self.body.max() + 1) + body

    @functools.cached_property
    def _blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """i64[b], f64[b]: blocks of bodies, by number, and their levels."""
        row, column = self.run[:, :2].T.astype(np.int64) // _BLOCK
        key, first = np.unique(self._block_key(row, column, self.body), return_index=True)
        return key, self.z[first]

    def over(self, grid: RasterGrid) -> np.ndarray:
        """f64[rows, columns]: the level where the middle of a cell is in water, NaN on land."""
        x, y = (v.ravel() for v in grid.centres())
        side, x0, y0, metre, _ = self.frame
        low, high = self.run.min(axis=0) - 1, self.run.max(axis=0) + 1
        near = [
            (v >= v0 + a * side / metre) & (v <= v0 + b * side / metre)
            for v, v0, a, b in ((y, y0, low[0], high[0]), (x, x0, low[1], high[2]))
        ]
        out = np.full(grid.shape, np.nan)
        out[np.ix_(*near)] = self.at(*np.meshgrid(x[near[1]], y[near[0]]))
        return out

    def put(self, values: np.ndarray, grid: RasterGrid) -> np.ndarray:
        """f32[rows, columns]: the values of a terrain model, level in water."""
        level = self.over(grid).astype(np.float32)
        return np.where(np.isnan(level), values, level)


_CORNERS = ((0, 0), (0, 1), (1, 0), (1, 1))


def _corner(
    place: list[np.ndarray], low: list[np.ndarray], way: tuple[int, int]
) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Row and column of one of the four cells around places, and its weight."""
    row, column = (np.abs(1 - one - (v - whole)) for v, whole, one in zip(place, low, way, strict=True))
    return (low[0] + way[0], low[1] + way[1]), row * column


def outlines(levels: WaterRuns | None, crs: Any) -> geopandas.GeoDataFrame:
    """The bodies as polygons, whose corners have a height: see :func:`jaxfilter.breaklines`. None: there are no bodies."""
    import geopandas
    import shapely

    if levels is None:
        none = np.zeros(0)
        return geopandas.GeoDataFrame({"elevation": none, "fall": none, "area": none}, geometry=[], crs=crs)

    side, x0, y0, metre, factor = levels.frame
    step, z = side / metre, levels.z / factor
    west, east = (x0 + (levels.run[:, k] - 0.5) * step for k in (1, 2))
    south = y0 + (levels.run[:, 0] - 0.5) * step
    order = np.argsort(levels.body, kind="stable")
    shapes, heights = [], []
    for rows in np.split(order, np.flatnonzero(np.diff(levels.body[order])) + 1):
        shape = shapely.union_all(shapely.box(west[rows], south[rows], east[rows], south[rows] + step))
        rings = [shape.exterior, *shape.interiors]
        turns = [shapely.get_coordinates(shapely.segmentize(ring, 1.001 * step)) for ring in rings]
        shell, *holes = (np.concatenate([at[:-1] + at[1:], at[:1] + at[1:2]]) / 2 for at in turns)
        shape = shapely.simplify(shapely.Polygon(shell, holes), 1e-6 * step)  # from the middle of a side to the next
        low, high = z[rows].min(), z[rows].max()
        if low == high:
            shape = shapely.simplify(shape, 0)
        heights.append((float(np.median(z[rows])), high - low))
        shapes.append(shape)
    corners = shapely.get_coordinates(shapes)
    # a corner is at the middle of four cells, of which one at least is water: the lowest counts
    around = [levels.at(*(corners + step * np.array(way)).T) for way in itertools.product((-0.25, 0.25), repeat=2)]
    corners = np.column_stack([corners, np.fmin.reduce(around)])
    shapes = shapely.set_coordinates(shapely.force_3d(shapes), corners)
    level, fall = np.array(heights).reshape(-1, 2).T
    found = geopandas.GeoDataFrame({"elevation": level, "fall": fall}, geometry=shapes, crs=crs)
    found.insert(2, "area", found.area)
    return found


def water_of(cloud: PointCloud, result: FilterResult | np.ndarray | None, ground: np.ndarray) -> WaterCells | None:
    """The water of a cloud: what the filter found, and what points of class 9 say. ``ground``: bool[n]. None if there is none."""
    found = result.water_cells if isinstance(result, FilterResult) else None
    labelled = labelled_water(cloud, ground, 1.0 if found is None else found.side)
    return found if labelled is None else labelled if found is None else labelled.with_others(found)


def levels_in(cloud: PointCloud, result: FilterResult | np.ndarray | None, ground: np.ndarray) -> WaterRuns | None:
    """The bodies of water of a cloud in memory; ``ground``: bool[n]."""
    return WaterRuns.joined([WaterRuns.of(water_of(cloud, result, ground), cloud)])


def levels_of(cloud: PointCloud, result: FilterResult | np.ndarray | None, ground: np.ndarray) -> WaterRuns | None:
    """As :func:`levels_in`, for a terrain model: None if ``result``, an array, says that points of the bed are ground."""
    classes = None if isinstance(result, FilterResult) else cloud.classification
    bed = classes is not None and bool((classes[ground] == BED).any())
    return None if bed else levels_in(cloud, result, ground)


def _levels(run: np.ndarray, z: np.ndarray, body: np.ndarray, side: float) -> np.ndarray:
    """f64[k]: the level of every run, whose cells have the sum ``z``.

    Blocks of cells are nodes of a graph. The way through it from the lower end of a body is cut into pieces, and each has the
    median of its blocks; where that falls, the mean of the highest so far and of the lowest from there on."""
    order: np.ndarray = np.lexsort((run[:, 1] // _BLOCK, run[:, 0] // _BLOCK, body))
    place = np.column_stack([body, run[:, 0] // _BLOCK, run[:, 1] // _BLOCK])[order]
    start = np.flatnonzero(np.append(True, (np.diff(place, axis=0) != 0).any(axis=1)))
    block: np.ndarray = np.empty(len(run), np.int64)
    block[order] = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(run))))
    place, weight = place[start], (run[:, 2] - run[:, 1]).astype(np.float64)
    cells = np.bincount(block, weight)
    places = run[:, 0], run[:, 1:].sum(axis=1) / 2 - 0.5
    middle = side * np.column_stack([np.bincount(block, weight * at) for at in places]) / cells[:, None]
    level = np.bincount(block, z) / cells
    of = place[:, 0]
    low, most, high = (_share(level, of, share) for share in (0.05, 0.5, 0.95))
    out, falls = most[of], (high - low > FALL)[of]
    if falls.any():
        rows = np.flatnonzero(falls)
        place, middle = place[rows] - place[rows].min(axis=0) + 1, middle[rows]
        wide = place.max(axis=0) + 2
        key = (place[:, 0] * wide[1] + place[:, 1]) * wide[2] + place[:, 2]  # ascending
        links = np.column_stack(touching(key, wide[2]))  # blocks of one body that touch, at a corner too
        length = np.hypot(*(middle[links[:, 0]] - middle[links[:, 1]]).T)
        out[rows] = _falling(level[rows], of[rows], links, length, out[rows])
    return out[block]


def _share(z: np.ndarray, group: np.ndarray, share: float) -> np.ndarray:
    """f64[g]: a quantile of each group, i64[n]; all numbers from 0 on are groups."""
    order, count = np.lexsort((z, group)), np.bincount(group)
    return z[order][np.cumsum(count) - count + (share * (count - 1)).astype(np.int64)]


def _falling(level: np.ndarray, of: np.ndarray, links: np.ndarray, length: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """f64[b]: levels of blocks that fall along their course; ``flat``: f64[b], those of bodies whose two ends are level."""
    from scipy import sparse
    from scipy.sparse.csgraph import dijkstra

    count = len(level)
    graph = sparse.csr_array((length, (links[:, 0], links[:, 1])), (count, count))
    bodies, of = np.unique(of, return_inverse=True)

    def farthest(starts: np.ndarray) -> np.ndarray:
        away = dijkstra(graph, directed=False, indices=starts, min_only=True)
        return np.lexsort((away, of))[np.cumsum(np.bincount(of)) - 1]

    def near(ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = dijkstra(graph, directed=False, indices=ends, min_only=True)
        at_end = away <= _PIECE
        return away, np.bincount(of[at_end], level[at_end]) / np.bincount(of[at_end])

    one = farthest(np.searchsorted(of, np.arange(len(bodies))))
    other = farthest(one)
    (way, here), (back, there) = near(one), near(other)
    way = np.where((here <= there)[of], way, back)
    band = (way / _PIECE).astype(np.int64)
    same = band[links[:, 0]] == band[links[:, 1]]
    piece = groups(links[same, 0], links[same, 1], count)
    own = _share(level, piece, 0.5)
    in_band = np.empty(len(own), np.int64)
    in_band[piece] = band
    pairs = links[~same]
    upward = (band[pairs[:, 0]] < band[pairs[:, 1]])[:, None]
    pairs = piece[np.where(upward, pairs, pairs[:, ::-1])]  # the lower one first
    pairs = pairs[np.argsort(in_band[pairs[:, 1]], kind="stable")]
    least, most = own.copy(), own.copy()
    steps = np.split(pairs, np.flatnonzero(np.diff(in_band[pairs[:, 1]])) + 1) if len(pairs) else []
    for some in steps:
        np.maximum.at(most, some[:, 1], most[some[:, 0]])
    for some in reversed(steps):
        np.minimum.at(least, some[:, 0], least[some[:, 1]])
    own = (least + most) / 2
    for left in reversed(
        range(_ROUNDS + 1)
    ):  # means of three pieces rise nowhere; the last round only finds the slopes
        below, above = np.full((2, len(own)), np.inf)
        np.minimum.at(below, pairs[:, 1], -own[pairs[:, 0]])  # the highest
        np.minimum.at(above, pairs[:, 0], own[pairs[:, 1]])
        down, up = own + below, above - own
        limit = _WEIR if left else _MOST
        down, up = (np.where(a <= limit, a, np.where(b <= limit, b, 0)) for a, b in ((down, up), (up, down)))
        own = own + (up - down) / 4 if left else own
    share = way / _PIECE - band - 0.5
    slope = np.where(share < 0, down[piece], up[piece])
    return np.where((np.abs(here - there) > FALL)[of], own[piece] + share * slope, flat)
