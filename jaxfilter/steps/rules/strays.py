"""Strays: false echoes below the ground that lower ground hides, or plants: on slopes, and in forests."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np

from ..outliers import lowest_few
from ..sensors import AIRBORNE
from ..trend import low_trend
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class StraysRule(OstRule):
    """Points are low if few others around them are as low, in heights over the trend of the low terrain: over it a hillside is
    level. Ground under plants has some ground of its level around it, and a false echo has hardly any."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE,)
    radius: float = 15.0
    """Metres around a point in which others count, and along the sides of the cells whose lowest points make the trend: farther
    away terrain leaves it."""
    depth: float = 1.5
    """Metres: others that are lower than so much above the point are as low."""
    share: float = 0.002
    """So many of the points in a disk of this radius are few. False echoes are one of a thousand, or fewer. Where the disk holds
    less than 1 / ``share`` points, none is barred."""

    def bar(self, scene: OstScene) -> None:
        few = int(self.share * math.pi * (self.radius / scene.spacing) ** 2)
        if few == 0:
            return
        rows, low = np.flatnonzero(~scene.low), scene.low.copy()
        xyz = scene.points.xyz[rows]
        xyz[:, 2] -= low_trend(xyz, *scene.points.lattice_corner(self.radius), self.radius)
        low[rows] = lowest_few(xyz, self.radius, self.depth, min(scene.ost.low_points, few))
        scene.low = low
