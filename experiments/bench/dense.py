"""What points beyond thirty per m2 cost: the same simulated place from photographs, ever denser. See README.md."""

from __future__ import annotations

import argparse
import shlex
import statistics
import sys
import time
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Column, Row, markdown, write_page

SIDE, CELL = 100.0, 0.1
NOISE, SHARED = 0.025, 0.03
"""Metres: standard deviations of the noise of each point, and of that which neighbours share."""
REACH = 0.5
"""Metres over which they share it."""


def photographed(density: float, seed: int = 1) -> tuple[jf.PointCloud, np.ndarray, np.ndarray]:
    """A village of 1 ha on a slope, as image matching shows it: one surface, edges smoothed, noise that neighbours share.

    Returns: the cloud, of ``density`` points per m2; bool[n], ground; and f64[n], elevation of the terrain at the points.
    """
    rng = np.random.default_rng(seed)
    nodes = round(SIDE / CELL) + 1

    def sheet(sigma: float, height: float) -> np.ndarray:
        made = gaussian_filter(rng.standard_normal((nodes, nodes)), sigma / CELL, mode="wrap")
        return np.asarray(made * (height / made.std()))

    y, x = np.mgrid[:nodes, :nodes] * CELL
    terrain = 0.08 * x + sheet(15, 1.5) + sheet(1, 0.02)
    thing = np.zeros_like(terrain)
    for east, north, turn in zip(*rng.uniform(12, SIDE - 12, (2, 8)), rng.uniform(0, np.pi, 8), strict=True):
        along = (x - east) * np.cos(turn) + (y - north) * np.sin(turn)
        across = (y - north) * np.cos(turn) - (x - east) * np.sin(turn)
        inside = (np.abs(along) < 6) & (np.abs(across) < 4)
        thing[inside] = np.maximum(thing, 5 - 0.6 * np.abs(across))[inside]
    for east, north, size in zip(*rng.uniform(0, SIDE, (2, 40)), rng.uniform(1, 4, 40), strict=True):
        dome = 1 - ((x - east) ** 2 + (y - north) ** 2) / size**2
        thing = np.maximum(thing, 2.5 * size * np.sqrt(np.maximum(dome, 0)) * (1 + 0.1 * sheet(0.3, 1.0)))
    surface = terrain + gaussian_filter(thing, 0.15 / CELL) + sheet(REACH, SHARED)
    at = np.floor(rng.uniform(0, SIDE, (round(SIDE**2 * density), 2)) * 1000) / 1000
    over = at[:, ::-1].T / CELL
    level, z = (map_coordinates(values, over, order=1) for values in (terrain, surface))
    z += rng.normal(0, NOISE, len(z))
    ground = map_coordinates(gaussian_filter(thing, 0.15 / CELL), over, order=1) < 0.1
    cloud = jf.PointCloud.from_arrays(np.column_stack([at, np.round(z, 3)]))
    return cloud, ground, level


def measured(density: float, repeats: int) -> Row:
    """The median of CPU seconds of warm calls, total error, and RMSE of ground points from the terrain."""
    cloud, truth, level = photographed(density)
    filter_ = jf.OST.for_cloud(cloud)
    result, seconds = filter_(cloud), []
    for _ in range(repeats):
        start = time.process_time()
        result = filter_(cloud)
        seconds.append(time.process_time() - start)
    scores = jf.evaluate(result, truth)
    off = (cloud.xyz[:, 2] - (level - cloud.origin[2]))[result.ground]
    return {
        "density": density,
        "points": len(cloud),
        "cpu": statistics.median(seconds),
        "per_million": statistics.median(seconds) / len(cloud) * 1e6,
        "type1": scores.type1,
        "type2": scores.type2,
        "total": scores.total,
        "bias": float(off.mean()),
    }


def main(arguments: list[str] | None = None) -> None:
    """Measure at each density and write a table."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--densities", type=float, nargs="+", default=[15, 30, 60, 125, 250, 500])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args(given)
    rows = [measured(density, options.repeats) for density in options.densities]
    columns: list[Column] = [
        ("density", "points/m2", "g"),
        ("points", "points", ",d"),
        ("cpu", "warm, CPU s", ".2f"),
        ("per_million", "CPU s per million", ".2f"),
        ("type1", "type I, %", ".2f"),
        ("type2", "type II, %", ".2f"),
        ("total", "total error, %", ".2f"),
        ("bias", "ground above terrain, m", ".3f"),
    ]
    command = shlex.join(["python", "experiments/bench/dense.py", *given])
    text = ["# Cost at high density", "", markdown(columns, rows)]
    options.out.mkdir(parents=True, exist_ok=True)
    write_page(options.out / "dense.md", "\n".join(text), command, ["ost"])
    print("\n".join(text))


if __name__ == "__main__":
    main()
