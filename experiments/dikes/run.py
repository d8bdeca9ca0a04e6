"""How much of the crest of simulated dikes each method keeps, by width, height and slope. See README.md.

python experiments/dikes/run.py
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Column, Row, markdown, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
DENSITIES, HEIGHTS, WIDTHS, SLOPES = (0.5, 2.0, 8.0), (3.0, 5.0, 8.0), (3.0, 5.0, 9.0), (0.5, 0.67, 0.8)
"""Points per square metre; metres; metres of the crest; rise over run of the sides."""
SIDES = {0.5: 200.0, 2.0: 160.0, 8.0: 100.0}
"""Metres of the scene by density."""
PLANTS, NOISE, AZIMUTH, SEED = 0.05, 0.03, 0.5, 7
"""Share of the points that lie on plants, 0.5 to 3 m high; metres, standard deviation; radians; of the random numbers."""


def main(arguments: list[str] | None = None) -> None:
    """Filter every dike by the given methods, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=list(jf.FILTERS), choices=jf.FILTERS)
    parser.add_argument("--densities", type=float, nargs="+", default=list(DENSITIES), choices=DENSITIES)
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    options = parser.parse_args(arguments)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    kinds = [(d, h, w, s) for d in options.densities for h in HEIGHTS for w in WIDTHS for s in SLOPES]
    rows = [row for kind in kinds for row in measured(*kind, options.methods)]
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(options.out / "results.csv", rows)
    write_page(options.out / "results.md", page(rows), "python experiments/dikes/run.py", options.methods)


def dike(density: float, height: float, width: float, slope: float) -> tuple[jf.PointCloud, np.ndarray, np.ndarray]:
    """A plain with waves of 0.3 m and a straight dike across it; and bool[n] each: its ground, and that of the crest."""
    rng, side = np.random.default_rng(SEED), SIDES[density]
    x, y = rng.uniform(-side / 2, side / 2, (2, int(side**2 * density)))
    across = np.abs(x * np.cos(AZIMUTH) + y * np.sin(AZIMUTH))
    z = np.maximum(height - slope * np.maximum(across - width / 2, 0), 0) + 0.3 * np.sin(x / 25)
    z += rng.normal(0, NOISE, len(x))
    ground = rng.random(len(x)) >= PLANTS
    z = np.where(ground, z, z + rng.uniform(0.5, 3, len(x)))
    return jf.PointCloud.from_arrays(np.column_stack([x, y, z])), ground, ground & (across < width / 2)


def measured(density: float, height: float, width: float, slope: float, methods: list[str]) -> list[Row]:
    """A row for each method: percent of the ground of the crest that is lost, of all ground, and of plants that are ground."""
    cloud, ground, crest = dike(density, height, width, slope)
    rows = []
    for name in methods:
        found = jf.FILTERS[name].for_cloud(cloud)(cloud).ground
        lost, wrong = 100 * (~found[ground]).mean(), 100 * found[~ground].mean()
        row: Row = {"method": name, "density": density, "height": height, "width": width, "slope": slope}
        rows.append(row | {"crest": 100 * (~found[crest]).mean(), "lost": lost, "plants": wrong})
    return rows


def page(rows: list[Row]) -> str:
    """Means by method, and lost crests by width and slope."""
    table = pd.DataFrame(rows)
    means = table.groupby("method")[["crest", "lost", "plants"]].mean()
    means.insert(1, "half", table[table.crest > 50].groupby("method").size().reindex(means.index, fill_value=0))
    means = means.sort_values("crest").reset_index()
    for width in WIDTHS:
        for slope in SLOPES:
            some = table[(table.width == width) & (table.slope == slope)].groupby("method").crest.mean()
            means[f"{width:g} m, {slope:g}"] = some.reindex(means.method).to_numpy()
    columns: list[Column] = [("method", "method", ""), ("crest", "lost crest", ".1f"), ("half", "dikes", "d")]
    columns += [("lost", "lost ground", ".1f"), ("plants", "plants", ".1f")]
    kinds: list[Column] = [("method", "method", ""), *((key, key, ".0f") for key in means.columns[5:])]
    records: list[Row] = means.to_dict("records")
    return (
        "# Dikes\n\n"
        f"{len(table) // len(means)} dikes of earth across a plain, every method as `for_cloud` gives it. Means over dikes, "
        "percent of points: ground of the crest that is lost; number of dikes that lose more than half of their crest; all "
        "ground that is lost; and plants that are ground. OST's rule for embankments was made with such dikes in view.\n\n"
        f"{markdown(columns, records)}\n\n"
        "## Lost crest by its width, and slope of the sides\n\n"
        f"{markdown(kinds, records)}\n"
    )


if __name__ == "__main__":
    main()
