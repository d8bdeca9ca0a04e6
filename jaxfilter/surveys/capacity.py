"""How a run is cut: tiles, and workers, by the memory there is."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from pathlib import Path
from typing import Unpack

import psutil

from ..core.errors import ParameterError
from .collection import Collection
from .options import RunOptions
from .plan import Plan, plan_tiles

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
    most_points: float | None = None,
    **run: Unpack[RunOptions],
) -> Layout:
    """The tiles of a run, by the memory there is, or so that none has more than so many points; see :class:`RunOptions`.

    Raises: ParameterError, InputError.
    """
    tile, memory, workers = run.get("tile"), run.get("memory"), run.get("workers")
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
