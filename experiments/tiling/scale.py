"""Time and memory of runs of growing size."""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import laspy
import numpy as np
import psutil

import jaxfilter as jf
from experiments.report import Column, Row

COMMAND = [sys.executable, "-c", "from jaxfilter.cli import main; main(prog_name='jaxfilter')", "ground"]


def table(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    """SMRF over more and more files, and file by file; FPTD over all of them."""
    paths = files(options.work, max(options.files))
    rows = [measured("smrf", paths[:count], options.work) for count in options.files]
    alone: Row = {"how": "SMRF, file by file", "points": 0, "wall": 0.0, "cpu": 0.0, "peak": 0.0, "tiles": 0}
    for path in paths[: options.files[0]]:
        one = watched([*COMMAND, "smrf", str(path), str(options.work / "alone.laz"), "--overwrite", "--json"])
        alone |= {key: alone[key] + one[key] for key in ("points", "wall", "cpu")}
        alone["peak"] = max(alone["peak"], one["peak"])
    rows += [alone, measured("fptd", paths, options.work)]
    for row in rows:
        row["per_million"] = row["cpu"] / row["points"] * 1e6
    columns: list[Column] = [
        ("how", "how", ""), ("points", "points", ",d"), ("tiles", "tiles", "d"), ("wall", "seconds", ".0f"),
        ("cpu", "CPU seconds", ".0f"), ("per_million", "CPU seconds per million", ".2f"), ("peak", "peak memory, GB", ".2f"),
    ]  # fmt: skip
    return rows, columns, "Time and memory by size"


def files(folder: Path, count: int) -> list[Path]:
    """Files of 3.7 million points on 4 km2, side by side: one simulated scene, moved."""
    paths = [folder / "large" / f"{k // 5}-{k % 5}.laz" for k in range(count)]
    if all(path.exists() for path in paths):
        return paths
    paths[0].parent.mkdir(parents=True, exist_ok=True)
    scene = jf.scenes.make("mixed", seed=3, size=2000.0, density=0.85)
    xyz, cloud = scene.cloud.coordinates(), scene.cloud
    for k, path in enumerate(paths):
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.scales, las.header.offsets = np.full(3, 0.01), np.zeros(3)
        las.x, las.y, las.z = xyz[:, 0] + 2000 * (k // 5), xyz[:, 1] + 2000 * (k % 5), xyz[:, 2]
        las.return_number, las.number_of_returns = cloud.return_number, cloud.number_of_returns
        las.write(path)
    return paths


def measured(method: str, paths: list[Path], work: Path, *more: str) -> Row:
    """One run of the command: points, tiles, seconds, CPU seconds and peak memory (GB) of all its processes."""
    out = work / "scale"
    shutil.rmtree(out, ignore_errors=True)
    row = watched([*COMMAND, method, *map(str, paths), str(out), "--json", *more])
    print(row, file=sys.stderr, flush=True)
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
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode:
        raise RuntimeError(f"{command} failed with exit code {process.returncode}")
    facts = json.loads(output)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    wall = time.perf_counter() - start
    return {
        "points": facts["points"], "read": facts.get("read", facts["points"]), "tiles": facts.get("tiles", 0),
        "wall": wall, "cpu": cpu, "peak": peak / 1e9,
    }  # fmt: skip


def memory(pid: int) -> float:
    """Bytes of a process and all below it; what they share counts once."""
    total = 0.0
    try:
        for process in (psutil.Process(pid), *psutil.Process(pid).children(recursive=True)):
            total += process.memory_full_info().pss
    except psutil.Error:
        pass
    return total
