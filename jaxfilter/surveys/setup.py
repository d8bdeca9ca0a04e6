"""One filter for a whole collection, set up from a few windows of it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud, Whole
from ..core.errors import InputError
from ..core.filter import Filter
from ..core.points import canonical_points
from ..files.blocks import Changed
from ..files.windows import read_window
from ..methods.default import default_filter
from .collection import Collection
from .task import ANCHOR, joined

_WINDOWS, _POINTS = 9, 20_000
"""Windows of a sample, and points expected in each."""


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """Windows of a collection: ``clouds``, each of some of its points, and ``whole``, what they say of it."""

    clouds: list[PointCloud]
    whole: Whole

    def cloud(self) -> PointCloud:
        """One of the windows, that with most candidates, as a part of the whole; empty if the collection is."""
        if not self.clouds:
            return joined([], self.whole)
        most = max(self.clouds, key=lambda cloud: int(cloud.candidate.sum()))
        return dataclasses.replace(most, whole=self.whole)


def sampled(
    collection: Collection, reading: dict[str, Any], index: Path | None = None, each: int = _POINTS, most: int = 0
) -> Sample:
    """Windows in the middle of files that are spread evenly over the points of a collection, with about ``each`` points.

    A collection of ``most`` points or fewer is its own sample, in one piece. ``reading``: as in
    :class:`jaxfilter.surveys.task.Job`. Files that cannot be read are passed over.

    Raises: InputError if points are not those that were read before.
    """
    entire = collection.count <= most
    total = collection.counts.cumsum()
    clouds: list[PointCloud] = []
    area = members = 0.0
    picked: dict[int, None] = {}
    if collection.count:
        shares = (np.arange(_WINDOWS) + 0.5) / _WINDOWS * total[-1]
        picked = dict.fromkeys(int(i) for i in np.searchsorted(total, shares, side="right"))
        picked = dict.fromkeys(np.flatnonzero(collection.counts).tolist()) if entire else picked
    for number in picked:
        source = collection[number]
        x0, y0, x1, y1 = source.bounds
        share = 1.0 if entire else math.sqrt(min(1.0, each / source.count))
        middle, half = ((x0 + x1) / 2, (y0 + y1) / 2), (share * (x1 - x0) / 2, share * (y1 - y0) / 2)
        slack = 0.001 / source.metre  # the box is half open
        box = (middle[0] - half[0], middle[1] - half[1], middle[0] + half[0] + slack, middle[1] + half[1] + slack)
        try:
            window = read_window(source, box, index, anchor=ANCHOR, **reading)
        except InputError as error:
            if isinstance(error, Changed):
                raise
            continue  # the run names it
        points = canonical_points(window.cloud)
        if len(points) > 1:
            clouds.append(dataclasses.replace(window.cloud, source=None))
            area += points.spacing() ** 2 * len(points)
            members += len(points)
    spacing = math.sqrt(area / members) if members else None
    return Sample([joined(clouds)] if entire and clouds else clouds, Whole(spacing))


def whole_for(
    filter_: Filter, sample: Sample, collection: Collection, reading: dict[str, Any], index: Path | None = None
) -> Whole:
    """What the filter takes from the collection as a whole (``Filter.of_scene``); the arguments are those of ``sampled``."""

    def some(points: int) -> list[PointCloud]:
        clouds = sampled(collection, reading, index, points // _WINDOWS, points).clouds
        return [dataclasses.replace(cloud, whole=sample.whole) for cloud in clouds]

    return dataclasses.replace(sample.whole, **filter_.of_scene(some))


def filter_for(
    sample: Sample,
    method: type[Filter] | None,
    changes: dict[str, Any],
    *,
    preset: str | None = None,
    for_cloud: bool = False,
    largest_building: float | None = None,
) -> Filter:
    """The filter of a run; the same for all its tiles.

    Args:
        method: None = the default.
        changes: fields that are given.
        for_cloud: set from the point spacing what depends on it; so it is for the default, and with ``largest_building``.

    Raises: ParameterError.
    """
    if method is None:
        return default_filter(sample.cloud(), largest_building)
    if for_cloud or largest_building is not None:
        return method.for_cloud(sample.cloud(), largest_building, preset=preset, **changes)
    return method.preset(preset, **changes) if preset else method(**changes)
