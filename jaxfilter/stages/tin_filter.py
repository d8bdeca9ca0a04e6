"""What the methods that densify a triangulation share: the fields for outliers and insertion, and the steps around them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from ..core.filter import Filter, Labels
from ..core.params import param, static
from ..core.points import Points
from ..core.result import Progress
from ..ops.facets import Rule
from .densify import INSERTIONS, Adaptive, Mirror, Vertices, densify
from .network import Network, border_positions, labels_of, one_network
from .outliers import bar_outliers


def facet_reach(cell: float) -> float:
    """Metres: the half diagonal of a cell and its eight neighbours, how far facets between one seed per cell reach."""
    return 1.5 * math.sqrt(2.0) * cell


@dataclasses.dataclass(frozen=True, kw_only=True)
class TinFilter(Filter):
    """Base of the methods that grow the ground from seeds on a triangulation. Lengths in metres."""

    radius: float = static(0.0, symbol="r", unit="m", ge=0, doc="radius of the outlier test; 0 = off")
    min_neighbours: int = static(10, symbol="n", ge=1, doc="a point with fewer neighbours within the radius is no seed")
    low_clusters: bool = static(True, choices=(True, False), doc="bar clusters of low outliers from the seeds")
    noise_floor: float = param(0.0, unit="m", ge=0, doc="accept points this close to their facet at any angle; 0 = off")
    vertex_spacing: float = static(
        0.0, unit="m", ge=0, doc="at most one vertex per square of this size; 0 = all points"
    )
    insertion: str = static(
        "batch", choices=INSERTIONS, doc="add all points that pass in a round, or the lowest over each facet"
    )
    max_rounds: int = static(100, ge=1, doc="limit of densification rounds")

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float) -> dict[str, Any]:
        """Above four points per square metre, ranging noise makes steep angles at short range."""
        dense = spacing < 0.5
        return {"noise_floor": 0.1 if dense else 0.0, "vertex_spacing": 0.7 if dense else 0.0}

    def outliers(self, points: Points, workers: int | None, **tests: Any) -> tuple[np.ndarray, np.ndarray]:
        """bool[m] points that must not be seeds, and bool[m] those among them that lie in clusters of low points.

        ``tests``: further ones, see :func:`jaxfilter.stages.outliers.bar_outliers`.
        """
        return bar_outliers(
            points,
            radius=self.radius,
            min_neighbours=self.min_neighbours,
            clusters=self.low_clusters,
            workers=workers,
            **tests,
        )

    def network(self, points: Points, seeds: np.ndarray, border_cell: float, late: np.ndarray) -> Network:
        """All points in one triangulation of the seeds (i64[s]), with border points every ``border_cell`` metres."""
        xy = points.xyz[:, :2].astype(np.float64)
        border = border_positions(xy.min(axis=0), xy.max(axis=0), border_cell)
        return one_network(points, seeds, border, late)

    def rule(self, **limits: float) -> Rule:
        """The thresholds of a test, with the noise floor of the method."""
        return Rule(noise_floor=self.noise_floor if self.noise_floor > 0 else -1.0, **limits)

    def grow(
        self,
        points: Points,
        network: Network,
        rule: Rule,
        *,
        barred: np.ndarray,
        late: np.ndarray,
        mirror: Mirror | None = None,
        refresh_border: bool = False,
        vertices: Vertices | None = None,
        adaptive: Adaptive | None = None,
        review: bool = False,
        workers: int | None,
        progress: Progress,
        trace: bool,
    ) -> Labels:
        """Densify the network (:func:`jaxfilter.stages.densify.densify`) and return the labels of the points."""
        out = densify(
            network,
            rule,
            mirror=mirror,
            refresh_border=refresh_border,
            vertex_spacing=self.vertex_spacing,
            vertices=vertices,
            adaptive=adaptive,
            review=review,
            insertion=self.insertion,
            max_rounds=self.max_rounds,
            workers=workers,
            progress=progress,
            keep_labels=trace,
        )
        return labels_of(points, network, out, barred=barred, late=late, keep_labels=trace)
