"""Time and memory: runs of growing size, a country of files, tiles against single files, and a Dask cluster."""

from __future__ import annotations

import argparse
import dataclasses
import filecmp
import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import jaxfilter as jf
from experiments.report import Column, Row, markdown
from experiments.tiling.labels import generated
from jaxfilter.surveys.options import need
from jaxfilter.surveys.plan import Where, plan_tiles
from jaxfilter.surveys.product import Cut

COMMAND = [sys.executable, "-c", "from jaxfilter.cli import main; main(prog_name='jaxfilter')", "ground"]
AREA = 40_000
"""Square kilometres, one file each, of the country of ``docs/scaling.md``."""
KILLS, KILL_EVERY = 3, 3.0
"""How often a worker is killed, and after how many seconds."""

COLUMNS: list[Column] = [
    ("how", "how", ""), ("points", "points", ",d"), ("tiles", "tiles", "d"), ("wall", "seconds", ".0f"),
    ("cpu", "CPU seconds", ".0f"), ("per_million", "CPU seconds per million points", ".2f"),
    ("peak", "memory of all processes, GB", ".2f"),
]  # fmt: skip


def scale(options: argparse.Namespace) -> tuple[list[Row], str]:
    """SMRF over more and more files, and file by file; FPTD over all of them."""
    paths = _side_by_side(options.work / "large", max(options.files), 5, {"seed": 3, "size": 2000.0, "density": 0.85})
    rows = [_of_collection("smrf", paths[:count], options.work) for count in options.files]
    alone: Row = {"how": "SMRF, file by file", "points": 0, "wall": 0.0, "cpu": 0.0, "peak": 0.0, "tiles": 0}
    for path in paths[: options.files[0]]:
        one = watched([*COMMAND, "smrf", str(path), str(options.work / "alone.laz"), "--overwrite", "--json"])
        alone |= {key: alone[key] + one[key] for key in ("points", "wall", "cpu")}
        alone["peak"] = max(alone["peak"], one["peak"])
    rows += [alone, _of_collection("fptd", paths, options.work)]
    for row in rows:
        row["per_million"] = row["cpu"] / row["points"] * 1e6
    return rows, f"# Time and memory by size\n\n{markdown(COLUMNS, rows)}"


def country(options: argparse.Namespace) -> tuple[list[Row], str]:
    """Each method on one file per density, and what a country of such files takes by its plan."""
    rows: list[Row] = []
    for density in options.densities:
        small, path = (_country_file(options.work, density, millions) for millions in (0.01, options.millions))
        for method in options.costs:
            start, found = (cost(method, place, options.work) for place in (small, path))
            per_read = (found["cpu"] - start["cpu"]) / found["read"]
            row: Row = {"method": method, "title": method.upper(), "density": density, **found}
            row["per_million"] = per_read * 1e6
            rows.append(row | _planned(jf.FILTERS[method].for_cloud(jf.read(path)), density, per_read))
    columns: list[Column] = [
        ("title", "method", ""), ("density", "points per m2", "g"),
        ("per_million", "CPU seconds per million points read", ".2f"), ("halo", "halo, m", ".0f"), ("tile", "tile, m", ",.0f"),
        ("times", "times a point is read", ".2f"), ("hours", "core-hours of the country", ",.0f"),
        ("worker", "memory of a worker, GB", ".1f"),
    ]  # fmt: skip
    return rows, f"# A country of {AREA:,} km2\n\n{markdown(columns, rows)}"


def collection(options: argparse.Namespace) -> tuple[list[Row], str]:
    """OST over nine files of a square kilometre, as one collection and, three of them, file by file."""
    scene = {"seed": 7, "size": 1000.0, "density": 5 / 1.1}
    paths = _side_by_side(options.work / "kilometres", 9, 3, scene)
    cost("ost", paths[0], options.work)
    alone = [cost("ost", path, options.work, warm=True) for path in paths[:3]]  # the others hold the same points, moved
    total: Row = {key: 3 * sum(one[key] for one in alone) for key in ("points", "read", "wall", "cpu")}
    total |= {"how": "file by file", "tiles": len(paths), "peak": max(one["peak"] for one in alone)}
    rows = [total, _of_collection("ost", paths, options.work, "--for-cloud") | {"how": "as a collection"}]
    for row in rows:
        row |= {"times": row["read"] / row["points"], "share": row["cpu"] / rows[0]["cpu"]}
        row["per_million"] = row["cpu"] / row["points"] * 1e6
    columns: list[Column] = [*COLUMNS, ("times", "times a point is read", ".2f")]
    return rows, f"# Files of a square kilometre, at 5 points per m2\n\n{markdown(columns, rows)}"


