"""Which methods find large halls, by their roofs and by how the border of the data cuts them. See README.md.

python experiments/halls/run.py
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
ROOFS = ("flat", "gable", "levels", "sawtooth", "annex")
PLACES = ("inside", "edge", "corner")
DENSITIES = (1.0, 2.0, 8.0)
"""Points per square metre."""
SIDES = {1.0: 260.0, 2.0: 260.0, 8.0: 200.0}
"""Metres of the scene by density."""
SEEDS, TREES, NOISE = (100, 101, 102, 103), 60, 0.03
"""Of the random numbers, for halls along the axes and turned ones; trees in a scene; metres, standard deviation."""


def main(arguments: list[str] | None = None) -> None:
    """Filter every hall by the given methods, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", default=list(jf.FILTERS), choices=jf.FILTERS)
    parser.add_argument("--densities", type=float, nargs="+", default=list(DENSITIES), choices=DENSITIES)
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    options = parser.parse_args(arguments)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    kinds = [(d, place, roof, s) for d in options.densities for place in PLACES for roof in ROOFS for s in SEEDS]
    rows = [row for kind in kinds for row in measured(*kind, options.methods)]
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(options.out / "results.csv", rows)
    write_page(options.out / "results.md", page(rows), "python experiments/halls/run.py", options.methods)


def hall(density: float, place: str, roof: str, seed: int) -> tuple[jf.PointCloud, np.ndarray, np.ndarray]:
    """A hall of 70 to 140 m and 5.5 to 12 m high, and trees, on gentle waves; and bool[n] each: ground, and the hall."""
    rng, side = np.random.default_rng(seed), SIDES[density]
    (wide, deep), height, turn = rng.uniform(70, 140, 2), rng.uniform(5.5, 12), rng.uniform(0, np.pi) * (seed % 2)
    x, y = rng.uniform(0, side, (2, int(side**2 * density)))
    left, low = side / 2 if place != "corner" else 0.35 * wide, side / 2 if place == "inside" else 0.35 * deep
    along = (x - left) * np.cos(turn) + (y - low) * np.sin(turn)
    across = (y - low) * np.cos(turn) - (x - left) * np.sin(turn)
    z, top = terrain(x, y), terrain(left, low) + height
    if roof == "gable":
        top = top + 0.12 * (deep / 2 - np.abs(across))
    elif roof == "levels":
        top = top + np.floor(along / 12) % 2
    elif roof == "sawtooth":
        top = top + 0.25 * (along % 10)
    built = (np.abs(along) < wide / 2) & (np.abs(across) < deep / 2)
    z = np.where(built, top, z)
    if roof == "annex":
        beside = (np.abs(along - wide / 2 - 6) < 6) & (np.abs(across) < deep / 3)
        z, built = np.where(beside & ~built, terrain(left, low) + 3.5, z), built | beside
    objects = built.copy()
    for cx, cy in rng.uniform(0, side, (TREES, 2)):
        crown = (np.hypot(x - cx, y - cy) < 3) & ~objects & (rng.random(len(x)) < 0.8)
        z, objects = z + crown * rng.uniform(2, 8, len(x)), objects | crown
    z += rng.normal(0, NOISE, len(x))
    return jf.PointCloud.from_arrays(np.column_stack([x, y, z])), ~objects, built


def terrain(x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
    """Metres: a slope of 2 % with waves of 1.5 m."""
    return np.asarray(0.02 * x + 1.5 * np.sin(np.divide(x, 60)) * np.cos(np.divide(y, 45)))


def measured(density: float, place: str, roof: str, seed: int, methods: list[str]) -> list[Row]:
    """A row for each method: percent of the points of the hall that become ground, and of the ground that is lost."""
    cloud, ground, built = hall(density, place, roof, seed)
    rows = []
    for name in methods:
        found = jf.FILTERS[name].for_cloud(cloud)(cloud).ground
        row: Row = {"method": name, "density": density, "place": place, "roof": roof, "seed": seed}
        rows.append(row | {"hall": 100 * found[built].mean(), "lost": 100 * (~found[ground]).mean()})
    return rows


def page(rows: list[Row]) -> str:
    """Means by method, and halls that become ground by place, roof and density."""
    table = pd.DataFrame(rows)
    means = table.groupby("method")[["hall", "lost"]].mean()
    means.insert(1, "halls", table[table.hall > 50].groupby("method").size().reindex(means.index, fill_value=0))
    means = means.sort_values(["hall", "lost"]).reset_index()
    for key in ("place", "roof", "density"):
        for value, some in table.groupby(key, sort=key == "density"):
            means[f"{value:g} per m2" if key == "density" else value] = (
                some.groupby("method").hall.mean().reindex(means.method).to_numpy()
            )
    columns: list[Column] = [("method", "method", ""), ("hall", "hall that is ground", ".1f"), ("halls", "halls", "d")]
    columns += [("lost", "lost ground", ".1f"), *((key, key, ".0f") for key in means.columns[4:])]
    records: list[Row] = means.to_dict("records")
    return (
        "# Large halls\n\n"
        f"{len(table) // len(means)} halls of 70 to 140 m, 5.5 to 12 m high, on gentle terrain with trees; every method as "
        "`for_cloud` gives it, which knows nothing of the size of buildings. Means over halls, percent of points: points of "
        "the hall that become ground; number of halls of which more than half does; ground that is lost. Then points of the "
        "hall that become ground by where the data end, by roof, and by density. OST's rules for halls were made with the "
        "halls of 2 per m2 in view.\n\n"
        f"{markdown(columns, records)}\n"
    )


if __name__ == "__main__":
    main()
