"""Fields by which filters keep outliers from the seeds of the ground."""

from __future__ import annotations

import dataclasses

from ..core.filter import Filter
from ..core.params import static
from ..core.points import Points
from ..engines.tin.growth import Outliers
from .outliers import bar_outliers


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutlierFilter(Filter):
    """A filter that keeps clusters of low points from the seeds."""

    low_clusters: bool = static("clusters of low points are kept out of the seeds", default=True, choices=(True, False))

    def outliers(self, points: Points, workers: int | None) -> Outliers:
        """The points that must not be seeds; fields with the name of a limit of :func:`bar_outliers` are that limit."""
        own = {name: getattr(self, name) for name in ("radius", "min_neighbours", "neighbours") if hasattr(self, name)}
        return bar_outliers(points, clusters=self.low_clusters, **own, workers=workers)


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutlierRadius(OutlierFilter):
    """A filter that also takes points with few neighbours for outliers."""

    radius: float = static(
        "the outlier test counts the points within this distance; 0 = no test", "r >= 0 m", default=0.0
    )
    min_neighbours: int = static(
        "a point is no seed if it has fewer neighbours than this within the radius", "n >= 1 and <= 4096", default=10
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutlierFate(OutlierFilter):
    """A filter whose paper removes outliers."""

    outlier_fate: str = static(
        "outliers are no seeds but may become ground (barred), or they are never ground (removed)",
        default="barred",
        choices=("barred", "removed"),
    )

    def outliers(self, points: Points, workers: int | None) -> Outliers:
        return super().outliers(points, workers)._replace(removed=self.outlier_fate == "removed")
