"""Water and bridge decks: what crosses the ground, or covers it."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np
import scipy

from ...core.filter import Labels
from ...core.water import WaterCells
from ...engines.grid.inpaint import fill_nearest
from ..decks import decks
from ..sensors import AIRBORNE, DRONE
from ..surfaces import look_up, number_in
from ..voids import lower_voids
from ..water import AFLOAT, SURFACE, waters
from .scene import Rule, Scene


@dataclasses.dataclass(frozen=True)
class Crossings(Rule):
    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)

    def seed(self, scene: Scene) -> None:
        ost, objects, inside = scene.ost, scene.objects, scene.inside
        edge = ~scipy.ndimage.binary_erosion(inside, iterations=3)
        rows, columns = objects.shape
        near = np.asarray(fill_nearest(scene.cells.lowest, scene.cells.seen, scene.cells.valid))[:rows, :columns]
        z = np.where(edge & ~scene.seen, near, scene.z)
        z = lower_voids(z, scene.seen | ~inside, ost.cell, scene.spacing)
        deck = decks(z, objects, inside, (ost.cell, scene.spacing, float(ost.roof_step), 2 * ost.window))
        others = objects & np.isnan(deck)
        level, apart = waters(z, inside & np.isnan(deck), number_in(scene.points, scene.cells), others, ost.cell)
        scene.found = deck, level
        xyz = scene.points.xyz
        d, c = look_up(xyz, scene.cells, deck, np.where(apart, level, np.float32(np.nan)))
        scene.never = scene.never | (xyz[:, 2] > d - np.float32(ost.roof_step)) | (np.abs(xyz[:, 2] - c) > AFLOAT)
        scene.seeds = scene.seeds[~scene.never[scene.seeds]]

    def label(self, scene: Scene, labels: Labels) -> None:
        z = scene.points.xyz[:, 2]
        deck, level = look_up(scene.points.xyz, scene.cells, *scene.found)
        labels.deck = ~labels.ground & (np.abs(z - deck) < np.float32(scene.ost.roof_step))
        labels.water = labels.ground & (np.abs(z - level) < SURFACE)
        if not np.isnan(scene.found[1]).all():
            grid = scene.cells.grid
            x, y, side = (float(v) for v in (grid.x0, grid.y0, grid.cell))
            labels.water_cells = WaterCells.from_levels(scene.points.cloud, scene.found[1], (x, y), side)
