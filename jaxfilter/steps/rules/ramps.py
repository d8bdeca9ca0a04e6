"""Ramps: what photographs and cars see of crowns, roofs and walls beside a place that they do not see."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import scipy

from ..sensors import MATCHING, MOBILE
from ..surfaces import look_up
from .plants import without_rising
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class RampsRule(OstRule):
    """Seeds beside an object, or a cell without points, must not rise steeply from others, unless the landscape is steep."""

    SENSORS: ClassVar[tuple[str, ...]] = (MATCHING, MOBILE)
    land: float = 0.4
    """Slope of the landscape, rise over run, from which on what rises is a face of rock. What is less steep is a ramp."""

    def seed(self, scene: OstScene) -> None:
        """Seeds that rise are dropped."""
        near = scipy.ndimage.binary_dilation(scene.marked | scene.whole | ~scene.seen, border_value=1)
        suspect = near & (scene.slope < self.land)
        scene.seeds = without_rising(scene, look_up(scene.points.xyz[scene.seeds], scene.cells, suspect)[0], 1)
