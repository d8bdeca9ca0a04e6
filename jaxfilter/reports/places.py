"""Places where a terrain model may be wrong: evidence in each cell; connected cells where it is likely; their list."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.ndimage

from ..core.cloud import PointCloud, as_cloud
from ..core.grid import most_cells
from ..core.reading import Bounds
from ..core.result import FilterResult
from ..engines.neighbours import groups, touching
from ..files.disk import check_suffix
from ..terrain.accuracy import OFF
from ..terrain.layer import extent_of, ground_of
from ..terrain.models import heights_of
from ..terrain.outline import cells_of, inward
from ..terrain.raster import RasterGrid

if TYPE_CHECKING:
    import geopandas

SIDE = 2.0
"""Metres: side of the cells that places are made of."""
LIKELY = 0.04
"""Cells whose terrain is off by more than half a metre with this chance, or a larger one, are named."""
LEAST_AREA = 40.0
"""Square metres that a place has at least."""
LARGEST_AREA = 2500.0
"""Square metres that a place has at most."""
SQUARE_CELLS = 25
"""Cells along the squares that cut what is larger."""
VIEW = 40.0
"""Cells: what lies so near to the largest part of a place, in both directions, is part of it, so that one view shows all."""
BLANK = 0.5
"""Share of the cells of a square from which on it is blank: where two of these touch, nothing can be said of the area."""
MOST, FEW = 60.0, 3
"""Places per square kilometre of the data, at most; so many in any case."""
PLACE_WEIGHTS = np.array([[-1.18, 1.17, -1.06, -1.15, 1.15], [-3.27, 0.0, -1.06, -0.48, 1.2]])
"""f64[2, 5]: constant and weights of :func:`gather_evidence`, for results with doubt and without; fitted to tiles and scenes."""
CUT_REACH = 30.0
"""Metres that an object which the outline of the data cuts reaches into the data at most: wider ones are hills and terraces."""
STEP = 0.7
"""Rise over run between neighbouring cells of one object, at most: roofs are seldom steeper than 35 degrees."""
DROP, DROP_SHARE = 2.5, 0.5
"""Metres that the surface falls by within two cells, and the share of the inner border of an object where it falls so."""
AREA, TOUCH = 20.0, 3.0
"""Square metres, and metres along the outline of the data, that a cut object has at least."""
UNKNOWN = 0.5
"""The chance that a cut object which is ground is none, and that a smooth steep face which is none is ground."""
STEEPEST_TERRAIN = 1.0
"""Rise over run: terrain between ground points that are far from each other is taken to rise by no more, and few roofs do."""
_WIDE = 1 << 31  # cells that a row may have
REASONS = (
    "canopy or roof cut by the edge of the data",
    "steep face taken as an object",
    "low points left out",
    "few ground points",
    "doubtful points",
)
"""Why a place is named: the first that holds in a cell, and in a place the one with the largest volume."""
ALONE = 2
"""The first so many reasons say what is there: what has one of these is a place of its own."""
UNKNOWN_AREA = "nothing can be said of this area"
"""Why an area is named that is too large to be looked through for errors."""
SUSPECT = np.dtype([("cell", "i4", 2), ("chance", "f4"), ("error", "f4"), ("reason", "i1"), ("filled", "?")])
"""A cell where the terrain model may be wrong: column and row from the zero of the coordinates; the chance that it is off by more
than half a metre; the expected error, metres; the place in :data:`REASONS`; whether it holds points."""


class ReviewCells(NamedTuple):
    """Cells of a cloud, arrays [rows, columns], row 0 in the north.

    Attributes:
        low: f64, elevation of the lowest candidate, metres, that of the nearest cell with one where there is none.
        height: f64, metres of it over the terrain model, zero where it is ground.
        ground: bool, the lowest candidate is ground; points, grounds: f64, number of candidates, and of ground points.
        doubt: f64, sum of the doubt; None if the result states none. noise: bool, cells with low outliers.
    """

    low: np.ndarray
    height: np.ndarray
    ground: np.ndarray
    points: np.ndarray
    grounds: np.ndarray
    doubt: np.ndarray | None
    noise: np.ndarray

    @classmethod
    def from_cloud(
        cls, cloud: PointCloud, result: FilterResult, every: np.ndarray, shape: tuple[int, int]
    ) -> ReviewCells:
        """With at least one candidate. ``every``: i64[n], the cell of each point, of ``shape``."""
        rows = slice(None) if cloud.candidate.all() else cloud.candidate
        at, z, ground = every[rows], cloud.xyz[:, 2][rows], result.ground[rows]
        height, is_ground, noise = (np.full(shape, none) for none in (np.inf, False, False))
        low = np.full(shape, np.inf, z.dtype)
        np.minimum.at(low.reshape(-1), at, z)
        least = np.flatnonzero(z == low.reshape(-1)[at])
        lowest = np.flatnonzero(cloud.candidate)[least]
        above = result.height[lowest].astype(np.float64)
        if not np.isfinite(above).any() and result.ground.any():
            above = heights_of(cloud, result.ground, lowest, workers=None) * cloud.units.z
        above[ground[least] | ~np.isfinite(above)] = 0
        np.minimum.at(height.reshape(-1), at[least], above)
        is_ground.reshape(-1)[at[least][ground[least]]] = True
        noise.reshape(-1)[every[result.low_noise]] = True

        def sums(values: np.ndarray | None = None) -> np.ndarray:
            return np.bincount(at, values, low.size).reshape(shape)

        points, grounds = sums().astype(np.float64), sums(ground)
        doubt = None if result.doubt is None else sums(np.nan_to_num(result.doubt[rows]))
        near = tuple(scipy.ndimage.distance_transform_edt(np.isinf(low), return_distances=False, return_indices=True))
        return cls(low[near].astype(np.float64), height[near], is_ground, points, grounds, doubt, noise)


def as_result(cloud: PointCloud, result: FilterResult | np.ndarray) -> FilterResult:
    """A result as it is; labels bool[n] as one of which nothing else is known. Raises: InputError for labels that do not fit."""
    ground = ground_of(cloud, result)
    return result if isinstance(result, FilterResult) else FilterResult.of_labels(ground)


def gather_evidence(surface: ReviewCells) -> np.ndarray:
    """f64[rows, columns, 4]: what speaks for an error, over a cell and the eight around it, as logarithms.

    Mean doubt of the points; share of ground points; ground points per square metre; slope of the terrain, rise over run. Small
    numbers are added, so that none is infinite. Without any doubt the first is zero.
    """
    points, grounds = np.maximum(sum_around(surface.points), 1), sum_around(surface.grounds)
    doubt = np.ones(points.shape) if surface.doubt is None else sum_around(surface.doubt) / points + 0.01
    density, slope = grounds / (9 * SIDE**2), _slope_of(surface.low - surface.height)
    return np.log(np.stack([doubt, grounds / points + 0.05, density + 0.05, slope + 0.05], axis=-1))


class Suspects(NamedTuple):
    """``cells``, of dtype :data:`SUSPECT`, whose terrain is wrong with a chance of :data:`LIKELY` or more; the ``area`` of all
    cells that hold points, square metres."""

    cells: np.ndarray
    area: float


def find_suspects(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    *,
    footprints: Iterable[Bounds] | None = None,
    window: Bounds | None = None,
    core: Bounds | None = None,
    inside: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Suspects:
    """The cells of a cloud whose terrain may be wrong.

    Args:
        cloud: n points. result: a FilterResult, or bool[n], what is ground.
        footprints: rectangles that are known to hold data, file coordinates, where the cloud was cut out of more data.
        window: the box that was read then; its edges are no outline. core: only cells with their centre in this box.
        inside: only cells with their centre, x and y as f64[k] in file coordinates, where this is True.

    Raises: InputError for labels that do not fit, or if the extent is too large.
    """
    result = as_result(cloud, result)
    if not cloud.candidate.any():
        return Suspects(np.zeros(0, SUSPECT), 0.0)
    side, metre = SIDE / cloud.units.xy, cloud.units.xy
    grid = RasterGrid.over(extent_of(cloud) if window is None else window, side, metre, most_cells(len(cloud)))
    grid = grid.grown(1)
    at = cells_of(cloud, grid)
    data = np.zeros(grid.shape, bool)
    data.flat[at if cloud.valid is None else at[cloud.valid]] = True
    for box in footprints or ():
        if window is not None:
            data |= _cells_in(grid, box) & ~_cells_in(grid, window)
    surface = ReviewCells.from_cloud(cloud, result, at, grid.shape)
    filled, figures, inner = surface.points > 0, gather_evidence(surface), inward(data, SIDE)
    seen = (sum_around(surface.points) > 0) & (inner > 0)
    weights = PLACE_WEIGHTS[int(surface.doubt is None)]
    chance = np.where(seen, 1 / (1 + np.exp(-(weights[0] + figures @ weights[1:]))), 0)
    spacing, slope = np.exp(-figures[..., 2] / 2), np.exp(figures[..., 3]) - 0.05
    error = np.maximum(OFF, np.minimum(slope, STEEPEST_TERRAIN) * spacing)
    fall, face = _find_cut(surface, filled, inner), _find_faces(surface, filled)
    rise = np.where(face, surface.height, np.where(surface.ground, fall, 0))
    chance, error = np.where(rise > 0, np.maximum(chance, UNKNOWN), chance), np.maximum(error, rise)
    reason = np.select([face, fall > 0, surface.noise, surface.grounds == 0], [1, 0, 2, 3], 4).astype(np.int8)
    own = np.ones(grid.shape, bool) if core is None else _cells_in(grid, core)
    if inside is not None:
        x, y = grid.centres()
        row, column = np.nonzero(own)
        own[row, column] = inside(x[column], y[row])
    named = own & (chance >= LIKELY)
    row, column = np.nonzero(named)
    found = np.zeros(len(row), SUSPECT)
    found["cell"] = np.stack([grid.left + column, grid.bottom + grid.rows - 1 - row], axis=1)
    found["chance"], found["error"] = chance[named], (chance * error)[named]
    found["reason"], found["filled"] = reason[named], filled[named]
    return Suspects(found, float((filled & own).sum()) * SIDE**2)


def sum_around(values: np.ndarray, mode: str = "constant") -> np.ndarray:
    """f64[rows, columns]: sums over each cell and the eight around it."""
    for axis in range(2):
        values = scipy.ndimage.correlate1d(values, np.ones(3), axis, mode=mode)
    return values


def _cells_in(grid: RasterGrid, box: Bounds) -> np.ndarray:
    """bool[rows, columns]: cells whose centre is in a box."""
    x, y = grid.centres()
    return ((x >= box[0]) & (x < box[2]))[None, :] & ((y >= box[1]) & (y < box[3]))[:, None]


def _slope_of(z: np.ndarray) -> np.ndarray:
    """f64[rows, columns]: rise over run, by the cells before and after."""
    wide = np.pad(z, 1, mode="edge")
    return np.hypot(wide[1:-1, 2:] - wide[1:-1, :-2], wide[2:, 1:-1] - wide[:-2, 1:-1]) / (2 * SIDE)


def _find_faces(surface: ReviewCells, filled: np.ndarray) -> np.ndarray:
    """bool[rows, columns]: steep ground that was taken as an object, with the cells beside it.

    Of a cell and the eight around it most have no ground, are steeper than :data:`STEEPEST_TERRAIN`, and lie between their
    neighbours: walls and canopies do not.
    """
    slope, bend = _slope_of(surface.low), np.abs(sum_around(surface.low, "nearest") / 9 - surface.low)
    steep = filled & (surface.grounds == 0) & (slope > STEEPEST_TERRAIN) & (bend < slope * SIDE / 4)
    return np.asarray(filled & (sum_around((sum_around(steep * 1.0) >= 5) * 1.0) > 0))


def _find_cut(surface: ReviewCells, filled: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """f64[rows, columns]: metres that objects which the outline cuts stand above what surrounds them; zero in other cells.

    An object is a segment of the surface of lowest points whose neighbouring cells differ by less than :data:`STEP` times the
    cell. It touches the outline, reaches no further than :data:`CUT_REACH` into the data, and the surface falls along its border
    inside the data. ``inner``: metres to the outline.
    """
    strip = filled & (inner <= CUT_REACH + SIDE)
    out, wall = np.zeros(strip.shape), np.zeros(strip.shape, bool)
    if not strip.any():
        return out
    number, links = np.cumsum(strip).reshape(strip.shape) - 1, []
    for here, there in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        both = strip[here] & strip[there]
        upright = both & (np.abs(surface.low[here] - surface.low[there]) >= STEP * SIDE)
        wall[here] |= upright
        wall[there] |= upright
        links.append((number[here][both & ~upright], number[there][both & ~upright]))
    one, other = np.concatenate(links, axis=1)
    segment = groups(one, other, int(strip.sum()))
    fall = (surface.low - scipy.ndimage.minimum_filter(np.where(filled, surface.low, np.inf), 5, mode="nearest"))[strip]
    wall, inner = wall[strip], inner[strip]
    cells, touching = np.bincount(segment), np.bincount(segment, inner < SIDE)
    border, falling = np.bincount(segment, wall), np.bincount(segment, wall & (fall > DROP))
    cut = (cells * SIDE**2 >= AREA) & (touching * SIDE >= TOUCH) & (np.bincount(segment, inner > CUT_REACH) == 0)
    cut &= (border > 0) & (falling >= DROP_SHARE * border)
    height = np.bincount(segment, np.where(wall & (fall > DROP), fall, 0)) / np.maximum(falling, 1)
    out[strip] = np.where(cut, height, 0)[segment]
    return out


class Place(NamedTuple):
    """A connected area where the terrain model may be wrong.

    Attributes:
        x, y: file coordinates of the middle of a cell that holds points.
        area: square metres. volume: expected error, cubic metres. chance: that a square metre of it is off by more than 0.5 m.
        reason: in words. cells: i32[k, 2], columns and rows from the zero of the coordinates.
    """

    x: float
    y: float
    area: float
    volume: float
    chance: float
    reason: str
    cells: np.ndarray

    def facts(self) -> dict[str, Any]:
        """All but the cells, by name."""
        return dict(zip(self._fields[:-1], self, strict=False))


def places_of(parts: Sequence[Suspects], metre: float) -> list[Place]:
    """The places of the parts of a cloud, largest volume first, and after them the areas of which nothing can be said.

    Cells that touch, at a corner too, are a part if they have :data:`LEAST_AREA`; squares of :data:`SQUARE_CELLS` cells cut
    what is wider. Parts that one view shows are a place. The largest are listed, :data:`MOST` per square kilometre. ``metre``:
    per unit.
    """
    found = np.concatenate([part.cells for part in parts]) if parts else np.zeros(0, SUSPECT)
    found = found[np.lexsort(found["cell"].T)]
    found = found[(np.bincount(of := _connected(_key(found["cell"]))) * SIDE**2 >= LEAST_AREA)[of]]
    square, at, count = np.unique(_key(found["cell"] // SQUARE_CELLS), return_inverse=True, return_counts=True)
    blank = np.flatnonzero(count >= BLANK * SQUARE_CELLS**2)
    area, of = np.full(len(square), -1), _connected(square[blank])
    area[blank] = np.where((np.bincount(of) > 1)[of], of, -1)
    blanks = _listed(found, area[at], metre)
    rest = area[at] < 0
    found, at = found[rest], at[rest]
    of = _connected(_key(found["cell"]))
    volume = np.zeros((len(found), len(REASONS)))
    np.add.at(volume, (of, found["reason"]), found["error"])
    found["reason"] = volume.argmax(axis=1)[of]
    wide = np.zeros(len(found), bool)
    for axis in range(2):
        place, cell = np.full((2, len(found)), _WIDE), found["cell"][:, axis].astype(np.int64)
        np.minimum.at(place[0], of, cell)
        np.minimum.at(place[1], of, -cell)
        wide |= (-place[1] - place[0])[of] >= SQUARE_CELLS
    part = np.where(wide, of * np.int64(len(square)) + at, -1 - of)
    most = max(FEW, math.floor(MOST * sum(part.area for part in parts) / 1e6))
    places = _listed(found, _gathered(found, part, most), metre)
    return places + [place._replace(reason=UNKNOWN_AREA) for place in blanks]


def _gathered(found: np.ndarray, part: np.ndarray, most: int) -> np.ndarray:
    """i64[n]: the place of each cell, negative for none: a part of large volume and those around it, up to :data:`LARGEST_AREA`.

    ``part``: i64[n], of each cell.
    """
    _, first_cell, part, count = np.unique(part, return_index=True, return_inverse=True, return_counts=True)
    volume = np.bincount(part, found["error"])
    middle = np.stack([np.bincount(part, found["error"] * found["cell"][:, axis]) / volume for axis in range(2)])
    alone = found["reason"][first_cell] < ALONE
    order, along = np.argsort(-volume, kind="stable"), np.argsort(middle[0], kind="stable")
    rank, place = np.argsort(order), np.full(len(volume), -1)
    likely, x, number = volume / count, middle[0, along], 0
    for first in order.tolist():
        if place[first] >= 0:
            continue
        if number == most:
            break
        near = along[slice(*np.searchsorted(x, middle[0, first] + [-VIEW - 1, VIEW + 1]))]
        near = near[(place[near] < 0) & (np.abs(middle[:, near] - middle[:, [first]]) <= VIEW).all(axis=0)]
        near = near[(near == first) | ~(alone[near] | alone[first])]
        near = near[np.lexsort((rank[near], -likely[near], near != first))]
        place[near[np.cumsum(count[near]) * SIDE**2 <= LARGEST_AREA]] = number
        number += 1
    return place[part]


def _key(cell: np.ndarray) -> np.ndarray:
    """i64[n]: cells i[n, 2] as numbers, row by row."""
    return cell[:, 1].astype(np.int64) * _WIDE + cell[:, 0]


def _connected(key: np.ndarray) -> np.ndarray:
    """i32[n]: the group of each cell, of those that touch; ``key``: ascending."""
    return groups(*touching(key, _WIDE), len(key))


def _listed(found: np.ndarray, of: np.ndarray, metre: float) -> list[Place]:
    """Cells of dtype :data:`SUSPECT` as the places that they are ``of``, i[n], none if negative; largest volume first."""
    order = np.argsort(of, kind="stable")[np.count_nonzero(of < 0) :]
    places = []
    for at in np.split(order, np.flatnonzero(np.diff(of[order])) + 1) if len(order) else []:
        cell, volume = found["cell"][at], found["error"][at] * SIDE**2
        first = cell.min(axis=0)  # sums from it on have the same bits wherever the cloud lies
        held = cell[found["filled"][at]]
        if len(at) * SIDE**2 < LEAST_AREA or not len(held):
            continue
        middle = volume @ (cell - first) / volume.sum()
        x, y = ((held[np.square(held - first - middle).sum(axis=1).argmin()] + 0.5) * SIDE / metre).tolist()
        why, chance = REASONS[int(np.bincount(found["reason"][at], volume).argmax())], float(found["chance"][at].mean())
        places.append(Place(x, y, len(at) * SIDE**2, float(volume.sum()), chance, why, cell))
    return sorted(places, key=lambda place: -place.volume)


def review(
    cloud: Any,
    result: FilterResult | np.ndarray,
    path: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """Places where the terrain model may be off by more than half a metre, the largest expected error volume first.

    Cells of 2 m whose chance of such an error is 4 % or more are named. Those that touch count from 40 m2 on; what lies close
    together is one place of 2,500 m2 at most, and at most 60 places per km2 are listed, or three. The chance follows from the
    mean doubt of the points, the share of ground among them, the density of ground points, and the slope of the terrain. Objects
    that are labelled ground and that the outline of the data cuts are named as well. Where half of a larger area is named, it is
    one entry at the end: nothing can be said of this area (docs/doubt.md).

    Args:
        cloud: what was classified, n points, a PointCloud or a ``laspy.LasData``.
        result: of any filter, or bool[n] with True = ground. Places are found better where doubt is stated (OST).
        path: a GeoPackage (.gpkg, layer ``review``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
            Both open in QGIS.
        overwrite: replace an existing file.

    Returns: GeoDataFrame with the CRS of the cloud, coordinates in its units, and the columns ``rank`` (from 1), ``x`` and
    ``y`` (in a cell that holds points), ``area`` (m2), ``volume`` (m3: expected error, area times height), ``chance`` (that a
    square metre of it is off by more than half a metre), ``reason``, ``verdict`` (empty: what a person decides there, for
    :func:`jaxfilter.apply`) and ``geometry``.
    Raises: ParameterError; InputError (labels of another length, too large an extent); OutputError
    (suffix, exists, disk). Warns: if a file is written and the cloud has no CRS.

    >>> places = jf.review(cloud, result, "places.geojson")
    >>> places["rank"].tolist() == list(range(1, len(places) + 1)), bool(places["volume"].is_monotonic_decreasing)
    (True, True)
    """
    from ..files.vectors import VECTOR_SUFFIXES, write_features

    target = None if path is None else check_suffix(Path(path), VECTOR_SUFFIXES)
    cloud = as_cloud(cloud)
    table = table_of(places_of([find_suspects(cloud, result)], cloud.units.xy), cloud.units.xy, cloud.crs)
    if target is not None:
        write_features(target, [table], "review", overwrite=overwrite)
    return table


def table_of(places: Sequence[Place], metre: float, crs: Any) -> geopandas.GeoDataFrame:
    """The table of :func:`review`. ``metre``: metres per unit of the file."""
    import geopandas
    import pandas
    import shapely

    side, shapes = SIDE / metre, []
    for place in places:
        low = place.cells * side
        boxes = shapely.box(low[:, 0], low[:, 1], low[:, 0] + side, low[:, 1] + side)
        # The corners of neighbouring cells are equal but for rounding: snapped to a ten thousandth of a side.
        shapes.append(shapely.union_all(boxes, grid_size=side / 10_000))
    table = pandas.DataFrame(places, columns=Place._fields).drop(columns="cells").assign(verdict="")
    table.insert(0, "rank", np.arange(1, len(places) + 1))
    return geopandas.GeoDataFrame(table, geometry=shapes, crs=crs)
