"""The bare terrain of a scene: a fractal surface, and what people and rivers have cut into it."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from .lattice import SPLINE_STD, Box, Layer, Nodes, Sheet, box_of, refine, smooth_noise, smoothstep, uniform
from .layouts import SceneLayout

OBJECT_MARGIN = 170.0
"""Metres around a patch that objects at its edge may need: the diagonal of a town quarter, a pit's radius."""
PERIOD = 520.0
"""Metres across the course after which the linear features recur."""

_FINEST = 1  # detail down to nodes of 2 m; a node spacing of 1 m is interpolated from it
_CUTTING, _PIT, _SCARP, _RIVER, _EMBANKMENT = 60.0, 205.0, 325.0, 400.0, 465.0  # where in the period they lie
_GORGE = 330.0  # where rivers between rock faces do
BRIDGE_PERIOD, BRIDGE_AT = 220.0, 95.0
"""Metres along the course after which bridges recur, and where the first one is."""
_RAMP_GRADE, _RAMP_SIDE = 12.0, 1.5  # run over rise of ramps, and of their sides
_PIT_PERIOD = 400.0
_BENCH_HEIGHT, _BENCH_WIDTH = 9.0, 12.0
_BERM = 10.0  # metres between the faces of a quarry
_VINE_ROWS = (0.22, 0.62)  # where on a tread they stand, as a share of its width


class TerrainSample(NamedTuple):
    """Terrain at points, each of shape [n]: ``z`` f64 metres; ``undisturbed``: no earthworks there; ``water``: bool; ``level``
    of the water, metres, NaN elsewhere and for water that returns no echo."""

    z: np.ndarray
    undisturbed: np.ndarray
    water: np.ndarray
    level: np.ndarray


class Course(NamedTuple):
    """Coordinates along and across the meandering course, and how much longer a metre across is than the distance."""

    along: np.ndarray
    across: np.ndarray
    stretch: np.ndarray

    def line(self, offset: float) -> tuple[np.ndarray, np.ndarray]:
        """Signed distance to the nearest line of a feature at ``offset`` in the period, and the number of that line."""
        t = self.across - offset
        k = np.rint(t / PERIOD)
        return (t - PERIOD * k) / self.stretch, k


