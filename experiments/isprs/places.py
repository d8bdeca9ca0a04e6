"""What the place of the grid decides: every method on the ISPRS samples, with grids that count from random points.

    python experiments/isprs/places.py [--places 8] [--methods smrf ost]

Writes ``results/places.csv`` and ``results/places.md``: the mean total error over the samples with grids that count from zero,
as they do by default, from the corner of each sample, and from random points.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, search, spaces
from experiments.report import Column, CommandLine, Row, markdown, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent


def main() -> None:
    """Run everything and write the tables."""
    parser = CommandLine(__file__, __doc__)
    parser.add_argument("--places", type=int, default=8)
    parser.add_argument("--methods", nargs="*", default=list(jf.FILTERS))
    options = parser.options(None)
    folder = samples.data_folder(options.data)
    tasks = [(samples.sample_path(folder, n), m, options.places) for m in options.methods for n in samples.SAMPLES]
    found = pd.DataFrame([row for _, rows in search.results(errors, tasks, 2) for row in rows])
    rows: list[Row] = []
    for method in options.methods:
        means = found[found.method == method].groupby("place").total.mean()
        drawn = means.drop(["zero", "corner"])
        rows.append({"method": method, "zero": means["zero"], "corner": means["corner"], "mean": drawn.mean(),
                     "least": drawn.min(), "largest": drawn.max(), "deviation": drawn.std()})  # fmt: skip
    write_csv(options.out / "places.csv", rows)
    write_page(options.out / "places.md", _report(rows, options.places), options.command, options.methods)


def errors(path: Path, method: str, places: int) -> list[Row]:
    """Total error in percent on a sample with grids from zero, from the corner, and from random points."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    filter_ = spaces.fixed(method, path.stem)
    anchors = {"zero": (0.0, 0.0), "corner": tuple(jf.read(path).coordinates().min(axis=0)[:2])}
    anchors |= drawn(path, places)
    clouds = {place: jf.read(path, anchor=anchor) for place, anchor in anchors.items()}
    return [
        {"method": method, "place": place, "total": jf.evaluate(filter_(cloud), cloud).total}
        for place, cloud in clouds.items()
    ]


def drawn(path: Path, places: int) -> dict[str, tuple[float, float]]:
    """Random points of a sample from which grids count, by number; the same for all methods."""
    rng = np.random.default_rng(int(path.stem.removeprefix("samp")))
    return {str(place): (x, y) for place, (x, y) in enumerate(rng.uniform(0, 1000, (places, 2)).round(2).tolist())}


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
        "default. Random points are drawn "
        "evenly from a square of a kilometre, the same for all methods. A difference between two methods, or two settings, that "
        "is smaller than this spread says nothing.",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
