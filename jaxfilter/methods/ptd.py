"""PTD: progressive TIN densification (Axelsson 2000) in the form of Zhang & Lin (2013)."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.tin.growth import Growth, Network, Outliers
from ..steps.seeds import lowest_per_cell
from ..steps.tin_filter import TerrainAngle, surrounded
from .papers import bibtex


@filter_params
class PTD(TerrainAngle):
    """Classic progressive TIN densification.

    P. Axelsson (2000): DEM generation from laser scanner data using adaptive TIN models. Int. Arch. Photogramm. Remote
    Sens. 33 (B4). J. Zhang, X. Lin (2013): Filtering airborne LiDAR data by embedding smoothness-constrained segmentation
    in progressive TIN densification. ISPRS J. Photogramm. Remote Sens. 81, 44-59. doi:10.1016/j.isprsjprs.2013.04.001

    Seeds are the lowest points of square cells as large as the largest building. In each round a point is ground if its
    distance to the facet it lies in, and its angle at the nearest vertex, are within their limits, on either side of the
    facet. Over a facet steeper than the terrain angle, the mirror image of the point about a vertex of the facet is tested
    instead. Lengths in metres, angles in degrees.

    Presets: "recommended" is the default; it bars clusters of low points from the seeds and lets the simulated border
    points follow the growing ground. "paper" is the plain method with neither. "D1" to "D4" take the thresholds of Li et al.
    (2021), Table I, with e as the distance, for the comparison in their Table IV: they print no values for PTD, and these come
    closest to it with ``refresh_border=False`` on clouds whose anchor is their lower left point (docs/filters/ptd.md).

    All points that pass in a round are added together (docs/fidelity.md has figures of other ways).

    >>> result = jf.PTD(max_angle=15.0, max_distance=1.4)(cloud)
    >>> sorted({jf.Decision(int(number)).name for number in result.decision[result.ground]})
    ['ACCEPTED', 'SEED']
    """

    max_angle: float = param(
        "a point is ground only if its angle to the facet is at most this", "theta > 0 and < 90 degrees", default=15.0
    )
    max_distance: float = param(
        "a point is ground only if it lies at most this far from its facet", "d > 0 m", default=1.4
    )
    seed_cell: float = static(
        "each square cell of this size has one seed, its lowest point; it must be larger than any building",
        "m > 0 m",
        default=60.0,
    )
    refresh_border: bool = static("the simulated border points follow the ground as it grows", default=True)

    BIBTEX: ClassVar[str] = bibtex("axelsson2000dem", "zhang2013filtering")
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: clusters of low points are barred from the seeds, border points follow the ground"
        ),
        "paper": Preset(
            "as reported by those who compare with it, except that grids begin at zero of the coordinates, not at the lower "
            "left point, that the border points are those of Li et al. (2021) and that facets are divided whatever the length "
            "of their edges",
            low_clusters=False,
            refresh_border=False,
        ),
        "D1": Preset("flat: theta = 18, d = 1.0", max_angle=18.0, max_distance=1.0),
        "D2": Preset("flat with gentle slopes: theta = 22, d = 1.2", max_angle=22.0, max_distance=1.2),
        "D3": Preset("flat with scarps: theta = 30, d = 0.8", max_angle=30.0, max_distance=0.8),
        "D4": Preset("steep: theta = 38, d = 1.4", max_angle=38.0, max_distance=1.4),
    }

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        outliers = self.outliers(points, workers)
        progress(0.0, "seeds")
        name = f"{type(self).__name__}(seed_cell={self.seed_cell!r})"
        return self.network(points, lowest_per_cell(points, self.seed_cell, outliers.barred, name), outliers)

    def network(self, points: Points, seeds: np.ndarray, outliers: Outliers) -> Network:
        """The seeds, i64[s], within simulated border points."""
        return surrounded(self, points, seeds, outliers, self.seed_cell)

    def growth(self, network: Network) -> Growth:
        return dataclasses.replace(super().growth(network), border_follows=self.refresh_border)