class Terrain:
    """The terrain that a layout and a seed stand for, in the scene's frame (metres from its lower left corner)."""

    def __init__(self, layout: SceneLayout, seed: int) -> None:
        self.layout, self.seed = layout, seed
        rng = np.random.default_rng((seed, Layer.COURSE))
        self._azimuth = rng.uniform(-0.2, 0.2)
        self._phase = rng.uniform(0, 2 * math.pi, 2)
        self.aspect = rng.uniform(0, 2 * math.pi)

    def patch(self, box: Box) -> Patch:
        """The terrain over a box and :data:`OBJECT_MARGIN` around it."""
        (x0, y0, x1, y1), m = box, OBJECT_MARGIN
        return Patch(self, (x0 - m, y0 - m, x1 + m, y1 + m))

    def course(self, x: np.ndarray, y: np.ndarray) -> Course:
        """Course coordinates of points, f64[n] each."""
        c, s = math.cos(self._azimuth), math.sin(self._azimuth)
        along = c * y + s * x
        wave, slope = self._meander(along)
        return Course(along, c * x - s * y - wave, np.sqrt(1 + slope**2))

    def position(self, along: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x and y f64[n] of course coordinates: the inverse of :meth:`course`."""
        c, s = math.cos(self._azimuth), math.sin(self._azimuth)
        t = across + self._meander(along)[0]
        return s * along + c * t, c * along - s * t

    def _meander(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        wave, slope = np.zeros_like(along), np.zeros_like(along)
        for amplitude, length, phase in zip((24.0, 5.0), (760.0, 210.0), self._phase, strict=True):
            k = 2 * math.pi / length
            wave += amplitude * np.sin(k * along + phase)
            slope += amplitude * k * np.cos(k * along + phase)
        return wave, slope


class Patch:
    """Terrain over one box; every patch that covers a point gives it the same elevation."""

    def __init__(self, terrain: Terrain, box: Box) -> None:
        self.terrain, self.box = terrain, box
        self.layout, self.seed = terrain.layout, terrain.seed
        layout = self.layout
        self.stream = _GORGE if layout.cliff else _RIVER  # where in the period the river lies, metres
        self._lake_level = -0.1 * layout.relief - 1.0
        self._cutting_top = 7 + 1.5 * layout.cutting  # half the width at the level of the land beside it, metres
        # width of a face, metres: of one from the floor to the land, or that of a bench and its berm
        self._step = (layout.bench or layout.cliff) / math.tan(math.radians(layout.face)) + _BERM * (layout.bench > 0)
        self.settlement_threshold = quantile(1 - layout.settlement)  # of ``settled``: above it land is built up
        self._relief = self._fractal()
        self.settled = smooth_noise(self.seed, Layer.SETTLEMENT, box, 8)
        if layout.terraces:
            self._terraced = smooth_noise(self.seed, Layer.TERRACES, box, 7)
        if layout.cliff:
            self._crags = smooth_noise(self.seed, Layer.CRAGS, box, 3)
        if layout.scarp or layout.pit or layout.cliff:
            self._ragged = smooth_noise(self.seed, Layer.ROUGHNESS, box, 4)

    def _fractal(self) -> Sheet:
        layout = self.layout
        coarsest = max(round(math.log2(layout.landform)), _FINEST + 1)
        shares = [2.0 ** (-layout.hurst * (coarsest - level)) for level in range(coarsest, _FINEST - 1, -1)]
        sigma = layout.relief / 4

        def detail(surface: np.ndarray, white: Callable[[], np.ndarray], level: int) -> np.ndarray:
            if level < _FINEST:
                return surface
            amplitude = sigma * shares[coarsest - level] / math.hypot(*shares) / SPLINE_STD
            if level == coarsest:
                return amplitude * white()
            rough = np.clip(0.7 + 0.4 * surface / max(sigma, 1e-9), 0.25, 1.5)  # crests are rougher than valleys
            surface = surface + amplitude * rough * white()
            if level == coarsest - 2 and layout.ridges:
                surface = (1 - layout.ridges) * surface + layout.ridges * (sigma - 2 * np.abs(surface))
            return surface

        return refine(self.seed, Layer.RELIEF, self.box, coarsest, 0, detail)

    def __call__(self, x: np.ndarray, y: np.ndarray) -> TerrainSample:
        """Terrain at x, y f64[n] in the scene's frame."""
        layout = self.layout
        course = self.terrain.course(x, y)
        natural = self.natural(x, y, course)
        z = natural.copy()
        water, level = np.zeros(len(x), bool), np.full(len(x), np.nan)
        if layout.ditches:
            self._ditch(z, x, y, course)
        if layout.cutting:
            z -= layout.cutting * _dam(course.line(_CUTTING)[0], self._cutting_top, 1.5 * layout.cutting)
        if layout.embankment:
            foot = 1.6 * layout.embankment
            z += layout.embankment * _dam(course.line(_EMBANKMENT)[0], 4 + foot, foot)
        if layout.pit:
            self._excavate(z, x, y, course)
        if layout.cliff:
            z = self._fall(z, x, y, course)
        if layout.river:
            far = np.abs(course.line(self.stream)[0]) - layout.river / 2
            z -= 3.7 * (far < 0) if layout.quay else 2.2 * smoothstep((5 - far) / 5) + 1.5 * smoothstep(-far / 4)
            water = far < 0
            if layout.water_echoes and not layout.cliff:
                level[:] = -0.32 * layout.relief - 2.2
                water &= z < level
        if layout.lake:
            far, shelf = self._off_lake(course), self._lake_level
            z -= 2 * smoothstep((4 - far[0]) / 8)
            z = np.where(far[0] < 0, np.maximum(z, shelf + 1.5 - 0.2 * far[1]), z)
            wet = (far[0] < 4) & (z < shelf)
            water |= wet
            level[wet & (layout.water_echoes > 0)] = shelf
        if layout.bridge_rise or layout.causeway:
            self._ramp(z, course)
            water &= ~(z > level)
        return TerrainSample(z, np.abs(z - natural) < 0.3, water, np.where(water, level, np.nan))

    def vines(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """bool[n]: in a row of vines, of which each terrace has two."""
        layout = self.layout
        step = self._landforms(x, y, self.terrain.course(x, y)) / layout.terraces
        row = np.min([np.abs(step - np.floor(step) - place) for place in _VINE_ROWS], axis=0) < 0.06
        return row & (self._terraced(x, y) < quantile(layout.vines)) & (self._open_land(x, y) > 0.5)

    def natural(self, x: np.ndarray, y: np.ndarray, course: Course) -> np.ndarray:
        """f64[n]: landforms, valleys, terraces and scarps, before anything is dug or heaped up."""
        layout = self.layout
        z = self._landforms(x, y, course)
        if layout.terraces:
            worked = smoothstep(2 * self._terraced(x, y) + 3) * self._open_land(x, y)
            step = z / layout.terraces
            tread = np.floor(step)
            rise = step - tread
            z += layout.terraces * worked * (tread + 0.2 * rise + 0.8 * smoothstep((rise - 0.86) / 0.14) - step)
        if layout.scarp:
            d = course.line(_SCARP)[0]
            face = smoothstep((d + 2.5 * self._ragged(x, y)) / (0.7 * layout.scarp) + 0.5)
            z += layout.scarp * (face - (d * course.stretch / PERIOD + 0.5))  # and gently back over the period
        return z

    def _landforms(self, x: np.ndarray, y: np.ndarray, course: Course) -> np.ndarray:
        """f64[n]: landforms and the valleys of rivers."""
        layout = self.layout
        z = self._relief(x, y)
        if layout.river and not layout.cliff:
            far = np.abs(course.line(self.stream)[0]) - layout.river / 2
            valley = -0.3 * layout.relief
            z = valley + (z - valley) * (0.03 + 0.97 * smoothstep((far - 6) / 120))
        if layout.lake:
            level = self._lake_level + 0.6
            z = level + (z - level) * (0.03 + 0.97 * smoothstep((self._off_lake(course)[0] - 6) / 90))
        if layout.tilt:
            z = z + layout.tilt * (math.cos(self.terrain.aspect) * x + math.sin(self.terrain.aspect) * y)
        return z

    def _off_lake(self, course: Course) -> tuple[np.ndarray, np.ndarray]:
        """f64[n] each: metres from the shore of lakes, negative inside, and from the middle of the islet in them."""
        across, row = course.line(_PIT)[0], np.floor(course.along / _PIT_PERIOD)
        along = course.along - (row + 0.5) * _PIT_PERIOD
        angle = np.arctan2(across, along)
        outline = self.layout.lake * (1 + 0.15 * np.sin(2 * angle + 1) + 0.08 * np.sin(3 * angle))
        off_islet = np.hypot(along - 0.45 * self.layout.lake, across) if self.layout.lake >= 40 else np.inf
        return np.hypot(along, across) - outline, np.broadcast_to(off_islet, along.shape)

    def _ramp(self, z: np.ndarray, course: Course) -> None:
        """Ramps up to the ends of decks, or dams across water in place of decks."""
        rise, half_width = self.layout.bridge_rise, self.layout.bridge_width / 2
        for offset, half in self.crossings():
            d = course.line(offset)[0]
            beside = np.abs(self.bridge(course, d)[1]) - half_width
            if self.layout.causeway:
                top = -0.32 * self.layout.relief - 1.0
                np.maximum(z, np.where(np.abs(d) < half, top - np.maximum(beside, 0) / _RAMP_SIDE, z), out=z)
            else:
                up = np.clip(1 - (np.abs(d) - half) / (_RAMP_GRADE * rise), 0, 1) * (np.abs(d) >= half - 0.5)
                z += np.maximum(rise * up - np.maximum(beside, 0) / _RAMP_SIDE, 0)

    def bridge(self, course: Course, d: np.ndarray, at: float = BRIDGE_AT) -> tuple[np.ndarray, np.ndarray]:
        """f64[n] each: the number of the nearest bridge along the course, and metres off its axis, of points ``d`` metres off
        the line that it crosses. ``at``: where along the course the first one is."""
        skew = math.radians(self.layout.bridge_skew)
        along = course.along - at - d * math.tan(skew)
        row = np.rint(along / BRIDGE_PERIOD)
        return row, (along - row * BRIDGE_PERIOD) * math.cos(skew)

    def _fall(self, z: np.ndarray, x: np.ndarray, y: np.ndarray, course: Course) -> np.ndarray:
        """f64[n]: the land ``z`` with what lies between rock faces: a floor, and faces that rise from it to the land."""
        layout, rise, width = self.layout, math.tan(math.radians(self.layout.face)), self._step
        ragged = self._ragged(x, y)
        away = np.abs(course.line(self.stream)[0]) - layout.floor / 2 + 3 * ragged + 0.8 * self._crags(x, y)
        if layout.bench:
            whole = np.maximum(np.floor(away / width), 0)
            climb = layout.bench * (whole + np.clip((away - whole * width) * rise / layout.bench, 0, 1))
        else:
            climb = -_lower(-away * rise, np.zeros(len(z)))  # debris at the foot
        return _lower(z, climb - layout.cliff + 0.03 * z + 0.3 * ragged)

    def _open_land(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """f64[n]: 1 well outside settlements, 0 in them."""
        return smoothstep(3 * (self.settlement_threshold - self.settled(x, y)) - 1)

    def _ditch(self, z: np.ndarray, x: np.ndarray, y: np.ndarray, course: Course) -> None:
        """Ditches side by side on open land; where there is a river, on its floodplain."""
        depth, spacing = self.layout.ditches, PERIOD / 13
        t = course.across / spacing + 0.5
        d = np.abs(t - np.floor(t) - 0.5) * spacing
        near = d < 0.7 + depth
        if self.layout.river:
            near &= np.abs(course.line(self.stream)[0]) < 110
        k = np.flatnonzero(near)
        z[k] -= depth * self._open_land(x[k], y[k]) * np.clip((0.7 + depth - d[k]) / depth, 0, 1)

    def _excavate(self, z: np.ndarray, x: np.ndarray, y: np.ndarray, course: Course) -> None:
        """Pits worked in benches, which a helical ramp joins, with spoil heaps at both ends."""
        dt, line = course.line(_PIT)
        dt = dt * course.stretch
        row = np.floor(course.along / _PIT_PERIOD)
        near = np.flatnonzero(np.abs(dt) < 110)
        if not len(near):
            return
        nodes = Nodes.over(box_of(line[near], row[near]))
        draw = uniform(self.seed, Layer.PITS, nodes, fields=4)
        i, j = nodes.mesh()
        centre_along = (j + 0.42 + 0.1 * draw[..., 0]) * _PIT_PERIOD
        at = self.terrain.position(centre_along.ravel(), (_PIT + PERIOD * i).ravel())
        floor = self.natural(*at, self.terrain.course(*at)).reshape(nodes.shape) - self.layout.pit
        k, m = (line[near] - nodes.i0).astype(np.intp), (row[near] - nodes.j0).astype(np.intp)
        radius, phase = 72 + 16 * draw[k, m, 1], 2 * math.pi * draw[k, m, 2]
        du, dt = course.along[near] - centre_along[k, m], dt[near]
        angle = np.arctan2(dt, du)
        outline = radius * (1 + 0.11 * np.sin(2 * angle + phase) + 0.06 * np.sin(3 * angle - 2 * phase))
        ragged = self._ragged(x[near], y[near])
        inward = outline - np.hypot(du, dt) + 1.5 * ragged
        turn = angle / (2 * math.pi)
        bench = inward / _BENCH_WIDTH + turn
        whole = np.floor(bench)
        depth = _BENCH_HEIGHT * (whole + smoothstep((bench - whole) / 0.3) - turn)
        dug = z[near] - np.maximum(depth, 0) * smoothstep(inward / 3)
        bottom = np.minimum(floor[k, m] + 0.25 * ragged, z[near])
        z[near] = np.where(inward > 0, np.maximum(dug, bottom), z[near])
        heap = np.hypot(0.8 * (np.abs(du) - radius - 34), 0.5 * (dt - 15)) + 1.2 * ragged
        z[near] += np.maximum(9 - np.hypot(0.7 * heap, 1.5), 0)

    def crossings(self) -> list[tuple[float, float]]:
        """(offset in the period, half span in metres) of what bridges cross."""
        layout = self.layout
        spans = [(_CUTTING, self._cutting_top + 2)] if layout.cutting else []
        spans += [(_CUTTING, layout.road / 2)] if layout.road else []
        if layout.cliff:
            steps = layout.cliff / (layout.bench or layout.cliff)
            return [*spans, (self.stream, layout.floor / 2 + steps * self._step + 14)]
        return spans + ([(self.stream, layout.river / 2 + 8)] if layout.river else [])


def _dam(far: np.ndarray, reach: float, side: float) -> np.ndarray:
    """f64[n]: 1 on a level top, 0 from ``reach`` metres off the line on, and even slopes ``side`` metres wide between."""
    return np.clip((reach - np.abs(far)) / side, 0, 1)


def _lower(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """f64[n]: the lower of two surfaces, metres, with the edge between them rounded off where they differ by less than 3 m."""
    return np.minimum(one, other) - np.maximum(3 - np.abs(one - other), 0) ** 2 / 12


def quantile(share: float) -> float:
    """Value below which this share of standard normal noise lies; +-9 stands for all and none."""
    return 9.0 if share >= 1 else -9.0 if share <= 0 else NormalDist().inv_cdf(share)
