"""Plants: seeds and vertices that stand on them, where they hide the ground."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ...engines.tin.ground import GroundTin
from ..pruning import Scatter, drop_vertices, points_above
from ..seeds import rising, veiled
from ..sensors import AIRBORNE, DRONE
from ..surfaces import cell_for, look_up
from .scene import Rule, Scene, grid_of


def hidden(scene: Scene, side: float = 2.0, around: float = 10.0) -> np.ndarray:
    """bool[m]: points where plants hide the ground (:func:`jaxfilter.steps.seeds.veiled`), by cells of ``side`` spacings within
    ``around`` metres."""
    cells = grid_of(scene, max(scene.ost.cell, cell_for(scene.spacing, side)))
    found = veiled(scene.points, cells, around)
    return look_up(scene.points.xyz, cells, found)[0]


@dataclasses.dataclass(frozen=True)
class Plants(Rule):
    """Where plants hide the ground, seeds must not rise steeply from others, and vertices must not stick out of those beside
    them."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)
    beside: float = 10.0
    """Metres from a seed to others from which it must not rise."""
    steep: float = 1.25
    """Rise over run: steeper is none of the slopes that forests grow on."""
    sides: int = 2
    """Quadrants in which it rises so: the upper edge of a step does in one."""
    out: float = 0.3
    """Metres per metre of spacing that a vertex may stick out on level land."""
    veil: float = 2.0
    """Points that are no ground for each vertex, up to ``edges`` edges away."""
    edges: int = 3
    passes: int = 3
    """Times that vertices are judged: beside high plants those that are less high do not stick out."""

    def bar(self, scene: Scene) -> None:
        scene.plants = hidden(scene)

    def seed(self, scene: Scene) -> None:
        seeds, xyz = scene.seeds, scene.points.xyz
        suspect = scene.plants[seeds]
        suspect[suspect] = rising(xyz, seeds[suspect], seeds, self.beside, self.steep, self.sides)
        scene.seeds = seeds[~suspect]

    def prune(self, scene: Scene, ground: GroundTin, scatter: Scatter) -> int:
        """Vertices are dropped that stick out by more than those beside them do, than ``noise``, and than a share of the spacing
        that grows with the slope of the landscape, where more points than ``veil`` are above each vertex around."""
        ost, dropped = scene.ost, 0
        around = look_up(scene.points.xyz, scene.cells, scene.slope)[0]
        least = np.maximum(np.float32(ost.noise), np.float32(scene.spacing) * (self.out + float(ost.scaling) * around))
        for number in range(self.passes if scene.plants.any() else 0):
            if number > 0 or dropped:
                scatter = scatter.measure_again(ground.tin, scene.plants)
            over = np.where(scene.plants, scatter.residual - np.maximum(least, scatter.roughness), np.float32(0))
            over[points_above(ground, over > 0, self.edges) <= self.veil] = 0
            count = drop_vertices(ground, over)
            dropped += count
            if count == 0:
                break
        return dropped
