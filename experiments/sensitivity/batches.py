"""What batches cost: all samples with 100 sets of SMRF in one call; programs for clouds of unlike size. See README.md."""

from __future__ import annotations

import argparse
import os
import resource
import shlex
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
from experiments.isprs import samples
from experiments.report import Row, markdown, write_csv, write_page
from jaxfilter.core import compilation

HERE = Path(__file__).parent
_GRID = np.meshgrid(np.linspace(0.05, 0.4, 5), np.linspace(0.2, 1.0, 5), np.linspace(0.0, 2.0, 4))
_RANDOM = np.random.default_rng(0).uniform((0.05, 0.2, 0.0), (0.4, 1.0, 2.0), (100, 3)).T
SETS = {
    name: {field: values.ravel() for field, values in zip(("slope", "threshold", "scaling"), columns, strict=True)}
    for name, columns in (("grid of 5 x 5 x 4", _GRID), ("100 random sets", _RANDOM))
}


def main(arguments: list[str] | None = None) -> None:
    """Measure and write the tables."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--repeats", type=int, default=5, help="warm calls, of which the median counts [%(default)s]")
    parser.add_argument("--samples", nargs="+", default=list(samples.SAMPLES), help="numbers of samples [all]")
    options = parser.parse_args(given)
    folder = samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    if hasattr(os, "sched_setaffinity"):  # two threads that share a core count more seconds than the work takes
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    compilation.watch_compilations()
    crops = unlike()
    before = compilation.compilations()[0]
    first = timed(lambda: [jf.SMRF()(crop) for crop in crops])
    programs = compilation.compilations()[0] - before
    again = timed(lambda: [jf.SMRF()(crop) for crop in crops])
    clouds = {f"samp{number}": jf.read(samples.sample_path(folder, number)) for number in options.samples}
    rows = [measured(name, sets, clouds, options.repeats) for name, sets in SETS.items()]
    write_csv(options.out / "batches.csv", rows)
    text = report(rows, len(clouds), (len(crops), programs, first, again))
    write_page(options.out / "batches.md", text, shlex.join(["python", "experiments/sensitivity/batches.py", *given]))
    print(text)


def unlike() -> list[jf.PointCloud]:
    """30 crops of a simulated town, 2,000 to 40,000 points each, of unlike size and shape."""
    xyz = jf.scenes.make("town", size=260.0, density=1.0, seed=3).cloud.coordinates()
    x, y = (xyz[:, :2] - xyz[:, :2].min(axis=0)).T
    rng = np.random.default_rng(5)
    found = []
    for points in np.geomspace(2_000, 40_000, 30):
        width = np.sqrt(points) * rng.uniform(0.8, 1.25)
        found.append(jf.PointCloud.from_arrays(xyz[(x < width) & (y < points / width)]))
    return found


def timed(function: Callable[[], Any]) -> tuple[float, float]:
    """Seconds of the processor, and seconds."""
    start, used = time.perf_counter(), time.process_time()
    function()
    return time.process_time() - used, time.perf_counter() - start


def measured(name: str, sets: dict[str, np.ndarray], clouds: dict[str, jf.PointCloud], repeats: int) -> Row:
    """One batch with all sets, scored on the device: cold, warm, the peak of memory; then its labels beside single calls."""
    batch = jf.batch(clouds, jf.SMRF())
    cold = timed(lambda: batch.confusion(sets).block_until_ready())
    warm = [timed(lambda: batch.confusion(sets).block_until_ready()) for _ in range(repeats)]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    labels = batch.unstack(batch.ground(sets))
    singles = [jf.SMRF(**{field: float(np.float32(value)) for field, value in zip(sets, values, strict=True)})
               for values in zip(*sets.values(), strict=True)]  # fmt: skip
    for one in singles[::25]:
        for cloud in clouds.values():
            one(cloud)
    start, unlike_labels, count = time.process_time(), 0, 0
    for key, cloud in clouds.items():
        for labels_of_set, one in zip(labels[key], singles, strict=True):
            unlike_labels += int((one(cloud).ground != labels_of_set).sum())
            count += len(cloud)
    return {
        "sets": name, "labels": count, "cold": cold[0], "cpu": statistics.median(cpu for cpu, _ in warm),
        "seconds": statistics.median(seconds for _, seconds in warm), "gigabytes": peak,
        "singly": time.process_time() - start, "unlike": unlike_labels,
    }  # fmt: skip


def report(rows: list[Row], clouds: int, crops: tuple[Any, ...]) -> str:
    """The tables as Markdown."""
    number, programs, first, again = crops
    columns = [
        ("sets", "sets of SMRF", ""), ("labels", "labels", ",d"), ("cold", "first call, CPU s", ".1f"),
        ("cpu", "warm, CPU s", ".1f"), ("seconds", "warm, s", ".1f"), ("singly", "single calls, warm, CPU s", ".1f"),
        ("gigabytes", "peak, GB", ".2f"), ("unlike", "labels unlike single calls", "d"),
    ]  # fmt: skip
    return "\n\n".join([
        "# Batches",
        f"{clouds} ISPRS samples in one `jf.batch`, scored on the device, on one processor. Medians of warm calls. Sets that "
        "differ in `threshold` and `scaling` only share the surface: a grid has few surfaces, random sets have one each.",
        markdown(columns, rows),
        "## Programs for clouds of unlike size",
        f"{number} crops of a simulated town, 2,000 to 40,000 points, one call of SMRF each: **{programs}** programs compiled; "
        f"first pass {first[0]:.1f} CPU s, {first[1]:.1f} s; warm {again[0]:.2f} CPU s, {again[1]:.2f} s.",
        "",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
