"""The ground around a tile, as far as the surface through it needs: for terrain models and heights."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable, Iterator

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError
from ..core.filter import Filter
from ..core.inputs import class_numbers
from ..core.reading import Bounds
from ..core.result import FilterResult
from ..terrain.interpolation import Heights, Linear
from .measures import Recipe, recipe_of
from .plan import window_around
from .product import Cut, Product
from .report import Summary
from .tiles import LOCAL, Around, Tile, inside

FIND_GROUND = "classify it first, or find the ground with a filter (ground=jf.SMRF(), or --filter smrf)"
"""What to do where no point is ground."""
HALOS = (40.0, 80.0, 160.0, 320.0)
"""Metres around a tile whose ground points take part: the first that suffices, by the circles of the triangles."""
_EDGE = 20.0
"""Metres along the edge of the data where triangles at the hull of a tile are let stand."""
GroundSource = Filter | Recipe | Iterable[int]
"""What is ground: a filter that finds it, or classes of points, less withheld ones."""


@dataclasses.dataclass(frozen=True, eq=False)
class Surroundings:
    """Points of a tile and around it; ``result``: of the filter, if it was asked.

    ``ground``: bool[n], all that was found; ``near``: the box within which these are ground points of the whole, None =
    everywhere; ``doubt``: counts what a surface through them may have otherwise than the whole.
    """

    around: Around
    tile: Tile
    ground: np.ndarray
    near: Bounds | None
    result: FilterResult | None
    doubt: DoubtfulTriangles

    @property
    def usable(self) -> np.ndarray:
        """bool[n]: ground points of the whole."""
        return self.ground & inside(self.around.cloud, self.near)


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundNeeded(Product):
    """A product for which the ground around each tile must be known.

    Attributes:
        data: bounds of all points, file units.
        classes_of_ground: None: ``filter`` finds it.
        grain: metres: ground points are taken as far as multiples of it.
    """

    data: Bounds
    classes_of_ground: tuple[int, ...] | None
    grain: float

    @property
    def reach(self) -> float:
        """Metres around a tile that ground is needed for, besides that under its own points or cells."""
        return 0.0

    def cut(self) -> Cut:
        """Tiles whose cores end at multiples of ``grain``."""
        beyond, lattice = self._seen()
        return Cut(HALOS[0] + self.reach + beyond, self.grain, HALOS[-1] + self.reach + beyond + lattice)

    def _seen(self) -> tuple[float, float]:
        """Metres around ground points that the filter sees, and that windows end at multiples of."""
        if self.filter is None:
            return 0.0, self.grain
        return self.filter.halo() if self.halo is None else self.halo, self.filter.lattice()

    def surroundings(self, tile: Tile, summary: Summary) -> Iterator[Surroundings]:
        """What is around a tile, with wider and wider halos. Raises: InputError unless the tile is ``patient``."""
        metre, local = tile.sources[0].metre, LOCAL.get()
        beyond, lattice = self._seen()
        for halo in HALOS:
            near, wide = None, tile
            if tile.core is not None:
                near = window_around(tile.core, (halo + self.reach) / metre, self.grain / metre)
                wide = dataclasses.replace(tile, window=window_around(near, beyond / metre, lattice / metre))
            around, result, start = self.read(wide, summary), None, time.perf_counter()
            if self.filter is not None:
                cloud = dataclasses.replace(around.cloud, core=near)
                result = self.filter(cloud, workers=local.threads, progress=local.progress)
                summary.seconds["filter"] += time.perf_counter() - start
            ground = ground_by_class(around.cloud, self.classes_of_ground, tile) if result is None else result.ground
            doubt = DoubtfulTriangles(around.cloud, self.data, near)
            yield Surroundings(around, wide, ground, near, result, doubt)
            if tile.core is None:
                return

    def facts(self) -> dict[str, object]:
        """Classes of ground points."""
        return {"classes_of_ground": self.classes_of_ground}


def ground_by_class(cloud: PointCloud, classes: tuple[int, ...] | None, tile: Tile) -> np.ndarray:
    """bool[n]: ground by class, or by the labels of text. Raises: InputError if there are neither."""
    if not classes:
        return np.zeros(len(cloud), bool)
    if cloud.classification is not None:
        ground = np.isin(cloud.classification, list(classes))
        return ground if cloud.withheld is None else ground & ~cloud.withheld
    if cloud.reference is not None or not len(cloud):
        return np.zeros(0, bool) if cloud.reference is None else cloud.reference
    raise InputError(f"{tile.sources[0].uri} has neither classes nor labels: {FIND_GROUND}")


def source_of_ground(ground: GroundSource) -> tuple[Recipe | None, tuple[int, ...] | None]:
    """The recipe of the filter that finds the ground, or the classes that say what it is. Raises: ParameterError, InputError."""
    if isinstance(ground, Filter | Recipe):
        recipe = recipe_of(ground)
        recipe.alone()
        return recipe, None
    return None, class_numbers(ground)


class DoubtfulTriangles:
    """Counts positions whose triangle may be another in the whole: the circle through its corners holds a place that has
    data and was not read. Outside the hull of the ground points that is any such place, but along the edge of the data."""

    def __init__(self, cloud: PointCloud, data: Bounds, near: Bounds | None) -> None:
        """``data``, ``near``: bounds of all points and of what was read, file units."""
        self.count, self.looked = 0, False
        factor, origin = cloud.units.xy, cloud.origin[:2]

        def local(box: Bounds) -> np.ndarray:
            return (np.array(box).reshape(2, 2) - origin) * factor

        (x0, y0), (x1, y1) = self._inner = local(data) + [[_EDGE], [-_EDGE]]
        (w, s), (e, n) = local(data if near is None else near)
        boxes = ((x0, y0, w, y1), (e, y0, x1, y1), (x0, y0, x1, s), (x0, n, x1, y1))
        self._strips = [np.array(box) for box in boxes if near is not None and box[0] < box[2] and box[1] < box[3]]

    @property
    def reaches(self) -> bool:
        """Whether there are data that were not read."""
        return bool(self._strips)

    def look(self, at: np.ndarray, surface: Heights) -> None:
        """Positions f64[q, 2], local metres, and the surface that gives their heights."""
        self.looked = True
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
