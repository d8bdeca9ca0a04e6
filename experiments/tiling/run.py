"""Collections in tiles: labels against the whole, memory and time, a cluster, and a country of files. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.isprs.search import results
from experiments.report import Column, Row, markdown, write_csv, write_page
from experiments.tiling import costs, labels
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
LARGE = {"IGN, village": "ign_semis_2023_0292_6833", "IGN, river and bridge": "ign_bridge_0299_6802"}
"""Labelled tiles of 1 km2. All others are at most 300 m wide: with a halo of 240 m most windows hold the whole of them."""
SIMULATED = (("mixed", 1000, 0.5), ("mountain", 2000, 0.2))
"""Layout, side in metres, and pulses per square metre."""
HALOS = (0.0, 15.0, 30.0, 60.0, 120.0)

Page = tuple[list[Row], str]
"""Rows of the CSV file, and the page as Markdown, with its title."""


def main(arguments: list[str] | None = None) -> None:
    """Run the parts asked for and write their tables."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    options.out.mkdir(parents=True, exist_ok=True)
    options.work.mkdir(parents=True, exist_ok=True)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    asked = [word for word in given if word not in PARTS]
    for part in options.parts:
        rows, text = PARTS[part](options)
        write_csv(options.out / f"{part}.csv", rows)
        command = shlex.join(["python", "experiments/tiling/run.py", part, *asked])
        behind = (*options.methods, "scenes") if part in ("labels", "halos") else ()
        write_page(options.out / f"{part}.md", text, command, behind)
    print(f"results are in {options.out}")


def _labels(options: argparse.Namespace) -> Page:
    folder = samples.data_folder(options.data) / "tiles"
    surveys = {title: tuple(folder.glob(f"{name}.la[sz]")) for title, name in LARGE.items()}
    for layout, side, density in SIMULATED:
        paths = labels.generated(options.work, side, 4, density, layout)
        surveys[f"simulated, {layout}, {side / 1000:g} km"] = tuple(paths)
    tasks = [
        (name, paths, method, 4, (None,), options.work) for name, paths in surveys.items() for method in options.methods
    ]
    rows = _measured(tasks)
    points = {row["survey"]: row["points"] for row in rows}
    table: list[Row] = []
    for method in options.methods:
        own = [row for row in rows if row["method"] == method]
        halos = dict.fromkeys(f"{halo(row['halo'] for row in own):.0f}" for halo in (min, max))
        differ = {row["survey"]: row["differ"] for row in own}
        table.append({"method": method.upper(), "halo": " to ".join(halos), **differ})
    columns: list[Column] = [("method", "method", ""), ("halo", "default halo, m", "")]
    columns += [(name, f"{name}, {points[name]:,} points", ",d") for name, paths in surveys.items()]
    tiles, seen = ([row[key] for row in rows] for key in ("tiles", "seen"))
    text = (
        "# Labels of tiles and of the whole, default halo\n\nPoints whose label in tiles is not that in the whole. Each survey "
        f"is cut into {min(tiles)} to {max(tiles)} tiles, of which the median sees {min(seen):.0%} to {max(seen):.0%} of all "
        "points. `labels.csv` has the total errors, and how far they move."
    )
    return rows, f"{text}\n\n{markdown(columns, table)}"


def _halos(options: argparse.Namespace) -> Page:
    paths = tuple(labels.generated(options.work, options.small, 3, 1.0))
    rows = _measured([("9 files", paths, method, 3, HALOS, options.work) for method in options.methods])
    labels.draw(rows, options.out / "halos.png")
    table: list[Row] = []
    for method in options.methods:
        differ = {f"{row['halo']:g}": row["differ"] for row in rows if row["method"] == method}
        table.append({"method": method.upper(), "own": jf.FILTERS[method]().halo(), **differ})
    columns: list[Column] = [("method", "method", ""), ("own", "default halo, m", ".0f")]
    columns += [(f"{halo:g}", f"{halo:g} m", ",d") for halo in HALOS]
    title = f"Labels that differ from those of the whole, of {rows[0]['points']:,}, in tiles of about {options.small / 3:g} m"
    return rows, f"# {title}, by halo\n\n{markdown(columns, table)}"


def _measured(tasks: list[tuple]) -> list[Row]:
    """The rows of :func:`labels.rows` for tasks, in their order."""
    found = {}
    for task, rows in results(labels.rows, tasks, 2):
        found[task] = rows
        print(f"{len(found)}/{len(tasks)}: {task[2]}, {task[0]}: {[row['differ'] for row in rows]} differ", flush=True)
    return [row for task in tasks for row in found[task]]


PARTS = {
    "labels": _labels, "halos": _halos, "scale": costs.scale, "cluster": costs.cluster,
    "country": costs.country, "tiles": costs.collection,
}  # fmt: skip


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=list(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--data", type=Path, help="folder with tiles/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    parser.add_argument("--work", type=Path, default=HERE / "out", help="folder for what is generated [%(default)s]")
    names = list(jf.FILTERS)
    parser.add_argument(
        "--methods", nargs="+", default=names, choices=names, metavar="METHOD", help="for labels, halos"
    )
    parser.add_argument("--small", type=int, default=300, help="metres, for halos and cluster [%(default)s]")
    parser.add_argument("--files", type=int, nargs="+", default=[3, 7, 14, 27], help="for scale %(default)s")
    parser.add_argument(
        "--densities", type=float, nargs="+", default=[2.0, 10.0], help="per m2, for country %(default)s"
    )
    parser.add_argument("--millions", type=float, default=4.0, help="points of each file, for country [%(default)s]")
    parser.add_argument("--costs", nargs="+", default=["ost", "smrf", "fptd"], choices=names, help="for country")
    return parser


if __name__ == "__main__":
    main()
