"""Every method on clouds that are made to hurt, each run in a process of its own: labels or a clear error, time, memory.

    python experiments/faults/adversarial.py [--out DIR] [--methods smrf,csf] [--clouds walls,grid]

Processor seconds are those of the call, compilations included; memory is the peak of the whole process. Ends with 1 if a
run crashed, gave an unclear error, or missed a bound.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments import report

SECONDS, MEGABYTES = 30.0, 1024.0
FAR_SECONDS = 10.0
"""What a run may take: processor time, peak memory; and the time with a point 1,000 km away."""
_PATIENCE = 600  # seconds on the clock, then it is killed
COLUMNS = (
    ("cloud", "cloud", ""),
    ("points", "points", ",.0f"),
    ("method", "method", ""),
    ("seconds", "CPU s", ".1f"),
    ("megabytes", "MB", ".0f"),
    ("outcome", "outcome", ""),
)


def _slope(points: int, size: float) -> np.ndarray:
    """f64[n, 3]: a rough slope of ``size`` metres."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(0, size, (points, 2))
    return np.column_stack([xy, 0.05 * xy[:, 0] + rng.normal(0, 0.03, points)]).round(2)


def _at_density(points: int) -> np.ndarray:
    return _slope(points, points**0.5)


def walls(share: float) -> np.ndarray:
    """Forty vertical lines of 2,500 points each, and one vertical wall of 50,000."""
    rng = np.random.default_rng(6)
    ground = _at_density(int(50_000 * share))
    size, line, wall = ground[:, 0].max(), int(2500 * share), int(50_000 * share)
    parts = [ground]
    for place in rng.uniform(0, size, (40, 2)):
        parts.append(np.column_stack([np.tile(place, (line, 1)), rng.uniform(0, 30, line)]))
    parts.append(np.column_stack([rng.uniform(0, size, wall), np.full(wall, size / 2), rng.uniform(0, 40, wall)]))
    return np.concatenate(parts).round(2)


def grid(share: float) -> np.ndarray:
    """A regular grid of 500 x 500 points with steps: all positions cocircular, most heights equal."""
    side = int(500 * share**0.5)
    x, y = (v.ravel().astype(float) for v in np.meshgrid(np.arange(side), np.arange(side)))
    return np.column_stack([x, y, 3.0 * ((x // 25 + y // 25) % 2)])


def duplicates(share: float) -> np.ndarray:
    """One point 100,000 times, and each of 1,000 others a hundred times."""
    some = _at_density(1000)
    return np.concatenate(
        [np.repeat(some[:1], int(100_000 * share), axis=0), np.repeat(some, max(2, int(100 * share)), axis=0)]
    )


def far_east(share: float) -> np.ndarray:
    """100,000 points and one 1,000 km to the east."""
    return np.concatenate([_at_density(int(100_000 * share)), [[1e6, 50.0, 0.0]]])


def far_south_west(share: float) -> np.ndarray:
    """100,000 points and one 1,000 km to the south and to the west, which is where the grids begin."""
    return np.concatenate([_at_density(int(100_000 * share)), [[-1e6, -1e6, 0.0]]])


def five_points(share: float) -> np.ndarray:
    """A square and its centre, one corner raised."""
    return np.array([[0, 0, 0], [10, 0, 0.1], [0, 10, 0.2], [10, 10, 3], [5, 5, 0.1]])


def millimetres(share: float) -> np.ndarray:
    """300,000 points 1 mm apart, with a step of 20 cm."""
    side = int(550 * share**0.5)
    x, y = (v.ravel() / 1000 for v in np.meshgrid(np.arange(side), np.arange(side)))
    z = np.random.default_rng(7).normal(0, 0.002, side * side) + 0.2 * ((x > 0.4 * x.max()) & (x < 0.6 * x.max()))
    return np.column_stack([x, y, z]).round(3)


def offsets(share: float) -> np.ndarray:
    """100,000 points at coordinates of 10^9, in x, y and z."""
    return _at_density(int(100_000 * share)) + [1e9, -1e9, 1e9]


CLOUDS: dict[str, Callable[[float], np.ndarray]] = {
    one.__name__: one for one in (walls, grid, duplicates, far_east, far_south_west, five_points, millimetres, offsets)
}
"""From the share of the full number of points to f64[n, 3]."""


def measure(name: str, method: str) -> dict[str, Any]:
    """One run, in this process."""
    import jaxfilter as jf

    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    xyz, filter_ = CLOUDS[name](1.0), jf.FILTERS[method]()
    start = time.process_time()
    try:
        result = filter_(xyz)
        outcome = f"{int(result.ground.sum()):,} ground"
    except jf.JaxfilterError as error:
        outcome = f"{type(error).__name__}: {error}"
    return {
        "points": len(xyz),
        "seconds": round(time.process_time() - start, 2),
        "megabytes": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        "outcome": outcome,
    }


def missed(row: dict[str, Any]) -> bool:
    """Whether a run crashed, took too much, or labelled a cloud that should be refused."""
    seconds = FAR_SECONDS if row["cloud"].startswith("far") else SECONDS
    return "seconds" not in row or row["seconds"] > seconds or row["megabytes"] > MEGABYTES


def main() -> int:
    """Run all pairs and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--clouds", default=",".join(CLOUDS))
    parser.add_argument("--methods")
    parser.add_argument("--one", nargs=2, metavar=("CLOUD", "METHOD"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(*arguments.one)))
        return 0

    import jaxfilter as jf

    rows: list[dict[str, Any]] = []
    for name in arguments.clouds.split(","):
        for method in arguments.methods.split(",") if arguments.methods else sorted(jf.FILTERS):
            command = [sys.executable, __file__, "--one", name, method]
            try:
                run = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE)
                found = json.loads(run.stdout) if run.returncode == 0 else {"outcome": f"exit code {run.returncode}"}
            except subprocess.TimeoutExpired:
                found = {"outcome": f"killed after {_PATIENCE} s"}
            rows.append({"cloud": name, "method": method, **found})
            print(rows[-1], flush=True)
    bad = [row for row in rows if missed(row)]
    arguments.out.mkdir(parents=True, exist_ok=True)
    report.write_csv(arguments.out / "adversarial.csv", rows)
    lines = [
        "# Clouds that are made to hurt",
        "",
        f"Bounds: {SECONDS:g} s of processor time ({FAR_SECONDS:g} s with a point 1,000 km away) and {MEGABYTES:g} MB for the",
        f"process. {len(bad)} of {len(rows)} runs missed them. Seconds include compilation, unless JAX had a persistent cache.",
        "",
        *(f"- {name}: {' '.join((CLOUDS[name].__doc__ or '').split())}" for name in arguments.clouds.split(",")),
        "",
        report.markdown(COLUMNS, rows),
        "",
    ]
    command = shlex.join(["python", "experiments/faults/adversarial.py", *sys.argv[1:]])
    report.write_page(arguments.out / "adversarial.md", "\n".join(lines), command)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
