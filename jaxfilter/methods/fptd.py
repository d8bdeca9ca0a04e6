"""FPTD: fast progressive TIN densification with adjacent surface information (Li et al. 2021)."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar

from ..core.errors import ParameterError
from ..core.grid import period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.tin.growth import Growth, Network
from ..engines.tin.network import block_networks, border_positions
from ..steps.outlier_filter import OutlierRadius
from ..steps.seeds import lowest_per_window
from ..steps.tin_filter import VertexSpacing, seeds_of, surrounded
from .papers import bibtex


@filter_params
class FPTD(OutlierRadius, VertexSpacing):
    """Fast progressive TIN densification.

    H. Li, C. Ye, Z. Guo, R. Wei, L. Wang, J. Li (2021): A fast progressive TIN densification filtering algorithm for
    airborne LiDAR data using adjacent surface information. IEEE J. Sel. Topics Appl. Earth Obs. Remote Sens. 14.
    doi:10.1109/JSTARS.2021.3131586

    Outliers are barred from the seeds (Sec. II-B). Seeds are the lowest points of windows that slide over the cloud by a
    stride smaller than their size (II-C); simulated points surround them (II-D). Then rounds of densification: a point is
    ground if its elevation over the highest vertex of its facet (eq. 2) and its signed angle to the facet at the nearest
    vertex (eq. 3) are within their limits, so that points below the facet pass (II-E). Lengths in metres, angles in degrees.

    Presets: "recommended" is the default. It triangulates all points together, and takes the place of the radius filter and
    of the manual removal of low outliers by :func:`jaxfilter.steps.outliers.low_clusters`. "paper" runs independent blocks
    with the radius filter (r = 5 m, n = 10) only.
    "D1" flat, "D2" gentle slope, "D3" flat with scarps, "D4" steep: the thresholds of Table I on the recommended
    machinery, since the manual edits behind the paper's Table IV cannot be repeated.

    Departures (docs/filters/fptd.md), in "paper" too: windows count from the anchor of the cloud, zero by default, not from its
    lower left point; removed outliers are tested again instead of being lost; the limit of step 1 of II-E follows the growing
    ground, in which form it never rejects a point that the elevation test would accept. Taken literally, the last two would
    make the errors of Table IV impossible.

    >>> filter_ = jf.FPTD.preset("D1", max_elevation=1.0)
    >>> result = filter_(cloud)
    >>> bool((result.margin[result.ground & (result.decision != jf.Decision.SEED)] <= 0).all())
    True
    """

    max_angle: float = param(
        "a point is ground only if its angle to the facet is at most this", "a > 0 and < 90 degrees", default=22.0
    )
    max_elevation: float = param(
        "a point is ground only if it stands at most this high over the highest vertex of its facet",
        "e > 0 m",
        default=1.2,
    )
    window: float = static(
        "the seed window and the blocks have this size; it must be larger than any building", "w > 0 m", default=60.0
    )
    stride: float = static("the seed window moves by this step", "s > 0 m", default=10.0)
    blocks: str = static(
        "all points are in one triangulation (global), or blocks of them grow on their own (independent)",
        default="global",
        choices=("global", "independent"),
    )

    BIBTEX: ClassVar[str] = bibtex("li2021fptd")
    WINDOW: ClassVar[str] = "window"
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset("the default: one triangulation, clusters of low points barred from the seeds"),
        "paper": Preset(
            "as printed, except that grids begin at zero of the coordinates, not at the lower left point, that removed points "
            "are tested again and the limit of step 1 follows the ground, as Table IV implies, and that nothing takes the place "
            "of manual removal",
            blocks="independent",
            radius=5.0,
            low_clusters=False,
        ),
        "D1": Preset("flat: a = 18, e = 1.0", max_angle=18.0, max_elevation=1.0),
        "D2": Preset("flat with gentle slopes: a = 22, e = 1.2", max_angle=22.0, max_elevation=1.2),
        "D3": Preset("flat with scarps: a = 30, e = 0.8", max_angle=30.0, max_elevation=0.8),
        "D4": Preset("steep: a = 38, e = 1.4", max_angle=38.0, max_elevation=1.4),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.stride > self.window:
            raise ParameterError(
                f"FPTD(stride={self.stride!r}): must not exceed window={self.window!r}, or points are skipped"
            )

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        fixed = super().from_spacing(spacing, largest_building)
        if largest_building is None:
            return fixed
        stride = math.ceil(largest_building / 0.6 - 1e-9) / 10.0  # a sixth of the window, which so is a multiple of it
        return fixed | {"window": round(6 * stride, 1), "stride": stride}

    def lattice(self) -> float:
        """Whole steps of the windows, and whole blocks, which simulated border points stand apart."""
        return period(self.stride, self.window)

    def growth(self, network: Network) -> Growth:
        growth = super().growth(network)
        return dataclasses.replace(growth, rule=growth.rule._replace(signed=1.0), border_follows=True)

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        outliers = self.outliers(points, workers)
        progress(0.0, "seeds")
        name = f"FPTD(window={self.window!r}, stride={self.stride!r})"
        seeds = lowest_per_window(points, self.window, self.stride, outliers.barred, name)
        if self.blocks == "independent":
            border = border_positions(*points.extent, self.window, points.anchored(), "FPTD(window)")
            reach = 1.5 * math.sqrt(2.0) * self.window  # the half diagonal of a window and its eight neighbours
            sizes = {"size": self.window, "overlap": self.stride, "reach": reach}
            return block_networks(points, seeds_of(self, points, seeds), border, outliers, **sizes)
        return surrounded(self, points, seeds, outliers, self.window)
