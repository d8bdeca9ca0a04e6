"""Water, and bridge decks: surfaces that are level and lie lower than the land, and those that fall upright on both flanks."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
import scipy

from ...core.filter import Labels
from ...core.water import WaterCells
from ...engines.grid.extremes import highest, lowest
from ..sensors import AIRBORNE, DRONE
from ..surfaces import look_up, number_in
from .scene import Flanked, OstRule, OstScene, Sizes

_BLOCK = 16
"""Cells along a side of the squares by which cells are grouped; it changes no result."""
_HALF = 2
"""Cells on each side of one whose surroundings must be level."""


@dataclasses.dataclass(frozen=True)
class CrossingsRule(OstRule):
    """Where water and bridge decks are in a grid of lowest points.

    A **deck** lies between two upright edges on a line across. Its cells, which differ by less than a step from one to the next,
    are judged together: at both ends the surface goes on to land without a fall, or at one and the border of the data cuts the
    other. So roofs, which fall all around, are none, nor are headlands, jetties and terraces.

    **Water** is a segment of level cells that has returned fewer of the pulses than the land, or that is large and very level;
    nearly all around it the surface is higher. So level meadows, which end at ditches, are none, nor are roofs, nor car parks,
    which slope, nor courts, which are small.
    """

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)
    gap: float = 1.5
    """Point spacings within which the surface falls at an upright edge; two cells at least. Voids are wider than twice that."""
    fall: float = 1 / 3
    """Of ``drop``, by which an edge falls at least: a fall takes three cells. The land joins a deck by less."""
    near: float = 4.0
    """Metres from where a deck falls by ``drop`` within which smaller edges count: there it comes down to the land. It is at
    least as long."""
    ends: float = 0.3
    """Of the width of a deck that joins the land at each of its ends, at least: cars and plants stand there."""
    steady: float = 0.5
    """How alike the lines across a deck are, at least: 1 if all are the same."""
    surface: float = 0.15
    """Metres from the level of water up to which points are its surface: noise of 5 cm, three times. From twice as much on they
    are no ground."""
    pond: float = 100.0
    """Square metres of a water body without its shore, at least."""
    lake: float = 1000.0
    """The same of one that has as many points as land. Courts can be as level, but not as large."""
    thin: float = 0.5
    """Of the points on a cell of land beside it that a body with few points has on one."""
    river: float = 0.001
    """Rise over run that a body with few points may have along its course: 1 m in 1 km."""
    rim: int = 4
    """Cells from a body up to which its shore is looked for, and half the width of what stands on it."""
    higher: float = 0.5
    """Of the rim of a body that is higher than its surface, less what is lower, at least."""

    def measure(self, scene: OstScene) -> None:
        """Where the surface falls upright on both sides."""
        ost = scene.ost
        step, drop, area = (float(value) for value in (ost.roof_step, ost.roof_drop, ost.roof_area))
        sizes = Sizes(ost.cell, scene.spacing, 2 * ost.window, step, drop, area)
        points = number_in(scene.points, scene.cells)
        scene.flanked = self.flanks(scene.z, scene.seen, scene.inside, points, sizes)

    def seed(self, scene: OstScene) -> None:
        """What is at a deck or above, and what is above or below water, but at its shore, is never ground."""
        xyz, step = scene.points.xyz, scene.flanked.sizes.step
        scene.deck, scene.level, clear = self.find(scene.flanked, scene.objects, scene.slope)
        deck, level = look_up(xyz, scene.cells, scene.deck, clear)
        scene.never |= (xyz[:, 2] > deck - np.float32(step)) | (np.abs(xyz[:, 2] - level) > 2 * self.surface)
        scene.seeds = scene.seeds[~scene.never[scene.seeds]]

    def label(self, scene: OstScene, labels: Labels) -> None:
        """Points of decks and of the surface of water are marked."""
        xyz, cloud, grid = scene.points.xyz, scene.points.cloud, scene.cells.grid
        deck, level = look_up(xyz, scene.cells, scene.deck, scene.level)
        labels.deck = ~labels.ground & (np.abs(xyz[:, 2] - deck) < np.float32(scene.ost.roof_step))
        labels.water = labels.ground & (np.abs(xyz[:, 2] - level) < self.surface)
        if not np.isnan(scene.level).all():
            labels.water_cells = WaterCells.from_levels(
                cloud, scene.level, (float(grid.x0), float(grid.y0)), float(grid.cell)
            )

    def flanks(self, z: np.ndarray, seen: np.ndarray, inside: np.ndarray, points: np.ndarray, sizes: Sizes) -> Flanked:
        """Where a surface falls upright on both sides, with voids filled from below. [rows, columns] each: lowest elevations f32,
        metres, none missing; bool, cells with points, and those that the data surround; i64, how many points are in each."""
        from ...engines.grid.shapes import flanks  # imports Numba

        gap = max(2, math.ceil(min(self.gap * sizes.spacing / sizes.cell, max(z.shape))))
        z = np.where(inside, z, np.float32(np.inf))
        edge = inside & ~(seen | lowest(inside, 2 * gap + 1, outside=False))  # where slim triangles go on to anywhere
        around = np.pad(np.where(seen, z, np.float32(np.inf)), gap, constant_values=np.inf)
        around = np.lib.stride_tricks.sliding_window_view(around, (2 * gap + 1, 2 * gap + 1))[edge]
        around = around.reshape(len(around), (2 * gap + 1) ** 2)
        away = np.hypot(*np.mgrid[-gap : gap + 1, -gap : gap + 1]).ravel()
        nearest = np.where(np.isinf(around), np.inf, away).argmin(axis=1)
        z[edge] = around[np.arange(len(around)), nearest]
        void = ~lowest(highest(seen | ~inside, 2 * gap + 1, outside=True), 2 * gap + 1)
        reach = round(sizes.widest / 2 / sizes.cell)
        for box, own in _groups(void, reach):  # water is below what is around it
            z[box] = np.where(own, lowest(z[box], 2 * reach + 1), z[box])
        found: tuple[np.ndarray, ...] = ()
        if sizes.spacing <= 2 * sizes.cell:  # else most of the surface is not seen
            found = flanks(z, gap, np.float32(sizes.widest / sizes.cell), np.float32(self.fall * sizes.drop))
        return Flanked(z, points, sizes, gap, found)

    def find(
        self, flanked: Flanked, objects: np.ndarray, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elevations of decks, of water, also below what stands on it, and of water without the shore: f32[rows, columns] each,
        metres, NaN elsewhere. A deck and a water body are judged as a whole, however far the data join their cells.

        ``objects``: bool[rows, columns], cells that are no ground; ``slope``: f32[rows, columns], rise over run of the landscape.
        """
        deck = np.full(flanked.z.shape, np.nan, np.float32)
        if flanked.flanks:
            deck = self._decks(flanked, objects, slope)
        z = np.where(np.isnan(deck), flanked.z, np.float32(np.inf))
        return (deck, *self._waters(z, objects & np.isnan(deck), flanked.points, flanked.sizes.cell))

    def _decks(self, flanked: Flanked, objects: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """f32[rows, columns]: elevation of decks, NaN elsewhere.

        Cells beside a deck whose lowest point is beneath it hold points of its edge, and have its elevation.
        """
        from ...engines.grid.shapes import segments  # imports Numba

        z, sizes, gap, (across, width, fall) = flanked.z, flanked.sizes, flanked.gap, flanked.flanks
        low, cell, deck = np.float32(self.fall * sizes.drop), sizes.cell, np.full(z.shape, np.nan, np.float32)
        high = fall > np.float32(sizes.drop) + np.float32(gap * cell) * slope  # the landscape explains the rest
        on = (across > 0) & highest(high, 2 * round(self.near / cell) + 1)
        part, count = segments(np.where(on, z, np.float32(np.nan)), np.float32(sizes.step), sizes.area / cell**2)
        row, column = np.nonzero(part > 0)
        name = part[row, column]

        def total(values: np.ndarray) -> np.ndarray:
            return np.bincount(name, values, count + 1)

        cells, turn = np.maximum(total(np.ones(len(name))), 1), np.pi / 4 * (across[row, column] - 1)
        sine, cosine = total(np.sin(turn)), total(np.cos(turn))  # of twice the angle, since a line has no sense
        wide = total(width[row, column]) / cells
        good = (np.hypot(sine, cosine) >= self.steady * cells) & (cells * cell >= self.near * wide)
        good &= 2 * total(high[row, column]) >= cells
        joins, cut = np.zeros(z.shape, bool), highest(np.isinf(z), 2 * gap + 3, outside=True)
        for box, own in _groups(_at(z.shape, row, column, good[name]), round(sizes.widest / 2 / cell)):
            rest, many = segments(np.where(part[box] > 0, np.float32(np.nan), z[box]), low, 1.0)
            land = np.bincount(rest[~objects[box] & np.isfinite(z[box])], minlength=many + 1) * cell**2 > sizes.area
            land[0] = False
            land = np.pad(np.where(land[rest], z[box], np.float32(np.nan)), 1, constant_values=np.nan)
            for beside in (land[:-2, 1:-1], land[2:, 1:-1], land[1:-1, :-2], land[1:-1, 2:]):
                joins[box] |= own & (np.abs(beside - z[box]) < low)
        axis = (np.arctan2(sine, cosine) + np.pi) / 2
        along = row * np.sin(axis)[name] + column * np.cos(axis)[name]
        ahead = along > (total(along) / cells)[name]
        ends = [[total(what[row, column] & side) / (wide + 2) for side in (ahead, ~ahead)] for what in (joins, cut)]
        join, border = (np.array(both) for both in ends)
        met = (join >= self.ends) | ((border >= self.ends) & (join[::-1] >= self.ends))
        good &= met.all(axis=0)
        for box, own in _groups(_at(z.shape, row, column, good[name]), 1):
            beside = highest(np.where(own, z[box], np.float32(-np.inf)), 3)
            deck[box] = np.where(own, z[box], np.where(beside - z[box] > low, beside, deck[box]))
        return deck

    def _waters(
        self, z: np.ndarray, objects: np.ndarray, points: np.ndarray, cell: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Elevations of water, and of water without the shore: f32[rows, columns], NaN elsewhere. ``z``: infinite where it is not
        known, and at decks."""
        from ...engines.grid.shapes import levels, rims, segments

        out = np.full((2, *z.shape), np.nan, np.float32)
        mean = levels(z, _HALF, np.float32(2 * self.surface))
        body, count = segments(mean, np.float32(self.surface / 6), self.pond / cell**2)
        row, column = np.nonzero(body > 0)
        name = body[row, column]

        def average(values: np.ndarray) -> np.ndarray:
            return np.bincount(name, values, count + 1) / cells

        cells = np.maximum(np.bincount(name, minlength=count + 1), 1)
        spread, extent = np.zeros((2, count + 1))
        for values, sum in ((mean[row, column].astype(np.float64), spread), (row, extent), (column, extent)):
            sum += average((values - average(values)[name]) ** 2)
        edge, higher, beside = rims(body, count, mean, z, points, _HALF + self.rim, np.float32(self.surface))
        thin = average(points[row, column]) * edge < self.thin * beside
        rough, most = np.sqrt(spread), np.maximum(self.surface, self.river * cell * np.sqrt(extent))
        wet = (thin & (rough <= most)) | ((cells * cell**2 >= self.lake) & (rough <= self.surface / 6))
        wet &= (edge > 0) & (higher >= self.higher * edge)
        wet[0] = False
        size = 2 * self.rim + 1
        for box, own in _groups(_at(z.shape, row, column, wet[name]), 3 * self.rim + _HALF):
            level = _mean(mean[box], own, 4 * self.rim + 1)
            flat = own | (np.abs(z[box] - level) < self.surface)
            flat = scipy.ndimage.binary_propagation(own, mask=flat)  # without crumbs of the shore
            afloat = lowest(highest(flat, size), size) & objects[box]
            wide = flat | afloat
            for found, there in zip(out[(slice(None), *box)], (wide, afloat | lowest(wide, 3)), strict=True):
                found[there] = level[there]
        return out[0], out[1]


def _groups(mask: np.ndarray, margin: int) -> Iterator[tuple[tuple[slice, ...], np.ndarray]]:
    """Slices of rows and columns around each group of the cells of ``mask``, bool[rows, columns], and ``margin`` more; and
    bool, the cells of the group. Groups are further apart than a square of :data:`_BLOCK` cells."""
    row, column = (at // _BLOCK for at in np.nonzero(mask))
    some = np.zeros([n // _BLOCK + 1 for n in mask.shape], bool)
    some[row, column] = True
    group, _ = scipy.ndimage.label(some, np.ones((3, 3)))
    for number, blocks in enumerate(scipy.ndimage.find_objects(group), 1):
        box = tuple(slice(max(one.start * _BLOCK - margin, 0), one.stop * _BLOCK + margin) for one in blocks)
        down, right = (np.arange(n)[one] // _BLOCK for n, one in zip(mask.shape, box, strict=True))
        yield box, mask[box] & (group[np.ix_(down, right)] == number)


def _at(shape: tuple[int, ...], row: np.ndarray, column: np.ndarray, which: np.ndarray) -> np.ndarray:
    """bool of a ``shape``: the cells that ``which``, bool[n], says of those at ``row`` and ``column``, i64[n]."""
    out = np.zeros(shape, bool)
    out[row[which], column[which]] = True
    return out


def _mean(z: np.ndarray, on: np.ndarray, size: int) -> np.ndarray:
    """f32[rows, columns]: the mean of ``z`` over the cells of a square window that are ``on``, NaN without any."""
    share = scipy.ndimage.uniform_filter(on.astype(np.float64), size, mode="constant")
    total = scipy.ndimage.uniform_filter(np.where(on, z, 0).astype(np.float64), size, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share > 0.5 / size**2, total / share, np.nan).astype(np.float32)
