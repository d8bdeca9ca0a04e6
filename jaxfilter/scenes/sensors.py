"""The sensors that scenes are surveyed with, and how those work that are no pulses from the air: photographs and cars."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from .lattice import Box, Layer, Nodes, box_of, uniform
from .layouts import Kind
from .objects import Town
from .scan import Echoes, Pulses, standing
from .terrain import Terrain, quantile


class Sensor(NamedTuple):
    """What a survey has unless it is told otherwise.

    Attributes:
        density: pulses, or pixels, per square metre. noise: standard deviation in elevation, metres.
        swath: width of a flight strip, metres. footprint: radius of the beam on the ground, metres.

    >>> jf.scenes.SENSORS["drone lidar"].density
    200.0
    """

    density: float
    noise: float
    swath: float
    footprint: float


SENSORS = {
    "airborne lidar": Sensor(4.0, 0.03, 600.0, 0.2),
    "drone lidar": Sensor(200.0, 0.015, 60.0, 0.03),
    "image matching": Sensor(50.0, 0.06, 600.0, 0.0),
    "mobile": Sensor(60.0, 0.01, 600.0, 0.0),
}
"""Sensors by name.

Drone lidar: 100 to 500 points per m2, precision 10 and accuracy 15 mm, beam 1.6 by 0.5 mrad wide, from 50 m (data sheet of
RIEGL miniVUX-1UAV). Image matching: one to two pixels of the ground in elevation, 2 to 10 cm, and on objects without
penetration (Haala, Cramer & Rothermel 2013, ISPRS Archives XL-1/W2; Ressl, Brockmann, Mandlburger & Pfeifer 2016, PFG 2016(2)).
Mobile: precision 5, accuracy 10 mm, profiles across the way (data sheet of RIEGL VMX-250; Cahalane et al. 2015, ISPRS
Int. J. Geo-Inf. 4, on how points thin out with the distance from the way)."""

_TILE = 128.0
_MATCHED = 2.0  # pixels; sigma of the surface that matching smooths: windows are 5 to 9 pixels wide
_SHARED = 5.0  # pixels; sigma over which errors of neighbours are alike
_WHITE = 0.3  # standard deviation of what neighbours do not share, in terms of the noise
_RAISED = 0.15  # metres above the terrain from which on a smoothed surface is no ground
_HOLES = 0.3  # share of the area of crowns that is not matched
_BLUNDER_CELL, _BLUNDERS = 6.0, 0.06  # metres; share of these cells with a cluster of wrong matches
_DEPTH = 0.4, 4.0  # metres that these are too low or too high by
_RAY_CELL = 0.1  # metres; of the surface that rays meet
_RANGE, _MAST = 60.0, 2.6  # metres; that rays go, and that the scanner is high
_PROFILES = 0.12  # metres between profiles across the way
_ANGLES = math.radians(-75), math.radians(55)  # of rays from the horizontal
_LOOKS = 4  # places on a ray that may be leaves


def photographs(terrain: Terrain, size: tuple[float, float], density: float, noise: float) -> Iterator[Echoes]:
    """Points of the highest surface, as matched from photographs: a point to a pixel, of which ``density`` make a square metre.

    Elevations are smoothed, so that walls become ramps and edges round; their errors are like those of their neighbours.
    Water and parts of crowns have no points. Wrong matches come in clusters below and above. Ground is what the smoothed
    surface raises by less than 0.15 m over the smoothed terrain.
    """
    pixel, margin = 1 / math.sqrt(density), round(4 * _SHARED)
    for x0 in np.arange(0, size[0], _TILE):
        for y0 in np.arange(0, size[1], _TILE):
            x1, y1 = min(x0 + _TILE, size[0]), min(y0 + _TILE, size[1])
            i0, j0, ni, nj = Nodes.over((x0, y0, x1, y1), pixel)
            nodes = Nodes(i0 - margin, j0 - margin, ni + 2 * margin, nj + 2 * margin)
            yield _matched(terrain, nodes, pixel, (x0, y0, x1, y1), noise)


def _matched(terrain: Terrain, nodes: Nodes, pixel: float, box: Box, noise: float) -> Echoes:
    draw = np.moveaxis(uniform(terrain.seed, Layer.MATCHING, nodes, fields=6), 2, 0)
    x, y = ((v + 0.25 + 0.5 * part) * pixel for v, part in zip(nodes.mesh(), draw[:2], strict=True))
    rng = np.random.default_rng((terrain.seed, Layer.MATCHING, nodes.i0 & 0xFFFFFFFF, nodes.j0 & 0xFFFFFFFF))
    at = x.ravel(), y.ravel()
    patch = terrain.patch(box_of(*at))
    surface, solid, kind, upper, woods = standing(patch, Pulses(*at, np.zeros(x.size), rng), 0.0)
    solid, crown = np.fmax(solid, upper), woods.crown(*at)[0]
    leaves = crown > solid
    top, kind = np.where(leaves, crown, solid), np.where(leaves, Kind.HIGH_VEGETATION, kind)

    def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
        """f64[n]: weighted means over pixels."""
        return gaussian_filter(values.reshape(nodes.shape), sigma, mode="nearest", truncate=3.0).ravel()

    z, raised = smooth(top, _MATCHED), smooth(top - surface.z, _MATCHED) >= _RAISED
    kind = np.where(raised, np.where(kind == Kind.GROUND, Kind.WALL, kind), Kind.GROUND).astype(np.uint8)
    white, own, holes = ((v.ravel() - 0.5) * math.sqrt(12) for v in draw[2:5])
    shared = 2 * _SHARED * math.sqrt(math.pi)  # one over the standard deviation of smoothed white noise
    z += noise * (math.sqrt(1 - _WHITE**2) * shared * smooth(white, _SHARED) + _WHITE * own)
    error = _blunders(terrain.seed, *at)
    wrong = (error != 0) & (draw[5].ravel() < 0.8)
    z[wrong] += error[wrong]
    kind[wrong] = np.where(error[wrong] < 0, Kind.LOW_OUTLIER, Kind.HIGH_OUTLIER)
    kept = ~surface.water & ~(leaves & (shared * smooth(holes, _SHARED) > quantile(1 - _HOLES)))
    kept &= (at[0] >= box[0]) & (at[0] < box[2]) & (at[1] >= box[1]) & (at[1] < box[3])
    return _single(np.stack([*at, z], axis=1)[kept], kind[kept])


def _blunders(seed: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """f64[n]: metres by which wrong matches are too high; 0 where matches are right."""
    i, j = (np.floor(v / _BLUNDER_CELL).astype(np.intp) for v in (x, y))
    cells = Nodes(int(i.min()), int(j.min()), int(np.ptp(i)) + 1, int(np.ptp(j)) + 1)
    draw = uniform(seed, Layer.BLUNDERS, cells, fields=6)[i - cells.i0, j - cells.j0]
    there, u, v, radius, size, side = np.moveaxis(draw, 1, 0)
    away = np.hypot(x / _BLUNDER_CELL - i - 0.2 - 0.6 * u, y / _BLUNDER_CELL - j - 0.2 - 0.6 * v) * _BLUNDER_CELL
    error = _DEPTH[0] * (_DEPTH[1] / _DEPTH[0]) ** size * np.where(side < 0.5, -1, 1)
    return np.where((there < _BLUNDERS) & (away < 0.15 + radius), error, 0)


def mobile(terrain: Terrain, size: tuple[float, float], density: float, noise: float) -> Iterator[Echoes]:
    """Points of a scanner on a car, which drives along the two streets that pass nearest to the middle of the scene.

    Rays go out at equal angles in profiles across the way, ``density`` for each square metre of the scene, and end at what they
    meet first: ground at a distance, walls, leaves. What is behind has no points. Rays into the sky are lost.
    """
    nodes = Nodes.over((0.0, 0.0, *size), _RAY_CELL)
    x, y = ((v.ravel() + 0.5) * _RAY_CELL for v in nodes.mesh())
    patch = terrain.patch((0.0, 0.0, *size))
    rng = np.random.default_rng((terrain.seed, Layer.RAYS))
    surface, z, kind, _, woods = standing(patch, Pulses(x, y, np.zeros(len(x)), rng), 0.0)
    z = np.where(surface.water & (kind == Kind.GROUND), np.nan, z)
    top, bottom = woods.crown(x, y)
    reach = np.arange(_RAY_CELL, _RANGE, _RAY_CELL)
    starts = []
    for place, way in Town(patch).streets(size[0] / 2, size[1] / 2):
        steps = np.arange(-sum(size), sum(size), _PROFILES)[:, None] * way + place
        inside = ((steps >= 0) & (steps < size)).all(axis=1)
        starts += [(spot, side * np.array([way[1], -way[0]])) for spot in steps[inside] for side in (-1, 1)]
    count = math.ceil(density * size[0] * size[1] / max(len(starts), 1))

    def cell(where: np.ndarray) -> np.ndarray:
        """i64[n]: cells of places f64[n, 2], those beyond the border of the scene moved to it."""
        i, j = (np.clip((v / _RAY_CELL).astype(np.intp), 0, n - 1) for v, n in zip(where.T, nodes.shape, strict=True))
        return i * nodes.nj + j

    yield _single(np.zeros((0, 3)), np.zeros(0))  # where no street passes
    for spot, way in starts:
        eye = surface.z[cell(spot[None])][0] + _MAST
        path = spot + reach[:, None] * way
        path = path[((path >= 0) & (path < size)).all(axis=1)]
        if len(path) < 2:
            continue
        at = cell(path)
        rise = np.nan_to_num((z[at] - eye) / reach[: len(at)], nan=-1e6)
        highest = np.maximum.accumulate(rise)
        ray = np.tan(_ANGLES[0] + (np.arange(count) + rng.random()) / count * (_ANGLES[1] - _ANGLES[0]))
        hit = np.searchsorted(highest, ray)
        met = (hit > 0) & (hit < len(at))
        far = np.where(met, hit, len(at) - 1)
        low = highest[np.maximum(far - 1, 0)]
        share = np.clip(np.where(rise[far] > low, (ray - low) / np.maximum(rise[far] - low, 1e-9), 1), 0, 1)
        distance = reach[np.maximum(far - 1, 0)] + share * _RAY_CELL
        leaf = np.zeros(count, bool)
        for look in np.sort(rng.random((_LOOKS, count)), axis=0)[::-1] * reach[far]:
            k = cell(spot + look[:, None] * way)
            level = eye + ray * look
            within = (level > bottom[k]) & (level < top[k])
            distance[within], leaf = look[within], leaf | within
        seen = met | leaf
        where, what = spot + distance[:, None] * way, kind[at[far]]
        level = eye + ray * distance
        ground = met & ~leaf & (what == Kind.GROUND)
        level[ground] = patch(*where[ground].T).z
        face = met & ~leaf & (what == Kind.BUILDING) & (z[at[far]] - level > 0.3)
        what = np.where(leaf, Kind.HIGH_VEGETATION, np.where(face, Kind.WALL, what)).astype(np.uint8)
        level += noise * rng.standard_normal(count)
        yield _single(np.column_stack([where, level])[seen], what[seen])


def _single(xyz: np.ndarray, kind: np.ndarray) -> Echoes:
    one = np.ones(len(xyz), np.uint8)
    return Echoes(xyz, kind.astype(np.uint8), one, one)
