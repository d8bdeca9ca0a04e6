"""Plants: points, seeds and vertices that stand above the ground where plants hide it."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ...engines.tin.ground import GroundTin
from ..pruning import Scatter, drop_vertices
from ..seeds import ABOVE, rising, standing, veiled
from ..sensors import AIRBORNE, DRONE
from ..surfaces import cell_for, look_up
from .scene import OstRule, OstScene, grid_of

BESIDE, STEEP = 10.0, 1.25
"""Metres from a seed to others, and rise over run, by which it must not rise from these: no ground under plants does, nor what is
seen of a ramp."""
PLANT_CELL = 2.0
"""Spacings along the side of the cells in which plants are looked for: they hold four points."""


def sides_of(cell: float, spacing: float, window: float) -> list[float]:
    """Metres along the sides of the cells in which plants are looked for. If the first is wider than a cell of the surface, more
    follow, each twice as wide as the one before, up to ``window``."""
    sides = [max(cell, cell_for(spacing, PLANT_CELL))]
    while cell < sides[0] and 2 * sides[-1] <= window:
        sides.append(2 * sides[-1])
    return sides


def hidden(scene: OstScene, side: float, height: float = ABOVE) -> tuple[np.ndarray, np.ndarray]:
    """bool[m] each: points where plants hide the ground, by cells of this side that are within 10 m; and points there that stand
    ``height`` metres above others (:func:`jaxfilter.steps.seeds.veiled`)."""
    cells, points = grid_of(scene, side), scene.points
    high = standing(points, cells, height)
    left = dataclasses.replace(points, weight=points.weight * ~scene.veil)
    found = look_up(points.xyz, cells, veiled(left, cells, BESIDE, high))[0]
    return found, found & high


def without_rising(scene: OstScene, suspect: np.ndarray, sides: int) -> np.ndarray:
    """i64: the seeds without those of the suspect ones, bool[seeds], that rise steeply from others in so many quadrants."""
    seeds, found = scene.seeds, suspect.copy()
    found[suspect] = rising(scene.points.xyz, seeds[suspect], seeds, BESIDE, STEEP, sides)
    return seeds[~found]


@dataclasses.dataclass(frozen=True)
class PlantsRule(OstRule):
    """Where plants hide the ground, the surface is made without what stands above the lowest points, seeds must not rise steeply
    from others, and vertices must not stick out of those beside them."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)
    sides: int = 2
    """Quadrants in which a seed rises from others: the upper edge of a step does in one."""
    passes: int = 3
    """Times that vertices are judged: beside high plants those that are less high do not stick out."""

    def bar(self, scene: OstScene) -> None:
        """Where plants hide the ground; and there, where points are few, the surface is made without what stands above others.

        If plants hide the ground by the points that are left, too, cells are twice as wide, and so on. What counts as high grows
        with the cells: over wide ones terrain is rough.
        """
        ost, height = scene.ost, ABOVE
        sides = sides_of(ost.cell, scene.spacing, ost.window)
        scene.plants, high = here, _ = hidden(scene, sides[0])
        for side in sides[1:]:
            scene.veil = scene.veil | (here & high)
            found, high = hidden(scene, side, height := 2 * height)
            here = here & found
        if sides[0] > ost.cell:
            scene.veil = scene.veil | (here & high)

    def seed(self, scene: OstScene) -> None:
        """Seeds that rise are dropped."""
        scene.seeds = without_rising(scene, scene.plants[scene.seeds], self.sides)

    def prune(self, scene: OstScene, ground: GroundTin, scatter: Scatter) -> int:
        """Vertices are dropped that stick out by more than those beside them do, than ``noise``, and than a share of the spacing
        that grows with the slope of the landscape."""
        ost, dropped = scene.ost, 0
        slope = look_up(scene.points.xyz, scene.cells, scene.slope)[0]
        share = np.float32(ost.tolerance_spacing) + np.float32(ost.scaling) * slope
        least = np.maximum(np.float32(ost.noise), np.float32(scene.spacing) * share)
        for _ in range(self.passes if scene.plants.any() else 0):
            scatter = scatter.measure_again(ground.tin, scene.plants)
            over = np.where(scene.plants, scatter.residual - np.maximum(least, scatter.roughness), np.float32(0))
            count = drop_vertices(ground, over)
            dropped += count
            if count == 0:
                break
        return dropped
