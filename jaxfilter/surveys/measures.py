"""The filter of a run, and measures of its scene: from all points of a small one, from some windows of a large one."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..core.cloud import PointCloud, Whole
from ..core.errors import InputError, ParameterError
from ..core.filter import Filter, of_scene
from ..core.params import declared
from ..core.points import canonical_points
from ..core.reading import Bounds, Reading
from ..files.sources import read_window
from .collection import Collection
from .tiles import joined

if TYPE_CHECKING:
    from .plan import Where

_WINDOWS, _POINTS, _SMALL = 9, 20_000, 2_000_000
"""Windows of a sample, points expected in each, and points of a scene that is measured as a whole, as in memory."""


@dataclasses.dataclass(frozen=True)
class Recipe:
    """A filter of which some parameters depend on the data.

    Attributes:
        method: None = the default method, set up for the data.
        changes: fields that are given.
        preset: a named set of parameters to start from.
        for_cloud: set from the point spacing what depends on it.
        largest_building: metres; with it, ``for_cloud`` and what depends on this width.
    """

    method: type[Filter] | None = None
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)
    preset: str | None = None
    for_cloud: bool = False
    largest_building: float | None = None

    @property
    def by_data(self) -> bool:
        """Whether parameters depend on the data."""
        return self.method is None or self.for_cloud or self.largest_building is not None

    def alone(self) -> Filter | None:
        """The filter before any cloud is read, to find wrong values early; None for the default. Raises: ParameterError."""
        if self.method is None:
            return None
        return self.method.preset(self.preset, **self.changes) if self.preset else self.method(**self.changes)

    def on(self, cloud: PointCloud) -> Filter:
        """The filter for a cloud. Raises: ParameterError."""
        if self.method is None:
            from ..methods.default import default_filter  # late: it brings SciPy

            return default_filter(cloud, self.largest_building)
        if self.by_data:
            return self.method.for_cloud(cloud, self.largest_building, preset=self.preset, **self.changes)
        return cast(Filter, self.alone())


def recipe_of(filter_: Any) -> Recipe:
    """What is given as a filter: one that is made, a recipe, or None for the default. Raises: ParameterError."""
    if isinstance(filter_, Recipe) or filter_ is None:
        return filter_ or Recipe()
    if isinstance(filter_, Filter):
        plain = filter_.replace()  # with numbers where fields are arrays
        return Recipe(type(plain), {field.name: getattr(plain, field.name) for field in declared(plain)})
    raise ParameterError(f"filter_={filter_!r}: is no filter; pass one, such as jaxfilter.SMRF()")


def whole_of(measures: Mapping[str, Any] | None) -> Whole | None:
    """Measures of a scene as a value, which ``RunReport.measures`` has as plain values; None if they are not given."""
    plain: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in (measures or {}).items()}
    return None if measures is None else Whole(**plain)


@dataclasses.dataclass(frozen=True)
class Sampler:
    """Reads windows of a collection."""

    collection: Collection
    reading: Reading
    where: Where

    def clouds(self, each: int = _POINTS, most: int = 0) -> list[PointCloud]:
        """Windows of about ``each`` points, which are spread evenly over the points, of at least two.

        A collection of ``most`` points or fewer that fill its extent is its own sample, in one piece, however few they are.
        Files that cannot be read are passed over.
        """
        where, total = self.where, self.collection.count
        if not len(where.points):
            return []
        if total <= most and where.fills:
            return [joined(self._read(None, range(len(self.collection))))]
        sums = where.points.cumsum()
        squares = np.searchsorted(sums, (np.arange(_WINDOWS) + 0.5) / _WINDOWS * sums[-1])
        clouds = []
        for square in dict.fromkeys(squares.tolist()):
            low, high = where.low[square], where.high[square]
            middle, side = (low + high) / 2, math.sqrt(each / where.points[square] * (high - low).prod())
            box: Bounds = (*(middle - side / 2).tolist(), *(middle + side / 2).tolist())  # type: ignore[assignment]
            found = self._read(box, self.collection.within(box).tolist())
            if found and len(canonical_points(window := joined(found))) > 1:
                clouds.append(window)
        return clouds

    def _read(self, box: Bounds | None, files: Iterable[int]) -> list[PointCloud]:
        """The points of files in a box; what cannot be read is named by the run."""
        clouds = []
        for number in files:
            with contextlib.suppress(InputError):
                window = read_window(self.collection[number], box, self.reading)
                if len(window.cloud):  # the origin of a cloud without points is anywhere
                    clouds.append(dataclasses.replace(window.cloud, source=None))
        return clouds

    @functools.cached_property
    def sample(self) -> tuple[list[PointCloud], Whole]:
        """Windows, or all of a small scene, and the point spacing of all of them together."""
        clouds = self.clouds(most=_SMALL)
        parts = [canonical_points(cloud) for cloud in clouds]
        if len(parts) == 1:
            return clouds, Whole(parts[0].spacing())
        area = sum(points.spacing() ** 2 * len(points) for points in parts)
        members = sum(len(points) for points in parts)
        return clouds, Whole(math.sqrt(area / members) if members else None)

    def filter_for(self, recipe: Recipe) -> Filter:
        """The filter of a run, the same for all tiles, by the window with most candidates. Raises: ParameterError."""
        if not recipe.by_data:
            return cast(Filter, recipe.alone())
        clouds, whole = self.sample
        if not clouds:
            return recipe.on(joined([], whole))
        most = max(clouds, key=lambda cloud: int(cloud.candidate.sum()))
        return recipe.on(dataclasses.replace(most, whole=whole))

    def whole_for(self, filter_: Filter) -> Whole:
        """What the filter takes from the scene as a whole (``of_scene``)."""
        whole = self.sample[1]

        def some(points: int) -> list[PointCloud]:
            entire = self.collection.count <= min(points, _SMALL) and self.where.fills
            clouds = (
                self.sample[0] if entire else self.clouds(min(points, self.collection.count // 4) // _WINDOWS, points)
            )
            return [dataclasses.replace(cloud, whole=whole) for cloud in clouds]

        return dataclasses.replace(whole, **of_scene(filter_, some))
