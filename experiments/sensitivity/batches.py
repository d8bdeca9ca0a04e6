"""What batches cost: all samples with 100 sets of SMRF in one call; programs for clouds of unlike size. See README.md."""

from __future__ import annotations

import os
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
os.environ["JAXFILTER_CACHE"] = "off"  # the first call compiles

import jaxfilter as jf
from experiments.report import Column, Row, markdown
from experiments.sensitivity.study import Study
from jaxfilter.core import compilation

EVERY = 10
"""So many sets stand for each that is called alone."""
GRID = np.meshgrid(np.linspace(0.05, 0.4, 5), np.linspace(0.2, 1.0, 5), np.linspace(0.0, 2.0, 4))
RANDOM = np.random.default_rng(0).uniform((0.05, 0.2, 0.0), (0.4, 1.0, 2.0), (100, 3)).T
COLUMNS: list[Column] = [
    ("sets", "sets of SMRF", ""), ("cold", "first call, CPU s", ".1f"), ("cpu", "warm, CPU s", ".1f"),
    ("singly", "single calls, warm, CPU s", ".0f"), ("gigabytes", "peak, GB", ".2f"), ("compared", "labels compared", ",d"),
    ("unlike", "unlike single calls", "d"),
]  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Measure and write the tables."""
    study = Study("batches", __doc__, arguments, repeats=3)
    if hasattr(os, "sched_setaffinity"):  # two threads that share a core count more seconds than the work takes
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    compilation.watch_compilations()
    crops, before = unlike(), compilation.compilations()[0]
    first = timed(lambda: [jf.SMRF()(crop) for crop in crops])
    programs = compilation.compilations()[0] - before
    again = timed(lambda: [jf.SMRF()(crop) for crop in crops])
    clouds = study.clouds()
    designs = {"grid of 5 x 5 x 4": GRID, "100 random sets": RANDOM}
    rows = [measured(name, values, clouds, study.options.repeats) for name, values in designs.items()]
    text = [
        "# Batches",
        f"{len(clouds)} ISPRS samples in one `jf.batch`, scored on the device, on one processor. Medians of warm calls. "
        "Sets that differ in `threshold` and `scaling` only share the surface: a grid has few surfaces, random sets one each. "
        f"Every {EVERY}th set is called alone, too: its labels are compared, and its time stands for {EVERY} sets.",
        markdown(COLUMNS, rows),
        "## Programs for clouds of unlike size",
        f"{len(crops)} crops of a simulated town, 2,000 to 40,000 points, one call of SMRF each: **{programs}** programs "
        f"compiled; first pass {first:.1f} CPU s; warm {again:.2f} CPU s.",
    ]
    study.write("batches", text, rows)


def unlike() -> list[jf.PointCloud]:
    """30 crops of a simulated town, 2,000 to 40,000 points each, of unlike size and shape."""
    xyz = jf.scenes.make("town", size=260.0, density=1.0, seed=3).cloud.coordinates()
    x, y = (xyz[:, :2] - xyz[:, :2].min(axis=0)).T
    rng = np.random.default_rng(5)
    sizes = [(points, np.sqrt(points) * rng.uniform(0.8, 1.25)) for points in np.geomspace(2_000, 40_000, 30)]
    return [jf.PointCloud.from_arrays(xyz[(x < width) & (y < points / width)]) for points, width in sizes]


def timed(function: Callable[[], Any]) -> float:
    """Seconds of the processor."""
    used = time.process_time()
    function()
    return time.process_time() - used


def measured(name: str, values: Any, clouds: dict[str, jf.PointCloud], repeats: int) -> Row:
    """One batch with all sets, scored on the device: cold, warm, the peak of memory; then its labels beside single calls."""
    sets = dict(zip(("slope", "threshold", "scaling"), (np.ravel(column) for column in values), strict=True))
    batch = jf.batch(clouds, jf.SMRF())
    cold, *warm = (timed(lambda: batch.confusion(sets).block_until_ready()) for _ in range(1 + repeats))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    labels = batch.unstack(batch.ground(sets))
    numbers = range(0, len(sets["slope"]), EVERY)
    singles = [jf.SMRF(**{field: float(np.float32(column[k])) for field, column in sets.items()}) for k in numbers]
    for cloud in clouds.values():
        singles[0](cloud)
    start, differ, count = time.process_time(), 0, 0
    for key, cloud in clouds.items():
        for number, one in zip(numbers, singles, strict=True):
            differ += int((one(cloud).ground != labels[key][number]).sum())
            count += len(cloud)
    return {
        "sets": name, "cold": cold, "cpu": statistics.median(warm), "gigabytes": peak, "compared": count, "unlike": differ,
        "singly": EVERY * (time.process_time() - start),
    }  # fmt: skip


if __name__ == "__main__":
    main()
