"""Embankments, dikes and ridges: narrow, but they fall on banks."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ..objects import EVEN, FURTHER, MOST
from ..sensors import AIRBORNE, DRONE
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class EmbankmentsRule(OstRule):
    """Smooth parts of the objects that fall on banks, not at walls, are ground. Earth lies at less than 45 degrees. On a bank the
    surface goes on falling, or rises behind as it falls in front; at a wall, or a crown, it falls at once."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)

    def give_back(self, scene: OstScene) -> None:
        from ...engines.grid.shapes import banks, segments  # imports Numba

        ost, z = scene.ost, np.where(scene.objects, scene.z, np.float32(np.nan))
        part, count = segments(z, np.float32(2 * ost.roof_step), ost.roof_area / ost.cell**2)
        limits = (np.float32(v) for v in (ost.roof_step, np.sqrt(8) * ost.cell, FURTHER, EVEN))
        cells, even, falling, sloping = banks(part, count, scene.z, *limits)
        scene.back = scene.back | ((2 * even >= cells) & (sloping >= MOST * falling) & (falling > 0))[part]
