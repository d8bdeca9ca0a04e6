"""What methods on a grid share: a pure model of the cells, a pure test of the points, and sweeps of both."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import in_turn
from ..core.errors import check_positive
from ..core.filter import Filter, Labels, ground_each, group_equal, values_of, watch
from ..core.grid import Grid
from ..core.params import static
from ..core.points import Points
from ..core.result import Decision, Progress
from ..engines.grid.sampling import bilinear
from .outliers import bar_outliers
from .surfaces import Cells, cell_values, hold_against, lowest_cells, steepness

CELL_BYTES, POINT_BYTES = 80, 24
"""About so many of memory per cell, and per point, for each surface of a sweep."""


class Surface(NamedTuple):
    """What a model makes of cells: a pytree of arrays of their padded shape [rows, columns].

    Attributes:
        z: f32, metres.
        slope: f32, rise over run.
        grid: as in :class:`jaxfilter.steps.surfaces.Cells`.
        limits: what else the method's test needs.
        counts: numbers of cells by what they are, i32[] each.
    """

    z: jax.Array
    slope: jax.Array
    grid: Grid
    limits: Any = None
    counts: dict[str, Any] = {}  # noqa: RUF012, never changed

    @classmethod
    def over(cls, cells: Cells, z: jax.Array, limits: Any = None, counts: dict[str, Any] | None = None) -> Surface:
        """Elevations of cells, f32[rows, columns], with their slopes."""
        return cls(z, steepness(z, cells.grid), cells.grid, limits, counts or {})

    def at(self, xyz: jax.Array | np.ndarray) -> tuple[jax.Array, jax.Array]:
        """Height of points f32[n, 3] above the surface, metres, and its slope, rise over run; bilinear between cell centres."""
        xyz = jnp.asarray(xyz)
        at = (xyz[:, :2] - jnp.stack([self.grid.x0, self.grid.y0])[None]) / self.grid.cell - 0.5
        sample = bilinear(at, jnp.stack(self.grid.shape), self.z.shape[1])
        return xyz[:, 2] - sample(self.z), sample(self.slope)


class Heights(NamedTuple):
    """Points held against a surface, f32[n] each.

    Attributes:
        height: metres above the surface.
        slope: of the surface there, rise over run.
        above: metres above the highest elevation that is ground there; negative below it.
        below: metres below the lowest elevation that is ground there; negative above it.
    """

    height: jax.Array
    slope: jax.Array
    above: jax.Array
    below: jax.Array

    @property
    def margin(self) -> jax.Array:
        """f32[n], metres outside the limits, negative inside: ground are the points with at most zero."""
        return jnp.maximum(self.above, self.below)


@dataclasses.dataclass(frozen=True)
class GridFilter(Filter):
    """A filter that makes a surface of the lowest elevation per cell, and holds all points against it.

    ``model`` and ``test`` are pure functions of pytrees, for a user's ``jax.jit`` and ``jax.vmap``, over parameters, over
    clouds of one padded shape, or over both; the filter itself is the pytree of its parameters::

        points = filter_.points_of(cloud)
        cells = filter_.cells(points)
        ground = filter_.test(filter_.model(cells), points.xyz).margin <= 0

    A method gives ``prepare``, ``surface`` and ``test``. Derivatives: ``test`` has them in the points' elevations, in the
    surface and in the fields in ``TESTED``; a surface changes in steps where cells become objects, and has none in other
    fields (:func:`jaxfilter.soft_labels`).

    >>> points = jf.SMRF().points_of(cloud)
    >>> surface = jf.SMRF().model(jf.SMRF().cells(points))
    >>> ground = jf.SMRF().test(surface, points.xyz).margin <= 0
    >>> bool((points.spread(ground) == jf.SMRF()(cloud).ground).all())
    True
    """

    cell: float = static("a grid cell is this wide", "c > 0 m", default=1.0)

    TESTED: ClassVar[tuple[str, ...]] = ()
    """Traced fields that ``test`` reads; sets that differ in these share the surface, unless ``surface`` reads one, too."""
    CENTRED: ClassVar[bool] = False
    """Whether cells are centred on the nodes of the lattice, instead of lying between them."""
    TRACED: ClassVar[str] = (
        "trace its model and test: test(model(cells), xyz), with cells = filter.cells(filter.points_of(cloud))"
    )

    def lattice(self) -> float:
        """The cells."""
        return float(self.cell)

    def _barred(self, points: Points, workers: int | None) -> np.ndarray:
        """bool[m]: points that set no lowest elevation."""
        return np.zeros(len(points), bool)

    def cells(self, points: Points, barred: np.ndarray | None = None) -> Cells:
        """The lowest elevation per ``cell``, without the points ``barred``, bool[m]; by default without clusters of low outliers,
        if the method bars them. Raises InputError for too many cells.

        >>> cells = jf.SMRF().cells(jf.SMRF().points_of(cloud))
        >>> cells.lowest.shape, cells.grid.shape, float(cells.grid.cell)
        ((256, 256), (61, 61), 1.0)
        """
        x, y = points.offset(self.cell)
        corner = (x - self.cell / 2, y - self.cell / 2) if self.CENTRED else (x, y)
        barred = self._barred(points, None) if barred is None else barred
        return lowest_cells(points, self.cell, f"{type(self).__name__}(cell)", corner=corner, barred=barred)

    def model(self, cells: Cells) -> Surface:
        """The surface that ground lies on. Cells with an elevation that is not finite count as empty; without any that
        has points the surface lies at zero, and that of MSF at infinity. Pure.
        Raises: InputError if the shapes of the arrays do not fit.

        >>> surface = jf.SMRF().model(jf.SMRF().cells(jf.SMRF().points_of(cloud)))
        >>> surface.z.shape == surface.slope.shape
        True
        """
        return self.surface(self.prepare(cells.checked()))

    def prepare(self, cells: Cells) -> Any:
        """The part of ``model`` in which no traced field has a part: a pytree of arrays. Pure.

        >>> cells = jf.SMRF().cells(jf.SMRF().points_of(cloud))
        >>> opened = jf.SMRF().prepare(cells)
        >>> bool((jf.SMRF(slope=0.3).surface(opened).z == jf.SMRF(slope=0.3).model(cells).z).all())
        True
        """
        return cells

    def surface(self, prepared: Any) -> Surface:
        """The rest of ``model``. Pure.

        >>> cells = jf.MSF().cells(jf.MSF().points_of(cloud))
        >>> surface = jf.MSF().surface(jf.MSF().prepare(cells))
        >>> bool((surface.z[cells.seen] <= cells.lowest[cells.seen]).all())
        True
        """
        raise TypeError(f"{type(self).__name__} does not define surface()")

    def test(self, surface: Surface, xyz: jax.Array | np.ndarray) -> Heights:
        """Points f32[n, 3], local metres, held against a surface. Pure.

        A method without a test of its own has for ``limits`` the highest and the lowest elevation of ground in every cell.

        >>> points = jf.SMRF().points_of(cloud)
        >>> surface = jf.SMRF().model(jf.SMRF().cells(points))
        >>> heights = jf.SMRF().test(surface, points.xyz)
        >>> heights.height.shape == (len(points),)
        True
        """
        return _between(surface, xyz)

    def _deciding(self, prepared: Any, sets: Sequence[Self]) -> list[Any]:
        """For every set what decides its surface: those with equal values share it."""
        return values_of(sets, but=self.TESTED)

    def _soft(self, prepared: Any, xyz: jax.Array, width: jax.Array | float) -> jax.Array:
        """f32[n], 0 to 1: :func:`soft_labels` of what ``prepare`` has made; ``width`` in metres. Pure."""
        return jax.nn.sigmoid(-self.test(self.surface(prepared), xyz).margin / width)

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see the class for the steps and :class:`jaxfilter.core.filter.Filter` for the call."""
        progress(0.0, "outliers")
        barred = self._barred(points, workers)
        progress(0.2, "lowest point per cell")
        prepared = self.prepare(self.cells(points, barred))
        progress(0.4, "surface")
        surface = self.surface(prepared)
        progress(0.8, "classifying")
        labels = labels_of(*hold_against(points.xyz, lambda chunk: self.test(surface, chunk)))
        progress(1.0, "done")
        labels.barred, labels.info = barred, {name: int(n) for name, n in surface.counts.items()}
        return labels


