"""What a country costs: seconds and memory by density and method, and the plans of a million square kilometres of files."""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path

import numpy as np

import jaxfilter as jf
from experiments.report import Column, Row
from experiments.tiling.scale import COMMAND, measured, watched
from jaxfilter.surveys.options import need
from jaxfilter.surveys.plan import plan_tiles

AREA, DENSITY = 40_000, 10.0
"""Square kilometres, one file each, and points per square metre, of the country of ``docs/scaling.md``."""


def table(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    """Each method on one file per density, and what a country of such files takes by its plan."""
    rows: list[Row] = []
    for density in options.densities:
        path = scene(options.work, density, options.millions)
        for method in options.costs:
            start, found = (cost(method, place, options.work) for place in (scene(options.work, density, 0.01), path))
            per_read = (found["cpu"] - start["cpu"]) / found["read"]
            row: Row = {"method": method, "density": density, **found, "per_million": per_read * 1e6}
            rows.append(row | country(jf.FILTERS[method].for_cloud(jf.read(path)), density, per_read))
    columns: list[Column] = [
        ("method", "method", ""), ("density", "points per m2", "g"), ("points", "points", ",d"), ("cpu", "CPU seconds", ".1f"),
        ("per_million", "per million points read", ".2f"), ("rate", "million points per core-hour, with halos", ",.0f"),
        ("halo", "halo, m", ".0f"), ("tile", "tile, m", ".0f"), ("times", "times a point is read", ".2f"),
        ("hours", "core-hours of the country", ",.0f"), ("worker", "memory of a worker, GB", ".1f"),
    ]  # fmt: skip
    return rows, columns, f"A country of {AREA:,} km2"


def cost(method: str, path: Path, work: Path) -> Row:
    """A whole command that has its compiled code: the second of two, where the first may make it."""
    command = [*COMMAND, method, str(path), str(work / "cost.laz"), "--for-cloud", "--overwrite", "--json"]
    watched(command)
    return watched(command)


def scene(folder: Path, density: float, millions: float) -> Path:
    """A simulated scene of about so many million points, first and last echoes, as LAZ."""
    path = folder / f"country_{density:g}_{millions:g}.laz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        side = math.sqrt(millions * 1e6 / density)
        made = jf.scenes.make("mixed", seed=5, size=side, density=density / 1.1)
        jf.write(path, made.cloud, np.zeros(len(made), bool), reset="none")
    return path


def country(filter_: jf.Filter, density: float, per_read: float) -> Row:
    """Tiles, times that a point is read, core-hours and memory (GB) of a worker for files of a square kilometre."""
    side = math.isqrt(AREA)
    x, y = (1000.0 * axis.ravel() for axis in np.meshgrid(np.arange(side), np.arange(side)))
    bounds, count = np.stack([x, y, x + 999.99, y + 999.99], axis=1), round(density * 1e6)
    plan = plan_tiles(bounds, np.full(side**2, count), halo=filter_.halo(), lattice=filter_.lattice())
    points = side**2 * count
    times = plan.times_read(points)
    return {
        "halo": filter_.halo(), "tile": plan.width, "tiles": len(plan), "times": times,
        "rate": 3600 / (per_read * times) / 1e6, "hours": points * times * per_read / 3600, "worker": need(plan) / 1e9,
    }  # fmt: skip


def collection(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    """OST over 16 files of a square kilometre, as one collection and, four of them, file by file."""
    paths = [options.work / "kilometres" / f"{k // 4}-{k % 4}.laz" for k in range(16)]
    if not all(path.exists() for path in paths):
        paths[0].parent.mkdir(parents=True, exist_ok=True)
        made = jf.scenes.make("mixed", seed=7, size=1000.0, density=5 / 1.1)
        for k, path in enumerate(paths):
            moved = dataclasses.replace(
                made.cloud, origin=made.cloud.origin + [1000.0 * (k // 4), 1000.0 * (k % 4), 0.0]
            )
            jf.write(path, moved, np.zeros(len(made), bool), reset="none")
    alone = [cost("ost", path, options.work) for path in paths[:4]]  # the others hold the same points, moved
    total: Row = {key: 4 * sum(one[key] for one in alone) for key in ("points", "read", "wall", "cpu")}
    total |= {"how": "file by file", "tiles": len(paths), "peak": max(one["peak"] for one in alone)}
    rows: list[Row] = [total]
    rows.append(measured("ost", paths, options.work, "--for-cloud") | {"how": "as a collection"})
    for row in rows:
        row |= {"times": row["read"] / row["points"], "share": row["cpu"] / rows[0]["cpu"]}
    columns: list[Column] = [
        ("how", "how", ""), ("points", "points", ",d"), ("tiles", "tiles", "d"), ("times", "times a point is read", ".2f"),
        ("wall", "seconds", ".0f"), ("cpu", "CPU seconds", ".0f"), ("share", "of those file by file", ".2f"),
        ("peak", "peak memory, GB", ".2f"),
    ]  # fmt: skip
    return rows, columns, "Files of a square kilometre, at 5 points per m2"
