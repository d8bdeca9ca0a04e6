"""Sweeps: hundreds of sets of parameters in one call, scored and voted."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import DAMAGED_ARRAYS, InputError, ParameterError
from ..core.filter import Filter, check_resources, degenerate, ground_each
from ..core.params import declared
from ..core.result import Progress, key_words, silent
from ..core.version import __version__
from ..files.disk import existing, new_file
from ..scoring import Scores, reference_labels
from .best import SCORE_NAMES, SCORES
from .design import Design, make_design
from .ranges import check_filter

_SAVE_EVERY = 10.0
"""Seconds between writes of a checkpoint."""


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """How sets of parameters are computed; what they find does not depend on ``workers`` and ``memory``.

    Attributes:
        key: JAX random key of methods that draw samples, the same for every set.
        workers: threads for triangulation; by default one per core.
        memory: bytes that may be held for sets computed at the same time.

    Raises: ParameterError for threads or bytes that are none, or another key.

    >>> jf.SweepOptions(workers=2).memory
    2000000000.0
    """

    key: Any = None
    workers: int | None = None
    memory: float = 2e9

    def __post_init__(self) -> None:
        check_resources(self.workers, self.memory, self.key)


class Subject:
    """A cloud in the shape that sets are computed in."""

    def __init__(self, filter_: Filter, cloud: PointCloud, options: SweepOptions) -> None:
        self.points, self.options = dataclasses.replace(filter_.points_of(cloud), kept={}), options
        self.same = degenerate(cloud, self.points)

    def ground_each(self, filters: Sequence[Filter], numbers: Sequence[int]) -> Iterator[tuple[int, np.ndarray]]:
        """Number and bool[m], ground, of some of the filters, which differ in traced fields only."""
        if self.same is not None:
            return ((number, self.same.ground) for number in numbers)
        sets = [filters[number] for number in numbers]
        found = ground_each(sets[0], self.points, sets, **vars(self.options))
        return ((numbers[place], ground) for place, ground in found)


def sweep(
    filter_: Filter,
    clouds: Any,
    axes: Mapping[str, Any],
    *,
    design: str = "grid",
    size: int | None = None,
    seed: int = 0,
    votes: bool = False,
    key: Any = None,
    workers: int | None = None,
    memory: float = 2e9,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> xarray.Dataset:
    """Classify clouds with many sets of parameters, and score each.

    Every set gives the labels that the filter gives with it alone. What sets have in common is computed once: grids and
    openings of SMRF, seeds and first triangulation of methods that densify a triangulation. Fields that fix array shapes or
    code paths (``cell``, ``window``, ...) may be swept too: the sets are grouped by them, and each group compiles at most
    once; ``attrs["groups"]`` says how many there are.

    Args:
        filter_: its other fields are kept.
        clouds: one cloud (PointCloud, or coordinates f64[n, 3]); a list; or a mapping from names to clouds.
        axes: field name to values. In random and sobol designs a tuple (low, high) is a range to draw from, and a list
            the values to choose from.
        design: "grid" = all combinations; "random" or "sobol" = ``size`` sets drawn with ``seed``; "list" = the i-th
            values of all axes make set i.
        votes: count for every point how many sets call it ground.
        key, workers, memory: how sets are computed, see :class:`SweepOptions`.
        checkpoint: file to save finished sets in, and to resume from if it exists.
        progress: called with the fraction done and what is being done.

    Returns: xarray.Dataset. A grid has one dimension per axis, in the order given, a design the dimension ``set`` with the
        axes as coordinates; several clouds add the dimension ``cloud``. A field whose name is also an argument of xarray is
        selected by a mapping: ``data.total.sel({"tolerance": 0.3})``. Variables: ``type1``, ``type2``, ``total``, ``kappa``
        in percent, for clouds with reference labels (NaN for those without); ``ground``, the number of ground points.
        With ``votes``: ``votes`` f32[point], the share of sets that call a point ground, for several clouds ``votes_NAME``
        over ``point_NAME``. Attributes say how to make it again: ``jaxfilter``, its version; ``method``, ``design``,
        ``seed``; as JSON ``parameters``, ``key``, and of each cloud the digest (:meth:`PointCloud.digest`) in ``clouds``.
    Raises: ParameterError naming the axis or argument, and InputError for reference labels of one class only, before
        anything runs; InputError for a checkpoint of another sweep.

    >>> data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.1, 0.2], "threshold": [0.3, 0.5]}, votes=True)
    >>> dict(data.total.sizes), data.votes.shape == (len(cloud),)
    ({'slope': 2, 'threshold': 2}, True)
    >>> int(data.ground.sel(slope=0.2, threshold=0.5)) == int(jf.SMRF(slope=0.2)(cloud).ground.sum())
    True
    """
    filter_ = check_filter(filter_)
    plan = make_design(filter_, axes, design, size, seed)
    options = SweepOptions(key, workers, memory)
    several, named = named_clouds(clouds)
    for name, cloud in named.items():
        check_reference(name, cloud)
    report = progress or silent
    state = _State(filter_, plan, named, votes, key, None if checkpoint is None else Path(checkpoint))
    jobs = len(named) * len(plan.sets)
    try:
        for c, (name, cloud) in enumerate(named.items()):
            scene: _Scene | None = None
            for g, group in enumerate(plan.groups):
                pending = [number for number in group if not state.done[c, number]]
                if not pending:
                    continue
                scene = scene or _Scene(filter_, cloud, options)
                text = f"{name}: " * several + f"{len(plan.sets)} sets"
                text += f", group {g + 1} of {len(plan.groups)}" if len(plan.groups) > 1 else ""
                report(state.done.sum() / jobs, text)
                for number, ground in scene.ground_each(plan.filters, pending):
                    state.add(c, number, scene, ground)
                    report(state.done.sum() / jobs, text)
    finally:
        state.save()
    digests = {name: cloud.digest() for name, cloud in named.items()}
    facts = {"jaxfilter": __version__, "seed": seed, "key": json.dumps(key_words(key)), "clouds": json.dumps(digests)}
    return _dataset(filter_, plan, several, named, state).assign_attrs(facts)


def named_clouds(clouds: Any, caller: str = "sweep") -> tuple[bool, dict[str, PointCloud]]:
    """Whether there are several clouds, and the clouds by name. Raises InputError if there is none, or two have one name."""
    if isinstance(clouds, Mapping):
        several, pairs = True, [(str(name), cloud) for name, cloud in clouds.items()]
    elif isinstance(clouds, PointCloud) or hasattr(clouds, "shape") or not isinstance(clouds, Iterable):
        several, pairs = False, [("cloud", clouds)]
    else:
        several, pairs = True, [(str(i), cloud) for i, cloud in enumerate(clouds)]
    if not pairs:
        raise InputError(f"{caller}: there is no cloud")
    names = [name for name, _ in pairs]
    if twice := {name for name in names if names.count(name) > 1}:
        raise InputError(f"{caller}: two clouds are called {min(twice)!r}: give them different names")
    return several, {name: as_cloud(cloud) for name, cloud in pairs}


def check_reference(name: str, cloud: PointCloud, caller: str = "sweep") -> None:
    """Raises: InputError if the reference labels of a cloud are all of one class."""
    if cloud.reference is None:
        return
    truth, counted = reference_labels(cloud)
    for kind, other in ((truth, "ground"), (~truth, "object")):
        if not (counted & kind).any():
            advice = "scores need both classes. Without scores, pass the cloud with reference=None"
            raise InputError(f"{caller}: no point of {name} has the reference label {other}: {advice}")


class _Scene(Subject):
    """A cloud in the shape that sets are computed and scored in."""

    def __init__(self, filter_: Filter, cloud: PointCloud, options: SweepOptions) -> None:
        super().__init__(filter_, cloud, options)
        self.weights: np.ndarray | None = None
        if cloud.reference is not None:
            truth, counted = reference_labels(cloud)
            index, member, rows = self.points.index, self.points.member, len(self.points)
            kinds = counted & truth, counted & ~truth  # of how many points of ground, and objects, a row consists
            self.weights = np.stack([np.bincount(member, kind[index], rows) for kind in kinds])
            self.totals = np.array([kind.sum() for kind in kinds])

    def confusion(self, ground: np.ndarray) -> np.ndarray:
        """i64[2, 2], as in Scores; zeros without a reference."""
        if self.weights is None:
            return np.zeros((2, 2), np.int64)
        as_ground = np.rint(self.weights @ ground).astype(np.int64)
        return np.stack([as_ground, self.totals - as_ground], axis=1)


class _State:
    """What is finished: counts per cloud and set, and votes per cloud; kept in a checkpoint."""

    def __init__(
        self, filter_: Filter, plan: Design, named: dict[str, PointCloud], votes: bool, key: Any, path: Path | None
    ) -> None:
        shape = len(named), len(plan.sets)
        self.done, self.ground = np.zeros(shape, bool), np.zeros(shape, np.int64)
        self.confusion = np.zeros((*shape, 2, 2), np.int64)
        self.votes = [np.zeros(len(cloud), np.uint32) for cloud in named.values()] if votes else None
        self.arrays: dict[str, Any] = {"done": self.done, "confusion": self.confusion, "ground": self.ground}
        self.arrays |= {f"votes_{i}": counts for i, counts in enumerate(self.votes or [])}
        self.path, self.saved, self.dirty = path, time.monotonic(), False
        if path is None:
            return
        if not path.absolute().parent.is_dir():
            raise ParameterError(f"checkpoint={str(path)!r}: {path.absolute().parent} is not a folder: make it first")
        self.facts = {
            "filter": repr(filter_),
            "sets": json.dumps(plan.sets, default=str),
            "clouds": json.dumps([f"{name} {_digest(cloud)}" for name, cloud in named.items()]),
            "votes": str(votes),
            "random key": str(key),
            "version of jaxfilter": __version__,
            "source of the filter": _source(type(filter_)),
        }
        if existing(path) is None:
            return
        try:
            with np.load(path) as file:
                data = dict(file)
            facts = json.loads(str(data["facts"]))
        except DAMAGED_ARRAYS as error:
            raise InputError(f"checkpoint {path} is not one of a sweep ({error}): name another file") from error
        for name, value in self.facts.items():
            if facts.get(name) != value:
                raise InputError(f"checkpoint {path} is of a sweep with other {name}: delete it or name another file")
        for name, values in self.arrays.items():
            values[...] = data[name]

    def add(self, cloud: int, number: int, scene: _Scene, ground: np.ndarray) -> None:
        """Note the labels bool[m] of a set."""
        self.confusion[cloud, number] = scene.confusion(ground)
        self.ground[cloud, number] = int(np.count_nonzero(ground[scene.points.member]))
        if self.votes is not None:
            self.votes[cloud] += scene.points.spread(ground)
        self.done[cloud, number] = self.dirty = True
        if self.path is not None and time.monotonic() - self.saved > _SAVE_EVERY:
            self.save()

    def save(self) -> None:
        """Write the checkpoint. Raises OutputError."""
        if self.path is None or not self.dirty:
            return
        with new_file(self.path, overwrite=True) as temporary, open(temporary, "wb") as file:
            np.savez(file, facts=np.array(json.dumps(self.facts)), **self.arrays)
        self.saved, self.dirty = time.monotonic(), False


def _source(method: type[Filter]) -> str:
    """Of the files that the method's functions stand in; of code without a file its name, which a notebook makes anew."""
    codes = (part.__code__ for one in method.__mro__ for part in vars(one).values() if hasattr(part, "__code__"))
    files = map(Path, sorted({code.co_filename for code in codes}))
    return hashlib.sha256(b"|".join(file.read_bytes() if file.is_file() else bytes(file) for file in files)).hexdigest()


