"""Ground filtering of a survey of any size: the files of a collection in, as many classified files out."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import math
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil

from ..core.cloud import KEPT_CLASSES, Whole
from ..core.errors import JaxfilterError, OutputError, ParameterError
from ..core.filter import Filter
from ..host.files import remove_dead
from ..host.storage import Place, Remote, place_of
from .collection import Collection
from .collection import open as open_collection
from .dask import Cluster
from .journal import NAME, Journal
from .outputs import target_names
from .plan import Plan, plan_tiles
from .pool import Executor, Pool
from .run import Run, RunReport, Standing, write_report
from .setup import filter_for, sampled
from .task import Job

SCRATCH = ".jaxfilter-run"
"""Folder beside the output that holds labels until their files are complete; removed with the last of them."""
REPORT, MAP = "jaxfilter-run.json", "jaxfilter-run.png"

_BASE = 350e6
"""Bytes of a worker before it has read a point."""
_PER_POINT = 330
"""About so many bytes per point of core and halo."""
_SHARE = 0.7
"""Of the memory that is free, when none is given."""
_MOST_POINTS = 8_000_000
"""Points of core and halo: larger tiles save little, unless they are narrower than so many halos, both sides included."""
_HALOS = 6


@dataclasses.dataclass(frozen=True)
class Layout:
    """How a run is cut: ``plan``, number of ``workers``, and ``most_points`` of core and halo; None if the size was given."""

    plan: Plan
    workers: int
    most_points: float | None


def layout(
    collection: Collection,
    *,
    halo: float,
    lattice: float,
    tile: float | None = None,
    memory: float | None = None,
    workers: int | None = None,
    most_points: float | None = None,
) -> Layout:
    """The tiles of a run, by the memory there is, or so that none has more than so many points; see :func:`ground`.

    Raises: ParameterError, InputError.
    """
    if not 0 <= halo < math.inf:
        raise ParameterError(f"halo={halo!r}: must be metres >= 0")
    if memory is not None and not memory > 0:
        raise ParameterError(f"memory={memory!r}: must be > 0 bytes")
    budget = _SHARE * free_memory() if memory is None else memory
    most = max(1, int(budget // (2 * _BASE)))
    count = min(processors(), most) if workers is None else workers
    room = (budget - _BASE) / count - _BASE
    if room <= 0:
        raise ParameterError(f"memory={budget:.3g} bytes do not suffice for {count} workers of {_BASE:.3g} each")
    if tile is None and (most_points is None or memory is not None):
        useful = collection.density * (_HALOS * halo) ** 2 if collection.density > 0 else 0.0
        most_points = min(room / _PER_POINT, max(_MOST_POINTS, useful))
    plan = plan_tiles(
        collection.footprints,
        collection.counts,
        metre=collection.metre,
        halo=halo,
        lattice=lattice,
        most_points=most_points or math.inf,
        side=tile,
    )
    return Layout(plan, count, most_points)


def ground(
    what: Any,
    out: str | Path,
    filter_: Filter | None = None,
    *,
    units: str | None = None,
    halo: float | None = None,
    tile: float | None = None,
    memory: float | None = None,
    workers: int | None = None,
    client: Any = None,
    resume: bool = False,
    overwrite: bool = False,
    returns: str = "last,only",
    ignore_classes: Iterable[int] = KEPT_CLASSES,
    keep_withheld: bool = False,
    drop_invalid: bool = False,
    ground_class: int = 2,
    other_class: int = 1,
    reset: str = "ground",
    only_ground: bool = False,
    extra: Iterable[str] = (),
    executor: Executor | None = None,
    progress: Callable[[Standing], None] | None = None,
    setup: Callable[[Collection, dict[str, Any], Path], tuple[Filter, Whole]] | None = None,
) -> RunReport:
    """Classify the ground points of the files of a collection, tile by tile, into one file for each in a folder.

    Every file is written as it was, with classes changed, when all its tiles are done. The journal in the folder lets a run
    that was stopped, in whatever way, go on with ``resume``; the files are those of an undisturbed run.

    Args:
        what: a :class:`Collection`, or what :func:`jaxfilter.open` takes.
        out: a folder, made if missing; it must be empty, but for ``resume`` and ``overwrite``.
        filter_: by default the default method, set up for the collection.
        halo: metres around each tile that are read as well; by default what the method needs (``Filter.tile_halo``).
        tile: side of a tile in metres; by default as large as the memory allows.
        memory: bytes for all processes together; by default seven tenths of what is free.
        workers: processes; by default one per processor, as far as the memory goes.
        client: a ``dask.distributed.Client``, or the address of a Dask scheduler, instead of processes of this machine.
        executor: any other way to have the tasks done, in place of ``workers`` and ``client``.
        resume: go on with the run that was begun in the folder. overwrite: begin anew; files in it are replaced.
        returns, ignore_classes, keep_withheld, drop_invalid: as in :func:`jaxfilter.read`.
        ground_class, other_class, reset, only_ground, extra: as in :func:`jaxfilter.write`.
        progress: called with the :class:`Standing` about four times a second.
        setup: in place of ``filter_``: makes filter and whole of the collection, the reading options and the folder for
            what is found out about files.

    Returns: RunReport; what could not be done is in it.
    Raises: InputError, ParameterError, OutputError before anything is filtered; OutputError if the journal cannot be written.

    >>> report = jf.ground("survey", "classified", jf.SMRF(), units="m", workers=1)
    >>> len(report.files), report.set_aside, 0 < report.ground < report.candidates
    (2, [], True)
    """
    collection = what if isinstance(what, Collection) else open_collection(what, units=units)
    metre = collection.metre  # which is refused where files do not go together
    folder = Path(out)
    reading = {
        "returns": returns,
        "ignore_classes": tuple(ignore_classes),
        "keep_withheld": keep_withheld,
        "drop_invalid": drop_invalid,
    }
    classes = {"ground_class": ground_class, "other_class": other_class, "reset": reset, "only_ground": only_ground}
    names = target_names(list(collection.uris))
    prepare_folder(folder, collection, names, resume=resume, overwrite=overwrite)
    scratch = folder / SCRATCH
    index = scratch / "index"
    with Journal(folder / NAME) as journal:
        with _taken_back(folder, journal):
            if setup is not None:
                filter_, whole = setup(collection, reading, index)
            else:
                sample = sampled(collection, reading, index)
                filter_, whole = filter_ or filter_for(sample, None, {}), sample.whole
            most = (journal.fact("tiles") or {}).get("most_points")  # what is free changes, the tiles of a run do not
            cut = layout(
                collection,
                halo=filter_.tile_halo() if halo is None else halo,
                lattice=filter_.lattice(),
                tile=tile,
                memory=memory,
                workers=workers,
                most_points=most,
            )
            width, height = (side * metre for side in cut.plan.largest())
            whole = dataclasses.replace(whole, width=width, height=height)
            job = Job(filter_, reading, classes, tuple(extra), whole, scratch, index)
            if executor is None:
                executor = Pool(cut.workers) if client is None else Cluster(client)
            try:
                journal.begin(_facts(collection, job, cut))
            except JaxfilterError:
                executor.close()
                raise
        targets: list[Place] = [folder / name for name in names]
        report = Run(job, cut.plan, collection, targets, journal, executor, overwrite=True, progress=progress)()
    report.failed += [{"file": name, "reason": reason} for name, reason in collection.unreadable]
    remove_dead(folder)
    write_report(report, folder / REPORT)
    return report


@contextlib.contextmanager
def _taken_back(folder: Path, journal: Journal) -> Iterator[None]:
    """A block that sets a run up; what it has made goes if the run is refused."""
    scratch = (folder / SCRATCH).exists()
    try:
        yield
    except JaxfilterError:
        if not scratch:
            shutil.rmtree(folder / SCRATCH, ignore_errors=True)
        if journal.fact("version") is None:
            journal.close()
            journal.path.unlink()
        raise


def free_memory() -> float:
    """Bytes that are free to this process, by the system and by the limit of its control group (Slurm, Kubernetes)."""
    free = float(psutil.virtual_memory().available)
    group = Path("/sys/fs/cgroup")
    for limit, used in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        with contextlib.suppress(OSError, ValueError):  # no such group, or "max"
            free = min(free, float((group / limit).read_text()) - float((group / used).read_text()))
    return free


def processors() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def prepare_folder(folder: Path, collection: Collection, names: list[str], *, resume: bool, overwrite: bool) -> None:
    """Make the folder of a run, empty but for what may stay.

    Raises: OutputError if it holds something and neither ``resume`` nor ``overwrite`` is asked for, or holds an input.
    """
    if isinstance(place_of(str(folder)), Remote):
        raise OutputError(f"{folder}: a run is written to a local folder; copy its files when it is complete")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = sorted(entry.name for entry in os.scandir(folder))
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror}") from error
    inputs = {os.path.realpath(uri) for uri in collection.uris if "://" not in uri}
    mine = [name for name in names if os.path.realpath(folder / name) in inputs]
    if mine:
        raise OutputError(f"{folder / mine[0]}: is an input; name another folder")
    if not held or (resume and (folder / NAME).exists()):
        return
    there = [name for name in names if name in held]
    if resume:
        if there:
            raise OutputError(f"{folder / there[0]}: exists, and no run was begun in this folder: name another folder")
        return
    if not overwrite:
        more = f" and {len(held) - 1} more" if len(held) > 1 else ""
        raise OutputError(
            f"{folder}: is not empty, it holds {held[0]}{more}: name another folder, pass resume=True to go on with a run, "
            "or pass overwrite=True to begin anew"
        )
    with Journal(folder / NAME):  # nobody else is at it
        pass
    (folder / NAME).unlink()
    shutil.rmtree(folder / SCRATCH, ignore_errors=True)
    for name in (*names, REPORT, MAP):
        (folder / name).unlink(missing_ok=True)


def _facts(collection: Collection, job: Job, cut: Layout) -> dict[str, Any]:
    """What decides the outcome of a run, to be told from another."""
    whole = dataclasses.asdict(job.whole)
    filter_ = {"method": type(job.filter).__name__, **dataclasses.asdict(job.filter)}  # type: ignore[call-overload]
    digest = _digest(collection)
    return {
        "version": version("jaxfilter"),
        "inputs": digest,
        "filter": filter_,
        "reading": {**job.reading, "ignore_classes": list(job.reading["ignore_classes"])},
        "classes": job.classes,
        "extra": list(job.extra),
        "spacing": whole["spacing"],
        "tiles": {
            "width": cut.plan.width,
            "height": cut.plan.height,
            "halo": cut.plan.halo,
            "number": len(cut.plan),
            "digest": cut.plan.digest(),
            "most_points": cut.most_points,
        },
    }


def _digest(collection: Collection) -> str:
    """Tells the files of a collection, by name and content, from others."""
    import hashlib

    found = hashlib.sha256()
    for source in collection:
        found.update(json.dumps([source.uri, source.count, source.identity]).encode())
    return found.hexdigest()
