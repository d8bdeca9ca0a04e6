"""Voids: water, and what a roof or a wall hides. A surface that is laid across them hides what stands at their edge."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import ClassVar

import numpy as np

from ..outliers import LOW_DEPTH
from ..sensors import AIRBORNE, DRONE
from ..surfaces import positions
from .scene import OstRule, OstScene


@dataclasses.dataclass(frozen=True)
class VoidsRule(OstRule):
    """Triangles across a void hang at the lowest elevation around those of their corners that are 2 m above it: so a roof at the
    edge of water stands out from it, as it does from land, and low terraces and plants do not. Voids of photographs, and of
    scans from a car, are no water."""

    SENSORS: ClassVar[tuple[str, ...]] = (AIRBORNE, DRONE)
    edge: float = 8.0
    """Metres: a triangle with a longer edge spans a void, if the edge is longer than four spacings, too."""
    rim: float = 0.2
    """Of the window: so far around a corner the lowest cell counts."""

    def fill(self, scene: OstScene) -> None:
        from ...engines.grid.shapes import draw  # imports Numba

        tin, cell = scene.tin, scene.ost.cell
        x, y = positions(tin.xyz, scene.cells)
        corner, limit = tin.triangles, max(self.edge, 4 * scene.spacing) / cell
        side = (
            np.hypot(x[corner[:, k]] - x[corner[:, k - 1]], y[corner[:, k]] - y[corner[:, k - 1]]) for k in range(3)
        )
        over = (corner.min(axis=1) >= 0) & (np.maximum.reduce(list(side)) > limit)
        nodes, reach = np.unique(corner[over]), math.ceil(self.rim * scene.ost.window / cell - 1e-6)
        z, known = scene.z.copy(), scene.seen
        wide = np.pad(np.where(known, z, np.float32(np.inf)), reach, constant_values=np.inf)
        row, column = (np.minimum(np.rint(at[nodes]).astype(int), n - 1) for at, n in zip((y, x), z.shape, strict=True))
        own, beneath = tin.xyz[nodes, 2], tin.xyz[:, 2].copy()
        low = own.copy()
        for i, j in itertools.product(range(2 * reach + 1), repeat=2):
            low = np.minimum(low, wide[row + i, column + j])
        beneath[nodes] = np.where(own - low > np.float32(LOW_DEPTH), low, own)
        draw(x, y, corner[over], beneath, z, known)
        scene.z = z
