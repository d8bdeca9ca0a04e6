"""What the methods that densify a triangulation share: their common fields, and the way from seeds to labels."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
import os
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np

from ..core.compilation import in_turn
from ..core.errors import warn
from ..core.filter import Labels, ground_each, group_equal, values_of, watch
from ..core.params import declared, param, static
from ..core.points import Points
from ..core.result import Decision, Progress, Status, silent
from ..engines.ground import grow
from ..engines.tin.facets import Rule
from ..engines.tin.ground import GroundTin
from ..engines.tin.growth import Growth, Mirror, Network, Outliers, Vertices
from ..engines.tin.network import border_positions, one_network
from ..engines.tin.reference import TRIANGULATIONS
from ..engines.tin.triangulation import Tin
from .outlier_filter import OutlierFilter

_DENSE = 0.5
"""Metres between points: with less a cloud is dense."""
_BYTES = 250
"""About so many of memory per point and growth."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TinFilter(OutlierFilter):
    """Base of the methods that grow the ground from seeds on a triangulation. Lengths in metres.

    A method gives ``start``, its seeds and network; ``growth`` says how its ground grows. Sets of a sweep that agree in all
    fields that ``start`` reads begin with the same network.
    """

    noise_floor: float = param(
        "a point is ground, whatever its angle, if it lies this close to its facet; 0 = off", ">= 0 m", default=0.0
    )
    max_rounds: int = static("the growth ends after this many rounds at the latest", ">= 1", default=100)
    triangulation: str = static(
        "vertices join the triangulation one by one (own), or SciPy makes it anew in each round (scipy)",
        default="own",
        choices=tuple(TRIANGULATIONS),
    )

    WINDOW: ClassVar[str] = "seed_cell"
    """The field that is as large as the largest building."""

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Above four points per square metre, ranging noise makes steep angles at short range."""
        window = {} if largest_building is None else {cls.WINDOW: largest_building}
        return {"noise_floor": 0.1 if spacing < _DENSE else 0.0, **window}

    def halo(self) -> float:
        """Four windows: growth goes on from facet to facet, and a facet spans one and a half."""
        return 4.0 * getattr(self, self.WINDOW)

    def lattice(self) -> float:
        """The cells that seeds are the lowest points of."""
        return float(getattr(self, self.WINDOW))

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        """Outliers, seeds and network. ``trace``: keep the labels of rounds, if there are any already."""
        raise TypeError(f"{type(self).__name__} does not define start()")

    def growth(self, network: Network) -> Growth:
        """How the ground grows from a network; fields with the name of a limit are that limit.

        >>> rule = jf.FPTD(max_angle=20.0).growth(None).rule
        >>> rule.max_angle, rule.signed, rule.max_distance
        (20.0, 1.0, inf)
        """
        names = (field.name for field in declared(self))
        return Growth(Rule(**{name: getattr(self, name) for name in names if name in Rule._fields}))

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        network = self.start(points, workers, progress, trace)
        done = 0.0 if network.before is None else 0.5
        with GroundTin.start(network, growth_of(self, network), workers=workers) as ground:
            status = grow(
                ground, self.max_rounds, lambda share, step: progress(done + (1.0 - done) * share, step), trace
            )
            ground.finish()
        progress(1.0, ground.STEP)
        return labels_of_nodes(ground, status)


def growth_of(filter_: TinFilter, network: Network) -> Growth:
    """How the ground of a filter grows, a user's too, over the triangulation that its field names."""
    return dataclasses.replace(filter_.growth(network), triangulation=filter_.triangulation)


def surrounded(
    filter_: TinFilter, points: Points, seeds: np.ndarray, outliers: Outliers, spacing: float, name: str = ""
) -> Network:
    """All points in one triangulation of the seeds (i64[s]), with border points every ``spacing`` metres.

    Few seeds are warned of, and without any the lowest point is one (:func:`seeds_of`). ``name``: of the field that the
    spacing is, if not that of the window.
    """
    name = f"{type(filter_).__name__}({name or filter_.WINDOW})"
    border = border_positions(*points.extent, spacing, points.anchored(), name)
    return one_network(points, seeds_of(filter_, points, seeds), border, outliers)


