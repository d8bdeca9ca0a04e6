"""Labels and times on a GPU beside those on the processor of the same machine. See README.md."""

from __future__ import annotations

import argparse
import dataclasses
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Row, cores, markdown, write_csv, write_page

HERE = Path(__file__).parent
BATCHED: list[tuple[str, jf.Filter, dict[str, tuple[float, float]]]] = [
    ("SMRF", jf.SMRF(), {"slope": (0.05, 0.4), "threshold": (0.2, 0.9), "scaling": (0.0, 3.0)}),
    ("MSF", jf.MSF(), {"slope": (0.3, 0.8), "initial_distance": (0.2, 0.9)}),
    ("PMF", jf.PMF(cell=1.0), {"slope": (0.1, 0.5), "initial_distance": (0.1, 0.9)}),
]
SETS = 256
SIDES = (150.0, 200.0, 250.0, 300.0) * 2
"""Sides of the clouds of a batch, m: as large as the ISPRS samples, at one point per m2."""


def main(arguments: list[str] | None = None) -> None:
    """Run every method on both platforms, each in a process of its own, and write the table."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    parser.add_argument("--size", type=float, default=1000.0, help="side of the simulated scene, m [%(default)s]")
    parser.add_argument("--platforms", nargs=2, default=["cpu", "cuda,cpu"], help="names of JAX [%(default)s]")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(given)
    if options.child:
        measure(options.size, options.child)
        return
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        found = []
        for number, platform in enumerate(options.platforms):
            path = Path(folder, f"{number}.npz")
            command = [sys.executable, __file__, "--size", str(options.size), "--child", str(path)]
            subprocess.run(command, check=True, env=os.environ | {"JAX_PLATFORMS": platform, "JAXFILTER_CACHE": "off"})
            with np.load(path) as stored:
                found.append({key: stored[key] for key in stored.files})
    rows = compared(*found)
    write_csv(options.out / "gpu.csv", rows)
    command = shlex.join(["python", "experiments/bench/gpu.py", *given])
    write_page(options.out / "gpu.md", report(rows, str(found[1]["device"]), int(found[1]["points"])), command)
    print(f"results are in {options.out}")


def measure(size: float, path: Path) -> None:
    """Labels and seconds of every method on one cloud, and of sets of parameters on a batch of clouds, written to a file."""
    import jax

    cloud = simulated(size, 1)
    found: dict[str, Any] = {"device": jax.devices()[0].device_kind, "points": len(cloud)}
    for name, method in jf.FILTERS.items():
        filter_ = method()
        found[f"{name} labels"], first, warm = timed(lambda filter_=filter_: filter_(cloud).ground)
        found[f"{name} seconds"] = [first, warm]
        print(f"{jax.default_backend()} {name:6} first {first:6.2f} s  warm {warm:6.2f} s", flush=True)
    clouds = [simulated(side, seed) for seed, side in enumerate(SIDES)]
    for name, filter_, ranges in BATCHED:
        draws = np.random.default_rng(0)
        sets = {field: draws.uniform(*between, SETS).astype(np.float32) for field, between in ranges.items()}
        batch = jf.batch(clouds, filter_)
        counts, first, warm = timed(lambda batch=batch, sets=sets: np.asarray(batch.confusion(sets)), 1)
        found |= {f"{name}, batch labels": counts, f"{name}, batch seconds": [first, warm]}
        print(f"{jax.default_backend()} {name}, batch  first {first:6.2f} s  warm {warm:6.2f} s", flush=True)
    np.savez(path, **found)


def simulated(size: float, seed: int) -> jf.PointCloud:
    """A scene of town, wood and fields with its truth."""
    scene = jf.scenes.make("benchmark", size=size, density=1.0, seed=seed)
    return dataclasses.replace(scene.cloud, reference=scene.truth)


def timed(function: Callable[[], Any], repeats: int = 3) -> tuple[Any, float, float]:
    """What it returns, the seconds of its first call, and the median of later ones."""
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        out = function()
        seconds.append(time.perf_counter() - start)
    return out, seconds[0], statistics.median(seconds[1:])


def compared(cpu: dict[str, Any], gpu: dict[str, Any]) -> list[Row]:
    """One row for every method and batch: labels that differ, and seconds on both."""
    rows = []
    for key in cpu:
        if key.endswith(" labels"):
            name = key.removesuffix(" labels")
            (first, warm), (first_gpu, warm_gpu) = cpu[f"{name} seconds"], gpu[f"{name} seconds"]
            share = 100 * np.mean(cpu[key] != gpu[key])
            if "batch" in name:  # counts: half the sum of their differences is the number of labels that changed
                share = 100 * np.abs(cpu[key] - gpu[key]).sum() / 2 / cpu[key].sum()
            rows.append({
                "method": name if "batch" in name else jf.FILTERS[name].__name__, "differ": share, "first_cpu": first,
                "first_gpu": first_gpu, "cpu": warm, "gpu": warm_gpu, "ratio": warm / warm_gpu,
            })  # fmt: skip
    return rows


def report(rows: list[Row], device: str, points: int) -> str:
    """The page: a table of single calls and one of batches."""
    columns = [
        ("method", "method", ""), ("differ", "labels that differ, %", ".4f"), ("first_cpu", "first call, CPU, s", ".2f"),
        ("first_gpu", "GPU, s", ".2f"), ("cpu", "warm call, CPU, s", ".3f"), ("gpu", "GPU, s", ".3f"),
        ("ratio", "CPU / GPU", ".1f"),
    ]  # fmt: skip
    single = [row for row in rows if "batch" not in row["method"]]
    batches = [row for row in rows if "batch" in row["method"]]
    return f"""# Methods on a GPU

Every method with its defaults on a simulated cloud of {points:,} points at one per m2, on {device} and on the processor of the
same machine ({cores()} cores). The first call compiles; warm is the median of three calls. Triangulations, the tests over their
facets, the cloth of CSF and other compiled loops stay on the processor. Other arrays travel to and from the device in every call.

{markdown(columns, single)}

`jf.batch` of {len(SIDES)} clouds of {min(SIDES):.0f} to {max(SIDES):.0f} m with {SETS} sets of parameters in one call, which
returns counts of right and wrong labels, which are compared:

{markdown(columns, batches)}
"""


if __name__ == "__main__":
    main()
