"""Decks and water found by OST, by area, in scenes, and how many points of them on labelled tiles. See README.md.

python experiments/water/run.py
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Column, Row, markdown, write_csv, write_page
from experiments.water import scenes
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
WATER, BRIDGE = 9, 17


def main(arguments: list[str] | None = None) -> None:
    """Score all scenes of the given seeds and the tiles that hold water or decks, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with tiles/ and tiles_hard/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--seeds", type=int, nargs="+", default=[scenes.CHOICE, scenes.CHECK])
    options = parser.parse_args(arguments)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    names = [*scenes.DECKS, *scenes.WATERS, *scenes.NONE]
    rows = [scored(n, d, seed) for seed in options.seeds for n in names for d in scenes.DENSITIES]
    try:
        folder: Path | None = samples.data_folder(options.data)
    except SystemExit:
        folder = None
    found = sorted(folder.glob("tiles*/*.la[sz]")) if folder else []
    tiles = [row for path in found if (row := tile(path))]
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(options.out / "scenes.csv", rows)
    write_csv(options.out / "tiles.csv", tiles)
    write_page(options.out / "results.md", page(rows, tiles), "python experiments/water/run.py", ["ost", "scenes"])


def scored(name: str, density: float, seed: int) -> Row:
    """F1 by area, and cells of 1 m whose terrain is off by more than 0.5 m; water without echoes has no surface to hold it to."""
    place = scenes.place(name, density, seed)
    result = jf.OST.for_cloud(place.cloud)(place.cloud)
    deck = scenes.nearest(place.cloud, result.deck, place.x, place.y, 1.5 * density**-0.5)
    water = np.zeros(len(place.x), bool)
    if (cells := result.water_cells) is not None:
        at = np.column_stack([place.y, place.x]) - place.cloud.anchor[::-1]
        places = np.floor(at / cells.side + 0.5).astype(np.int64) @ [1 << 32, 1]
        water = np.isin(places, cells.at.astype(np.int64) @ [1 << 32, 1])
    row: Row = {"scene": name, "density": density, "seed": seed}
    for what, area, truth in (("deck", deck, place.deck), ("water", water, place.water)):
        row |= {f"{what}_{key}": v for key, v in scenes.by_area(area, truth).items()}
        row[f"{what}_wrong"] = int((area & ~truth).sum())
    model = jf.dtm(place.cloud, result, 1.0)
    x, y = model.centres()
    off = model.values[np.rint(y[0] - place.y).astype(int), np.rint(place.x - x[0]).astype(int)] - place.terrain
    known = np.isfinite(off) & np.isfinite(place.terrain)
    print(row, file=sys.stderr, flush=True)
    return row | {"off": 100 * float((np.abs(off[known]) > 0.5).mean())}


def tile(path: Path) -> Row | None:
    """How many points of classes 9 and 17 of a tile are marked, and of those that are marked have these or no class."""
    cloud = jf.read(path, units="m", returns="all", ignore_classes=(7, 18))
    classes = cloud.classification
    if not np.isin(classes, (WATER, BRIDGE)).any():
        return None
    result, row = jf.OST.for_cloud(cloud)(cloud), {"tile": path.stem}
    for what, number, marked in (("water", WATER, result.water), ("deck", BRIDGE, result.deck)):
        own = classes == number
        row |= {
            f"{what}_points": int(own.sum()),
            f"{what}_marked": int(marked.sum()),
            f"{what}_both": int((marked & own).sum()),
        }
    return row


def page(rows: list[Row], tiles: list[Row]) -> str:
    """The tables as Markdown."""
    text = ["# Water and bridge decks", ""]
    for seed in dict.fromkeys(row["seed"] for row in rows):
        seen = "looked at while the rules were chosen" if seed == scenes.CHOICE else "only scored"
        columns: list[Column] = [
            ("scene", "scene", ""), ("density", "points/m2", ".1f"), ("deck_f1", "deck, F1", ".2f"),
            ("deck_wrong", "no deck, m2", ",d"), ("water_f1", "water, F1", ".2f"), ("water_wrong", "no water, m2", ",d"),
            ("off", "off by > 0.5 m, %", ".2f"),
        ]  # fmt: skip
        table = [row for row in rows if row["seed"] == seed]
        text += [f"## Scenes of seed {seed}, {seen}", "", markdown(columns, table), ""]
    if tiles:
        heading: list[Column] = [("tile", "tile", "")]
        heading += [(f"{w}_{k}", f"{w}, {k}", ",d") for w in ("water", "deck") for k in ("points", "marked", "both")]
        text += ["## Tiles with classes 9 and 17", "", markdown(heading, tiles), ""]
    return "\n".join(text).rstrip()


if __name__ == "__main__":
    main()
