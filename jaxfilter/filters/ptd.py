"""PTD: progressive TIN densification (Axelsson 2000) in the form of Zhang & Lin (2013)."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import numpy as np

from ..core.filter import Filter, Labels
from ..core.params import filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..ops.facets import Rule
from ..stages.densify import Mirror, densify
from ..stages.network import border_positions, labels_of, one_network
from ..stages.outliers import bar_outliers
from ..stages.seeds import lowest_per_cell


@filter_params
class PTD(Filter):
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
    (2021), Table I, with e as the distance, for the comparison in their Table IV: they print no values for PTD, and these,
    with ``refresh_border=False``, come within half a point of total error on two thirds of its rows.

    Departure (docs/fidelity.md): all points that pass in a round are added together, so that their order does not matter.
    """

    max_angle: float = param(15.0, symbol="theta", unit="degrees", gt=0, lt=90, doc="iteration angle: facet to point")
    max_distance: float = param(1.4, symbol="d", unit="m", gt=0, doc="iteration distance: point to facet plane")
    seed_cell: float = static(60.0, symbol="m", unit="m", gt=0, doc="cell with one seed; larger than any building")
    max_terrain_angle: float = static(88.0, symbol="t", unit="degrees", gt=0, le=90, doc="mirror over steeper facets")
    mirror: str = static("highest", choices=("highest", "nearest", "off"), doc="vertex that points are mirrored about")
    mirror_mode: str = static(
        "replace", choices=("replace", "or"), doc="test the mirror image instead of the point, or as a second chance"
    )
    refresh_border: bool = static(
        True, choices=(True, False), doc="simulated border points follow the growing ground, as in FPTD"
    )
    radius: float = static(0.0, symbol="r", unit="m", ge=0, doc="radius of the outlier test; 0 = off")
    min_neighbours: int = static(10, symbol="n", ge=1, doc="a point with fewer neighbours within the radius is no seed")
    low_clusters: bool = static(True, choices=(True, False), doc="bar clusters of low outliers from the seeds")
    noise_floor: float = param(0.0, unit="m", ge=0, doc="accept points this close to their facet at any angle; 0 = off")
    vertex_spacing: float = static(
        0.0, unit="m", ge=0, doc="at most one vertex per square of this size; 0 = all points"
    )
    max_rounds: int = static(100, ge=1, doc="limit of densification rounds")

    PRESETS: ClassVar[dict[str, dict[str, Any]]] = {
        "recommended": {},
        "paper": {"low_clusters": False, "refresh_border": False},
        "D1": {"max_angle": 18.0, "max_distance": 1.0},
        "D2": {"max_angle": 22.0, "max_distance": 1.2},
        "D3": {"max_angle": 30.0, "max_distance": 0.8},
        "D4": {"max_angle": 38.0, "max_distance": 1.4},
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float) -> dict[str, Any]:
        dense = spacing < 0.5
        return {
            "seed_cell": largest_building,
            "noise_floor": 0.1 if dense else 0.0,
            "vertex_spacing": 0.7 if dense else 0.0,
        }

    def halo(self) -> float:
        """The half diagonal of a seed cell and its eight neighbours: how far facets between seeds reach."""
        return 1.5 * math.sqrt(2.0) * self.seed_cell

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        progress(0.0, "outliers")
        barred, late = bar_outliers(
            points,
            radius=self.radius,
            min_neighbours=self.min_neighbours,
            clusters=self.low_clusters,
            workers=workers,
        )
        progress(0.0, "seeds")
        seeds = lowest_per_cell(points, self.seed_cell, barred)
        xy = points.xyz[:, :2].astype(np.float64)
        border = border_positions(xy.min(axis=0), xy.max(axis=0), self.seed_cell)
        network = one_network(points, seeds, border, late)
        rule = Rule(
            max_angle=self.max_angle,
            max_distance=self.max_distance,
            noise_floor=self.noise_floor if self.noise_floor > 0 else -1.0,
        )
        mirror = None if self.mirror == "off" else Mirror(self.max_terrain_angle, self.mirror, self.mirror_mode)
        out = densify(
            network,
            rule,
            mirror=mirror,
            refresh_border=self.refresh_border,
            vertex_spacing=self.vertex_spacing,
            max_rounds=self.max_rounds,
            workers=workers,
            progress=progress,
            keep_labels=trace,
        )
        return labels_of(points, network, out, barred=barred, late=late, keep_labels=trace)
