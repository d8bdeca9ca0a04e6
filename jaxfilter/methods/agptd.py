"""AGPTD: progressive TIN densification from the seeds of an adaptive grid (Zheng et al. 2024)."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.tin.growth import Growth, Mirror, Network
from ..steps.adaptive_grid import REMAINDERS, lowest_per_adaptive_cell
from ..steps.outlier_filter import OutlierFate, OutlierRadius
from ..steps.tin_filter import surrounded
from .papers import bibtex
from .ptd import PTD


@filter_params
class AGPTD(OutlierRadius, OutlierFate, PTD):
    """Adaptive grid-based progressive TIN densification.

    J. Zheng, M. Xiang, T. Zhang, J. Zhou (2024): An improved adaptive grid-based progressive triangulated irregular
    network densification algorithm for filtering airborne LiDAR data. Remote Sensing 16 (20), 3846.
    doi:10.3390/rs16203846

    Outliers by number and by elevation of neighbours are barred from the seeds (Sec. 3.1). Seeds are the lowest points of
    square cells; a cell with enough points and a large relative slope is divided into four, which give a seed each (3.2).
    Then points are added round by round as in :class:`PTD`: a point is ground if its distance to its facet and its angle at
    the nearest vertex are within their limits, on either side; over facets steeper than the terrain angle the mirror image of
    the point about the highest vertex is tested instead (3.3). Lengths in metres, angles in degrees.

    Presets: "recommended" is the default. Its cells of the first level are as large as the largest building; clusters of
    low points are barred in place of the paper's test of elevations, the border points follow the ground, and the terrain angle
    is a constant instead of that of the steepest cell, which in large cells is less than that of the hills in them. "paper"
    has the printed grid for urban points, with the medians of the angles and distances of Table 1.

    Departures (docs/filters/agptd.md): seed cells smaller than buildings, as printed, need a cloud without roofs, which the
    outlier tests of the paper cannot provide; cells count from the anchor of the cloud, zero by default, not from its lower
    left point; removed outliers are tested again instead of being lost; the elevation test
    compares metres with square metres and is replaced; the terrain slope is the largest mean slope of a cell, and
    ``max_terrain_angle`` its upper limit.

    >>> filter_ = jf.AGPTD(levels=1)
    >>> jf.evaluate(filter_(cloud), cloud).total < 10
    True
    """

    seed_cell: float = static(
        "the cells of the first grid level have this size; it must be larger than any building",
        "s_pri > 0 m",
        default=60.0,
    )
    levels: int = static(
        "the grid has this many levels; each halves the cells that it divides", ">= 1 and <= 8", default=2
    )
    least_points: int = static("a cell is divided only if it holds at least this many points", "n_pp >= 2", default=5)
    relative_slope: float = param(
        "a cell is divided if the mean of its slopes exceeds the least of them by this much",
        "s_r >= 0 rise/run",
        default=0.06,
    )
    remainder: str = static(
        "points beyond the last whole cell join it (absorbed), or have smaller cells (own_cells)",
        default="absorbed",
        choices=REMAINDERS,
    )
    terrain_angle: str = static(
        "a point is mirrored over facets steeper than max_terrain_angle, or than the steepest cell if that is less",
        default="constant",
        choices=("constant", "steepest_cell"),
    )
    neighbours: int = static(
        "a point is no seed if its elevation is unlike that of this many neighbours; 0 = no test",
        "k >= 0 and <= 4096",
        default=0,
    )
    radius: float = 6.0
    min_neighbours: int = static(
        "a point is no seed if it has fewer neighbours than this within the radius", "num >= 1 and <= 4096", default=4
    )

    BIBTEX: ClassVar[str] = bibtex("zheng2024improved")
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: seed cells as large as the largest building, clusters of low points are barred"
        ),
        "paper": Preset(
            "as printed for urban points with the medians of Table 1, except that grids begin at zero of the coordinates, not at "
            "the lower left point, that the test of elevations is replaced, whose formula has no unit, and that num = 4 and a "
            "relative slope of 0.06 are not printed",
            remainder="own_cells",
            terrain_angle="steepest_cell",
            neighbours=4,
            low_clusters=False,
            refresh_border=False,
            max_angle=34.0,
            max_distance=0.8,
            seed_cell=6.0,
            outlier_fate="removed",
        ),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        radius = max(1.0, round(6.0 * spacing, 1))  # four times the largest spacing, which is half as much again
        return super().from_spacing(spacing, largest_building) | {"radius": radius}

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        outliers = self.outliers(points, workers)
        progress(0.0, "seeds")
        seeds = lowest_per_adaptive_cell(
            points,
            self.seed_cell,
            outliers.barred,
            levels=self.levels,
            least_points=self.least_points,
            relative_slope=self.relative_slope,
            remainder=self.remainder,
        )
        steepest = self.max_terrain_angle if self.terrain_angle == "constant" else seeds.steepest
        info = {
            "seeds_by_level": [len(rows) for rows in seeds.levels],
            "divided_cells": seeds.divided,
            "terrain_angle": min(self.max_terrain_angle, steepest),
        }
        return dataclasses.replace(surrounded(self, points, seeds.rows, outliers, self.seed_cell), info=info)

    def growth(self, network: Network) -> Growth:
        """Points are mirrored over facets steeper than the limit, or than the steepest cell of the seeds."""
        return dataclasses.replace(super().growth(network), mirror=Mirror(network.info["terrain_angle"]))
