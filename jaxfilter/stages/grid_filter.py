"""What methods on a grid share: a pure model of the cells, a pure test of the points, and sweeps of both."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket, in_turn
from ..core.filter import Filter, Labels, alike, values_but
from ..core.params import static
from ..core.points import Points
from ..core.result import Decision, Progress
from ..ops.sampling import bilinear
from .outliers import bar_outliers
from .surfaces import Cells, cell_values, chunks, hold_against, lowest_cells, steepness

_SURFACES, _SETS = (4, 16), 32
"""In a sweep: surfaces made at a time, in a short one and in others, and sets held against one of them at a time."""
_CELL_BYTES, _POINT_BYTES = 80, 24
"""About so many of memory per cell, and per point, for each surface of a sweep."""
_ROUNDING = 4e-7
"""Share of the elevations: programs that were compiled for one set and for several round differently by less."""


class Surface(NamedTuple):
    """What a model makes of cells: a pytree of arrays of their padded shape [rows, columns].

    Attributes:
        z: f32, metres.
        slope: f32, rise over run.
        extent, frame: as in :class:`jaxfilter.stages.surfaces.Cells`.
        limits: what else the method's test needs.
        counts: numbers of cells by what they are, i32[] each.
    """

    z: jax.Array
    slope: jax.Array
    extent: jax.Array | np.ndarray
    frame: jax.Array | np.ndarray
    limits: Any = None
    counts: dict[str, Any] = {}  # noqa: RUF012, never changed

    @classmethod
    def over(cls, cells: Cells, z: jax.Array, limits: Any = None, counts: dict[str, Any] | None = None) -> Surface:
        """Elevations of cells, f32[rows, columns], with their slopes."""
        return cls(z, steepness(z, cells.extent, cells.frame[2]), cells.extent, cells.frame, limits, counts or {})

    def at(self, xyz: jax.Array | np.ndarray) -> tuple[jax.Array, jax.Array]:
        """Height of points f32[n, 3] above the surface, metres, and its slope, rise over run; bilinear between cell centres."""
        xyz = jnp.asarray(xyz)
        sample = bilinear((xyz[:, :2] - self.frame[:2]) / self.frame[2] - 0.5, self.extent, self.z.shape[1])
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
    >>> labels = np.asarray(ground)[points.member]
    >>> bool((labels == jf.SMRF()(cloud).ground[points.index]).all())
    True
    """

    cell: float = static(default=1.0, symbol="c", unit="m", gt=0, doc="side of a grid cell")

    TESTED: ClassVar[tuple[str, ...]] = ()
    """Traced fields that ``test`` reads and ``surface`` does not: sets that differ in these share the surface."""

    def lattice(self) -> float:
        """The cells."""
        return float(self.cell)

    def barred(self, points: Points, workers: int | None) -> np.ndarray:
        """bool[m]: points that set no lowest elevation, those in clusters of low outliers if ``low_clusters`` is on.

        >>> points = jf.PMF().points_of(cloud)
        >>> jf.PMF().barred(points, None).dtype, bool(jf.PMF(low_clusters=False).barred(points, None).any())
        (dtype('bool'), False)
        """
        clusters = getattr(self, "low_clusters", False)
        return bar_outliers(points, radius=0.0, min_neighbours=1, clusters=clusters, workers=workers)[0]

    def cells(self, points: Points, barred: np.ndarray | None = None) -> Cells:
        """The lowest elevation per ``cell``, without the points ``barred``, bool[m]. Raises InputError for too many cells.

        >>> cells = jf.SMRF().cells(jf.SMRF().points_of(cloud))
        >>> cells.lowest.shape, np.asarray(cells.extent).tolist(), float(cells.frame[2])
        ((128, 128), [61, 61], 1.0)
        """
        return lowest_cells(
            points, self.cell, f"{type(self).__name__}(cell)", corner=self.corner(points), barred=barred
        )

    def corner(self, points: Points) -> tuple[float, float]:
        """A corner of the lattice of cells, local metres.

        >>> x, y = jf.SMRF(cell=2.0).corner(jf.SMRF().points_of(cloud))
        >>> -2 <= x <= 0 and -2 <= y <= 0
        True
        """
        return points.offset(self.cell)

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

    def soft(self, prepared: Any, xyz: jax.Array, width: jax.Array | float) -> jax.Array:
        """f32[n], 0 to 1: :func:`soft_labels` of what ``prepare`` has made; ``width`` in metres. Pure.

        >>> points = jf.PMF().points_of(cloud)
        >>> prepared = jf.PMF().prepare(jf.PMF().cells(points))
        >>> soft = jf.PMF().soft(prepared, points.xyz, 0.1)
        >>> bool(((soft >= 0) & (soft <= 1)).all())
        True
        """
        return jax.nn.sigmoid(-self.test(self.surface(prepared), xyz).margin / width)

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see the class for the steps and :class:`jaxfilter.core.filter.Filter` for the call."""
        progress(0.0, "outliers")
        barred = self.barred(points, workers)
        progress(0.2, "lowest point per cell")
        prepared = self.prepare(self.cells(points, barred))
        progress(0.4, "surface")
        surface = self.surface(prepared)
        progress(0.8, "classifying")
        labels = labels_of(*hold_against(points.xyz, lambda chunk: self.test(surface, chunk)))
        progress(1.0, "done")
        labels.barred, labels.info = barred, {name: int(n) for name, n in surface.counts.items()}
        return labels

    def ground_each(
        self, points: Points, sets: Sequence[Self], *, key: Any, workers: int | None, memory: float
    ) -> Iterator[tuple[int, np.ndarray]]:
        """``vmap`` of the model over all sets, which share what ``prepare`` makes; see the class :class:`Filter`."""
        prepared = self.prepare(self.cells(points, self.barred(points, workers)))
        keys = self.deciding(prepared, sets)
        groups = sorted(alike(keys), key=lambda numbers: keys[numbers[0]])  # surfaces made together are alike
        jobs = sorted((part[k : k + _SETS] for part in groups for k in range(0, len(part), _SETS)), key=len)
        wide = bucket(min(_SETS, max(map(len, alike(values_but(self.TESTED, sets))), default=1)), 1)
        size = max(a.size for a in jax.tree.leaves(prepared))
        room = int(memory // (_CELL_BYTES * size + _POINT_BYTES * len(points)))
        most = int(np.clip(room, 1, _SURFACES[len(jobs) > _SURFACES[0]]))

        def stacked(rows: list[list[int]]) -> GridFilter:
            """The sets of these numbers, [rows, numbers]."""
            leaves = (sets[number] for row in rows for number in row)
            return jax.tree.map(lambda *values: np.asarray(values, np.float32).reshape(len(rows), -1), *leaves)

        def passed(some: list[list[int]]) -> np.ndarray:
            """bool[jobs, sets, m], of as many sets as the longest job has, and the last of the others over and over."""
            longest = -(-max(map(len, some)) // wide) * wide
            padded = [job + job[-1:] * (longest - len(job)) for job in some + some[-1:] * (most - len(some))]
            parts = [stacked([job[k : k + wide] for job in padded]) for k in range(0, longest, wide)]
            surfaces = _surfaces(jax.tree.map(lambda leaf: leaf[:, 0], parts[0]), prepared)
            ground = [
                np.concatenate([_passed(part, surfaces, chunk) for part in parts], axis=1)[
                    ..., : rows.stop - rows.start
                ]
                for rows, chunk in chunks(points.xyz)
            ]
            return np.concatenate(ground, axis=-1)

        batches = [jobs[start : start + most] for start in range(0, len(jobs), most)]
        threads = max(1, min(workers or os.cpu_count() or 1, room // most, len(batches)))
        for some, ground in in_turn(passed, batches, threads):
            yield from ((number, ground[i, k]) for i, job in enumerate(some) for k, number in enumerate(job))

    def deciding(self, prepared: Any, sets: Sequence[Self]) -> list[Any]:
        """For every set what decides its surface: those with equal values share it.

        >>> cells = jf.MSF().cells(jf.MSF().points_of(cloud))
        >>> same, other = jf.MSF().deciding(cells, [jf.MSF(slope=0.3), jf.MSF(slope=0.4)])
        >>> same == other
        False
        """
        return values_but(self.TESTED, sets)

    def votes(self, points: Points, sets: Sequence[Self], *, workers: int | None = None) -> np.ndarray:
        """i32[m]: how many sets call each point ground. They differ in the fields in ``TESTED`` only and share the surface.

        The labels are those of ``classify``: points so near to a threshold that rounding may decide are held against the
        surface once more, in the way it does.

        >>> sets = [jf.SMRF(threshold=metres) for metres in (0.3, 0.5, 0.7)]
        >>> votes = sets[0].votes(sets[0].points_of(cloud), sets)
        >>> int(votes.min()), int(votes.max())
        (0, 3)
        """
        surface = self.model(self.cells(points, self.barred(points, workers)))
        stacked = jax.tree.map(lambda *leaves: np.asarray(leaves, np.float32), *sets)
        near = np.float32(_ROUNDING * (1.0 + float(np.abs(points.xyz[:, 2]).max())))
        counted, doubtful = hold_against(points.xyz, lambda chunk: _votes(stacked, surface, chunk, near))
        votes, again = counted.astype(np.int32), np.flatnonzero(doubtful)
        xyz = points.xyz[again]
        margins = np.asarray(hold_against(xyz, lambda chunk: tuple(_margins(stacked, surface, chunk))), np.float32)
        for one, margin in zip(sets, margins, strict=False):
            rows = np.flatnonzero(np.abs(margin) <= near)
            held = hold_against(xyz[rows], lambda chunk, one=one: one.test(surface, chunk))  # type: ignore[misc]
            if held:
                votes[again[rows]] += labels_of(*held).ground.astype(np.int32) - (margin[rows] <= 0)
        return votes


def soft_labels(filter_: GridFilter, cells: Cells, xyz: jax.Array, width: jax.Array | float = 0.1) -> jax.Array:
    """How much each point is ground, by smooth functions in place of thresholds: for fits by gradient.

    Args:
        filter_: SMRF, or PMF on a grid; its traced fields may be what is differentiated.
        cells: what ``filter_.cells`` has made, once.
        xyz: f32[n, 3], local metres.
        width: metres over which a label changes from 0.73 to 0.27 at a threshold.

    Returns: f32[n], 0 to 1. The logistic function of the margin, so that 1/2 is the threshold; for the slope of SMRF, at which
        cells become objects, a mixture of both cases (:meth:`jaxfilter.filters.smrf.SMRF.soft`). Pure.

    >>> points = jf.SMRF().points_of(cloud)
    >>> soft = jf.soft_labels(jf.SMRF(), jf.SMRF().cells(points), points.xyz, width=0.1)
    >>> bool(((soft >= 0) & (soft <= 1)).all())
    True
    """
    return filter_.soft(filter_.prepare(cells.checked()), xyz, width)


@jax.jit
def _surfaces(filters: GridFilter, prepared: Any) -> Surface:
    """The surface of every filter of a stack."""
    return jax.vmap(lambda one: one.surface(prepared))(filters)


@jax.jit
def _passed(filters: GridFilter, surfaces: Surface, xyz: jax.Array) -> jax.Array:
    """bool[surfaces, sets, n]: points that are ground by every filter of [surfaces, sets]."""

    def one_surface(row: GridFilter, surface: Surface) -> jax.Array:
        return jax.vmap(lambda one: one.test(surface, xyz).margin <= 0)(row)

    return jax.vmap(one_surface)(filters, surfaces)


@jax.jit
def _votes(filters: GridFilter, surface: Surface, xyz: jax.Array, near: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How many filters of a stack call each point ground, i32[n], and points that lie within ``near`` metres of a limit.

    One filter after the other: what they share is computed once, and not once for each as under ``vmap``.
    """

    def add(counted: tuple[jax.Array, jax.Array], one: GridFilter) -> tuple[tuple[jax.Array, jax.Array], None]:
        votes, doubtful = counted
        margin = one.test(surface, xyz).margin
        return (votes + (margin <= 0), doubtful | (jnp.abs(margin) <= near)), None

    start = jnp.zeros(len(xyz), jnp.int32), jnp.zeros(len(xyz), bool)
    return jax.lax.scan(add, start, filters)[0]


@jax.jit
def _margins(filters: GridFilter, surface: Surface, xyz: jax.Array) -> jax.Array:
    """f32[sets, n]: the margins of points for every filter of a stack."""
    return jax.lax.map(lambda one: one.test(surface, xyz).margin, filters)


@jax.jit
def _between(surface: Surface, xyz: jax.Array) -> Heights:
    """Points f32[n, 3] held against the limits of their cell."""
    (highest, lowest), z = surface.limits, xyz[:, 2]
    tables = (surface.z, surface.slope, highest, lowest)
    base, slope, ceiling, floor = cell_values(xyz, tables, surface.frame, surface.extent)
    return Heights(z - base, slope, z - ceiling, floor - z)


def labels_of(height: np.ndarray, slope: np.ndarray, above: np.ndarray, below: np.ndarray) -> Labels:
    """Labels of points by what :class:`Heights` holds, f32[n] each."""
    margin = np.maximum(above, below)
    decision = np.full(len(margin), Decision.ACCEPTED, np.uint8)
    decision[below > 0] = Decision.LOW
    decision[above > 0] = Decision.SURFACE
    return Labels(margin <= 0, height=height, slope=np.degrees(np.arctan(slope)), margin=margin, decision=decision)
