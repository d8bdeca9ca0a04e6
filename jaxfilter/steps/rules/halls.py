"""Halls and roofs of several levels: objects that no single segment shows."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.ndimage import uniform_filter

from .scene import Rule, Scene


@dataclasses.dataclass(frozen=True)
class Halls(Rule):
    """Segments with small steps between them are objects together, if the surface falls along their border. What the edge of the
    data cuts is an object if it has high walls along nearly all of its border inside: a plateau has not."""

    levels: tuple[float, ...] = (2 / 3, 1.0, 5 / 3)
    """Shares of ``roof_drop`` below which steps join segments. Fewer trees beside a wall are a way down by the smaller ones;
    parts of a large building differ by the larger one."""
    tall: float = 4.0
    """Metres by which the surface falls at such walls, at least."""
    walls: float = 0.8
    """Share of the border inside the data that such walls are."""
    shown: float = 0.9
    """How many times as many cells are on that border as at the edge of the data. A rectangle cut by a corner has as many."""
    even: float = 0.1
    """Metres that a steep roof bends by from cell to cell."""

    def judge(self, scene: Scene) -> None:
        one, drop, share = scene.segments, float(scene.ost.roof_drop), float(scene.ost.roof_drop_share)
        whole = scene.whole.copy()
        for group in (one, *(one.joined(scene.z, level * drop) for level in self.levels)):
            found = group.census(scene.slope, drop, self.tall)
            cut, hall = found.edge > 0, found.walls >= self.walls * found.border
            falls = np.where(
                cut, hall & (found.border >= self.shown * found.edge), found.falling >= share * found.border
            )
            here = (falls & (found.border > 0))[group.number]
            number, size = group.number[here], group.last + 1
            level = one.number[here] > 0
            counts = np.bincount(number[level], minlength=size)
            if cut[number].any():  # it may be steep, too
                even = np.abs(scene.z - uniform_filter(scene.z, 3, mode="nearest"))[here] <= self.even
                counts = np.where(cut, np.maximum(counts, np.bincount(number[even], minlength=size)), counts)
            whole[here] |= (2 * counts >= found.cells)[number]
        scene.whole = whole
