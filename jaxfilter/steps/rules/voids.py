"""Voids: water, and what a roof or a wall hides. A surface that is laid across them hides what stands at their edge."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np

from ...engines.grid.extremes import lowest
from ..sensors import AIRBORNE, DRONE
from ..surfaces import positions
from .scene import Rule, Scene


@dataclasses.dataclass(frozen=True)
class Voids(Rule):
    """Triangles across a void hang at the lowest elevation around their corners: so a roof at the edge of water stands out from
    it, as it does from land. Voids of photographs, and of scans from a car, are no water."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)
    edge: float = 8.0
    """Metres: a triangle with a longer edge spans a void, if the edge is longer than four spacings, too."""
    rim: float = 4.0
    """Metres around a corner within which the lowest cell counts."""

    def surface(self, scene: Scene) -> None:
        from ...engines.grid.shapes import draw  # imports Numba

        tin, cell = scene.tin, scene.ost.cell
        corner = tin.xyz[tin.triangles]
        longest = np.sqrt(((corner - np.roll(corner, 1, axis=1))[:, :, :2] ** 2).sum(axis=2).max(axis=1))
        over = (tin.triangles.min(axis=1) >= 0) & (longest > max(self.edge, 4 * scene.spacing))
        if not over.any():
            return
        low = lowest(np.where(scene.seen, scene.z, np.float32(np.inf)), 2 * math.ceil(self.rim / cell - 1e-6) + 1)
        x, y = positions(tin.xyz, scene.cells)
        row, column = (np.clip(np.rint(at).astype(int), 0, n - 1) for at, n in zip((y, x), low.shape, strict=True))
        z, known = scene.z.copy(), scene.seen.copy()
        draw(x, y, tin.triangles[over], np.minimum(low[row, column], tin.xyz[:, 2]), z, known)
        scene.z = z