@dataclasses.dataclass(frozen=True, kw_only=True)
class LowOutlierFilter(GridFilter):
    """A filter on a grid that may bar clusters of low outliers, which otherwise would lower the surface around them."""

    low_clusters: bool = static("clusters of low outliers take no part in the lowest elevations", default=True)

    def _barred(self, points: Points, workers: int | None) -> np.ndarray:
        return bar_outliers(points, radius=0.0, min_neighbours=1, clusters=self.low_clusters, workers=workers)[0]


@ground_each.register(GridFilter)
def _ground_each(
    filter_: GridFilter, points: Points, sets: Sequence[Any], *, key: Any, workers: int | None, memory: float
) -> Iterator[tuple[int, np.ndarray]]:
    """Sets that agree in what cells and ``prepare`` read share them, and those that ``_deciding`` calls alike the surface; each
    is then held against it by the program that ``classify`` runs, since another one would round differently."""
    one, read = watch(filter_)
    prepared = one.prepare(one.cells(points, one._barred(points, workers)))
    same, *others = group_equal(values_of(sets, read))
    for rest in others:
        again = [sets[number] for number in rest]
        for number, ground in _ground_each(again[0], points, again, key=key, workers=workers, memory=memory):
            yield rest[number], ground
    some = [sets[number] for number in same]
    size = max(np.size(a) for a in jax.tree.leaves(prepared))
    room = int(memory // (CELL_BYTES * size + POINT_BYTES * len(points)))
    threads = workers or os.cpu_count() or 1

    def make_surface(numbers: list[int]) -> tuple[Surface, set[str]]:
        first, read = watch(some[numbers[0]])
        return first.surface(prepared), read

    def classify_set(job: tuple[Surface | None, int]) -> np.ndarray:
        one = some[job[1]]
        return _passed(job[0] or one.surface(prepared), points.xyz, one)

    for numbers, (surface, read) in in_turn(
        make_surface, group_equal(filter_._deciding(prepared, some)), max(1, min(threads, room))
    ):
        shared = surface if read.isdisjoint(filter_.TESTED) else None
        for (_, number), ground in in_turn(classify_set, [(shared, number) for number in numbers], threads):
            yield same[number], ground


def soft_labels(filter_: GridFilter, cells: Cells, xyz: jax.Array, width: jax.Array | float = 0.1) -> jax.Array:
    """How much each point is ground, by smooth functions in place of thresholds: for fits by gradient.

    Args:
        filter_: SMRF, or PMF on a grid; its traced fields may be what is differentiated.
        cells: what ``filter_.cells`` has made, once.
        xyz: f32[n, 3], local metres.
        width: metres over which a label changes from 0.73 to 0.27 at a threshold.

    Raises: ParameterError for a width that is not positive.
    Returns: f32[n], 0 to 1. The logistic function of the margin, so that 1/2 is the threshold. At the slope of SMRF, and at the
        thresholds of PMF that surfaces are compared by, cells become objects: there it is a mixture of both cases, which has no
        jumps, so that the gradient is that of what is returned. It is not the gradient of the labels, which are steps. Pure.

    >>> points = jf.SMRF().points_of(cloud)
    >>> soft = jf.soft_labels(jf.SMRF(), jf.SMRF().cells(points), points.xyz, width=0.1)
    >>> bool(((soft >= 0) & (soft <= 1)).all())
    True
    """
    check_width(width)
    return filter_._soft(filter_.prepare(cells.checked()), xyz, width)


def check_width(width: jax.Array | float) -> None:
    """Raises: ParameterError for a width that is not above zero, unless it is traced."""
    if not isinstance(width, jax.core.Tracer):
        check_positive(" of metres", width=float(width))


def _passed(surface: Surface, xyz: np.ndarray, one: GridFilter) -> np.ndarray:
    """bool[n]: the points f32[n, 3] that are ground, as by :func:`labels_of`."""
    above, below = hold_against(xyz, lambda chunk: one.test(surface, chunk)[2:])
    return np.maximum(above, below) <= 0


@jax.jit
def _between(surface: Surface, xyz: jax.Array) -> Heights:
    """Points f32[n, 3] held against the limits of their cell."""
    (highest, lowest), z = surface.limits, xyz[:, 2]
    base, slope, ceiling, floor = cell_values(xyz, (surface.z, surface.slope, highest, lowest), surface.grid)
    return Heights(z - base, slope, z - ceiling, floor - z)


def labels_of(height: np.ndarray, slope: np.ndarray, above: np.ndarray, below: np.ndarray) -> Labels:
    """Labels of points by what :class:`Heights` holds, f32[n] each."""
    margin = np.maximum(above, below)
    decision = np.full(len(margin), Decision.ACCEPTED, np.uint8)
    decision[below > 0] = Decision.LOW
    decision[above > 0] = Decision.SURFACE
    return Labels(margin <= 0, height=height, slope=np.degrees(np.arctan(slope)), margin=margin, decision=decision)
