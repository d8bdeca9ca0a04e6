"""Steep terrain: rocks, faces and headlands, which openings cut, and overhangs."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import scipy

from ...core.filter import Labels
from ..objects import EVEN
from ..sensors import MATCHING, spreads
from ..surfaces import highest_in, look_up
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class SteepRule(OstRule):
    """Parts of the objects that are steep, bare and no roofs, and have no walls, are ground. Near them distances grow, all seeds
    count, and rock over a void is ground.

    Half of the cells of a part must have points as all around them do, and half of these be bare; few may be in segments that
    are objects as a whole, and fewer than half of those on its border walls, from which the surface falls farther than it rises
    to the inside (:func:`jaxfilter.engines.grid.shapes.faces`).

    In photographs walls are ramps, so the landscape must be steep, too.
    """

    roofs: float = 0.1
    """Share of the cells of steep terrain that may be in roofs."""
    walls: float = 0.45
    """Share of those on its border that may be walls."""
    sheet: float = 1.5
    """Standard deviation at most that points of rock lie from their plane in a cell, in ``roof_step``. Leaves scatter by more."""
    land: float = 0.2
    """Slope of the landscape, rise over run, from which on such parts are rock in photographs. On less steep land they are roofs,
    whose walls are ramps."""

    def fill(self, scene: OstScene) -> None:
        """The highest point of each cell: rock is bare where it is little higher than the lowest."""
        scene.high = highest_in(scene.points.xyz, scene.cells)

    def give_back(self, scene: OstScene) -> None:
        from ...engines.grid.shapes import faces, segments  # imports Numba

        ost, z = scene.ost, np.where(scene.objects, scene.z, np.float32(np.nan))
        part, count = segments(z, np.float32(np.inf), ost.roof_area / ost.cell**2)
        limits = (np.float32(limit) for limit in (ost.roof_step, 2 * EVEN, 2 * ost.roof_step))
        cells, roofs, known, bare, border, walls = faces(
            part, count, scene.z, scene.high, scene.seen, scene.whole, *limits
        )
        rock = (
            (2 * known >= cells) & (2 * bare >= known) & (roofs <= self.roofs * cells) & (walls <= self.walls * border)
        )
        found = (rock & (cells > 0))[part]
        if ost.sensor == MATCHING:
            found &= scene.slope >= self.land
        scene.rock = scene.rock | found
        scene.back = scene.back | scene.rock

    def seed(self, scene: OstScene) -> None:
        """Within ``window`` of such terrain no plants are looked for, and distances grow by the side of a cell times the slope of
        the landscape: on rough rock the other points of a cell lie that much above its lowest."""
        if not scene.rock.any():
            return
        near, slope = look_up(scene.points.xyz, scene.cells, near_rock(scene), scene.slope)
        scene.plants = scene.plants & ~near
        scene.distance = scene.distance + near * np.float32(scene.ost.cell) * slope

    def label(self, scene: OstScene, labels: Labels) -> None:
        """Rock over a void is ground, unless it is barred; the triangulation stays as it is."""
        if scene.rock.any() and labels.margin is not None and labels.barred is not None:
            rock = self.overhangs(scene) & ~(labels.ground | labels.barred | scene.never)
            labels.ground[rock], labels.margin[rock] = True, 0

    def overhangs(self, scene: OstScene) -> np.ndarray:
        """bool[n]: points of rock over a void, which a surface with one elevation at a place cannot have beside what is beneath.

        Of the points in a cell those above the highest void count. They must be a sheet, and go on in a cell beside it: some
        points there, of bare steep terrain or of such a sheet, are as high as some of them.
        """
        xyz, shape, step = scene.points.xyz, scene.z.shape, np.float32(scene.ost.roof_step)
        at = scene.cells.grid.flat(xyz)
        own = np.flatnonzero(near_rock(scene).ravel()[at])
        own = own[np.lexsort((xyz[own, 2], at[own]))]
        cell, z, number = at[own], xyz[own, 2], np.arange(len(own))
        first = np.diff(cell, prepend=-1) > 0
        void = ~first & (np.diff(z, prepend=z[:1]) > 2 * scene.ost.roof_drop)
        start, known = np.zeros(scene.z.size, np.int64), cell[first]
        np.maximum.at(start, cell, np.where(first | void, number, 0))
        upper = number >= start[cell]
        low, high = np.full((2, scene.z.size), np.nan, np.float32)
        low[known], high[known] = z[start[known]], np.maximum.reduceat(z, number[first])
        above, sheet = np.zeros((2, scene.z.size), bool)
        above[cell[void]] = True
        sheet[known] = spreads(xyz[own[upper]].astype(np.float64), cell[upper]) < self.sheet * step
        bottoms, tops, hung, sheets = (np.pad(values.reshape(shape), 1) for values in (low, high, above, sheet))
        rock, more = np.pad(scene.rock, 1) & ~hung, hung
        while more.any():
            beside = np.zeros_like(rock)
            for shift in itertools.product((-1, 0, 1), repeat=2):
                there, bottom, top = (np.roll(values, shift, (0, 1)) for values in (rock, bottoms, tops))
                beside |= there & (bottoms <= top + step) & (bottom <= tops + step)
            more = beside & hung & sheets & ~rock
            rock |= more
        found = np.zeros(len(xyz), bool)
        found[own] = upper & (rock & hung)[1:-1, 1:-1].ravel()[cell]
        return found


def near_rock(scene: OstScene) -> np.ndarray:
    """bool[rows, columns]: cells within ``window`` of steep terrain that is ground."""
    return scipy.ndimage.distance_transform_edt(~scene.rock) * scene.ost.cell <= scene.ost.window
