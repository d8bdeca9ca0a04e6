"""How long sweeps take beside single runs and beside a process pool, and how much memory. See README.md."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import shlex
import statistics
import subprocess
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
from experiments.report import Row, markdown, read_csv, write_csv, write_page
from jaxfilter.core import compilation
from jaxfilter.sweeps.design import make_design

HERE = Path(__file__).parent
Task = tuple[str, jf.Filter, dict[str, Any], dict[str, Any]]
"""Name, filter, axes and design of a sweep."""
SMRF_GRID = {
    "slope": np.linspace(0.05, 0.4, 8).tolist(),
    "threshold": np.linspace(0.2, 0.9, 8).tolist(),
    "scaling": np.linspace(0.0, 3.0, 4).tolist(),
}
SMRF_RANGES = {"slope": (0.05, 0.4), "threshold": (0.2, 0.9), "scaling": (0.0, 3.0)}
FPTD_GRID = {
    "max_angle": np.arange(2.0, 43.0, 4.0).tolist(),
    "max_elevation": np.round(np.arange(0.6, 2.01, 0.2), 1).tolist(),
}
TASKS: list[tuple[str, Task]] = [
    ("12", ("SMRF, grid of 8 x 8 x 4", jf.SMRF(), SMRF_GRID, {})),
    ("12", ("SMRF, 256 random sets", jf.SMRF(), SMRF_RANGES, {"design": "random", "size": 256})),
    *((n, ("FPTD, 11 angles x 8 elevations", jf.FPTD(), FPTD_GRID, {})) for n in ("54", "71", "24", "52")),
    ("21", ("CSF, 32 thresholds", jf.CSF(), {"threshold": (0.2, 1.5)}, {"design": "sobol", "size": 32})),
    ("21", ("CSF, 32 sets", jf.CSF(), {"threshold": (0.2, 1.5), "time_step": (0.4, 0.8)}, {"design": "sobol", "size": 32})),
    ("21", ("PPDF, 32 sets", jf.PPDF(), {"buffer": (0.2, 1.5), "max_distance": (0.3, 2.0)}, {"design": "sobol", "size": 32})),
    ("21", ("STIN, 32 sets", jf.STIN(), {"max_angle": (5.0, 45.0), "max_distance": (0.3, 3.0)}, {"design": "sobol", "size": 32})),
    ("21", ("SPF, 32 sets", jf.SPF(), {"max_angle": (5.0, 45.0), "max_distance": (0.3, 3.0)}, {"design": "sobol", "size": 32})),
]  # fmt: skip
FPTD_RANGES = {"max_angle": (4.0, 42.0), "max_elevation": (0.6, 2.0)}
LARGE: list[Task] = [
    ("SMRF, 1,000 random sets", jf.SMRF(), SMRF_RANGES, {"design": "random", "size": 1000}),
    ("FPTD, 100 random sets", jf.FPTD(), FPTD_RANGES, {"design": "random", "size": 100}),
]  # fmt: skip
_ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1", "OMP_NUM_THREADS": "1"}
_CLOUD: jf.PointCloud | None = None


def main(arguments: list[str] | None = None) -> None:
    """Measure what is asked for and write the tables."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--repeats", type=int, default=3, help="warm sweeps, of which the median counts [%(default)s]")
    parser.add_argument("--only", default="", help="tasks whose name holds this text [all]")
    parser.add_argument("--no-memory", dest="memory", action="store_false", help="leave the large clouds out")
    parser.add_argument("--no-times", dest="times", action="store_false", help="the large clouds only")
    parser.add_argument("--large", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(given)
    if options.large is not None:
        print(json.dumps(large(LARGE[options.large])))
        return
    folder = samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    compilation.watch_compilations()
    rows = []
    for number, task in TASKS:
        if options.times and options.only.lower() in task[0].lower():
            rows.append(measured(samples.sample_path(folder, number), f"samp{number}", task, options.repeats))
            print(f"{rows[-1]['sweep']:32} {rows[-1]['sample']}  {rows[-1]['seconds']:6.2f} s  "
                  f"single runs {rows[-1]['singly']:6.2f} s  pool {rows[-1]['pool']:6.2f} s", flush=True)  # fmt: skip
    big = []
    for i, task in enumerate(LARGE):
        if options.memory and options.only.lower() in task[0].lower():
            run = subprocess.run(
                [sys.executable, __file__, "--large", str(i)], capture_output=True, text=True, check=True
            )
            big.append(json.loads(run.stdout.splitlines()[-1]))
            print(
                f"{big[-1]['sweep']:32} {big[-1]['points']:,} points  {big[-1]['seconds']:.0f} s  {big[-1]['gigabytes']:.2f} GB"
            )
    rows = kept(options.out / "speed.csv", rows)
    big = kept(options.out / "memory.csv", big)
    command = shlex.join(["python", "experiments/sensitivity/speed.py", *given])
    write_page(options.out / "speed.md", report(rows, big, options.repeats), command)
    print(f"results are in {options.out}")


def kept(path: Path, rows: list[Row]) -> list[Row]:
    """The rows, and those of an earlier run that were not measured anew; written to the file."""
    new = {(row["sweep"], row.get("sample")): row for row in rows}
    old = {(row["sweep"], row.get("sample")): row for row in (read_csv(path) if path.exists() else [])}
    out = list((old | new).values())
    write_csv(path, out)
    return out


def measured(path: Path, sample: str, task: Task, repeats: int) -> Row:
    """A sweep, warm and cold; the same sets one after the other, warm; and in a pool of two processes of one thread each."""
    name, filter_, axes, design = task
    cloud = jf.read(path)
    plan = make_design(filter_, axes, design.get("design", "grid"), design.get("size"))
    sets = [filter_.replace(**one) for one in plan.sets]
    before = compilation.compilations()
    start = time.perf_counter()
    jf.sweep(filter_, cloud, axes, **design)
    first = time.perf_counter() - start
    compiled = compilation.compilations()[0] - before[0]
    found, seconds = timed(lambda: jf.sweep(filter_, cloud, axes, **design), repeats)
    again = compilation.compilations()[0] - before[0] - compiled
    for one in sets[:: max(1, len(sets) // 4)]:
        one(cloud)
    results, singly = timed(lambda: [one(cloud) for one in sets], 1)
    totals = np.array([jf.evaluate(result, cloud).total for result in results])
    return {
        "sweep": name, "sample": sample, "points": len(cloud), "sets": len(sets), "first": first, "seconds": seconds,
        "singly": singly, "pool": pooled(path, sets), "compiled": compiled, "compiled_warm": again,
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
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        with ProcessPoolExecutor(2, multiprocessing.get_context("spawn"), _load, (path,)) as pool:
            list(pool.map(_single, sets[:2] + sets[-2:], chunksize=1))
            list(pool.map(_single, [sets[0]] * 8, chunksize=4))  # both processes have compiled
            start = time.perf_counter()
            list(pool.map(_single, sets, chunksize=max(1, len(sets) // 16)))
            return time.perf_counter() - start
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


def _load(path: Path) -> None:
    global _CLOUD
    _CLOUD = jf.read(path)


def _single(filter_: jf.Filter) -> float:
    assert _CLOUD is not None
    return jf.evaluate(filter_(_CLOUD, workers=1), _CLOUD).total


def large(task: Task) -> Row:
    """A sweep with votes of a simulated million points: seconds, and the most memory that the process held."""
    name, filter_, axes, design = task
    scene = jf.scenes.make("benchmark", size=1019.0, density=1.0, seed=1)
    cloud = jf.PointCloud.from_arrays(
        scene.cloud.coordinates(), return_number=scene.cloud.return_number,
        number_of_returns=scene.cloud.number_of_returns, reference=scene.truth,
    )  # fmt: skip
    del scene
    start = time.perf_counter()
    data = jf.sweep(filter_, cloud, axes, votes=True, **design)
    return {
        "sweep": name, "points": len(cloud), "sets": len(data["set"]), "seconds": time.perf_counter() - start,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, "least": float(data.total.min()),
    }  # fmt: skip


def report(rows: list[Row], big: list[Row], repeats: int) -> str:
    """Both tables as Markdown."""
    for row in rows:
        row |= {"ratio": row["singly"] / row["seconds"], "pool_ratio": row["pool"] / row["seconds"]}
    return "\n\n".join(
        [
            "# Sweeps beside single runs",
            f"Medians of {repeats} warm sweeps. Single runs are made one after the other in the "
            "same process, all cores at their disposal, and warm; the pool has two warm processes of one thread each. First = "
            "the first sweep of its kind in the process, compilation included. Difference = largest between the total errors "
            "of a set in the sweep and alone, points.",
            markdown(
                [
                    ("sweep", "sweep", ""), ("sample", "sample", ""), ("points", "points", ",d"), ("sets", "sets", "d"),
                    ("first", "first, s", ".2f"), ("seconds", "warm, s", ".2f"), ("singly", "single runs, s", ".2f"),
                    ("ratio", "times faster", ".1f"), ("pool", "pool, s", ".2f"), ("pool_ratio", "times faster", ".1f"),
                    ("compiled_warm", "compiled when warm", "d"), ("difference", "difference", ".4f"),
                ],
                rows,
            ),
            "## Memory",
            "With votes, on a simulated cloud, in a process of its own that makes the scene first.",
            markdown(
                [
                    ("sweep", "sweep", ""), ("points", "points", ",d"), ("sets", "sets", "d"), ("seconds", "seconds", ".0f"),
                    ("gigabytes", "peak, GB", ".2f"),
                ],
                big,
            ),
            "",
        ]
    )  # fmt: skip


if __name__ == "__main__":
    main()
