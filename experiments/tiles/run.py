"""Every method, one set each, on six labelled tiles of other sensors, densities and land cover. See README.md."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, spaces
from experiments.report import Column, CommandLine, Row, markdown, save_png, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.points import canonical_points

HERE = Path(__file__).parent
TILES = {
    "geo1101_Delft_manual": "city block, Delft",
    "3dfier_ahn3_cropped_2": "city blocks, AHN3",
    "ign_semis_2023_0292_6833": "countryside and village, thinned",
    "lff_2_42": "steep dense forest",
    "zf_veluwezoom_ahn3": "hilly forest, AHN3",
    "lidR_Topography": "boreal forest with a lake",
}
SHARED = {"ppdf": "lff_2_42"}
"""Methods and the tile that took part in the choice of their defaults."""
MARK = "‡"
LEFT_OUT = (7, 9, 12, 18, 26, 65, 66, 67)
"""Noise, water, overlap and other classes that are neither ground nor object; they are not scored."""


def main(arguments: list[str] | None = None) -> None:
    """Run all methods on all tiles and write the tables."""
    options = _parser().options(arguments)
    folder = samples.data_folder(options.data) / "tiles"
    keep_compilations()
    # what producers set apart is filtered like the rest: a user's cloud has no classes yet
    reading = jf.Reading(units="m", returns="all", ignore_classes=(7, 18))
    data = jf.datasets.folder(folder, ignore=LEFT_OUT, reading=reading)
    rows: list[Row] = []
    for tile in options.tiles:
        if tile not in data:
            print(f"{tile} is left out: it is not in {folder}", file=sys.stderr)
            continue
        cloud = data[tile]
        rows += [tile_row(tile, name, cloud) for name in options.methods]
    write_csv(options.out / "tiles.csv", rows)
    write_page(options.out / "results.md", report(rows), options.command, options.methods)
    heat(rows, options.out / "totals.png")
    print(f"results are in {options.out}")


def tile_row(tile: str, name: str, cloud: jf.PointCloud) -> Row:
    """Scores of a method as ``for_cloud`` gives it for the tile."""
    spacing = canonical_points(cloud).spacing()
    filter_ = jf.FILTERS[name].for_cloud(cloud)
    filter_(cloud)
    start = time.perf_counter()
    result = filter_(cloud)
    seconds = time.perf_counter() - start
    scores = jf.evaluate(result, cloud)
    print(f"{tile:26} {name:6} total error {scores.total:6.2f}  {seconds:.2f} s", file=sys.stderr, flush=True)
    return {
        "tile": tile, "cover": TILES[tile], "method": name, "points": len(cloud), "density": round(1 / spacing**2, 2),
        "type1": scores.type1, "type2": scores.type2, "total": scores.total, "kappa": scores.kappa, "seconds": seconds,
    }  # fmt: skip


def report(rows: list[Row]) -> str:
    """All tables as Markdown."""
    text = [
        "# Six labelled tiles, one set per method", "",
        "Every method as `for_cloud(cloud)` gives it: defaults, and what follows from the point spacing. OST's defaults "
        "were found on these tiles, twelve others, the ISPRS samples and scenes. Of the others no default was chosen here but "
        "the limit for large clusters of low points, which all methods but SMRF search for, and "
        f"PPDF's, on {SHARED['ppdf']} (and simulated forests): its figure there is marked {MARK}, and its "
        f"mean stands with and without that tile. All echoes are filtered; only points of classes 7 and 18 are set aside, so "
        "that no method profits from water, bridges or artefacts that a producer has classified. Points are scored as class 2 "
        f"or not, but for those of classes {', '.join(map(str, LEFT_OUT))} and 0. Seconds are those of one warm call.", "",
    ]  # fmt: skip
    tiles = list(dict.fromkeys(row["tile"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    by = {(row["tile"], row["method"]): row for row in rows}
    facts = [next(row for row in rows if row["tile"] == tile) for tile in tiles]
    text += [markdown([("tile", "tile", ""), ("cover", "cover", ""), ("points", "points", ",d"), ("density", "points/m2", ".1f")],
                      facts), ""]  # fmt: skip
    for key, title in (("total", "Total error, %"), ("kappa", "Kappa, %"), ("type1", "Type I, %"), ("type2", "Type II, %"),
                       ("seconds", "Seconds")):  # fmt: skip
        columns: list[Column] = [
            ("method", "method", ""),
            *((tile, tile, ".2f") for tile in tiles),
            ("mean", "mean", ".2f"),
            ("others", "mean of tiles not marked", ".2f"),
        ]
        table = []
        for method in methods:
            values = {tile: by[tile, method][key] for tile in tiles if (tile, method) in by}
            line: Row = {"method": method, **values, "mean": float(np.mean(list(values.values())))}
            if SHARED.get(method) in values and len(values) > 1:
                line["others"] = float(np.mean([v for tile, v in values.items() if tile != SHARED[method]]))
                line["method"] = f"{method} {MARK} {SHARED[method]}"
            table.append(line)
        text += [f"## {title}", "", markdown(columns, table), ""]
    return "\n".join([*text, "![Total error of every method on every tile](totals.png)", ""])


def heat(rows: list[Row], path: Path) -> None:
    """Total errors as a table of colours, methods by tiles."""
    from matplotlib.figure import Figure

    tiles = list(dict.fromkeys(row["tile"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    value = np.full((len(methods), len(tiles)), np.nan)
    for row in rows:
        value[methods.index(row["method"]), tiles.index(row["tile"])] = row["total"]
    figure = Figure(figsize=(1.6 + 1.25 * len(tiles), 1.2 + 0.32 * len(methods)), layout="constrained")
    ax = figure.subplots()
    shade = ax.imshow(np.log10(value), cmap="YlOrRd", aspect="auto", vmin=0, vmax=np.log10(40))
    for (i, j), v in np.ndenumerate(value):
        ax.text(j, i, f"{v:.1f}", ha="center", va="center", fontsize=8, color="white" if v > 20 else "black")
    ax.set_xticks(range(len(tiles)), [TILES[tile].replace(", ", ",\n") for tile in tiles], fontsize=8)
    ax.set_yticks(range(len(methods)), [name.upper() for name in methods], fontsize=8)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    bar = figure.colorbar(shade, ax=ax, ticks=np.log10([1, 2, 5, 10, 20, 40]), pad=0.02)
    bar.ax.set_yticklabels(["1", "2", "5", "10", "20", "40"])
    bar.set_label("total error (%)")
    save_png(figure, path, 150)


def _parser() -> CommandLine:
    parser = CommandLine(__file__, __doc__)
    parser.add_argument(
        "--tiles", nargs="+", choices=TILES, default=list(TILES), metavar="TILE", help=f"of {', '.join(TILES)}"
    )
    names = spaces.method_names()
    parser.add_argument(
        "--methods", nargs="+", choices=names, default=names, metavar="METHOD", help=f"of {', '.join(names)}"
    )
    return parser


if __name__ == "__main__":
    main()