def cluster(options: argparse.Namespace) -> tuple[list[Row], str]:
    """A scheduler and two workers as processes of their own, over TCP: left alone, and with a worker killed now and then."""
    inputs = [str(path) for path in generated(options.work, options.small, 3, 1.0)]
    local, out = options.work / "undisturbed", options.work / "clustered"
    flags = ["--resume", "--tile", "150", "--halo", "40", "--wide-halos", "--quiet"]
    shutil.rmtree(local, ignore_errors=True)
    start = time.perf_counter()
    subprocess.run([*COMMAND, "pmf", *inputs, str(local), *flags], check=True, stderr=subprocess.DEVNULL)
    alone, rows = time.perf_counter() - start, []
    with _cluster() as workers:
        for every in (None, KILL_EVERY):
            shutil.rmtree(out, ignore_errors=True)
            start, killed = time.perf_counter(), 0
            command = [*COMMAND, "pmf", *inputs, str(out), *flags, "--scheduler", workers.scheduler_address]
            process = subprocess.Popen(command)
            while process.poll() is None:
                try:
                    process.wait(every if killed < KILLS else None)
                except subprocess.TimeoutExpired:
                    os.kill(next(iter(workers.workers.values())).pid, signal.SIGKILL)
                    killed += 1
            names = [path.name for path in local.glob("*.laz")]
            same = sum(filecmp.cmp(local / name, out / name, False) for name in names if (out / name).exists())
            rows.append({
                "trial": "workers killed" if every else "left alone", "kills": killed, "code": process.returncode,
                "same": same, "files": len(names), "seconds": time.perf_counter() - start, "local": alone,
            })  # fmt: skip
    columns: list[Column] = [
        ("trial", "trial", ""), ("kills", "kills", "d"), ("code", "exit code", "d"), ("same", "files with the same bytes", "d"),
        ("files", "files", "d"), ("seconds", "seconds", ".1f"), ("local", "seconds of the local pool", ".1f"),
    ]  # fmt: skip
    return rows, f"# A Dask cluster of two workers\n\n{markdown(columns, rows)}"


def _side_by_side(folder: Path, count: int, rows: int, scene: dict[str, float]) -> list[Path]:
    """Files beside each other, so many in a row: one simulated scene, moved."""
    paths = [folder / f"{k // rows}-{k % rows}.laz" for k in range(count)]
    if not all(path.exists() for path in paths):
        folder.mkdir(parents=True, exist_ok=True)
        made = jf.scenes.make("mixed", **scene)
        for k, path in enumerate(paths):
            origin = made.cloud.origin + [scene["size"] * (k // rows), scene["size"] * (k % rows), 0.0]
            jf.write(path, dataclasses.replace(made.cloud, origin=origin), np.zeros(len(made), bool), reset="none")
    return paths


def _country_file(folder: Path, density: float, millions: float) -> Path:
    """About so many million points, first and last echoes."""
    scene = {"seed": 5, "size": math.sqrt(millions * 1e6 / density), "density": density / 1.1}
    return _side_by_side(folder / f"country_{density:g}_{millions:g}", 1, 1, scene)[0]


def _planned(filter_: jf.Filter, density: float, per_read: float) -> Row:
    """Tiles, times that a point is read, core-hours and memory (GB) of a worker for files of a square kilometre."""
    side, count = math.isqrt(AREA), round(density * 1e6)
    x, y = (1000.0 * axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    bounds = np.stack([x, y, x + 999.99, y + 999.99], axis=1)
    where = Where.from_files(bounds, np.full(side**2, count))
    plan = plan_tiles(where, Cut(filter_.halo(), filter_.lattice()))
    times = plan.times_read(side**2 * count)
    area = np.median((plan.cores[:, 2:] - plan.cores[:, :2]).prod(axis=1))
    hours = side**2 * count * times * per_read / 3600
    found = {"halo": filter_.halo(), "tile": math.sqrt(area), "tiles": len(plan), "times": times, "hours": hours}
    return found | {"worker": need(plan.points.max()) / 1e9}


def cost(method: str, path: Path, work: Path, warm: bool = False) -> Row:
    """A whole command that has its compiled code: the second of two, where the first may make it, unless it is there."""
    command = [*COMMAND, method, str(path), str(work / "cost.laz"), "--for-cloud", "--overwrite", "--json"]
    if not warm:
        watched(command)
    return watched(command)


def _of_collection(method: str, paths: list[Path], work: Path, *more: str) -> Row:
    """One run of the command over files in tiles, as :func:`watched`."""
    shutil.rmtree(work / "scale", ignore_errors=True)
    row = watched([*COMMAND, method, *map(str, paths), str(work / "scale"), "--json", *more])
    return {"how": f"{method.upper()}, {len(paths)} files", **row}


def watched(command: list[str]) -> Row:
    """A command: points, points read with halos, tiles, seconds, CPU seconds and peak memory (GB) of all its processes."""
    before, start, peak = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter(), 0.0
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    def watch() -> None:
        nonlocal peak
        while process.poll() is None:
            peak = max(peak, memory(process.pid))
            time.sleep(0.2)

    watcher = threading.Thread(target=watch)
    watcher.start()
    output = process.communicate()[0]
    watcher.join()
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - start
    if process.returncode:
        raise RuntimeError(f"{command} failed with exit code {process.returncode}")
    facts = json.loads(output)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    found = {"points": facts["points"], "read": facts.get("read", facts["points"]), "tiles": facts.get("tiles", 0)}
    print(f"{' '.join(command[3:5])}: {found['points']:,} points, {wall:.0f} s", file=sys.stderr, flush=True)
    return found | {"wall": wall, "cpu": cpu, "peak": peak / 1e9}


def memory(pid: int) -> float:
    """Bytes of a process and all below it; what they share counts once."""
    total = 0.0
    try:
        for process in (psutil.Process(pid), *psutil.Process(pid).children(recursive=True)):
            total += process.memory_full_info().pss
    except psutil.Error:
        pass
    return total


def _cluster() -> Any:
    """A scheduler, and two workers as processes of their own, over TCP; one that dies is started again."""
    from dask.distributed import LocalCluster

    return LocalCluster(n_workers=2, threads_per_worker=1, memory_limit=0, dashboard_address=None)
