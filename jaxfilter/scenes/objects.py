"""What stands on the terrain. Every object has its own cell in some lattice, so points find theirs without a search."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation

from .lattice import Layer, Nodes, box_of, smooth_noise, uniform
from .terrain import BRIDGE_AT, BRIDGE_PERIOD, PERIOD, Patch, TerrainSample, quantile

_QUARTER = 110.0  # metres between the axes of the streets around a town quarter
_STREET = 7.0  # half the width of a street
_PLOTS = (4, 2, 2, 2, 1, 1)  # plots a side in quarters with houses, rows, blocks, towers, halls, trees
_HOUSES, _ROWS, _BLOCKS, _TOWERS, _HALLS, _PARK = range(6)
_NONE = -1
_FLAT, _GABLE, _HIP, _SAWTOOTH = range(4)
_TREE_CELL = 5.0
_BOAT_CELL, _WEIR_AT, _JETTY_AT = 12.0, 150.0, 185.0


class Plot(NamedTuple):
    """Where points [n] lie in a town.

    ``quarter``: its kind (-1: open land); ``east``, ``north``: metres from its corner; ``i``, ``j``: index of the plot;
    ``u``, ``v``: metres from the corner of the plot, whose side is ``side``.
    """

    quarter: np.ndarray
    east: np.ndarray
    north: np.ndarray
    i: np.ndarray
    j: np.ndarray
    side: np.ndarray
    u: np.ndarray
    v: np.ndarray


class Roof(NamedTuple):
    """Buildings at points [n], elevations in metres; NaN where there is none.

    ``z`` of the roof above the point, ``eave`` of the eaves of the plot's building; ``edge``: metres from the wall,
    negative outside.
    """

    z: np.ndarray
    eave: np.ndarray
    edge: np.ndarray


class Town:
    """Streets, buildings, walls and cars. Quarters form a square lattice that is turned against the axes."""

    def __init__(self, patch: Patch) -> None:
        self._patch, self._layout, seed = patch, patch.layout, patch.seed
        self._azimuth, self._seed = np.random.default_rng((seed, Layer.QUARTERS)).uniform(-0.45, 0.45), seed
        x0, y0, x1, y1 = patch.box
        corners = self._turn(np.array([x0, x1, x0, x1]), np.array([y0, y0, y1, y1]))
        self._quarters = quarters = Nodes.over(box_of(*corners), _QUARTER)
        weights = np.cumsum(self._layout.quarters()) / (sum(self._layout.quarters()) or 1.0)
        kind = np.searchsorted(weights[:-1], uniform(seed, Layer.QUARTERS, quarters)[..., 0], side="right")
        east, north = (((v + 0.5) * _QUARTER).ravel() for v in quarters.mesh())
        at = self._turn(east, north, -1)
        settled = patch.settled(*at).reshape(quarters.shape) > patch.settlement_threshold
        self._quarter = np.where(settled, kind, _NONE)
        self._plan()

    def _turn(self, x: np.ndarray, y: np.ndarray, way: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """East and north along the streets, f64[n] each, of x and y; the other way with ``way`` = -1."""
        c, s = math.cos(self._azimuth), way * math.sin(self._azimuth)
        return c * x + s * y, c * y - s * x

    def _plan(self) -> None:
        """Buildings of all plots of the patch, as arrays [ni * 4, nj * 4]; quarters with fewer plots use the first."""
        plots = Nodes(*(4 * v for v in self._quarters))
        shape = plots.shape
        draw = np.moveaxis(uniform(self._seed, Layer.PLOTS, plots, fields=9), 2, 0)
        quarter = self._quarter.repeat(4, 0).repeat(4, 1)
        a, b = plots.mesh()
        per_side = np.array(_PLOTS)[quarter]
        plot = (_QUARTER - 2 * _STREET) / per_side
        used = (quarter != _NONE) & (quarter != _PARK) & (a % 4 < per_side) & (b % 4 < per_side)

        def between(low: list[float], high: list[float], field: int) -> np.ndarray:
            lows, highs = np.array([*low, 0.0])[quarter], np.array([*high, 0.0])[quarter]
            return lows + (highs - lows) * draw[field]

        length = between([9, 25, 32, 16, 45], [15, 42, 44, 26, 80], 0) / 2
        width = between([7, 8, 30, 14, 30], [11, 12, 42, 24, 70], 1) / 2
        along_north = draw[2] < 0.5
        self._half_u, self._half_v = np.where(along_north, width, length), np.where(along_north, length, width)
        slack_u, slack_v = (np.maximum(plot / 2 - half - 1.0, 0) for half in (self._half_u, self._half_v))
        centre_u = plot / 2 + slack_u * (2 * draw[3] - 1) * 0.8
        centre_v = plot / 2 + slack_v * (2 * draw[4] - 1) * 0.8
        self._centre_u, self._centre_v, self._along_north = centre_u, centre_v, along_north
        eave = between([2.8, 5, 11, 22, 6], [6.5, 9, 22, 60, 15], 5)
        choice = draw[6]
        gable_or = np.where(choice < 0.65, _GABLE, np.where(choice < 0.85, _HIP, _FLAT))
        hall_roof = np.where(choice < 0.55, _FLAT, np.where(choice < 0.8, _SAWTOOTH, _GABLE))
        block_roof = np.where(choice < 0.5, _GABLE, _FLAT)
        flat = np.full(shape, _FLAT)
        self._roof = np.choose(quarter % 6, [gable_or, gable_or, block_roof, flat, hall_roof, flat])
        pitch = np.tan(np.radians(25 + 22 * draw[7]))
        self._pitch = np.where(quarter == _HALLS, 0.08, np.where(quarter == _BLOCKS, 0.6, pitch))
        self._wing = np.where((quarter == _BLOCKS) & (draw[8] < 0.75), 10.0 + 2 * draw[7], np.inf)
        self._notched = (draw[8] < 0.3) & np.isin(quarter, (_HOUSES, _TOWERS, _HALLS))
        self._walled = (quarter == _HOUSES) & (draw[8] > 1 - self._layout.walls)

        east, north = (v // 4 * _QUARTER + _STREET + v % 4 * plot for v in (a, b))
        corners, undisturbed = [], np.ones(shape, bool)
        for su, sv in ((-1, -1), (-1, 1), (1, -1), (1, 1), (0, 0)):
            corner = east + centre_u + su * self._half_u, north + centre_v + sv * self._half_v
            surface = self._patch(*self._turn(corner[0].ravel(), corner[1].ravel(), -1))
            undisturbed &= surface.undisturbed.reshape(shape)
            corners.append(surface.z.reshape(shape))
        lowest, highest = np.min(corners, axis=0), np.max(corners, axis=0)
        self._eave = np.maximum(np.mean(corners, axis=0) + eave, highest + 2.2)
        self._built = used & undisturbed & (highest - lowest < 7) & ((quarter != _HOUSES) | (draw[6] < 0.93))

    def streets(self, x: float, y: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """The two streets that pass nearest to a place: f64[2] where, and f64[2] their direction, of length 1."""
        at = self._turn(np.array(x), np.array(y))
        east, north = (np.rint(v / _QUARTER) * _QUARTER for v in at)
        places = self._turn(np.array([east, at[0]]), np.array([at[1], north]), -1)
        ways = self._turn(np.array([0.0, 1.0]), np.array([1.0, 0.0]), -1)
        return list(zip(np.stack(places, axis=1), np.stack(ways, axis=1), strict=True))

    def locate(self, x: np.ndarray, y: np.ndarray) -> Plot:
        """Quarter and plot of points f64[n]."""
        east, north = self._turn(x, y)
        east, north = east / _QUARTER - self._quarters.i0, north / _QUARTER - self._quarters.j0
        i, j = (np.clip(v.astype(np.intp), 0, n - 1) for v, n in zip((east, north), self._quarter.shape, strict=True))
        east, north = (east - i) * _QUARTER, (north - j) * _QUARTER
        quarter = self._quarter[i, j]
        per_side = np.array(_PLOTS)[quarter]
        side = (_QUARTER - 2 * _STREET) / per_side
        a, b = (np.clip(np.floor((v - _STREET) / side), 0, per_side - 1).astype(np.intp) for v in (east, north))
        u, v = east - _STREET - a * side, north - _STREET - b * side
        return Plot(quarter, east, north, i * 4 + a, j * 4 + b, side, u, v)

    def roof(self, plot: Plot) -> Roof:
        """The buildings' roofs."""
        n = len(plot.u)
        z, eave, edge = np.full(n, np.nan), np.full(n, np.nan), np.full(n, -np.inf)
        near = np.flatnonzero(self._built[plot.i, plot.j])
        k = plot.i[near] * self._built.shape[1] + plot.j[near]
        p, q = plot.u[near] - self._centre_u.ravel()[k], plot.v[near] - self._centre_v.ravel()[k]
        half_u, half_v = self._half_u.ravel()[k], self._half_v.ravel()[k]
        turned = self._along_north.ravel()[k]
        p, q = np.where(turned, q, p), np.where(turned, -p, q)  # p along the ridge
        half_p, half_q = np.where(turned, half_v, half_u), np.where(turned, half_u, half_v)
        inside = np.minimum(half_p - np.abs(p), half_q - np.abs(q))
        wing = self._wing.ravel()[k]
        inside = np.minimum(inside, wing - inside)
        notch = np.maximum(0.25 * half_p - p, 0.1 * half_q - q)
        inside = np.where(self._notched.ravel()[k], np.minimum(inside, notch), inside)
        eave[near], edge[near] = self._eave.ravel()[k], inside
        on = np.flatnonzero(inside >= 0)
        k, p, q, inside, wing = k[on], p[on], q[on], inside[on], wing[on]
        half_p, half_q = half_p[on], half_q[on]
        kind, pitch = self._roof.ravel()[k], self._pitch.ravel()[k]
        plant = (np.abs(p - 0.3 * half_p) < 2) & (np.abs(q + 0.3 * half_q) < 2.5) & (inside > 1)  # on flat roofs
        rise = np.select(
            [kind == _GABLE, kind == _HIP, kind == _SAWTOOTH],
            [pitch * np.where(np.isfinite(wing), inside, half_q - np.abs(q)), pitch * inside, 0.25 * np.mod(p, 9.0)],
            np.where(inside < 0.4, 0.5, np.where(plant & np.isinf(wing), 2.5, 0.0)),
        )
        z[near[on]] = self._eave.ravel()[k] + rise
        return Roof(z, eave, edge)

    def paved(self, plot: Plot) -> np.ndarray:
        """bool[n]: on a street."""
        lane = np.minimum(np.minimum(plot.east, plot.north), _QUARTER - np.maximum(plot.east, plot.north))
        return (plot.quarter != _NONE) & (lane < _STREET)

    def wall(self, plot: Plot) -> np.ndarray:
        """f64[n]: height of garden walls above the terrain, 0 where there is none."""
        low, high = np.minimum(plot.u, plot.v), np.maximum(plot.u, plot.v)
        on = (plot.quarter == _HOUSES) & (low >= 0) & (low < 0.35) & (high < plot.side) & self._walled[plot.i, plot.j]
        return np.where(on, 1.7, 0.0)

    def car(self, plot: Plot) -> np.ndarray:
        """f64[n]: height of parked cars above the terrain, 0 where there is none."""
        height = np.zeros(len(plot.u))
        if not self._layout.cars:
            return height
        slots = 17  # places of 6.47 m along a quarter, on both kerbs
        kerbs = (Layer.KERB_EAST, plot.east, plot.north), (Layer.KERB_NORTH, plot.north, plot.east)
        for layer, cross, along in kerbs:
            lane = np.abs(np.minimum(cross, _QUARTER - cross) - 4.6)
            near = np.flatnonzero((lane < 0.9) & (np.abs(along - _QUARTER / 2) < 44) & (plot.quarter != _NONE))
            i, j = plot.i[near] // 4, plot.j[near] // 4
            place = along[near] / _QUARTER * slots
            slot = place.astype(np.intp)
            offset = (place - slot - 0.5) * _QUARTER / slots
            draw = uniform(self._seed, layer, self._quarters, fields=2 * slots)
            taken = draw[i, j, slot + slots * (cross[near] > _QUARTER / 2)] < self._layout.cars
            profile = np.where(offset > 1.1, 0.95, 1.45)
            height[near] = np.where(taken & (np.abs(offset) < 2.2), profile, 0.0)
        return height


