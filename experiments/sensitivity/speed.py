"""How long sweeps take beside single runs and beside a process pool, and how much memory. See README.md."""

from __future__ import annotations

import multiprocessing
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Column, Row, markdown
from experiments.sensitivity.study import Study
from jaxfilter.sweeps.design import make_design

SMRF_GRID = {
    "slope": np.linspace(0.05, 0.4, 8).tolist(),
    "threshold": np.linspace(0.2, 0.9, 8).tolist(),
    "scaling": np.linspace(0.0, 3.0, 4).tolist(),
}
SMRF_RANGES = {name: (values[0], values[-1]) for name, values in SMRF_GRID.items()}
FPTD_GRID = {"max_angle": list(range(2, 43, 4)), "max_elevation": [0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0]}
LIMITS = {"max_angle": (5.0, 45.0), "max_distance": (0.3, 3.0)}
SOBOL = {"design": "sobol", "size": 32}
TASKS: list[tuple[str, str, jf.Filter, dict[str, Any], dict[str, Any]]] = [
    ("12", "SMRF, grid of 8 x 8 x 4", jf.SMRF(), SMRF_GRID, {}),
    ("12", "SMRF, 256 random sets", jf.SMRF(), SMRF_RANGES, {"design": "random", "size": 256}),
    ("52", "FPTD, 11 angles x 8 elevations", jf.FPTD(), FPTD_GRID, {}),
    ("21", "CSF, 32 thresholds", jf.CSF(), {"threshold": (0.2, 1.5)}, SOBOL),
    ("21", "CSF, 32 sets", jf.CSF(), {"threshold": (0.2, 1.5), "time_step": (0.4, 0.8)}, SOBOL),
    ("21", "PPDF, 32 sets", jf.PPDF(), {"buffer": (0.2, 1.5), "max_distance": (0.3, 2.0)}, SOBOL),
    ("21", "STIN, 32 sets", jf.STIN(), LIMITS, SOBOL),
    ("21", "SPF, 32 sets", jf.SPF(), LIMITS, SOBOL),
]
COLUMNS: list[Column] = [
    ("sweep", "sweep", ""), ("sample", "sample", ""), ("points", "points", ",d"), ("sets", "sets", "d"),
    ("first", "first, s", ".2f"), ("seconds", "warm, s", ".2f"), ("singly", "single runs, s", ".2f"),
    ("ratio", "times faster", ".1f"), ("pool", "pool, s", ".2f"), ("pool_ratio", "times faster", ".1f"),
    ("difference", "difference", ".4f"),
]  # fmt: skip
_CLOUD: jf.PointCloud | None = None


def main(arguments: list[str] | None = None) -> None:
    """Measure what is asked for and write the tables."""
    study = Study("speed", __doc__, arguments, repeats=3)
    rows = []
    for number, name, *task in TASKS:
        found = measured(samples.sample_path(study.folder, number), study.options.repeats, *task)
        rows.append({"sweep": name, "sample": f"samp{number}"} | found)
        print(rows[-1], flush=True)
    text = [
        "# Sweeps beside single runs",
        f"Medians of {study.options.repeats} warm sweeps. Single runs are made one after the other in the same process, with all "
        "cores, and warm. The pool has two warm processes of one thread each. First = the first sweep of its kind in the "
        "process, compilation included. Difference = largest between the total errors of a set in the sweep and alone, points.",
        markdown(COLUMNS, rows),
    ]
    study.write("speed", text, rows)


def measured(path: Path, repeats: int, filter_: jf.Filter, axes: dict[str, Any], design: dict[str, Any]) -> Row:
    """A sweep, warm and cold; the same sets one after the other, warm; and in a pool of two processes of one thread each."""
    cloud = jf.read(path)
    plan = make_design(filter_, axes, design.get("design", "grid"), design.get("size"))
    sets = [filter_.replace(**one) for one in plan.sets]
    _, first = timed(lambda: jf.sweep(filter_, cloud, axes, **design), 1)
    found, seconds = timed(lambda: jf.sweep(filter_, cloud, axes, **design), repeats)
    for one in sets[:: max(1, len(sets) // 4)]:
        one(cloud)
    results, singly = timed(lambda: [one(cloud) for one in sets], 1)
    totals, pool = np.array([jf.evaluate(result, cloud).total for result in results]), pooled(path, sets)
    return {
        "points": len(cloud), "sets": len(sets), "first": first, "seconds": seconds,
        "singly": singly, "ratio": singly / seconds, "pool": pool, "pool_ratio": pool / seconds,
        "difference": float(np.abs(totals - found.total.values.ravel()).max()),
    }  # fmt: skip


def timed(function: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """What it returns, and the median of its seconds."""
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        out = function()
        seconds.append(time.perf_counter() - start)
    return out, statistics.median(seconds)


def pooled(path: Path, sets: Sequence[jf.Filter]) -> float:
    """Seconds for all sets in two warm processes; a process that has begun with one thread keeps to it."""
    os.environ |= {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "OMP_NUM_THREADS": "1"}  # of new processes
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn"), _load, (path,)) as pool:
        list(pool.map(_single, sets[:2] + sets[-2:], chunksize=1))
        list(pool.map(_single, [sets[0]] * 8, chunksize=4))  # both processes have compiled
        return timed(lambda: list(pool.map(_single, sets, chunksize=max(1, len(sets) // 16))), 1)[1]


def _load(path: Path) -> None:
    global _CLOUD
    _CLOUD = jf.read(path)


def _single(filter_: jf.Filter) -> float:
    return jf.evaluate(filter_(_CLOUD, workers=1), _CLOUD).total


if __name__ == "__main__":
    main()
