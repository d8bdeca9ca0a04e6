"""Low clusters: false echoes that are too many for the count of low points."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from ..outliers import LOW_DEPTH, low_clusters, scattered
from ..sensors import AIRBORNE
from .plants import hidden, sides_of
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class LowClustersRule(OstRule):
    """Points below all around them are low if they are alone, or in clusters that scatter; not where plants hide the ground."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE,)

    def bar(self, scene: OstScene) -> None:
        most = scene.ost.low_points
        if most == 0:
            return
        below = scattered(scene.points, low_clusters(scene.points, depth=LOW_DEPTH, max_points=most).barred)
        if (below & ~scene.low).any():
            side = sides_of(scene.ost.cell, scene.spacing, scene.ost.window)[0]
            scene.low = scene.low | (below & ~hidden(scene, side)[0])
