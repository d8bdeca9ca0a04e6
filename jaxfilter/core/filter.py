"""The part of a ground filter that all methods share: candidates in, degenerate clouds, labels out in input order."""

from __future__ import annotations

import dataclasses
import functools
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import jax
import numpy as np

from .cloud import PointCloud, as_cloud
from .compilation import in_turn, keep_compilations
from .errors import InputError, ParameterError, check_positive, check_whole, warn
from .params import Preset, check_fields, declared
from .points import Points, canonical_points, check_extent, has_area, plain_points
from .process import need_threads
from .result import QUANTITIES, Call, Decision, FilterResult, Progress, Status, key_words, silent
from .water import WaterCells

_BYTES = 1000
"""About so many of memory per point of a classification."""


@dataclasses.dataclass
class Labels:
    """What a method's ``classify`` gives back: as :class:`FilterResult`, per row of ``Points`` (length m); what is absent stays
    None."""

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
    water: np.ndarray | None = None
    deck: np.ndarray | None = None
    water_cells: WaterCells | None = None
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
    that has such registers how with :func:`passed`. A class with methods of its own has none that it does not name itself.
    ``DOUBTS`` methods state for every label how likely it is to be wrong.
    ``TRACED`` says what of the method can be traced by ``jax.jit``, ``vmap`` and ``grad``, which a call cannot.

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
    TRACED: ClassVar[str] = "SMRF, PMF and MSF have a model and a test that can be traced"

    def __new__(cls, *values: Any, **fields: Any) -> Self:
        if values:
            names = ", ".join(f.name for f in declared(cls))
            raise ParameterError(f"{cls.__name__}({values[0]!r}): name the field that this is: {names}")
        return super().__new__(cls)

    def __init_subclass__(cls, **options: Any) -> None:
        """What the classes above promise of their own methods does not hold for others."""
        super().__init_subclass__(**options)
        own = vars(cls)
        if "classify" in own:
            ground_each.register(cls, ground_each.dispatch(object))
        if "LAST" not in own and any(callable(own[name]) for name in own if name[:2] != "__"):
            cls.LAST = ()

    if not TYPE_CHECKING:

        def __getattribute__(self, name):
            if (read := _own(self).get("_read")) is not None:
                read.update(_own(self) if name == "__dict__" else (name,))
            return object.__getattribute__(self, name)

    def __post_init__(self) -> None:
        """Validate the fields; methods extend it by what holds of several fields together. Raises ParameterError."""
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
        check_positive(" of metres", largest_building=largest_building)
        points = canonical_points(as_cloud(cloud), keep=not cls.ORDER_FREE)
        changes = {**cls.from_points(points, largest_building), **changes}
        return cls(**changes) if preset is None else cls.preset(preset, **changes)

    @classmethod
    def from_points(cls, points: Points, largest_building: float | None) -> dict[str, Any]:
        """Field values for distinct candidates and a largest building, metres: those of :meth:`from_spacing`, and what a method
        tells from the points besides."""
        return cls.from_spacing(points.spacing(), largest_building)

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Field values for a mean point spacing and a largest building, both in metres; None = its size is not known."""
        return {}

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed. Raises ParameterError."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def points_of(self, cloud: PointCloud) -> Points:
        """The candidates of a cloud as ``classify`` takes them. Raises InputError if the extent is beyond measure, ForkError
        in a forked process without the threads of JAX."""
        need_threads()
        keep_compilations()
        points = plain_points(cloud) if self.ORDER_FREE else canonical_points(cloud)
        check_extent(cloud, points.xyz)
        return points

    def halo(self) -> float:
        """Metres around a tile that are filtered with it: farther away next to nothing changes labels inside. It grows with
        the largest building: a tile must see as far as an object is wide."""
        raise TypeError(f"{type(self).__name__} does not define halo()")

    def lattice(self) -> float:
        """Period, metres, of all squares of the method that count from the anchor: tiles that end at multiples of it cut none
        of them, and points that are shifted by multiples of it have the labels that they had (docs/conventions.md says where
        not)."""
        return 1.0

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Classify candidate points, distinct and in canonical order unless the method is ``ORDER_FREE``. There are at least
        four positions, not on a line, and not all of one elevation."""
        raise TypeError(f"{type(self).__name__} does not define classify()")

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
        """
        one = self.replace()  # checked, and with plain numbers, which trees may hold as arrays
        one._need_values(cloud)
        check_resources(workers, key=key)
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
        return dataclasses.replace(result, run=Call(one, cloud, time.perf_counter() - start, key_words(key)))

    def _need_values(self, cloud: Any) -> None:
        """Raises: InputError for a traced array, ParameterError for a traced field: sorting and triangulation need values."""
        name = type(self).__name__
        advice = f"{name} cannot be called within jax.jit, vmap or grad, since it works on values; {self.TRACED} (docs/arrays.md)"
        if isinstance(cloud, jax.core.Tracer):
            raise InputError(f"{name}(...)(cloud): the cloud is a traced array; {advice}")
        for field in declared(self):
            if isinstance(getattr(self, field.name), jax.core.Tracer):
                raise ParameterError(f"{name}({field.name}=...)(cloud): the field is traced; {advice}")


_Method = TypeVar("_Method", bound=Callable[..., Any])
_Filter = TypeVar("_Filter", bound=Filter)


def watch(filter_: _Filter) -> tuple[_Filter, set[str]]:
    """A copy of a filter, and the names of what has been read of it so far: what a step makes of the copy, it makes of every set
    that agrees in these fields. A function under ``jax.jit`` that takes a filter reads all of it."""
    one, own, names = object.__new__(type(filter_)), _own(filter_), {field.name for field in declared(filter_)}
    derived = own.keys() - names - {"_read"}  # of fields that nobody has watched
    read = names if derived else set[str]()
    _own(one).update(own, _read=read)
    return one, read


def _own(filter_: Filter) -> dict[str, Any]:
    """The fields of a filter, unwatched."""
    return object.__getattribute__(filter_, "__dict__")  # type: ignore[no-any-return]


def stage(method: _Method) -> _Method:
    """A method of a filter, called with points, whose result is kept where points keep such results, those of a sweep. Sets that
    agree in all fields that it reads share the result, and must not change it, until a set with other values asks for its own."""

    @functools.wraps(method)
    def call(self: Filter, points: Points, *args: Any) -> Any:
        if points.kept is None:
            return method(self, points, *args)
        read, values, result = points.kept.get(method.__qualname__, (set(), None, None))
        if values != values_of([self], read):
            one, read = watch(self)
            result = method(one, points, *args)
            points.kept[method.__qualname__] = read, values_of([self], read), result
        _own(self).get("_read", set()).update(read)  # whoever watches the caller is to know
        return result

    return call  # type: ignore[return-value]


@functools.singledispatch
def passed(filter_: Filter, labels: Labels | FilterResult) -> np.ndarray:
    """bool[m], of a FilterResult bool[n]: ground by the thresholds in ``filter_.LAST``; ``labels`` are those of a set that may
    differ in these. Methods that have such thresholds register how they apply them."""
    raise TypeError(f"{type(filter_).__name__} has no thresholds that are applied last")


@functools.singledispatch
def lowest_among(filter_: Filter, points: Points) -> np.ndarray | None:
    """bool[m]: the points whose lowest elevation decides labels anywhere in the scene; None = no elevation does."""
    return None


@functools.singledispatch
def of_scene(filter_: Filter, some: Callable[[int], list[PointCloud]]) -> dict[str, Any]:
    """Fields of :class:`jaxfilter.core.cloud.Whole` that the method takes from a scene before any part of it is filtered.
    ``some`` reads windows of the scene with about so many points together, or all of it where that is less."""
    return {}


@functools.singledispatch
def ground_each(
    filter_: Filter, points: Points, sets: Sequence[Any], *, key: Any, workers: int | None, memory: float
) -> Iterator[tuple[int, np.ndarray]]:
    """Classify the same points, as ``classify`` gets them, with several sets of parameters, which differ from the filter's in
    traced fields only. Methods whose sets can share work register a way of their own. Here sets that differ in ``LAST`` only
    share all but the last step, and several are classified at a time, in threads. Each set has the labels of ``classify``.
    ``memory``: bytes for what is held for many sets. Yields: number of the set, and bool[m], the points that are ground; in
    any order of the sets."""
    jobs = group_equal(values_of(sets, but=filter_.LAST))
    points = points if points.kept is not None else dataclasses.replace(points, kept={})
    threads = workers or os.cpu_count() or 1
    at_once = max(1, min(threads, len(jobs), int(memory // (_BYTES * len(points)))))

    def classified(job: list[int]) -> Labels:
        return sets[job[0]].classify(points, key=key, workers=threads // at_once, progress=silent, trace=False)

    for job, labels in in_turn(classified, jobs, at_once):
        yield job[0], labels.ground
        yield from ((number, passed(sets[number], labels)) for number in job[1:])


def values_of(sets: Sequence[Filter], read: set[str] | None = None, but: Sequence[str] = ()) -> list[tuple[Any, ...]]:
    """The values of all fields of every set, or of those that :func:`watch` has seen read; but not of some."""
    names = [f.name for f in declared(sets[0]) if (read is None or f.name in read) and f.name not in but]
    return [tuple(map(_own(one).get, names)) for one in sets]


def group_equal(keys: Iterable[Any]) -> list[list[int]]:
    """Numbers of equal keys together, in the order in which the keys appear."""
    found: dict[Any, list[int]] = {}
    for number, key in enumerate(keys):
        found.setdefault(key, []).append(number)
    return list(found.values())


def check_resources(workers: int | None, memory: float = 1.0, key: Any = None) -> None:
    """Raises: ParameterError for threads or bytes that are none, or another random key than one of JAX."""
    if workers is not None:
        check_whole(1, 4096, workers=workers)
    if not 0 < memory < 1e18:
        raise ParameterError(f"memory={memory!r}: must be a number of bytes > 0, below 1e18")
    try:
        if key is not None:
            jax.eval_shape(jax.random.bits, key)
    except (TypeError, ValueError) as error:
        raise ParameterError(f"key={key!r}: must be one JAX random key, such as jax.random.key(0), or None") from error


def degenerate(cloud: PointCloud, points: Points) -> Labels | None:
    """Labels for clouds in which there is nothing to filter, else None."""
    m = len(points)
    if m == 0:
        return Labels(np.zeros(0, bool), status=Status.NO_CANDIDATES if len(cloud) else Status.NO_POINTS)
    z = points.xyz[:, 2]
    three = all(len(np.unique(points.xyz[:few, :2], axis=0)) <= 3 for few in (10, 1000, m))
    if three or not has_area(points.xyz):
        xy = points.xyz[:, :2].astype(np.float64)
        order = np.lexsort((z, xy[:, 1], xy[:, 0]))
        ground = np.ones(m, bool)
        ground[order[1:]] = (np.diff(xy[order], axis=0) != 0).any(axis=1)
        return Labels(ground, status=Status.TOO_FEW_POINTS)
    if np.ptp(z) == 0:
        level = np.zeros(m, np.float32)
        return Labels(np.ones(m, bool), height=level, slope=level, status=Status.FLAT)
    return None


def expand(cloud: PointCloud, points: Points, labels: Labels) -> FilterResult:
    """From canonical points back to all points of the cloud, in input order."""

    def spread(values: np.ndarray | None, empty: Any, dtype: Any) -> np.ndarray:
        return np.full(len(cloud), empty, dtype) if values is None else points.spread(values, empty, dtype)

    facts: dict[str, Any] = {name: spread(getattr(labels, name), np.nan, np.float32) for name in QUANTITIES}
    for name in ("settled", "doubt", "water", "deck"):
        values = getattr(labels, name)
        facts[name] = None if values is None else points.spread(values, np.nan if name == "doubt" else False)
    facts |= {name: spread(getattr(labels, name), False, bool) for name in ("ground", "barred")}
    decision = labels.decision
    if decision is None:
        decision = np.where(labels.ground, Decision.ACCEPTED, Decision.SURFACE)
    facts["decision"] = spread(decision, Decision.SET_ASIDE, np.uint8)
    facts["trace"] = [
        {name: spread(v, False, bool) if name == "ground" else v for name, v in step.items()} for step in labels.trace
    ]
    facts["info"] = {"points": len(cloud), "candidates": len(points.index), **labels.info}
    return FilterResult(status=labels.status, water_cells=labels.water_cells, **facts)
