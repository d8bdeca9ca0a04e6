"""What the methods that densify a triangulation share: their common fields, and the way from seeds to labels."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ClassVar, Self

import numpy as np

from ..core.compilation import in_turn
from ..core.errors import warn
from ..core.filter import Filter, Labels, alike, values_but
from ..core.params import param, static
from ..core.points import Points
from ..core.result import Progress, silent
from ..engines.tin.densify import densify, triangulated
from ..engines.tin.facets import Rule
from ..engines.tin.growth import Adaptive, Growth, Mirror, Network, Vertices
from ..engines.tin.network import border_positions, labels_of, one_network
from ..engines.tin.vertices import choice_of
from .outliers import bar_outliers

_DENSE = 0.5
"""Metres between points: with less a cloud is dense."""
_BYTES = 250
"""About so many of memory per point and growth."""
_NODES = 131072
"""Sets of a sweep grow together up to so many nodes."""


def facet_reach(cell: float) -> float:
    """Metres: the half diagonal of a cell and its eight neighbours, how far facets between one seed per cell reach."""
    return 1.5 * math.sqrt(2.0) * cell


@dataclasses.dataclass(frozen=True, kw_only=True)
class TinFilter(Filter):
    """Base of the methods that grow the ground from seeds on a triangulation. Lengths in metres.

    A method gives ``start``, its seeds and network, and ``limits``, its thresholds; ``schedule`` says what else its growth
    does. Fields named in ``LIMITS`` may decide ``limits`` and ``adaptive``, and nothing else: sets of a sweep that differ in
    no others start from the same triangulation.
    """

    low_clusters: bool = static(
        default=True, choices=(True, False), doc="clusters of low points are kept out of the seeds"
    )
    noise_floor: float = param(
        default=0.0,
        unit="m",
        ge=0,
        doc="a point is ground, whatever its angle, if it lies this close to its facet; 0 = off",
    )
    max_rounds: int = static(default=100, ge=1, doc="the growth ends after this many rounds at the latest")

    LIMITS: ClassVar[tuple[str, ...]] = Rule._fields
    WINDOW: ClassVar[str] = "seed_cell"
    """The field that is as large as the largest building."""

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Above four points per square metre, ranging noise makes steep angles at short range."""
        dense = spacing < _DENSE
        window = {} if largest_building is None else {cls.WINDOW: largest_building}
        return {"noise_floor": 0.1 if dense else 0.0, **window}

    def halo(self) -> float:
        """The half diagonal of a seed cell and its eight neighbours: how far facets between seeds reach."""
        return facet_reach(getattr(self, self.WINDOW))

    def tile_halo(self) -> float:
        """Four windows: growth goes on from facet to facet, so ``halo()``, which one facet spans, is too little."""
        return 4.0 * getattr(self, self.WINDOW)

    def lattice(self) -> float:
        """The cells that seeds are the lowest points of."""
        return float(getattr(self, self.WINDOW))

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        """Outliers, seeds and network. ``trace``: keep the labels of rounds, if there are any already."""
        raise TypeError(f"{type(self).__name__} does not define start()")

    def limits(self) -> Rule:
        """The thresholds of growth, in metres and degrees.

        >>> limits = jf.FPTD(max_angle=20.0).limits()
        >>> float(limits.max_angle), float(limits.signed)
        (20.0, 1.0)
        """
        return self.rule(max_angle=self.max_angle, max_distance=self.max_distance)  # type: ignore[attr-defined]

    def adaptive(self) -> Adaptive | None:
        """How the thresholds follow the ground; None = they are constant.

        >>> jf.ATIN().adaptive() is None, jf.ATIN(thresholds="adaptive").adaptive() is None
        (True, False)
        """
        return None

    def mirroring(self, network: Network) -> Mirror | None:
        """When points are mirrored; None = never."""
        return None

    def schedule(self, network: Network, **changes: Any) -> Growth:
        """The growth from a network, with ``changes`` of its policies."""
        policies: dict[str, Any] = {
            "rule": self.limits(),
            "mirror": self.mirroring(network),
            "adaptive": self.adaptive(),
            "border_follows": getattr(self, "refresh_border", False),
            "max_rounds": self.max_rounds,
        }
        return Growth(**policies | changes)

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        network = self.settled(self.start(points, workers, progress, trace))
        done = 0.0 if network.before is None else 0.5
        out = densify(
            network,
            self.schedule(network),
            workers=workers,
            progress=lambda share, step: progress(done + (1.0 - done) * share, step),
            keep_labels=trace,
        )
        return labels_of(network, out, trace)

    def ground_each(
        self, points: Points, sets: Sequence[Self], *, key: Any, workers: int | None, memory: float
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Sets that differ in ``LIMITS`` only share network and triangulation of the seeds."""
        for numbers in alike(values_but(self.LIMITS, sets)):
            for i, ground in _grown_each([sets[number] for number in numbers], points, workers, memory):
                yield numbers[i], ground

    def settled(self, network: Network) -> Network:
        """The network with the nodes that are open to this filter: all that are open."""
        return network

    def outliers(self, points: Points, workers: int | None, **tests: Any) -> tuple[np.ndarray, np.ndarray]:
        """bool[m] points that must not be seeds, and bool[m] those among them that lie in clusters of low points.

        ``tests``: further ones, see :func:`jaxfilter.steps.outliers.bar_outliers`.
        """
        return bar_outliers(points, clusters=self.low_clusters, workers=workers, **tests)

    def network(
        self, points: Points, seeds: np.ndarray, spacing: float, barred: np.ndarray, late: np.ndarray, **more: Any
    ) -> Network:
        """All points in one triangulation of the seeds (i64[s]), with border points every ``spacing`` metres.

        Without seeds the lowest point is one, with a warning.
        ``barred``, ``late`` and ``more``: see :class:`jaxfilter.engines.tin.growth.Network`.
        """
        if len(seeds) == 0:
            warn(f"{type(self).__name__}: no point is left as a seed of the ground, and the lowest one is taken")
            seeds = np.array([np.argmin(points.xyz[:, 2])])
        name = "border_spacing" if hasattr(self, "border_spacing") else self.WINDOW
        border = border_positions(*points.extent, spacing, points.anchored(), f"{type(self).__name__}({name})")
        return one_network(points, seeds, border, barred, late, **more)

    def rule(self, **limits: float) -> Rule:
        """The thresholds of a test, with the noise floor of the method."""
        return Rule(noise_floor=self.noise_floor if self.noise_floor > 0 else -1.0, **limits)


def _grown_each(
    sets: Sequence[TinFilter], points: Points, workers: int | None, memory: float
) -> Iterator[tuple[int, np.ndarray]]:
    """Number of the set and bool[m], ground, for sets that differ in ``LIMITS`` only; several grow at a time, in threads.

    On small clouds each thread takes many sets, as sheets of one network: a round costs them little more than one alone.
    """
    threads = workers or os.cpu_count() or 1
    network = sets[0].start(points, workers, silent)
    growth = sets[0].schedule(network)
    with ThreadPoolExecutor(threads) as pool:
        tin = triangulated(network, choice_of(network, growth.vertices), pool, threads)
    nodes, sheets = len(network.xyz), int(network.sheet[-1]) + 1
    most = max(1, int(memory // (_BYTES * nodes)))
    at_once = min(threads, len(sets), most)
    size = max(1, min(_NODES // nodes, most // at_once))
    if growth.adaptive is not None or growth.vertices.grids:  # what a round decides depends on the whole network
        size = 1
    batches = at_once * -(-len(sets) // (at_once * size))
    limits = np.array([one.limits() for one in sets], np.float32).T
    differ = (limits != limits[:, :1]).any(axis=1)

    def grown(part: slice) -> np.ndarray:
        some = sets[part]
        own = differ & (len(some) > 1)
        rule: Any = [np.repeat(v[part], sheets) if each else v[part][0] for v, each in zip(limits, own, strict=True)]
        opened = np.concatenate([one.settled(network).open for one in some])
        many = dataclasses.replace(network.repeated(len(some)), open=opened)
        growth = some[0].schedule(many, rule=Rule(*rule))
        out = densify(
            many, growth, tin=tin.repeated(len(some)), scores=False, heights=False, workers=threads // at_once
        )
        if len(some) > 1 and not out.converged:  # together they may need more rounds than any alone
            return np.concatenate([grown(slice(i, i + 1)) for i in range(len(sets))[part]])
        ground = np.zeros((len(some), len(points)), bool)
        node = np.flatnonzero(out.ground & many.real)
        ground[node // nodes, many.row[node]] = True
        return ground

    parts = [slice(i, None, batches) for i in range(min(batches, len(sets)))]  # neighbours take about equally long
    for part, found in in_turn(grown, parts, at_once):
        yield from zip(range(len(sets))[part], found, strict=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class VertexSpacing(TinFilter):
    """A TIN filter of which the ground points, or one per square, are vertices."""

    vertex_spacing: float = static(
        default=0.0,
        unit="m",
        ge=0,
        doc="a square of this size holds one vertex at most; 0 = every ground point is a vertex",
    )

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """One vertex per 0.7 m in dense clouds bounds the number of vertices by the area."""
        return super().from_spacing(spacing, largest_building) | {"vertex_spacing": 0.7 if spacing < _DENSE else 0.0}

    def schedule(self, network: Network, **changes: Any) -> Growth:
        return super().schedule(network, **{"vertices": Vertices(self.vertex_spacing), **changes})


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutlierRadius(TinFilter):
    """A TIN filter that also takes points with few neighbours for outliers."""

    radius: float = static(
        default=0.0,
        symbol="r",
        unit="m",
        ge=0,
        doc="the outlier test counts the points within this distance; 0 = no test",
    )
    min_neighbours: int = static(
        default=10,
        symbol="n",
        ge=1,
        le=4096,
        doc="a point is no seed if it has fewer neighbours than this within the radius",
    )

    def outliers(self, points: Points, workers: int | None, **tests: Any) -> tuple[np.ndarray, np.ndarray]:
        """As in the other TIN filters, and points with few neighbours."""
        return super().outliers(points, workers, radius=self.radius, min_neighbours=self.min_neighbours, **tests)


@dataclasses.dataclass(frozen=True, kw_only=True)
class OutlierFate(TinFilter):
    """A TIN filter whose paper removes outliers."""

    outlier_fate: str = static(
        default="barred",
        choices=("barred", "removed"),
        doc="outliers are no seeds but may become ground (barred), or they are never ground (removed)",
    )

    def settled(self, network: Network) -> Network:
        """The network with the nodes that are open to this filter: without outliers, if they are removed."""
        network = super().settled(network)
        if self.outlier_fate != "removed" or network.barred is None:
            return network
        return dataclasses.replace(network, open=network.open & ~network.barred[network.row])


@dataclasses.dataclass(frozen=True, kw_only=True)
class TerrainAngle(VertexSpacing):
    """A TIN filter that mirrors points over steep facets about the highest vertex, and tests the image in their place."""

    max_terrain_angle: float = static(
        default=88.0,
        symbol="t",
        unit="degrees",
        gt=0,
        le=90,
        doc="a point is mirrored if its facet is steeper than this",
    )

    def mirroring(self, network: Network) -> Mirror | None:
        return Mirror(self.max_terrain_angle)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SlopeMirroring(TinFilter):
    """A TIN filter that may give points over steep facets a second chance: their image about the nearest vertex."""

    max_terrain_slope: float = static(
        default=10.0, unit="%", gt=0, doc="a point is mirrored if its facet is steeper than this"
    )
    mirror: str = static(
        default="off",
        choices=("nearest", "off"),
        doc="a point over a steep facet is also tested at its mirror image about the nearest vertex, or it is not",
    )

    def mirroring(self, network: Network) -> Mirror | None:
        slope = math.degrees(math.atan(self.max_terrain_slope / 100.0))
        return None if self.mirror == "off" else Mirror(slope, nearest=True)
