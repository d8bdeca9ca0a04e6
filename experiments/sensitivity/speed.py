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
from experiments.isprs import samples, spaces
from experiments.report import Column, Row, markdown, write_csv
from experiments.sensitivity.study import Study
from jaxfilter.core.params import declared
from jaxfilter.sweeps.design import make_design
from jaxfilter.sweeps.ranges import RANGES, Range, around, search_ranges

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
SETS, EVERY = 40, 4
DESIGNS = {"searched": ("12",), "all": ("21", "31", "52")}
"""Samples by design: fields that a calibration searches, or all traced fields that have a range."""
DESIGN_COLUMNS: list[Column] = [
    ("method", "method", ""), ("searched", "searched", ".2f"), ("searched_first", "first", ".2f"),
    ("searched_cpu", "CPU s", ".1f"), ("all", "all fields", ".2f"), ("all_first", "first", ".2f"), ("all_cpu", "CPU s", ".1f"),
]  # fmt: skip
_CLOUD: jf.PointCloud | None = None


def main(arguments: list[str] | None = None) -> None:
    """Measure what is asked for and write the tables."""
    study = Study("speed", __doc__, arguments, repeats=3)
    designs: list[Row] = []
    for name in spaces.method_names():
        designs.append({"method": name.upper()})
        for design in DESIGNS:  # each in a process of its own, since the first sweep imports and compiles
            with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
                designs[-1] |= pool.submit(by_design, name, design, study.folder).result()
        print(designs[-1], flush=True)
        write_csv(study.options.out / "designs.csv", designs)
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
        f"## {SETS} random sets of each method",
        "CPU seconds of a warm sweep for each CPU second of the same sets in warm single calls. Searched: random "
        "values of the fields that a calibration searches, on samp12. All fields: of all traced fields that have a range, on "
        "samp21, samp31 and samp52. First: the same for the first sweep of each cloud in a new process, with what it imports "
        f"and compiles. Every {EVERY}th set is called alone, and its time stands for {EVERY} sets.",
        markdown(DESIGN_COLUMNS, designs),
    ]
    study.write("speed", text, rows)


def by_design(method: str, design: str, folder: Path) -> Row:
    """CPU seconds of sweeps, by those of single calls. As many points are ground in sets that are called alone."""
    first = warm = single = 0.0
    for number in DESIGNS[design]:
        cloud = jf.read(samples.sample_path(folder, number))
        filter_ = jf.FILTERS[method].for_cloud(cloud)
        axes = drawn(search_ranges(filter_) if design == "searched" else every_range(filter_))
        some = range(0, SETS, EVERY)
        alone = [filter_.replace(**{name: values[k] for name, values in axes.items()}) for k in some]
        _, cold = used(jf.sweep, filter_, cloud, axes, design="list")
        swept, again = used(jf.sweep, filter_, cloud, axes, design="list")
        alone[0](cloud)
        ground, singly = used(lambda sets, cloud: [int(one(cloud).ground.sum()) for one in sets], alone, cloud)
        assert ground == swept.ground.values[some].tolist(), (method, design, number)
        first, warm, single = first + cold, warm + again, single + EVERY * singly
    return {design: warm / single, f"{design}_first": first / single, f"{design}_cpu": single}


def every_range(filter_: jf.Filter) -> dict[str, Range]:
    """The range of each traced field that has one."""
    found = {one.name: RANGES.get(one.name) or around(one) for one in declared(filter_) if not one.metadata["static"]}
    return {name: one for name, one in found.items() if one is not None}


def drawn(ranges: dict[str, Range]) -> dict[str, list[float]]:
    """A random value of each field for every set."""
    rng = np.random.default_rng(5)
    return {name: [one.at(u) for u in rng.random(SETS)] for name, one in ranges.items()}


def used(function: Callable[..., Any], *given: Any, **options: Any) -> tuple[Any, float]:
    """What it returns, and the seconds of the processor that it takes."""
    start = time.process_time()
    out = function(*given, **options)
    return out, time.process_time() - start


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
