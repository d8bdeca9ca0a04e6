"""Embankments, dikes and ridges: narrow, but they fall on banks."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ..sensors import AIRBORNE, DRONE
from .scene import Rule, Scene


@dataclasses.dataclass(frozen=True)
class Embankments(Rule):
    """Smooth parts of the objects that fall on banks, not at walls, are ground. Earth lies at less than 45 degrees. On a bank the
    surface goes on falling, or rises behind as it falls in front; at a wall, or a crown, it falls at once."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)
    bank: float = 0.5
    """Metres that a bank falls by within two cells, at least."""
    even: float = 0.1
    """Metres that the top bends by from cell to cell, in half of the cells."""
    banks: float = 0.8
    """Share of the border where the surface falls that banks are, at least."""
    further: float = 1.6
    """On a bank the surface falls so many times as far within two cells as within one."""

    def give_back(self, scene: Scene) -> None:
        from ...engines.grid.shapes import banks, segments  # imports Numba

        ost, z = scene.ost, np.where(scene.objects, scene.z, np.float32(np.nan))
        part, count = segments(z, np.float32(2 * ost.roof_step), ost.roof_area / ost.cell**2)
        limits = (np.float32(v) for v in (self.bank, np.sqrt(8) * ost.cell, self.further, self.even))
        cells, even, falling, sloping = banks(part, count, scene.z, *limits)
        scene.back = scene.back | ((2 * even >= cells) & (sloping >= self.banks * falling) & (falling > 0))[part]
