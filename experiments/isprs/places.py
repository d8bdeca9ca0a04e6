"""What the place of the grid decides: every method on the ISPRS samples, with grids that count from random points.

    python experiments/isprs/places.py [--places 16] [--methods smrf ost]

Writes ``results/places.csv`` and ``results/places.md``: the mean total error over the samples with grids that count from zero,
as they do by default, from the corner of each sample, and from random points.
"""

from __future__ import annotations

import argparse
import shlex
import statistics
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, spaces
from experiments.report import Column, Row, markdown, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent


def main() -> None:
    """Run everything and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, default=HERE / "results")
    parser.add_argument("--places", type=int, default=16)
    parser.add_argument("--methods", nargs="*", default=list(jf.FILTERS))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    folder = samples.data_folder(options.data)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    rows: list[Row] = []
    for method in options.methods:
        errors = {number: _errors(folder, method, number, options.places) for number in samples.SAMPLES}
        zero, corner, *drawn = np.mean(list(errors.values()), axis=0).tolist()
        rows.append(
            {"method": method, "zero": zero, "corner": corner, "mean": statistics.fmean(drawn)}
            | {"least": min(drawn), "largest": max(drawn), "deviation": statistics.stdev(drawn)}
        )
        print(
            " ".join(f"{value:.3f}" if isinstance(value, float) else str(value) for value in rows[-1].values()),
            flush=True,
        )
    write_csv(options.out / "places.csv", rows)
    command = shlex.join(["python", "experiments/isprs/places.py", *sys.argv[1:]])
    write_page(options.out / "places.md", _report(rows, options.places), command, options.methods)


def _errors(folder: Path, method: str, number: str, places: int) -> list[float]:
    """Total error in percent with grids from zero, from the corner, and from random points."""
    path = folder / "isprs" / f"samp{number}.txt"
    cloud = jf.read(path)
    filter_ = spaces.fixed(method, f"samp{number}")
    corner = cloud.coordinates().min(axis=0)[:2]
    rng = np.random.default_rng(int(number))
    anchors = [(0.0, 0.0), tuple(corner), *(tuple(v) for v in rng.uniform(0, 1000, (places, 2)).round(2))]
    found = []
    for anchor in anchors:
        moved = jf.read(path, anchor=anchor)
        found.append(jf.evaluate(filter_(moved), moved).total)
    return found


def _report(rows: list[Row], places: int) -> str:
    columns: list[Column] = [
        ("method", "method", ""), ("zero", "from zero", ".2f"), ("corner", "from the corner", ".2f"),
        ("mean", f"{places} random points, mean", ".2f"), ("least", "least", ".2f"), ("largest", "largest", ".2f"),
        ("deviation", "deviation", ".2f"),
    ]  # fmt: skip
    return "\n\n".join([
        "# The place of the grid",
        markdown(columns, [row | {"method": row["method"].upper()} for row in rows]),
        "Mean total error over the 15 ISPRS samples, percent, fixed protocol. Grids count from zero of the coordinates by "
        "default; before, those of a single file counted from its own lower left corner. Random points are drawn "
        "evenly from a square of a kilometre, the same for all methods. A difference between two methods, or two settings, that "
        "is smaller than this spread says nothing.",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
