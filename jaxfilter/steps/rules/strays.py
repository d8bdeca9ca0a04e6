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
    """Points are low if few others around them are as low over the trend of the low terrain. Ground under plants has ground of
    its level around it, however few points that is, and false echoes have hardly any: a hillside is level over its trend."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE,)
    radius: float = 15.0
    """Metres around a point in which others count: terrain bends away from its trend beyond."""
    depth: float = 2.0
    """Metres above the point below which they are as low."""
    share: float = 0.002
    """Of the points in a disk of that radius: so many at most are few, but no more than ``low_points``."""
    trend: float = 15.0
    """Metres along the side of the cells whose lowest points make the trend. Four spacings are in one at least."""
    passes: int = 2
    """Times that points are judged: false echoes are few where others are not counted any more, and bend no trend."""

    def bar(self, scene: OstScene) -> None:
        points, side = scene.points, max(self.trend, 4 * scene.spacing)
        most = min(scene.ost.low_points, int(self.share * math.pi * (self.radius / scene.spacing) ** 2))
        for _ in range(self.passes):
            rows = np.flatnonzero(~scene.low)
            xyz = points.xyz[rows]
            xyz[:, 2] -= low_trend(xyz, *points.lattice_corner(side), side)
            found = lowest_few(xyz, self.radius, self.depth, most)
            if not found.any():
                return
            low = scene.low.copy()
            low[rows[found]] = True
            scene.low = low
