"""Pits: wrong matches of photographs, and clusters of false echoes, that lie a little below the ground."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from ..outliers import pits
from ..sensors import DRONE, MATCHING
from .scene import OstRule, OstScene, grid_of


@dataclasses.dataclass(frozen=True)
class PitsRule(OstRule):
    """Points below what surrounds them are low, in pits of a few cells. A ditch is longer."""

    SENSORS: ClassVar[tuple[str, ...]] = (MATCHING, DRONE)
    depth: float = 0.4
    """Metres below the surroundings, at least: wrong matches come as clusters that are too high for a count of low points."""
    area: float = 12.0
    """Square metres of a pit at most."""

    def bar(self, scene: OstScene) -> None:
        scene.low = scene.low | pits(scene.points.xyz, grid_of(scene, scene.ost.cell), self.depth, self.area)
