"""ATIN: adaptive TIN densification, in the form in which Axelsson (2000) is compared with STIN."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np

from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..engines.tin.facets import Rule
from ..engines.tin.growth import Adaptive, Growth, Network, Outliers
from ..engines.tin.network import corner_positions, one_network
from ..steps.tin_filter import SlopeMirroring, seeds_of
from .papers import bibtex
from .ptd import PTD

_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
_DEVIATIONS = 15.0
"""The limits are this many standard deviations above the median."""


@filter_params
class ATIN(SlopeMirroring, PTD):
    """Adaptive TIN densification.

    P. Axelsson (2000): DEM generation from laser scanner data using adaptive TIN models. Int. Arch. Photogramm. Remote
    Sens. 33 (B4), 110-117. Parameters as in F. Uray, A. Varlik (2024), Table 2, doi:10.47112/neufmbd.2024.61

    Seeds are the lowest points of square cells as large as the largest building. All ground points are vertices. In each
    round a point is ground if its distance to the facet it lies in, and its angles at the vertices, are within limits, on
    either side. With ``thresholds="adaptive"`` the limits are derived from the triangulation before each round, and never
    exceed the user's. With ``mirror="nearest"`` the mirror image of a point about the nearest vertex is tested too over
    facets steeper than a slope. Lengths in metres, angles in degrees, slopes in percent.

    How the limits follow from the data is a reconstruction (docs/filters/atin.md): the median plus 15 standard
    deviations, robustly estimated, of the distances (angles) of vertices over the facets next to theirs. With
    ``thresholds="constant"``, the default, it is PTD with other defaults.

    Presets: "recommended" is the default; border points follow the ground, clusters of low points are no seeds, and the
    limits are constant, since in no variant that was tried did adaptive ones do better on simulated scenes. "paper" has
    adaptive limits, four corner points and the medians of Table 2 of Uray & Varlik (2024).

    >>> filter_ = jf.ATIN(thresholds="adaptive", max_distance=1.4)
    >>> filter_(cloud).status.message
    'finished'
    """

    max_angle: float = param(
        "a point is ground only if its angle to the facet is at most this", "alpha > 0 and < 90 degrees", default=25.0
    )
    thresholds: str = static(
        "the limits stay the same (constant), or each round derives some that are no larger from its triangulation (adaptive)",
        default="constant",
        choices=("constant", "adaptive"),
    )
    border: str = static(
        "simulated points stand all round the data (perimeter), or only at its four corners (corners)",
        default="perimeter",
        choices=("perimeter", "corners"),
    )

    max_terrain_angle: ClassVar[float] = 90.0  # type: ignore[misc]  # no field of this method, whose mirroring goes by a slope
    BIBTEX: ClassVar[str] = bibtex("axelsson2000dem", "uray2024filtering")
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: border points all round follow the ground, clusters of low points are no seeds, no mirroring, "
            "constant limits"
        ),
        "paper": Preset(
            "as reported by Uray and Varlik (2024) with the medians of their Table 2, except that how limits follow from "
            "histograms is not reported: median plus 15 robust standard deviations, at most these medians",
            thresholds="adaptive", border="corners", refresh_border=False, low_clusters=False, mirror="nearest",
            seed_cell=30.0, max_terrain_slope=10.0, max_distance=2.4, max_angle=30.0,
        ),
    }  # fmt: skip

    def network(self, points: Points, seeds: np.ndarray, outliers: Outliers) -> Network:
        if self.border == "perimeter":
            return super().network(points, seeds, outliers)
        return one_network(points, seeds_of(self, points, seeds), corner_positions(*points.extent), outliers)

    def growth(self, network: Network) -> Growth:
        adaptive = Adaptive(self.adapted) if self.thresholds == "adaptive" else None
        return dataclasses.replace(super().growth(network), adaptive=adaptive)

    def adapted(self, distance: np.ndarray, angle: np.ndarray) -> Rule:
        """Thresholds from distances f32[s], metres, and angles f32[s], degrees, of vertices over the facets next to theirs.

        They are whole steps of 5 cm and of one degree, rounded up: what differs by a hair then gets the same labels.
        """

        def above(values: np.ndarray, step: float, most: float) -> float:
            middle = np.median(values)
            spread = _SIGMA * np.median(np.abs(values - middle))
            return min(float(most), step * math.ceil((middle + _DEVIATIONS * spread) / step))

        return Rule(
            max_angle=above(angle, 1.0, self.max_angle),
            max_distance=above(distance, 0.05, self.max_distance),
            noise_floor=self.noise_floor,
        )