def seeds_of(filter_: TinFilter, points: Points, seeds: np.ndarray) -> np.ndarray:
    """The seeds, i64[s], or if there is none the row of the lowest point, with a warning; also where seeds are few.

    A square as large as the largest building holds ground, and so should hold a seed. With one for two squares or fewer, much
    of the first surface is a guess, which facets between far seeds or simulated points make.
    """
    name = type(filter_).__name__
    if len(seeds) == 0:
        warn(f"{name}: no point is left as a seed of the ground, and the lowest one is taken")
        return np.array([np.argmin(points.xyz[:, 2])])
    size = float(getattr(filter_, filter_.WINDOW))
    low, high = points.extent
    number = np.maximum(1, (high - low) // size)  # the last square of a row holds what is left over
    if 2 * len(seeds) <= number.prod():  # else there are seeds enough, whatever squares are empty
        at = np.minimum((points.xyz[:, :2] - low) // size, number - 1)
        squares = len(np.unique(at @ [1, number[0]]))
        if 2 * len(seeds) <= squares:
            warn(
                f"{name}: too few seeds of the ground, {len(seeds)} for {squares} squares of {filter_.WINDOW}={size:g} m that "
                "hold points, each of which should have one: much ground may be lost; loosen the limits that seeds must keep, "
                "or use the default"
            )
    return seeds


def labels_of_nodes(out: GroundTin, status: Status) -> Labels:
    """From nodes back to points: ground where any sheet accepts it; quantities from a sheet that does, else from any."""
    network, points, barred = out.net, out.net.points, out.net.outliers.barred
    order = np.flatnonzero(network.real)
    if network.sheet[-1] > 0:  # accepting sheets last, so that they prevail
        order = order[np.argsort(out.ground[order], kind="stable")]
    row = network.row[order]
    one_sheet = network.sheet[-1] == 0 and len(order) == len(points)  # the first nodes are the points

    def of_points(values: np.ndarray) -> np.ndarray:
        if one_sheet:
            return values[: len(points)]
        spread = np.zeros(len(points), values.dtype)
        spread[row] = values[order]
        return spread

    def in_any_sheet(nodes: np.ndarray) -> np.ndarray:
        return of_points(nodes) if one_sheet else np.bincount(row, nodes[order], len(points)) > 0

    names = ("ground", "height", "slope", "angle", "elevation", "margin", "decision")
    found: dict[str, Any] = {name: of_points(getattr(out, name)) for name in names}
    trace = out.trace
    if network.before is not None:
        before, trace = network.before, network.before.trace + trace
        status = status if before.status == Status.CONVERGED else before.status
        assert before.decision is not None
        earlier = before.ground & (before.decision != Decision.SEED)
        for name in ("angle", "elevation", "margin", "decision"):
            found[name][earlier] = getattr(before, name)[earlier]
    for step in out.trace:
        if "ground" in step:
            step["ground"] = in_any_sheet(step["ground"])
    return Labels(
        **found,
        barred=barred,
        status=status,
        info={
            "sheets": int(network.sheet[-1]) + 1,
            "seeds": int(in_any_sheet(network.seed).sum()),
            "border_points": len(network.virtual),
            "rounds": len(out.trace),
            "facets": len(out.tin),
            "vertices": int(out.tin.vertex.sum()),
            "barred": int(barred[points.member].sum()),
            "barred_low_clusters": int(in_any_sheet(network.late)[points.member].sum()),
            "barred_then_ground": int((barred & found["ground"])[points.member].sum()),
            **network.info,
        },
        trace=trace,
    )


@ground_each.register(TinFilter)
def _ground_each(
    filter_: TinFilter, points: Points, sets: Sequence[Any], *, key: Any, workers: int | None, memory: float
) -> Iterator[tuple[int, np.ndarray]]:
    """Sets that agree in what ``start`` reads share the network, and if they have the same vertices the triangulation of its
    seeds. Each grows by its own rule."""
    threads = workers or os.cpu_count() or 1

    @functools.lru_cache(threads)
    def start(first: int) -> tuple[set[str], Network, Growth, Tin]:
        one, read = watch(sets[first])
        network = one.start(points, threads, silent)
        growth = growth_of(sets[first], network)
        with GroundTin.start(network, growth, workers=threads) as seeds:
            return read, network, growth, seeds.tin

    def grow_set(job: tuple[int, int]) -> np.ndarray:
        first, number = job
        read, network, other, tin = start(first)
        if len(group_equal(values_of([sets[first], sets[number]], read))) > 1:
            return grow_set((number, number))  # more was read than in the first set of all
        growth = dataclasses.replace(growth_of(sets[number], network), kept=())
        shared = operator.attrgetter("border_follows", "vertices", "triangulation")
        same = shared(growth) == shared(other)
        with GroundTin.start(network, growth, tin.copied() if same else None, threads // at_once) as out:
            grow(out, sets[number].max_rounds)
        ground = np.zeros(len(points), bool)
        ground[network.row[np.flatnonzero(out.ground & network.real)]] = True
        return ground

    read, network, *_ = start(0)
    groups = group_equal(values_of(sets, read))
    at_once = min(threads, len(sets), max(1, int(memory // (_BYTES * len(network.xyz)))))
    for (_, number), ground in in_turn(grow_set, [(group[0], k) for group in groups for k in group], at_once):
        yield number, ground


@dataclasses.dataclass(frozen=True, kw_only=True)
class VertexSpacing(TinFilter):
    """A TIN filter of which the ground points, or one per square, are vertices."""

    vertex_spacing: float = static(
        "a square of this size holds one vertex at most; 0 = every ground point is a vertex", ">= 0 m", default=0.0
    )

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """One vertex per 0.7 m in dense clouds bounds the number of vertices by the area."""
        return super().from_spacing(spacing, largest_building) | {"vertex_spacing": 0.7 if spacing < _DENSE else 0.0}

    def growth(self, network: Network) -> Growth:
        return dataclasses.replace(super().growth(network), vertices=Vertices(self.vertex_spacing))


@dataclasses.dataclass(frozen=True, kw_only=True)
class TerrainAngle(VertexSpacing):
    """A TIN filter that mirrors points over steep facets about the highest vertex, and tests the image in their place."""

    max_terrain_angle: float = static(
        "a point is mirrored if its facet is steeper than this", "t > 0 and <= 90 degrees", default=88.0
    )

    def growth(self, network: Network) -> Growth:
        return dataclasses.replace(super().growth(network), mirror=Mirror(self.max_terrain_angle))


@dataclasses.dataclass(frozen=True, kw_only=True)
class SlopeMirroring(TinFilter):
    """A TIN filter that may give points over steep facets a second chance: their image about the nearest vertex."""

    max_terrain_slope: float = static("a point is mirrored if its facet is steeper than this", "> 0 %", default=10.0)
    mirror: str = static(
        "a point over a steep facet is also tested at its mirror image about the nearest vertex, or it is not",
        default="off",
        choices=("nearest", "off"),
    )

    def growth(self, network: Network) -> Growth:
        slope = math.degrees(math.atan(self.max_terrain_slope / 100.0))
        mirror = None if self.mirror == "off" else Mirror(slope, nearest=True)
        return dataclasses.replace(super().growth(network), mirror=mirror)