def _digest(cloud: PointCloud) -> str:
    """Of what decides labels and scores."""
    labels = () if cloud.reference is None else reference_labels(cloud)  # of classified clouds not all points count
    return cloud.digest(*labels)


def _dataset(base: Filter, plan: Design, several: bool, named: dict[str, PointCloud], state: _State) -> xarray.Dataset:
    grid = plan.kind == "grid"
    sizes = {name: len(values) for name, values in plan.axes.items()} if grid else {"set": len(plan.sets)}
    sizes |= {"cloud": len(named)} if several else {}

    def laid_out(values: np.ndarray) -> tuple[tuple[str, ...], np.ndarray]:
        return tuple(sizes), np.moveaxis(values, 0, -1).reshape(tuple(sizes.values()))

    scores = np.full((len(SCORES), *state.done.shape), np.nan)
    for c, cloud in enumerate(named.values()):
        if cloud.reference is not None:
            for s in range(len(plan.sets)):
                of_set = Scores.from_confusion(state.confusion[c, s])
                scores[:, c, s] = [getattr(of_set, name) for name in SCORES]
    variables: dict[str, Any] = {
        name: (*laid_out(scores[i]), {"long_name": SCORE_NAMES[name], "units": "%"}) for i, name in enumerate(SCORES)
    }
    variables["ground"] = (*laid_out(state.ground), {"long_name": "ground points"})
    if state.votes is not None:
        for (name, _), counts in zip(named.items(), state.votes, strict=True):
            end = f"_{name}" if several else ""
            share = (counts / len(plan.sets)).astype(np.float32)
            variables[f"votes{end}"] = ((f"point{end}",), share, {"long_name": "share of sets: ground", "units": "1"})
    fields = {f.name: f for f in declared(base)}
    coords: dict[str, Any] = {}
    for name, values in plan.axes.items():  # names become one text, which the field takes as well
        words = [("+".join(value) or "none") if isinstance(value, tuple) else value for value in values]
        coords[name] = ((name if grid else "set",), words, about(fields[name]))
    if not grid:
        coords["set"] = np.arange(len(plan.sets))
    if several:
        coords["cloud"] = list(named)
    attrs = {
        "method": type(base).__name__,
        "parameters": json.dumps(dataclasses.asdict(base), default=str),  # type: ignore[call-overload]
        "design": plan.kind,
        "sets": len(plan.sets),
        "groups": len(plan.groups),
    }
    return xarray.Dataset(variables, coords, attrs)


def about(field: dataclasses.Field[Any]) -> dict[str, str]:
    """Attributes of a coordinate: what the field is, and its unit."""
    unit = field.metadata["unit"]
    return {"long_name": field.metadata["doc"]} | ({"units": unit} if unit else {})
