"""What the methods that densify a triangulation share: the fields for outliers and insertion, and the steps around them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, Self

import numpy as np

from ..core.filter import Filter, Labels
from ..core.params import param, static
from ..core.points import Points
from ..core.result import Progress, silent
from ..ops.facets import Rule
from .densify import INSERTIONS, Adaptive, Mirror, Vertices, densify
from .lanes import densify_each
from .network import Network, border_positions, labels_of, one_network
from .outliers import bar_outliers

FATES = ("barred", "removed")
"""What becomes of outliers: they are tested like other points, or labelled non-ground for good."""


@dataclasses.dataclass(eq=False)
class Start:
    """What growth starts from, whatever its thresholds.

    Attributes:
        barred: bool[m], points that are no seeds; late: bool[m], those among them that are tested when the others are done.
        mirror, refresh_border: see :func:`jaxfilter.stages.densify.densify`.
        info: counts for the result.
    """

    network: Network
    barred: np.ndarray
    late: np.ndarray
    mirror: Mirror | None = None
    refresh_border: bool = False
    info: dict[str, Any] = dataclasses.field(default_factory=dict)


def facet_reach(cell: float) -> float:
    """Metres: the half diagonal of a cell and its eight neighbours, how far facets between one seed per cell reach."""
    return 1.5 * math.sqrt(2.0) * cell


@dataclasses.dataclass(frozen=True, kw_only=True)
class TinFilter(Filter):
    """Base of the methods that grow the ground from seeds on a triangulation. Lengths in metres.

    A method gives ``start``, its seeds and network, and ``limits``, its thresholds; or it has a ``classify`` of its own. Only
    fields that are named as those of :class:`jaxfilter.ops.facets.Rule` may decide the limits, and they nothing else.
    """

    radius: float = static(0.0, symbol="r", unit="m", ge=0, doc="radius of the outlier test; 0 = off")
    min_neighbours: int = static(10, symbol="n", ge=1, doc="a point with fewer neighbours within the radius is no seed")
    low_clusters: bool = static(True, choices=(True, False), doc="bar clusters of low outliers from the seeds")
    outlier_fate: str = static("barred", choices=FATES, doc="outliers are no seeds, or never ground")
    noise_floor: float = param(0.0, unit="m", ge=0, doc="accept points this close to their facet at any angle; 0 = off")
    vertex_spacing: float = static(
        0.0, unit="m", ge=0, doc="at most one vertex per square of this size; 0 = all points"
    )
    insertion: str = static(
        "batch",
        choices=INSERTIONS,
        doc="add all points that pass in a round, the lowest over each facet, or one by one",
    )
    border_in_tests: bool = static(
        True, choices=(True, False), doc="simulated border points count as nearest and as highest vertex"
    )
    max_rounds: int = static(100, ge=1, doc="limit of densification rounds")

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Above four points per square metre, ranging noise makes steep angles at short range."""
        dense = spacing < 0.5
        return {"noise_floor": 0.1 if dense else 0.0, "vertex_spacing": 0.7 if dense else 0.0}

    def start(self, points: Points, workers: int | None, progress: Progress) -> Start:
        """Outliers, seeds and network."""
        raise TypeError(f"{type(self).__name__} does not define start()")

    def limits(self) -> Rule:
        """The thresholds of growth."""
        raise TypeError(f"{type(self).__name__} does not define limits()")

    def adaptive(self) -> Adaptive | None:
        """How the thresholds follow the ground; None = they are constant."""
        return None

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        start = self.start(points, workers, progress)
        labels = self.grow(
            points,
            start.network,
            self.limits(),
            barred=start.barred,
            late=start.late,
            mirror=start.mirror,
            refresh_border=start.refresh_border,
            adaptive=self.adaptive(),
            workers=workers,
            progress=progress,
            trace=trace,
        )
        labels.info |= start.info
        return labels

    def ground_each(
        self, points: Points, sets: Sequence[Self], *, key: Any, workers: int | None, memory: float
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Sets that differ in their limits only share the start, and grow together."""
        own_way = type(self).classify is not TinFilter.classify
        if own_way or self.insertion != "batch" or self.adaptive() is not None:
            yield from super().ground_each(points, sets, key=key, workers=workers, memory=memory)
            return
        deciding = [f.name for f in dataclasses.fields(self) if f.name not in Rule._fields]
        alike: dict[tuple[Any, ...], list[int]] = {}
        for number, one in enumerate(sets):
            alike.setdefault(tuple(getattr(one, name) for name in deciding), []).append(number)
        for numbers in alike.values():
            start = sets[numbers[0]].start(points, workers, silent)
            network = self._without_removed(start.network, start.barred)
            counts = (network.row >= 0) & (network.open | network.seed)
            grown = densify_each(
                network,
                [sets[number].limits() for number in numbers],
                mirror=start.mirror,
                refresh_border=start.refresh_border,
                vertex_spacing=self.vertex_spacing,
                border_in_tests=self.border_in_tests,
                max_rounds=self.max_rounds,
                workers=workers,
                memory=memory,
            )
            for lane, nodes in grown:
                ground = np.zeros(len(points), bool)
                ground[network.row[counts & nodes]] = True
                yield numbers[lane], ground

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

    def _without_removed(self, network: Network, barred: np.ndarray) -> Network:
        """The network, in which outliers bool[m] are not to be classified if they are removed."""
        if self.outlier_fate != "removed":
            return network
        return dataclasses.replace(network, open=network.open & ~barred[network.row])

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
        network = self._without_removed(network, barred)
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
            border_in_tests=self.border_in_tests,
            max_rounds=self.max_rounds,
            workers=workers,
            progress=progress,
            keep_labels=trace,
        )
        return labels_of(points, network, out, barred=barred, late=late, keep_labels=trace)
