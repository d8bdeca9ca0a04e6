"""STIN: simple TIN densification (Uray & Varlik 2024)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import ParameterError
from ..core.filter import degenerate, of_scene
from ..core.grid import Grid, grid_over, period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress, silent
from ..engines.ground import grow
from ..engines.tin.facets import Rule
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Adaptive, Growth, Network, Vertices
from ..engines.tin.network import corner_positions, one_network
from ..steps.outlier_filter import OutlierFate
from ..steps.seeds import lowest_on_grid
from ..steps.tin_filter import SlopeMirroring, growth_of, seeds_of
from ..steps.trend import low_trend, quadratic_trend
from .papers import bibtex

_SAMPLE = 2_000_000
"""Points that tell how many rounds there are on each grid."""
_OUTLIER_CELL = 10.0
"""Metres: cells that the surface is made from which outliers are far from (Uray & Varlik 2024)."""
QUANTILE = 0.97
"""Share of the ground points that stays within the limits when they are lowered."""


def _side_by_side(clouds: Sequence[PointCloud], cell: float) -> PointCloud:
    """The candidates of several clouds as one, each moved by a multiple of ``cell`` metres, five cells from the next.

    A single one stays where it is, as other lattices than that of ``cell`` would be moved against it.
    """
    if len(clouds) == 1:
        return clouds[0]
    moved, east = [np.zeros((0, 3))], 0.0
    for cloud in clouds:
        xyz = cloud.origin * cloud.units.factor + cloud.xyz[cloud.candidate]
        if not len(xyz):
            continue
        corner = np.floor(xyz[:, :2].min(axis=0) / cell) * cell
        moved.append(xyz - [corner[0] - east, corner[1], 0.0])
        east += (math.ceil(np.ptp(xyz[:, 0]) / cell) + 6) * cell
    whole = next((cloud.whole for cloud in clouds if cloud.whole is not None), None)
    return PointCloud.from_arrays(np.concatenate(moved), anchor=(0.0, 0.0), whole=whole)


@filter_params
class STIN(OutlierFate, SlopeMirroring):
    """Simple TIN densification.

    F. Uray, A. Varlik (2024): Filtering airborne LIDAR data using simple triangulation irregular network. Necmettin Erbakan
    University Journal of Science and Engineering 6 (3), 495-511. doi:10.47112/neufmbd.2024.61

    Points far from a smooth surface are outliers and no seeds. Four simulated points stand around the cloud, 10 m outside.
    The lowest point of every cell of a grid as large as the largest building is ground. Only the lowest *ground* point of
    each cell is a vertex of the triangulation. The other points are tested: those within a distance of their facet, and
    within an angle at its vertices, on either side, are ground too. With ``mirror="nearest"`` the mirror
    image of a point is tested as well over facets steeper than a slope (eqs. 1 to 3). This is repeated while a round adds a
    thousandth of all points or more; then the cells are halved, down to 2 m. Lengths in metres, angles in degrees, slopes
    in percent.

    Presets: "recommended" is the default; it takes as outliers what lies below the trend of the low terrain and clusters of
    low points, and mirrors nothing. "paper" takes everything as printed, with the medians of Table 2 as upper limits of
    thresholds that are recomputed from the ground so far.

    Departures (docs/filters/stin.md): outliers are tested again instead of being lost, unless ``outlier_fate`` is "removed".

    >>> result = jf.STIN(seed_cell=30.0)(cloud)
    >>> jf.evaluate(result, cloud).total < 10
    True
    """

    max_angle: float = param(
        "a point is ground only if its angle to the facet is at most this", "alpha > 0 and < 90 degrees", default=30.0
    )
    max_distance: float = param(
        "a point is ground only if it lies at most this far from its facet", "d > 0 m", default=1.4
    )
    seed_cell: float = static(
        "each cell of the first grid has this size and one seed; it must be larger than any building",
        "> 0 m",
        default=60.0,
    )
    final_cell: float = static("the cells are halved until they have this size", "> 0 m", default=2.0)
    stop_ratio: float = param(
        "the cells are halved when a round adds less than this share of all distinct candidates",
        "> 0 and <= 1",
        default=0.001,
    )
    thresholds: str = static(
        "the limits stay the same (constant), or are lowered as the cells get smaller (quantile)",
        default="constant",
        choices=("constant", "quantile"),
    )
    outlier_surface: str = static(
        "outliers lie far from one surface of second degree (quadratic), or far below the low terrain (local)",
        default="local",
        choices=("quadratic", "local", "off"),
    )
    outlier_distance: float = param(
        "a point is an outlier if it lies further than this from that surface", "> 0 m", default=5.0
    )

    BIBTEX: ClassVar[str] = bibtex("uray2024filtering")
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: 30 degrees and 1.4 m, no mirroring; no seeds below the trend of the low terrain or in clusters of "
            "low points"
        ),
        "paper": Preset(
            "as printed with the medians of Table 2, except that how limits follow from histograms is not printed: the 0.97 "
            "quantile of the ground so far whenever cells are halved, at most these medians",
            seed_cell=30.0, max_terrain_slope=10.0, max_distance=2.4, max_angle=30.0, thresholds="quantile",
            mirror="nearest", low_clusters=False, outlier_surface="quadratic", outlier_fate="removed",
        ),
    }  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.final_cell > self.seed_cell:
            raise ParameterError(f"STIN(final_cell={self.final_cell!r}): must not exceed seed_cell={self.seed_cell!r}")

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        fixed = super().from_spacing(spacing, largest_building)
        return fixed if largest_building is None else fixed | {"final_cell": min(2.0, largest_building)}

    def lattice(self) -> float:
        """Whole cells of the seeds, of the finest grid and of the outlier surface."""
        return period(self.seed_cell, self.final_cell, _OUTLIER_CELL)

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        known = self.outliers(points, workers)
        outliers = known._replace(barred=known.barred | self.far_from_surface(points))
        progress(0.0, "seeds")
        seeds = lowest_on_grid(points, self.grids(points)[0], outliers.barred)
        return one_network(points, seeds_of(self, points, seeds), corner_positions(*points.extent), outliers)

    def growth(self, network: Network) -> Growth:
        whole = network.points.cloud.whole
        planned = None if whole is None else whole.rounds
        vertices = Vertices(grids=self.grids(network.points), stop_share=float(self.stop_ratio), rounds=planned)
        adaptive = Adaptive(self.lowered, of_ground=True) if self.thresholds == "quantile" else None
        return dataclasses.replace(super().growth(network), vertices=vertices, adaptive=adaptive)

    def far_from_surface(self, points: Points) -> np.ndarray:
        """bool[m]: outliers. Further from the quadratic surface than the limit, or as far below the low terrain."""
        if self.outlier_surface == "off":
            return np.zeros(len(points), bool)
        if self.outlier_surface == "quadratic":
            return np.abs(points.xyz[:, 2] - quadratic_trend(points.xyz, _OUTLIER_CELL)) > self.outlier_distance
        grid = grid_over(points.xyz, _OUTLIER_CELL, points.offset(_OUTLIER_CELL), name="cell of STIN's outlier surface")
        return low_trend(points.xyz, grid.x0, grid.y0, _OUTLIER_CELL) - points.xyz[:, 2] > self.outlier_distance

    def grids(self, points: Points) -> list[Grid]:
        """Grids of square cells from ``seed_cell`` down to ``final_cell``, each half as large as the one before."""
        cells = [self.seed_cell]
        while cells[-1] > self.final_cell:
            cells.append(max(cells[-1] / 2.0, self.final_cell))
        names = ["STIN(seed_cell)", *len(cells[1:]) * [f"STIN(final_cell={self.final_cell!r}): cell"]]
        return [grid_over(points.xyz, c, points.offset(c), name) for c, name in zip(cells, names, strict=True)]

    def lowered(self, distance: np.ndarray, angle: np.ndarray) -> Rule:
        """The limits, or where it is less the 0.97 quantile of the ground points' distances f32[g] and angles f32[g]."""
        far, steep = (float(np.quantile(values, QUANTILE)) for values in (distance, angle))
        angle_limit, distance_limit = min(float(self.max_angle), steep), min(float(self.max_distance), far)
        return Rule(max_angle=angle_limit, max_distance=distance_limit, noise_floor=self.noise_floor)


@of_scene.register(STIN)
def _of_scene(filter_: STIN, some: Callable[[int], list[PointCloud]]) -> dict[str, Any]:
    """The number of rounds on each grid: a part does not know what share of *all* points a round adds."""
    points = filter_.points_of(_side_by_side(some(_SAMPLE), filter_.seed_cell))
    if degenerate(points.cloud, points) is not None:
        return {}
    network = filter_.start(points, None, silent)
    with GroundTin.start(network, growth_of(filter_, network)) as out:
        grow(out, filter_.max_rounds)
    rounds = [filter_.max_rounds] * (len(filter_.grids(points)) + 1)
    for step in out.trace:
        if "stage" in step and not step["enough"]:  # else the stage ended since nothing was left to be tested
            rounds[step["stage"]] = 1 + sum(s.get("stage") == step["stage"] for s in out.trace[: out.trace.index(step)])
    return {"rounds": tuple(rounds)}
