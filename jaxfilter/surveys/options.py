"""How a run is carried out."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import ParameterError
from ..core.filter import check_resources
from ..core.result import Progress, silent
from ..files.sources import WHOLE

if TYPE_CHECKING:
    from .executors import Executor
    from .report import Standing

_BASE, _PER_POINT, _SHARE = 350e6, 330, 0.7
"""Bytes of a worker before it has read a point, bytes per point of core and halo, and the share of the memory that is free."""


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """How a run is carried out. None of this changes what is found, but ``tile``, ``halo`` and ``measures`` where a label depends
    on points at any distance.

    One file of 8 million points or fewer is read, filtered and written in this process, unless ``tile`` is given, or most of its
    extent is empty: then
    ``client``, ``executor`` and ``work`` have nothing to do.

    Attributes:
        tile: side of a tile in metres; by default tiles follow the points, see :func:`jaxfilter.surveys.plan.plan_tiles`.
        halo: metres around each tile that the filter sees as well; by default what the method needs (``Filter.halo``).
        wide_halos: let halos hold more than twice the points of the tiles; a ``tile`` so small is refused otherwise.
        workers: processes, or threads where there is one tile; by default one per processor, as far as the memory goes, and
            this process for tiles of 8 million points or fewer together. With 1 everything is done in this process.
        memory: bytes for all processes together; by default seven tenths of what is free. It limits the number of workers.
        client: a ``dask.distributed.Client``, or the address of a Dask scheduler, instead of processes of this machine.
        executor: any other way to have the tasks done, in place of ``workers`` and ``client``.
        work: local folder in which the run keeps what it needs to go on; all workers see it. By default beside the output,
            or, of one file into a URL, in the user's ``~/.local/state/jaxfilter``; it must be given for several into a URL.
        resume: go on with the run that was begun for the output. Of one small file nothing is kept to go on with: nothing is
            done if the output is there, and else the run begins anew, in place in any case.
        overwrite: begin anew; files that the run writes are replaced.
        in_place: write the inputs; there is no other output.
        dry_run: write nothing; ``RunReport.forecast`` tells what the run would do.
        measures: of the scene, as ``RunReport.measures`` of another run has them, instead of measuring them here.
        progress: called with the :class:`Standing` about four times a second.

    >>> run = jf.RunOptions(tile=50.0, wide_halos=True, workers=1)
    >>> jf.heights("survey", "heights", run=run, reading=jf.Reading(units="m")).complete
    True
    """

    tile: float | None = None
    halo: float | None = None
    wide_halos: bool = False
    workers: int | None = None
    memory: float | None = None
    client: Any = None
    executor: Executor | None = None
    work: str | Path | None = None
    resume: bool = False
    overwrite: bool = False
    in_place: bool = False
    dry_run: bool = False
    measures: Mapping[str, Any] | None = None
    progress: Callable[[Standing], None] | None = None

    def __post_init__(self) -> None:
        check_resources(self.workers, 1.0 if self.memory is None else self.memory)


def executor_for(options: RunOptions, points: np.ndarray, progress: Progress = silent) -> Executor:
    """What does the work: what is given, a cluster, this process, or several, which begin slower than tiles of few points end.
    ``points``: f64[t], of each tile with its halo; ``progress``: of filters in this process.

    Raises: JaxfilterError if workers cannot be started.
    """
    from .executors import Here, Pool

    if options.executor is not None:
        return options.executor
    if options.client is not None:
        from .dask import Cluster

        return Cluster(options.client)
    count, small = workers_for(options, points), options.workers is None and points.sum() <= WHOLE
    if count > 1 and len(points) > 1 and not small:
        return Pool(count)
    return Here(options.workers, progress)


def workers_for(options: RunOptions, points: np.ndarray) -> int:
    """Processes of this machine, or threads for one tile: as many as are asked for, or as there are processors and memory."""
    if options.workers is not None:
        return options.workers
    room = options.memory or _SHARE * free_memory()
    return min(processors(), max(1, int(room // need(points.max(initial=0.0)))))


def need(points: float) -> float:
    """Bytes of a worker that has so many points of core and halo at a time."""
    return float(_BASE + _PER_POINT * points)


def check_memory(options: RunOptions, points: float) -> None:
    """Raises: ParameterError if the memory does not suffice for a worker that has so many points of core and halo at a time."""
    needed = need(points)
    if options.memory is not None and options.memory < needed:
        raise ParameterError(
            f"memory={options.memory:.3g} bytes do not suffice for a worker, which needs {needed:.3g}: pass memory= with "
            "more, or tile= with less"
        )


def free_memory() -> float:
    """Bytes that are free to this process, by the system and by the limit of its control group (Slurm, Kubernetes)."""
    import psutil

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
