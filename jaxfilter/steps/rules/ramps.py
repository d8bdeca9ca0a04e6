"""Ramps: what photographs and cars see of crowns, roofs and walls beside a place that they do not see."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import scipy

from ..seeds import rising
from ..sensors import MATCHING, MOBILE
from ..surfaces import look_up
from .scene import Rule, Scene


@dataclasses.dataclass(frozen=True)
class Ramps(Rule):
    """Seeds beside an object, or a cell without points, must not rise steeply from others."""

    SENSORS: ClassVar[tuple[str, ...]] = (MATCHING, MOBILE)
    beside: float = 10.0
    """Metres from a seed to others from which it must not rise."""
    steep: float = 1.0
    """Rise over run: ramps are steeper, most ground is not."""

    def seed(self, scene: Scene) -> None:
        seeds, xyz = scene.seeds, scene.points.xyz
        near = scipy.ndimage.binary_dilation(scene.marked | scene.whole | ~scene.seen)
        suspect = look_up(xyz[seeds], scene.cells, near)[0]
        suspect[suspect] = rising(xyz, seeds[suspect], seeds, self.beside, self.steep)
        scene.seeds = seeds[~suspect]
