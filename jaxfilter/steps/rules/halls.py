"""Halls and roofs of several levels: objects that no single segment shows."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.ndimage import uniform_filter

from ..objects import EVEN, MOST
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class HallsRule(OstRule):
    """Segments with small steps between them are objects together, if the surface falls along their border. What the edge of the
    data cuts is an object if it has high walls, of twice ``roof_drop``, along nearly all of its border inside, and as many cells
    on that border as at the edge of the data, as a rectangle that a corner cuts: a plateau has not."""

    levels: tuple[float, ...] = (2 / 3, 5 / 3)
    """Shares of ``roof_drop`` below which steps join segments. Fewer trees beside a wall are a way down by the smaller ones;
    parts of a large building differ by the larger one."""

    def measure(self, scene: OstScene) -> None:
        """Segments over larger steps."""
        drop = float(scene.ost.roof_drop)
        scene.joined = [scene.segments.joined(scene.z, level * drop) for level in self.levels]

    def judge(self, scene: OstScene) -> None:
        one, drop, share = scene.segments, float(scene.ost.roof_drop), float(scene.ost.roof_drop_share)
        whole = scene.whole.copy()
        for group in (one, *scene.joined):
            found = group.census(scene.slope, drop, 2 * drop)
            cut, hall = found.edge > 0, found.walls >= MOST * found.border
            falls = np.where(cut, hall & (found.border >= found.edge), found.falling >= share * found.border)
            here = (falls & (found.border > 0))[group.number]
            number, size = group.number[here], group.last + 1
            level = one.number[here] > 0
            counts = np.bincount(number[level], minlength=size)
            if cut[number].any():  # it may be steep, too
                even = np.abs(scene.z - uniform_filter(scene.z, 3, mode="nearest"))[here] <= EVEN
                counts = np.where(cut, np.maximum(counts, np.bincount(number[even], minlength=size)), counts)
            whole[here] |= (2 * counts >= found.cells)[number]
        scene.whole = whole