class Woods:
    """Trees, each in its own cell of 5 m, and patches of low vegetation."""

    def __init__(self, patch: Patch, town: Town) -> None:
        layout, seed = patch.layout, patch.seed
        box = patch.box
        self._cells = Nodes.over(box, _TREE_CELL)
        ni, nj = self._cells.shape
        draw = np.moveaxis(uniform(seed, Layer.TREES, self._cells, fields=6), 2, 0).reshape(6, -1)
        i, j = (v.ravel() for v in self._cells.mesh())
        x, y = (i + 0.15 + 0.7 * draw[0]) * _TREE_CELL, (j + 0.15 + 0.7 * draw[1]) * _TREE_CELL
        forest = smooth_noise(seed, Layer.FOREST, box, 6)
        plot = town.locate(x, y)
        wooded = (plot.quarter == _NONE) & (forest(x, y) > quantile(1 - layout.forest))
        share = np.where(wooded, 0.9, np.where(plot.quarter == _PARK, 0.35, layout.trees))
        kept = np.flatnonzero(draw[2] < share)
        at = Plot(*(v[kept] for v in plot))
        surface = patch(x[kept], y[kept])
        free = (town.roof(at).edge < -1) & surface.undisturbed & ~surface.water & ~town.paved(at)
        kept, z = kept[free], surface.z[free]
        self._x, self._y = x, y
        self._conifer = draw[4] < layout.conifers
        tall = 7 + 20 * np.sqrt(draw[3]) * np.where(wooded, 1.0, 0.75)
        self._height = tall
        self._radius = np.where(self._conifer, 1.3 + 0.075 * tall, 1.5 + 0.13 * tall) * (0.85 + 0.3 * draw[5])
        self._z = np.full(ni * nj, np.nan)
        self._z[kept] = z
        self._near = binary_dilation(np.isfinite(self._z).reshape(ni, nj), np.ones((3, 3))).ravel()
        self._shrubs = smooth_noise(seed, Layer.SHRUBS, box, 4) if layout.low_vegetation else None
        self._shrub_threshold = quantile(1 - layout.low_vegetation)

    def crown(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Elevations f64[n] of top and bottom of the highest crown over each point f64[n], NaN where there is none: half an
        ellipsoid, or a cone for conifers."""
        i0, j0, ni, nj = self._cells
        top, bottom = np.full(len(x), np.nan), np.full(len(x), np.nan)
        i = np.clip((x / _TREE_CELL - i0).astype(np.intp), 1, ni - 2)
        j = np.clip((y / _TREE_CELL - j0).astype(np.intp), 1, nj - 2)
        cell = i * nj + j
        near = np.flatnonzero(self._near[cell])
        px, py, cell = x[near], y[near], cell[near]
        best, low = np.full(len(near), -np.inf), np.full(len(near), np.nan)
        for step in (di * nj + dj for di in (-1, 0, 1) for dj in (-1, 0, 1)):
            k = cell + step
            t = ((px - self._x[k]) ** 2 + (py - self._y[k]) ** 2) / self._radius[k] ** 2
            hit = np.flatnonzero((t < 1) & np.isfinite(self._z[k]))
            k, t = k[hit], t[hit]
            conifer, height = self._conifer[k], self._height[k]
            z = self._z[k] + height * np.where(conifer, 1 - 0.8 * np.sqrt(t), 0.5 + 0.5 * np.sqrt(1 - t))
            higher = z > best[hit]
            best[hit[higher]] = z[higher]
            low[hit[higher]] = (self._z[k] + height * np.where(conifer, 0.12, 0.3))[higher]
        top[near] = np.where(np.isfinite(best), best, np.nan)
        bottom[near] = low
        return top, bottom

    def undergrowth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """f64[n]: height of low vegetation above the terrain, 0.1 to 1 m, or 0 where there is none."""
        if self._shrubs is None:
            return np.zeros(len(x))
        excess = self._shrubs(x, y) - self._shrub_threshold
        return np.where(excess > 0, np.clip(0.1 + 0.8 * excess, 0, 1), 0.0)


def afloat(patch: Patch, surface: TerrainSample, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """What stands on water, at points f64[n]: heights of boats and of weirs above it, f64[n] each, 0 where there are none, and
    bool[n]: where reeds grow."""
    layout, course = patch.layout, patch.terrain.course(x, y)
    cells = Nodes.over(patch.box, _BOAT_CELL)
    draw = uniform(patch.seed, Layer.BOATS, cells, fields=2)
    i, j = (np.floor(v / _BOAT_CELL).astype(np.intp) for v in (x, y))
    there, size = np.moveaxis(draw[i - cells.i0, j - cells.j0], 1, 0)
    hull = np.hypot((x / _BOAT_CELL - i - 0.5) * _BOAT_CELL / 1.5, (y / _BOAT_CELL - j - 0.5) * _BOAT_CELL / 4.5) < 1
    boat = np.where(np.isfinite(surface.level) & hull & (there < layout.boats), 1 + 2 * size, 0.0)
    weir = layout.weir & (np.abs(patch.bridge(course, np.zeros(len(x)), _WEIR_AT)[1]) < 2) & np.isfinite(surface.level)
    shallow = surface.z > surface.level - 0.9
    grown = smooth_noise(patch.seed, Layer.SHRUBS, patch.box, 4)(x, y) > quantile(1 - layout.reeds)
    return boat, np.where(weir, 1.0, 0.0), shallow & grown


def open_deck(patch: Patch, surface: TerrainSample, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """f64[n]: elevation of bridge decks and jetties where they are more than half a metre above the ground or bed, NaN elsewhere.
    Decks run level with the land at both abutments, jetties 1.2 m above the water, from the bank."""
    deck, layout, course = np.full(len(x), np.nan), patch.layout, patch.terrain.course(x, y)
    if layout.jetty:
        d = course.line(patch.stream)[0]
        out = d + layout.river / 2
        on = (np.abs(patch.bridge(course, 0 * d, _JETTY_AT)[1]) < 2) & (out > -5) & (out < layout.jetty)
        deck[on] = -0.32 * layout.relief - 1.0
    for offset, half in patch.crossings() if layout.bridges and not layout.causeway else []:
        d, line = course.line(offset)
        row, beside = patch.bridge(course, d)
        on = np.flatnonzero((np.abs(d) < half) & (np.abs(beside) < layout.bridge_width / 2))
        if not len(on):
            continue
        crossing, which = np.unique(np.stack([row[on], line[on]]), axis=1, return_inverse=True)
        along, across = crossing[0] * BRIDGE_PERIOD + BRIDGE_AT, crossing[1] * PERIOD + offset
        reach = half * patch.terrain.course(*patch.terrain.position(along, across)).stretch
        aside = half * math.tan(math.radians(layout.bridge_skew))
        ends = [patch(*patch.terrain.position(along + s * aside, across + s * reach)).z for s in (-1, 1)]
        share = (d[on] / half + 1) / 2
        camber = 0.6 * (1 - (2 * share - 1) ** 2)
        deck[on] = ends[0][which] * (1 - share) + ends[1][which] * share + camber
    return np.where(deck > surface.z + 0.5, deck, np.nan)
