"""IPTD: improved progressive TIN densification with morphological seeds (Zhao et al. 2016), a reconstruction."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np

from ..core.grid import period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.grid.morphology import opening
from ..engines.grid.spread import fill_from_neighbours
from ..engines.ground import grow
from ..engines.tin.facets import Rule
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Growth, Network, Vertices
from ..engines.tin.network import one_network
from ..steps.local_planes import TRANSLATIONS, over_local_planes
from ..steps.seeds import lowest_of_cells
from ..steps.surfaces import cell_for, lowest_cells
from ..steps.tin_filter import TerrainAngle, labels_of_nodes, surrounded
from .papers import bibtex


@filter_params
class IPTD(TerrainAngle):
    """Improved progressive TIN densification: morphological seeds, then growth downward and upward.

    X. Zhao, Q. Guo, Y. Su, B. Xue (2016): Improved progressive TIN densification filtering algorithm for airborne LiDAR
    data in forested areas. ISPRS J. Photogramm. Remote Sens. 117, 79-91. doi:10.1016/j.isprsjprs.2016.03.016.
    Reconstructed from the summaries and parameters in F. Uray, A. Varlik (2024) and from Zheng et al. (2024).

    1. Lowest point per cell; empty cells get the mean of their neighbours. Cells that one opening, with a square as large
       as the largest object, lowers by at most ``tolerance`` give potential seeds: their lowest points.
    2. A plane is fitted to the ``k`` nearest potential seeds of each; with ``translation="lowest"`` it is moved down to the
       lowest of them. Seeds more than ``plane_error`` over the plane are no ground.
    3. Simulated points surround the seeds.
    4. Downward densification: points below the triangulation become ground, the lowest over each facet first, until none
       is left.
    5. Upward densification: PTD with ``max_angle`` and ``max_distance``. Lengths in metres, angles in degrees.

    ``info`` counts ``potential_seeds``, ``removed_seeds`` and ``downward_rounds``. "paper" moves the planes down and has no
    search for low outliers.

    Departures (docs/filters/iptd.md): the planes are not moved down by default.

    >>> result = jf.IPTD(window=30.0)(cloud)
    >>> result.info["potential_seeds"] > result.info["removed_seeds"]
    True
    """

    cell: float = static("the grid cells have this side", "c > 0 m", default=2.0)
    window: float = static("the largest object has this size", "w > 0 m", default=60.0, cells=1000)
    tolerance: float = param(
        "a cell gives a potential seed only if the opening lowers it by at most this", ">= 0 m", default=1.0
    )
    k: int = static(
        "a plane is fitted to this many potential seeds around each of them", "k >= 3 and <= 4096", default=100
    )
    plane_error: float = param(
        "a potential seed is dropped if it lies more than this over its plane", "r >= 0 m", default=0.8
    )
    translation: str = static(
        "the planes stay as they are fitted (none), or move down to the lowest of their seeds (lowest)",
        default="none",
        choices=TRANSLATIONS,
    )
    max_angle: float = param(
        "a point is ground only if its angle to the facet is at most this", "theta > 0 and < 90 degrees", default=25.0
    )
    max_distance: float = param(
        "a point is ground only if it lies at most this far from its facet", "d > 0 m", default=1.4
    )
    border_spacing: float = static("the simulated points around the seeds stand this far apart", "> 0 m", default=10.0)

    BIBTEX: ClassVar[str] = bibtex("zhao2016improved")
    WINDOW: ClassVar[str] = "window"
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: one set for all terrain, planes stay as fitted, clusters of low points are barred"
        ),
        "paper": Preset(
            "as reported by Uray and Varlik (2024) for most samples, planes of 300 seeds, moved down to the lowest of them, "
            "except cells of 2 m and a tolerance of 0.3 m, which are not reported, and window, angle and distance, the defaults",
            tolerance=0.3,
            k=300,
            translation="lowest",
            low_clusters=False,
        ),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Cells of half a point spacing, in steps of 0.5 m and 1 m at least; on simulated scenes wider ones do no better."""
        return super().from_spacing(spacing, largest_building) | {"cell": cell_for(spacing, 1 / 2)}

    @property
    def reach(self) -> int:
        """Half the window of the opening, cells: the square is wider than the largest object.

        >>> jf.IPTD(cell=2.0, window=30.0).reach
        8
        """
        return math.ceil(self.window / self.cell / 2 - 1e-6)

    def lattice(self) -> float:
        """Whole cells of the openings, and whole steps between simulated border points."""
        return period(self.cell, self.border_spacing)

    def potential_seeds(self, points: Points, barred: np.ndarray) -> np.ndarray:
        """i64[p], ascending: rows of the lowest points of the cells that the opening keeps. ``barred``: bool[m]."""
        cells = lowest_cells(points, self.cell, "IPTD(cell)", barred=barred)
        everywhere = np.int32(sum(cells.lowest.shape))
        surface, _ = fill_from_neighbours(cells.lowest, cells.seen, cells.valid, everywhere)
        opened = opening(surface, self.reach, self.reach, "square", cells.valid)
        return lowest_of_cells(points, cells, np.subtract(surface, opened) <= np.float32(self.tolerance), barred)

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        outliers = self.outliers(points, workers)
        progress(0.0, "openings")
        potential = self.potential_seeds(points, outliers.barred)
        progress(0.0, "planes")
        over = over_local_planes(points.xyz[potential], self.k, self.translation, workers)
        seeds = potential[over <= self.plane_error]
        network = surrounded(self, points, seeds, outliers, self.border_spacing, "border_spacing")
        rule = Rule(max_angle=0.0, signed=1.0, noise_floor=self.noise_floor)
        vertices = Vertices(self.vertex_spacing)
        below = Growth(rule, vertices=vertices, one_per_facet=True, triangulation=self.triangulation)
        with GroundTin.start(network, below, workers=workers) as out:
            status = grow(out, self.max_rounds, lambda share, _: progress(share / 2, "densify downward"), trace)
        downward = labels_of_nodes(out, status)
        info = {
            "seeds": len(seeds),
            "potential_seeds": len(potential),
            "removed_seeds": len(potential) - len(seeds),
            "downward_rounds": len(out.trace),
        }
        network = one_network(points, np.flatnonzero(downward.ground), network.xyz[network.virtual, :2], outliers)
        return dataclasses.replace(network, info=info, before=downward)
