"""The part of a ground filter that all methods share: candidates in, degenerate clouds, labels out in input order."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, ClassVar, Self

import jax
import numpy as np

from .cloud import PointCloud, as_cloud
from .compilation import in_turn
from .errors import InputError, ParameterError, warn
from .forks import need_threads
from .markup import table
from .params import Preset, check_fields, declared, plain_fields
from .points import Points, canonical_points, check_extent, plain_points
from .result import Decision, FilterResult, Progress, Run, Status, silent

_BYTES = 1000
"""About so many of memory per point of a classification."""


@dataclasses.dataclass
class Labels:
    """What a method's ``classify`` gives back, per row of ``Points`` (length m); absent quantities stay None.

    ``settled``: bool[m], points that are ground before the last thresholds are applied. ``doubt``: f32[m], probability that
    the label is wrong.
    """

    ground: np.ndarray
    height: np.ndarray | None = None
    slope: np.ndarray | None = None
    angle: np.ndarray | None = None
    elevation: np.ndarray | None = None
    margin: np.ndarray | None = None
    decision: np.ndarray | None = None
    barred: np.ndarray | None = None
    settled: np.ndarray | None = None
    doubt: np.ndarray | None = None
    status: Status = Status.CONVERGED
    info: dict[str, Any] = dataclasses.field(default_factory=dict)
    trace: list[dict[str, Any]] = dataclasses.field(default_factory=list)


class Filter:
    """Base of all methods. A subclass is a ``@filter_params`` dataclass with ``classify`` and ``halo``.

    ``BIBTEX`` holds the entries of the papers to cite, a blank line between them.
    ``PRESETS`` maps a preset's name to field values with a note; every method has "paper" (as printed, but for what the
    note names) and "recommended" (ours).
    ``ORDER_FREE`` methods give each position the same label in any order of the points; theirs are not sorted.
    ``LAST`` names the thresholds that ``classify`` applies last of all, to quantities that do not depend on them; a method
    that has such defines ``passed``.
    ``DOUBTS`` methods state for every label how likely it is to be wrong.

    >>> issubclass(jf.SMRF, jf.Filter), isinstance(jf.SMRF(), jf.GroundFilter)
    (True, True)
    >>> jf.SMRF()(cloud.coordinates())
    FilterResult(2521 of 5033 ground, 50.1 %; finished)
    """

    BIBTEX: ClassVar[str] = ""
    PRESETS: ClassVar[dict[str, Preset]] = {"paper": Preset("as printed"), "recommended": Preset("the default")}
    ORDER_FREE: ClassVar[bool] = False
    LAST: ClassVar[tuple[str, ...]] = ()
    DOUBTS: ClassVar[bool] = False

    def __post_init__(self) -> None:
        plain_fields(self)
        self.check()

    def check(self) -> None:
        """Validate the fields and their combination. Raises ParameterError.

        >>> jf.SMRF(slope=0.2).check()
        >>> jf.SMRF(slope=-1)
        Traceback (most recent call last):
            ...
        jaxfilter.core.errors.ParameterError: SMRF(slope=-1): must be > 0 rise/run
        """
        check_fields(self)

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Self:
        """The filter with a named set of parameters, and with ``changes`` on top. Raises ParameterError.

        >>> list(jf.FPTD.PRESETS)
        ['recommended', 'paper', 'D1', 'D2', 'D3', 'D4']
        >>> jf.FPTD.preset("D4", max_angle=40.0).max_angle
        40.0
        """
        if name not in cls.PRESETS:
            raise ParameterError(f"{cls.__name__} has no preset {name!r}; it has {', '.join(cls.PRESETS)}")
        return cls(**{**cls.PRESETS[name], **changes})

    @classmethod
    def for_cloud(
        cls, cloud: Any, largest_building: float | None = None, *, preset: str | None = None, **changes: Any
    ) -> Self:
        """Parameters set from point spacing and, where it is given, from the largest building (metres) in the cloud.

        Without it windows and seed cells keep their defaults. They replace those of ``preset``; ``changes`` come on top.
        Raises ParameterError.

        >>> filter_ = jf.SMRF.for_cloud(cloud, largest_building=30.0)
        >>> filter_.cell, filter_.window
        (1.0, 15.0)
        """
        if largest_building is not None and not largest_building > 0:
            raise ParameterError(f"largest_building={largest_building!r}: must be > 0 metres")
        points = canonical_points(as_cloud(cloud), keep=not cls.ORDER_FREE)
        changes = {**cls.from_spacing(points.spacing(), largest_building), **changes}
        return cls(**changes) if preset is None else cls.preset(preset, **changes)

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Field values for a mean point spacing and a largest building, both in metres; None = its size is not known.

        >>> jf.SMRF.from_spacing(2.4, 30.0)
        {'window': 15.0, 'cell': 1.5}
        """
        return {}

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed.

        >>> jf.SMRF().replace(slope=0.3).slope
        0.3
        """
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def points_of(self, cloud: PointCloud) -> Points:
        """The candidates of a cloud as ``classify`` takes them. Raises InputError if the extent is
        beyond measure, ForkError in a forked process without the threads of JAX.

        >>> points = jf.PTD().points_of(cloud)
        >>> len(points) <= int(cloud.candidate.sum())
        True
        >>> points.xyz.dtype, points.xyz.shape[1]
        (dtype('float32'), 3)
        """
        need_threads()
        points = plain_points(cloud) if self.ORDER_FREE else canonical_points(cloud)
        check_extent(cloud, points.xyz)
        return points

    def halo(self) -> float:
        """Metres beyond a region that can change labels inside it.

        >>> jf.PMF(max_window=33.0).halo() > 33.0
        True
        """
        raise TypeError(f"{type(self).__name__} does not define halo()")

    def tile_halo(self) -> float:
        """Metres around a tile that are filtered with it by default: ``halo()``, or less where more changes next to nothing.

        >>> filter_ = jf.SMRF(window=18.0)
        >>> filter_.tile_halo() <= filter_.halo()
        True
        """
        return self.halo()

    def lattice(self) -> float:
        """Side of the squares that the method begins with, metres: tiles that end at multiples of it cut none of them.

        >>> jf.SMRF(cell=2.0).lattice()
        2.0
        """
        return 1.0

    def lowest(self, points: Points) -> np.ndarray | None:
        """bool[m]: the points whose lowest elevation decides labels anywhere in the scene; None = no elevation does.

        >>> jf.SMRF().lowest(jf.SMRF().points_of(cloud)) is None
        True
        """
        return None

    def of_scene(self, some: Callable[[int], list[PointCloud]]) -> dict[str, Any]:
        """Fields of :class:`jaxfilter.core.cloud.Whole` that the method takes from a scene before any part of it is filtered.

        ``some``: reads windows of the scene with about so many points together, or all of it where that is less.

        >>> jf.SMRF().of_scene(lambda most: [cloud])
        {}
        """
        return {}

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Classify candidate points, distinct and in canonical order unless the method is ``ORDER_FREE``.

        There are at least four positions, not on a line, and not all of one elevation.

        >>> points = jf.SMRF().points_of(cloud)
        >>> quiet = lambda share, step: None
        >>> labels = jf.SMRF().classify(points, key=None, workers=1, progress=quiet, trace=False)
        >>> bool((points.spread(labels.ground) == jf.SMRF()(cloud).ground).all())
        True
        """
        raise TypeError(f"{type(self).__name__} does not define classify()")

    def passed(self, labels: Labels | FilterResult) -> np.ndarray:
        """bool[m], ground by the thresholds in ``LAST``; ``labels`` are those of a set that may differ in these.

        Of a FilterResult: bool[n].

        >>> jf.CSF.LAST
        ('threshold',)
        >>> other = jf.CSF(threshold=0.3)
        >>> bool((other.passed(jf.CSF(threshold=0.5)(cloud)) == other(cloud).ground).all())
        True
        """
        raise TypeError(f"{type(self).__name__} does not define passed()")

    def ground_each(
        self, points: Points, sets: Sequence[Self], *, key: Any, workers: int | None, memory: float
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Classify the same points with several sets of parameters, which differ from this one in traced fields only.

        A method overrides this where sets can share work. Here sets that differ in ``LAST`` only share all but the last step,
        and several are classified at a time, in threads. Each set has the labels of ``classify``. The clouds are those that
        ``classify`` gets; ``memory`` is in bytes, for what is held for many sets.

        Yields: number of the set, and bool[m], the points that are ground; in any order of the sets.

        >>> sets = [jf.SMRF(threshold=metres) for metres in (0.3, 0.5)]
        >>> points = sets[0].points_of(cloud)
        >>> found = dict(sets[0].ground_each(points, sets, key=None, workers=1, memory=1e9))
        >>> bool((found[0] <= found[1]).all())
        True
        """
        jobs = alike(values_but(self.LAST, sets))
        threads = workers or os.cpu_count() or 1
        at_once = max(1, min(threads, len(jobs), int(memory // (_BYTES * len(points)))))

        def classified(job: list[int]) -> Labels:
            one = sets[job[0]]
            return one.classify(points, key=key, workers=threads // at_once, progress=silent, trace=False)

        for job, labels in in_turn(classified, jobs, at_once):
            yield job[0], labels.ground
            yield from ((number, sets[number].passed(labels)) for number in job[1:])

    def __call__(
        self,
        cloud: Any,
        *,
        key: Any = None,
        workers: int | None = None,
        progress: Progress | None = None,
        trace: bool = False,
    ) -> FilterResult:
        """Classify a cloud.

        Args:
            cloud: a PointCloud, a ``laspy.LasData``, a structured array with X, Y and Z (as of PDAL), or coordinates f64[n, 3];
                arrays are in metres.
            key: a JAX random key; only methods that draw samples use it.
            workers: threads for triangulation; by default one per core.
            progress: called with the fraction done and the name of the step.
            trace: keep the labels after every round in ``result.trace``.

        Returns: FilterResult of length n, in input order.
        Raises: ParameterError, InputError, ForkError.

        >>> jf.SMRF(slope=0.2)(cloud, workers=1).status.message
        'finished'
        """
        one = self.replace()  # checked, and with plain numbers, which trees may hold as arrays
        one._need_values(cloud)
        check_resources(workers)
        cloud, start = as_cloud(cloud), time.perf_counter()
        points = one.points_of(cloud)
        labels = degenerate(cloud, points)
        if labels is None:
            labels = one.classify(points, key=key, workers=workers, progress=progress or silent, trace=trace)
        else:
            warn(f"{type(self).__name__}: {labels.status.message}")
            if self.DOUBTS:
                labels.doubt = np.full(len(labels.ground), np.nan, np.float32)
        result = expand(cloud, points, labels)
        return dataclasses.replace(result, run=Run(one, cloud, time.perf_counter() - start))

    def _need_values(self, cloud: Any) -> None:
        """Raises: InputError for a traced array, ParameterError for a traced field: sorting and triangulation need values."""
        name = type(self).__name__
        advice = f"{name} cannot be called within jax.jit, vmap or grad, since it works on values; "
        if hasattr(self, "model"):
            advice += (
                "trace its model and test: test(model(cells), xyz), with cells = filter.cells(filter.points_of(cloud))"
            )
        else:
            advice += "SMRF, PMF and MSF have a model and a test that can be traced"
        advice += " (docs/arrays.md)"
        if isinstance(cloud, jax.core.Tracer):
            raise InputError(f"{name}(...)(cloud): the cloud is a traced array; {advice}")
        for field in declared(self):
            if isinstance(getattr(self, field.name), jax.core.Tracer):
                raise ParameterError(f"{name}({field.name}=...)(cloud): the field is traced; {advice}")

    def _repr_html_(self) -> str:
        rows = []
        for field in declared(self):
            value, meta = getattr(self, field.name), field.metadata
            default = "" if value == field.default else f" (default {field.default})"
            rows.append(
                (field.name, f"{value}{default}", meta.get("symbol") or "", meta.get("unit") or "", meta["doc"])
            )
        heading = ("parameter", "value", "symbol", "unit", "meaning")
        return f"<strong>{type(self).__name__}</strong>" + table(heading, rows)


def values_but(names: Sequence[str], sets: Sequence[Filter]) -> list[tuple[Any, ...]]:
    """The values of all fields of every set but these."""
    return [tuple(getattr(one, f.name) for f in declared(one) if f.name not in names) for one in sets]


def alike(keys: Iterable[Any]) -> list[list[int]]:
    """Numbers of equal keys together, in the order in which the keys appear."""
    found: dict[Any, list[int]] = {}
    for number, key in enumerate(keys):
        found.setdefault(key, []).append(number)
    return list(found.values())


def check_resources(workers: int | None, memory: float = 1.0) -> None:
    """Raises: ParameterError for threads or bytes that are none."""
    if workers is not None and workers < 1:
        raise ParameterError(f"workers={workers!r}: must be at least 1")
    if not 0 < memory < math.inf:
        raise ParameterError(f"memory={memory!r}: must be a finite number of bytes > 0")


def degenerate(cloud: PointCloud, points: Points) -> Labels | None:
    """Labels for clouds in which there is nothing to filter, else None."""
    m = len(points)
    if len(cloud) == 0:
        return Labels(np.zeros(0, bool), status=Status.NO_POINTS)
    if m == 0:
        return Labels(np.zeros(0, bool), status=Status.NO_CANDIDATES)
    z = points.xyz[:, 2]
    three = all(len(np.unique(points.xyz[:few, :2], axis=0)) <= 3 for few in (10, 1000, m))
    if three or not points.has_area():
        xy = points.xyz[:, :2].astype(np.float64)
        order = np.lexsort((z, xy[:, 1], xy[:, 0]))
        first = np.ones(m, bool)
        first[1:] = (np.diff(xy[order], axis=0) != 0).any(axis=1)
        ground = np.zeros(m, bool)
        ground[order[first]] = True
        return Labels(ground, status=Status.TOO_FEW_POINTS)
    if np.ptp(z) == 0:
        return Labels(
            np.ones(m, bool), height=np.zeros(m, np.float32), slope=np.zeros(m, np.float32), status=Status.FLAT
        )
    return None


def expand(cloud: PointCloud, points: Points, labels: Labels) -> FilterResult:
    """From canonical points back to all points of the cloud, in input order."""

    def spread(values: np.ndarray | None, empty: Any, dtype: Any) -> np.ndarray:
        return np.full(len(cloud), empty, dtype) if values is None else points.spread(values, empty, dtype)

    decision = labels.decision
    if decision is None:
        decision = np.where(labels.ground, np.uint8(Decision.ACCEPTED), np.uint8(Decision.SURFACE))
    trace = [
        {**step, "ground": spread(step["ground"], False, bool)} if "ground" in step else step for step in labels.trace
    ]
    nan = np.nan
    return FilterResult(
        ground=spread(labels.ground, False, bool),
        height=spread(labels.height, nan, np.float32),
        slope=spread(labels.slope, nan, np.float32),
        angle=spread(labels.angle, nan, np.float32),
        elevation=spread(labels.elevation, nan, np.float32),
        margin=spread(labels.margin, nan, np.float32),
        decision=spread(decision, Decision.SET_ASIDE, np.uint8),
        barred=spread(labels.barred, False, bool),
        settled=None if labels.settled is None else spread(labels.settled, False, bool),
        doubt=None if labels.doubt is None else spread(labels.doubt, nan, np.float32),
        status=labels.status,
        info={"points": len(cloud), "candidates": len(points.index), **labels.info},
        trace=trace,
    )
