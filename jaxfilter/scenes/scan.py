"""The flight: where pulses meet the ground, strip by strip, and the echoes that come back."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .lattice import Layer, Nodes, Sheet, box_of, smooth_noise, uniform
from .layouts import Kind
from .objects import Town, Woods, afloat, open_deck
from .terrain import Patch, Terrain, TerrainSample

_LINE_RATIO = 1.25  # distance of scan lines over distance of pulses within a line
_HEADING = math.radians(8)  # flight direction, clockwise from north
_FORWARD, _RIGHT = (math.sin(_HEADING), math.cos(_HEADING)), (math.cos(_HEADING), -math.sin(_HEADING))
_CHUNK_PULSES = 400_000
_CHUNK_LENGTH = 800.0
_BEAM_CELL = 0.5  # metres; of the surface that slanting beams meet
_CLUSTER_CELL = 50.0
_CLUSTER_SHARE = 0.8  # of the pulses inside a low cluster
_CLUSTER_REACH = 12.0
_GLINT, _CALM = 8.0, -0.3  # degrees; value of a field of normal noise below which water returns next to nothing
_VINE_SHARE = 0.6  # of the pulses over a row of vines
VINE_HEIGHT = 1.8
"""Metres that vines are high at most."""
DEPTH = (2.0, 30.0)
"""Metres below the terrain between which low outliers lie."""


class Pulses(NamedTuple):
    """Pulses of a stretch of a strip in the order of time: x and y f64[n] in the scene's frame, f64[n] from -1 to 1 across the
    strip, and their generator."""

    x: np.ndarray
    y: np.ndarray
    across: np.ndarray
    rng: np.random.Generator


class Echoes(NamedTuple):
    """Echoes [n] in the order of time, of each pulse from the first to the last."""

    xyz: np.ndarray
    kind: np.ndarray
    number: np.ndarray
    total: np.ndarray


def pulses(
    terrain: Terrain, size: tuple[float, float], density: float, pattern: str, swath: float, overlap: float, step: float
) -> Iterator[Pulses]:
    """All pulses over a scene in chunks. Positions are multiples of ``step`` metres; parameters as for ``make``."""
    layout, steepest = terrain.layout, math.tan(math.radians(terrain.layout.scan_angle))
    reach = steepest * (layout.relief + layout.cliff + layout.scarp + layout.pit + layout.tilt * math.hypot(*size))
    corners = np.array([(0, 0), (size[0], 0), (0, size[1]), size])
    across, along = corners @ np.array(_RIGHT), corners @ np.array(_FORWARD)
    pitch = swath * (1 - overlap)
    per_line = max(2, round(swath * math.sqrt(density * (1 - overlap) * _LINE_RATIO)))
    spacing = swath / per_line
    line_spacing = 1 / (density * (1 - overlap) * spacing)
    lines_per_chunk = max(1, min(_CHUNK_PULSES // per_line, int(_CHUNK_LENGTH / line_spacing)))
    first_line, last_line = (math.floor(v / line_spacing) + o for v, o in ((along.min(), -1), (along.max(), 1)))
    sweep = (np.arange(per_line) + 0.5) / per_line
    strips = math.floor((across.min() - swath - reach) / pitch), math.ceil((across.max() + reach) / pitch) + 1
    for strip in range(*strips):
        for start in range(first_line, last_line + 1, lines_per_chunk):
            line = np.arange(start, min(start + lines_per_chunk, last_line + 1))
            rng = np.random.default_rng((terrain.seed, Layer.PULSES, strip & 0xFFFFFFFF, start & 0xFFFFFFFF))
            position = np.broadcast_to(sweep, (len(line), per_line))
            if pattern == "zigzag":
                position = np.where((line % 2 == 1)[:, None], position[:, ::-1], position)
            jitter = rng.standard_normal((2, len(line), per_line)) * (0.1 * spacing)
            a = strip * pitch + swath * position + jitter[0]
            b = (line[:, None] + sweep) * line_spacing + jitter[1]
            x, y = a * _RIGHT[0] + b * _FORWARD[0], a * _RIGHT[1] + b * _FORWARD[1]
            near, place = _within(x, y, size, reach), 2 * position - 1
            if steepest and near.any():
                place = place[near]
                x, y = _slanted(terrain, x[near], y[near], steepest * place, reach)
            x, y = (np.rint(v / step) * step for v in (x, y))
            inside = _within(x, y, size, 0.0)
            if inside.any():
                yield Pulses(x[inside], y[inside], place[inside], rng)


def _within(x: np.ndarray, y: np.ndarray, size: tuple[float, float], margin: float) -> np.ndarray:
    """Whether x and y lie in a scene or at most ``margin`` metres beside it, bool of their shape."""
    return (x >= -margin) & (x <= size[0] + margin) & (y >= -margin) & (y <= size[1] + margin)


def _slanted(
    terrain: Terrain, x: np.ndarray, y: np.ndarray, tangent: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """x and y f64[n] where beams meet the terrain that meet the level zero at x and y, at most ``reach`` metres away.

    They spread from above the strip's axis: ``tangent`` of their angles, f64[n], positive to its right. So a face that is
    turned to the scanner gets more of them, and what lies behind an edge none.
    """
    x0, y0, x1, y1 = box_of(x, y)
    cells = Nodes.over((x0 - reach, y0 - reach, x1 + reach, y1 + reach), _BEAM_CELL)
    i, j = (v.ravel() * _BEAM_CELL for v in cells.mesh())
    z = terrain.patch(box_of(i, j))(i, j).z
    surface = Sheet(cells.i0, cells.j0, _BEAM_CELL, z.reshape(cells.shape))
    level, beams, on = np.full(len(x), float(z.max())), np.arange(len(x)), (x, y)
    while len(beams):
        away = -level * tangent
        on = x + away * _RIGHT[0], y + away * _RIGHT[1]
        above = level[beams] - surface(on[0][beams], on[1][beams])
        beams, above = beams[above > 0.01], above[above > 0.01]
        level[beams] -= 0.4 * above  # no further than to where a face of 75 degrees may be
    return on


def standing(
    patch: Patch, shot: Pulses, footprint: float
) -> tuple[TerrainSample, np.ndarray, np.ndarray, np.ndarray, Woods]:
    """What pulses meet, whose beams have the radius ``footprint``, metres: the bare terrain; elevations f64[n] of the first solid
    thing below crowns, and u8[n], what it is; f64[n], of a roof of which only the edge is hit, NaN elsewhere; and the trees."""
    layout, (x, y, _, rng) = patch.layout, shot
    n = len(x)
    surface = patch(x, y)
    town = Town(patch)
    plot = town.locate(x, y)
    woods = Woods(patch, town)
    z, kind = surface.z.copy(), np.full(n, Kind.GROUND, np.uint8)

    def stand(height: np.ndarray, what: Kind) -> None:
        on = np.flatnonzero(height > 0)
        z[on] += height[on]
        kind[on] = what

    growth = woods.undergrowth(x, y) * rng.uniform(0.2, 1.0, n) * (rng.random(n) < 0.7)
    stand(np.where((growth > 0.1) & ~surface.water & ~town.paved(plot), growth, 0), Kind.LOW_VEGETATION)
    if layout.vines and layout.terraces:
        vines = patch.vines(x, y) & (kind == Kind.GROUND) & (rng.random(n) < _VINE_SHARE)
        stand(np.where(vines, rng.uniform(0.4, VINE_HEIGHT, n), 0), Kind.LOW_VEGETATION)
    free = surface.undisturbed & ~surface.water & (kind == Kind.GROUND)
    stand(np.where(free, town.wall(plot), 0), Kind.WALL)
    stand(np.where(free, town.car(plot), 0), Kind.CAR)
    roof = town.roof(plot)
    facade = np.flatnonzero((roof.edge < 0) & (roof.edge > -0.3))
    facade = facade[rng.random(len(facade)) < 0.4]
    z[facade] = rng.uniform(surface.z[facade] + 0.3, roof.eave[facade])
    kind[facade] = Kind.WALL

    upper = np.full(n, np.nan)  # a roof of which only the edge is hit
    on = np.flatnonzero(np.isfinite(roof.z))
    edge = on[(roof.edge[on] < footprint) & (rng.random(len(on)) < 0.5)]
    upper[edge] = roof.z[edge]
    whole = np.setdiff1d(on, edge, assume_unique=True)
    z[whole], kind[whole] = roof.z[whole], Kind.BUILDING
    z[edge], kind[edge] = surface.z[edge], Kind.GROUND
    deck = open_deck(patch, surface, x, y)
    on = np.flatnonzero(np.isfinite(deck))
    z[on], kind[on], upper[on] = deck[on], Kind.BRIDGE, np.nan
    return surface, z, kind, upper, woods


def echoes(patch: Patch, shot: Pulses, footprint: float, noise: float, density: float) -> Echoes:
    """The echoes of pulses over a patch.

    A pulse passes crowns, and at a roof's edge half of it passes the roof; the first solid thing below ends it. Ranging
    noise is one draw per pulse, so the echoes of a pulse stay in order.
    """
    layout, (x, y, _, rng) = patch.layout, shot
    n = len(x)
    surface, z, kind, upper, woods = standing(patch, shot, footprint)
    last = np.where(surface.water & (kind == Kind.GROUND), np.nan, z)
    if layout.water_echoes:
        _meet_water(patch, shot, surface, last, kind)
    _strike_low(patch, shot, surface.z, last, kind, density)
    highest = np.fmax(z, upper)
    crowns = _crown_echoes(woods, shot, highest, last, layout.penetration)
    bird = np.full(n, np.nan)
    up = np.flatnonzero(rng.random(n) < layout.high_outliers)
    bird[up] = highest[up] + 20 * 50 ** rng.random(len(up))
    columns = [bird, *crowns, upper, last]
    kinds = np.empty((n, len(columns)), np.uint8)
    kinds[:] = [Kind.HIGH_OUTLIER, *[Kind.HIGH_VEGETATION] * len(crowns), Kind.BUILDING, Kind.GROUND]
    kinds[:, -1] = kind

    levels = np.stack(columns, axis=1)
    levels += (noise * rng.standard_normal(n))[:, None]
    there = np.isfinite(levels)
    pulse, _ = np.nonzero(there)
    xyz = np.stack([x[pulse], y[pulse], levels[there]], axis=1)
    number = np.cumsum(there, axis=1, dtype=np.uint8)
    return Echoes(xyz, kinds[there], number[there], number[pulse, -1])


def _meet_water(patch: Patch, shot: Pulses, surface: TerrainSample, last: np.ndarray, kind: np.ndarray) -> None:
    """Echoes of the level surface of water, and of what stands on it.

    Smooth water reflects light away from the scanner but for pulses that come nearly straight down, and drops out in patches
    (Höfle et al. 2009, Earth Surf. Process. Landforms 34). Points of class 9 in seven labelled tiles have 13 to 100 % of the
    density of the land and scatter by 0.01 to 0.08 m; here they have up to 90 %, and scatter as ranging does.
    """
    layout, (x, y, across, rng) = patch.layout, shot
    open_water = np.isfinite(surface.level) & (kind == Kind.GROUND)
    boat, weir, reeds = afloat(patch, surface, x, y)
    calm = smooth_noise(patch.seed, Layer.RIPPLES, patch.box, 4)(x, y) < _CALM
    share = layout.water_echoes * np.exp(-((across * layout.scan_angle / _GLINT) ** 2)) * np.where(calm, 0.1, 1)
    back = open_water & (rng.random(len(x)) < share)
    last[back], kind[back] = surface.level[back], Kind.WATER
    plants = np.where(reeds & (rng.random(len(x)) < 0.7), rng.uniform(0.3, 2.0, len(x)), 0)
    for height, what in ((plants, Kind.LOW_VEGETATION), (boat, Kind.CAR), (weir, Kind.WALL)):
        on = open_water & (height > 0)
        last[on], kind[on] = surface.level[on] + height[on], what


def _crown_echoes(
    woods: Woods, shot: Pulses, solid: np.ndarray, last: np.ndarray, penetration: float
) -> list[np.ndarray]:
    """Up to three echoes in crowns, f64[n] each with NaN for none; takes away ``last`` where nothing came through."""
    top, bottom = woods.crown(shot.x, shot.y)
    out = [np.full(len(solid), np.nan) for _ in range(3)]
    hit = np.flatnonzero(top > solid + 2)
    rng, bottom = shot.rng, np.maximum(bottom[hit], solid[hit] + 1)
    level = top[hit] - rng.exponential(0.5, len(hit))
    for k, column in enumerate(out):
        inside = level > bottom
        hit, level, bottom = hit[inside], level[inside], bottom[inside]
        column[hit] = level
        if k == 0:
            last[hit[rng.random(len(hit)) > penetration]] = np.nan
        goes_on = rng.random(len(hit)) < 0.45
        hit, level, bottom = hit[goes_on], level[goes_on], bottom[goes_on]
        level = level - 1.0 - rng.exponential(2.5, len(hit))
    return out


def _strike_low(
    patch: Patch, shot: Pulses, terrain: np.ndarray, last: np.ndarray, kind: np.ndarray, density: float
) -> None:
    """Put last echoes below the terrain, singly and in clusters as multipath makes them."""
    layout, (x, y, _, rng) = patch.layout, shot
    n, (shallow, deep) = len(x), DEPTH
    struck = np.flatnonzero(rng.random(n) < layout.low_outliers)
    depth = shallow * (deep / shallow) ** rng.random(len(struck))
    last[struck], kind[struck] = terrain[struck] - depth, Kind.LOW_OUTLIER
    if not layout.low_clusters:
        return
    cells = Nodes.over(box_of(x, y), _CLUSTER_CELL)
    i, j = (np.floor(v / _CLUSTER_CELL).astype(np.intp) - first for v, first in zip((x, y), cells[:2], strict=True))
    draw = uniform(patch.seed, Layer.LOW_CLUSTERS, cells, fields=5)
    present = draw[..., 0] < layout.low_clusters * _CLUSTER_CELL**2 * 1e-6
    near = np.flatnonzero(present[i, j])
    i, j = i[near], j[near]
    cell = draw[i, j]
    count = 3 * (100 / 3) ** cell[:, 1]
    radius = np.minimum(np.sqrt(count / (_CLUSTER_SHARE * math.pi * density)), _CLUSTER_REACH)
    margin = _CLUSTER_REACH / _CLUSTER_CELL
    centre = margin + (1 - 2 * margin) * cell[:, 2:4]
    dx = x[near] - (cells.i0 + i + centre[:, 0]) * _CLUSTER_CELL
    dy = y[near] - (cells.j0 + j + centre[:, 1]) * _CLUSTER_CELL
    away = np.hypot(dx, dy)
    member = (away < radius) & (rng.random(len(near)) < _CLUSTER_SHARE)
    near, cell = near[member], cell[member]
    depth = shallow * (deep / shallow) ** cell[:, 4] * (1 + 0.08 * rng.standard_normal(len(near)))
    last[near], kind[near] = terrain[near] - np.clip(depth, shallow, deep), Kind.LOW_OUTLIER
