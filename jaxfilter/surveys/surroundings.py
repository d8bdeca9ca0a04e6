"""The ground around a tile, as far as the surface through it needs: for terrain models and heights."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..core.cloud import KEPT_CLASSES, PointCloud, Whole
from ..core.filter import Filter
from ..core.result import FilterResult
from ..files.disk import Bounds
from ..methods import PMF
from ..terrain.interpolation import Heights, Linear
from .capacity import Layout, layout
from .collection import Collection
from .options import RunOptions
from .plan import Plan, plan_with_halo, window_around
from .setup import filter_for, sampled, whole_for
from .task import Around, Job, Tile, inside, read_tile

HALOS = (40.0, 80.0, 160.0, 320.0)
"""Metres around a tile whose ground points take part: the first that suffices, by the circles of the triangles."""
READING = {
    "returns": "last,only", "ignore_classes": KEPT_CLASSES, "ignore_overlap": False, "keep_withheld": False,
    "drop_invalid": False,
}  # fmt: skip
_EDGE = 20.0
"""Metres along the edge of the data where triangles at the hull of a tile are let stand."""


@dataclasses.dataclass(frozen=True)
class GroundJob(Job):
    """A job that needs the ground points around each tile.

    Attributes:
        data: bounds of all points, file units.
        ground_classes: classes of ground points, less withheld ones; None: ``filter`` finds them.
        grain, lattice, filter_halo: file units: ground points are taken as far as multiples of the first; the others are the
            filter's.
    """

    data: Bounds
    ground_classes: tuple[int, ...] | None
    grain: float
    lattice: float
    filter_halo: float


Kind = TypeVar("Kind", bound=GroundJob)


@dataclasses.dataclass(frozen=True, eq=False)
class Surroundings:
    """Points of a tile and around it; ``tile``: as it was read; ``halo``: metres; ``result``: of the filter, if it was asked.

    ``ground``: bool[n], all that was found; ``near``: the box within which these are ground points of the whole.
    """

    around: Around
    tile: Tile
    halo: float
    ground: np.ndarray
    near: Bounds
    result: FilterResult | None

    @property
    def usable(self) -> np.ndarray:
        """bool[n]: ground points of the whole."""
        return self.ground & inside(self.around.cloud, self.near)


def ground_job(
    kind: type[Kind],
    collection: Collection,
    finder: type[Filter] | None,
    changes: dict[str, Any],
    *,
    largest_building: float | None,
    ground_classes: Iterable[int],
    grain: float,
    run: RunOptions,
    most_points: float | None,
    classes: dict[str, Any],
    scratch: Path,
    **more: Any,
) -> tuple[Kind, Layout, Plan]:
    """Job of a ``kind`` with ``more`` fields, layout and plan; ``grain``: metres; ``classes``: how labels are written; the rest
    as in :func:`jaxfilter.ground`."""
    metre, index = collection.metre, scratch / "index"
    filter_, whole, filter_halo, lattice = None, Whole(), 0.0, grain
    if finder is not None:
        sample = sampled(collection, READING, index)
        filter_ = filter_for(sample, finder, changes, largest_building=largest_building)
        whole = whole_for(filter_, sample, collection, READING, index)
        filter_halo, lattice = filter_.tile_halo(), filter_.lattice()
    cut = layout(
        collection,
        lattice=grain,
        halo=HALOS[0] + filter_halo,
        most_points=most_points,
        **run,
    )
    job = kind(
        filter_ or PMF(), READING, classes, (), whole, scratch, index, collection.bounds,
        None if finder is not None else tuple(ground_classes), grain / metre, lattice / metre, filter_halo / metre, **more,
    )  # fmt: skip
    return job, cut, plan_with_halo(cut.plan, collection, HALOS[-1] + filter_halo + lattice)


def surroundings(job: GroundJob, tile: Tile) -> Iterator[Surroundings]:
    """What is around a tile, with wider and wider halos. Raises: as :func:`jaxfilter.surveys.task.filter_tile`."""
    metre = tile.sources[0].metre
    for halo in HALOS:
        near = window_around(tile.core, halo / metre, job.grain)
        wide = dataclasses.replace(tile, window=window_around(near, job.filter_halo, job.lattice))
        around = read_tile(job, wide)
        cloud, result = around.cloud, None
        if job.ground_classes is None:
            result = job.filter(cloud, workers=1)
            ground = result.ground
        elif cloud.classification is None:
            ground = np.zeros(len(cloud), bool)
        else:
            ground = np.isin(cloud.classification, job.ground_classes)
            ground = ground if cloud.withheld is None else ground & ~cloud.withheld
        yield Surroundings(around, wide, halo, ground, near, result)


class Doubt:
    """Counts positions whose triangle may be another in the whole: the circle through its corners holds a place that has
    data and was not read. Outside the hull of the ground points that is any such place, but along the edge of the data."""

    def __init__(self, cloud: PointCloud, data: Bounds, near: Bounds) -> None:
        """``data``, ``near``: bounds of all points and of what was read, file units."""
        self.count = 0
        factor, origin = cloud.units.xy, cloud.origin[:2]

        def local(box: Bounds) -> np.ndarray:
            return (np.array(box).reshape(2, 2) - origin) * factor

        (x0, y0), (x1, y1) = self._inner = local(data) + [[_EDGE], [-_EDGE]]
        (w, s), (e, n) = local(near)
        boxes = ((x0, y0, w, y1), (e, y0, x1, y1), (x0, y0, x1, s), (x0, n, x1, y1))
        self._strips = [np.array(box) for box in boxes if box[0] < box[2] and box[1] < box[3]]

    @property
    def reaches(self) -> bool:
        """Whether there are data that were not read."""
        return bool(self._strips)

    def look(self, at: np.ndarray, surface: Heights) -> None:
        """Positions f64[q, 2], local metres, and the surface that gives their heights."""
        if not isinstance(surface, Linear) or not self._strips:
            return
        centre, radius = surface.circles(at)
        low, high = self._inner
        at_edge = ((at < low) | (at > high)).any(axis=1)
        radius[np.isinf(radius) & at_edge] = 0.0
        meets = np.zeros(len(at), bool)
        for strip in self._strips:
            away = np.maximum(np.maximum(strip[:2] - centre, centre - strip[2:]), 0.0)
            meets |= np.hypot(away[:, 0], away[:, 1]) < radius
        self.count += int(meets.sum())
