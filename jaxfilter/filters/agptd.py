"""AGPTD: progressive TIN densification from the seeds of an adaptive grid (Zheng et al. 2024)."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import jax
import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.compilation import bucket
from ..core.errors import ParameterError
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points, canonical_points
from ..core.result import FilterResult, Progress
from ..ops.facets import Rule
from ..stages.adaptive_grid import REMAINDERS, lowest_per_adaptive_cell
from ..stages.densify import Mirror
from ..stages.tin_filter import Start, TinFilter, facet_reach

_PAPER = {
    "max_angle": 34.0,
    "max_distance": 0.8,
    "seed_cell": 6.0,
    "remainder": "own_cells",
    "terrain_angle": "steepest_cell",
    "neighbours": 4,
    "low_clusters": False,
    "refresh_border": False,
}
_TABLE1 = {
    11: (39.0, 0.8), 12: (34.0, 0.6), 21: (45.0, 0.4), 22: (35.0, 1.0), 23: (34.0, 1.2),
    24: (39.0, 0.7), 31: (34.0, 0.5), 41: (45.0, 1.4), 42: (37.0, 0.5), 51: (26.0, 0.5),
    52: (28.0, 1.2), 53: (29.0, 1.4), 54: (15.0, 0.6), 61: (28.0, 1.0), 71: (35.0, 0.9),
}  # fmt: skip
"""max_angle and max_distance that the paper's Table 1 gives each ISPRS sample."""


def _sample(number: int) -> Preset:
    """The settings of an ISPRS sample: radius by Sec. 3.1.1, seed cell by the number of seeds in Table 4."""
    angle, distance = _TABLE1[number]
    rural = number > 50
    cell = 8.0 if rural else 4.0 if number == 41 else 6.0
    radius = 14.0 if rural else 6.0
    own = {"max_angle": angle, "max_distance": distance, "seed_cell": cell, "radius": radius}
    text = f"ISPRS sample {number}: theta = {angle:g}, d = {distance:g}, s_pri = {cell:g}, r = {radius:g}"
    return Preset(text, **_PAPER | own)


@filter_params
class AGPTD(TinFilter):
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
    low points are barred in place of the paper's outlier tests, the border points follow the ground, and the terrain angle
    is a constant instead of that of the steepest cell, which in large cells is less than that of the hills in them. "paper"
    has the printed grid for urban points, with the medians of the angles and distances of Table 1. "samp11" to "samp71"
    have the values of Table 1 for the ISPRS samples, which the authors chose by trial on these samples.

    Departures (docs/fidelity.md): seed cells smaller than buildings, as printed, need a cloud without roofs, which the
    outlier tests of the paper cannot provide; removed outliers are tested again instead of being lost; the elevation test
    compares metres with square metres and is replaced; the terrain slope is the largest mean slope of a cell.

    ``oracle_removal`` is for research only. It takes away a share of the points that the cloud's reference labels call
    objects, as the paper's Table 3 reports of its outlier removal. Its result has ``info["uses_labels"]`` True.
    """

    max_angle: float = param(15.0, symbol="theta", unit="degrees", gt=0, lt=90, doc="largest angle: facet to point")
    max_distance: float = param(1.4, symbol="d", unit="m", gt=0, doc="largest distance: point to facet plane")
    seed_cell: float = static(
        60.0, symbol="s_pri", unit="m", gt=0, doc="cell of the first grid level; larger than any building"
    )
    levels: int = static(2, ge=1, le=8, doc="grid levels; each halves the cells that it divides")
    least_points: int = static(5, symbol="n_pp", ge=2, doc="a cell with fewer points is not divided")
    relative_slope: float = param(
        0.06, symbol="s_r", ge=0, doc="divide cells whose mean slope less the least exceeds this (rise over run)"
    )
    remainder: str = static(
        "absorbed", choices=REMAINDERS, doc="what lies beyond the last whole cell joins it, or makes smaller cells"
    )
    mirror: str = static("highest", choices=("highest", "nearest", "off"), doc="vertex that points are mirrored about")
    mirror_mode: str = static(
        "replace", choices=("replace", "or"), doc="test the mirror image instead of the point, or as a second chance"
    )
    terrain_angle: str = static(
        "constant",
        choices=("constant", "steepest_cell"),
        doc="mirror over facets steeper than max_terrain_angle, or than the steepest mean slope of a cell",
    )
    max_terrain_angle: float = static(
        88.0, unit="degrees", gt=0, le=90, doc="mirror over steeper facets; the upper limit of steepest_cell"
    )
    refresh_border: bool = static(True, choices=(True, False), doc="simulated border points follow the growing ground")
    neighbours: int = static(
        0, symbol="k", ge=0, doc="neighbours of the test that bars points of odd elevation from the seeds; 0 = off"
    )
    deviations: float = param(3.0, gt=0, doc="standard deviations at which the elevation of a point is odd")
    oracle_removal: float = static(
        0.0, ge=0, le=1, doc="research only, uses labels: share of the reference objects to take away first"
    )
    _: dataclasses.KW_ONLY
    radius: float = static(6.0, symbol="r", unit="m", ge=0, doc="radius of the outlier test; 0 = off")
    min_neighbours: int = static(
        4, symbol="num", ge=1, doc="a point with fewer neighbours within the radius is no seed"
    )

    NOT_SWEPT: ClassVar[tuple[str, ...]] = ("oracle_removal",)
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: seed cells as large as the largest building, clusters of low points are barred"
        ),
        "paper": Preset(
            "as printed for urban points with the medians of Table 1, except that the test of elevations is replaced, whose "
            "formula has no unit, and that num = 4 and a relative slope of 0.06 are not printed",
            **_PAPER,
            outlier_fate="removed",
        ),
        **{f"samp{number}": _sample(number) for number in _TABLE1},
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        radius = max(1.0, round(6.0 * spacing, 1))  # four times the largest spacing, which is half as much again
        own = {} if largest_building is None else {"seed_cell": largest_building}
        return super().from_spacing(spacing, largest_building) | own | {"radius": radius}

    def halo(self) -> float:
        """The half diagonal of a seed cell and its eight neighbours: how far facets between seeds reach.

        The steepest cell and the spread of elevations are taken over the whole cloud, or tile, at any distance.
        """
        return facet_reach(self.seed_cell)

    def __call__(
        self,
        cloud: Any,
        *,
        key: Any = None,
        workers: int | None = None,
        progress: Progress | None = None,
        trace: bool = False,
    ) -> FilterResult:
        cloud = as_cloud(cloud)
        if self.oracle_removal > 0:
            cloud = without_labelled_objects(cloud, self.oracle_removal, jax.random.key(0) if key is None else key)
        result = super().__call__(cloud, key=key, workers=workers, progress=progress, trace=trace)
        result.info["uses_labels"] = self.oracle_removal > 0
        return result

    def outliers(self, points: Points, workers: int | None, **tests: Any) -> tuple[np.ndarray, np.ndarray]:
        """As in the other TIN filters, and points whose elevation is unlike that of their neighbours."""
        return super().outliers(points, workers, neighbours=self.neighbours, deviations=self.deviations, **tests)

    def start(self, points: Points, workers: int | None, progress: Progress) -> Start:
        progress(0.0, "outliers")
        barred, late = self.outliers(points, workers)
        progress(0.0, "seeds")
        seeds = lowest_per_adaptive_cell(
            points,
            self.seed_cell,
            barred,
            levels=self.levels,
            least_points=self.least_points,
            relative_slope=self.relative_slope,
            remainder=self.remainder,
        )
        limit = self.max_terrain_angle
        if self.terrain_angle == "steepest_cell":
            limit = min(limit, seeds.steepest)
        return Start(
            self.network(points, seeds.rows, self.seed_cell, late),
            barred,
            late,
            Mirror(limit, self.mirror, self.mirror_mode),
            self.refresh_border,
            {
                "seeds_by_level": [len(rows) for rows in seeds.levels],
                "divided_cells": seeds.divided,
                "terrain_angle": limit,
            },
        )

    def limits(self) -> Rule:
        return self.rule(max_angle=self.max_angle, max_distance=self.max_distance)


def without_labelled_objects(cloud: PointCloud, share: float, key: jax.Array) -> PointCloud:
    """The cloud with a share (0 to 1) of its objects set aside at random. It reads the reference labels: research only.

    Which ones depends on ``key`` and on the coordinates, not on the order of the points. Points that coincide go
    together, and stay if one of them is ground. Raises: ParameterError if the cloud has no reference labels.
    """
    if cloud.reference is None:
        raise ParameterError(
            "AGPTD(oracle_removal > 0) takes away labelled objects and needs a cloud with reference labels; this one has "
            "none. It is a switch for research: leave it at 0 to classify a cloud"
        )
    points = canonical_points(cloud)
    is_object = np.ones(len(points), bool)
    is_object[points.member[cloud.reference[points.index]]] = False
    objects = np.flatnonzero(is_object)
    draw = np.asarray(jax.random.uniform(key, (bucket(len(points)),)))[objects]
    removed = np.zeros(len(points), bool)
    removed[objects[np.argsort(draw, kind="stable")[: round(share * len(objects))]]] = True
    candidate = cloud.candidate.copy()
    candidate[points.index[removed[points.member]]] = False
    return dataclasses.replace(cloud, candidate=candidate)
