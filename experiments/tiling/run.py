"""Collections in tiles: labels against the whole, memory and time, kills, a cluster, and a million tiles. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
import warnings
from pathlib import Path

import laspy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Column, Row, markdown, write_csv, write_page
from experiments.tiles.run import TILES
from experiments.tiling import country, labels, robustness, scale
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.reports.places import REASONS

HERE = Path(__file__).parent
PARTS = ("labels", "halos", "border", "scale", "kills", "cluster", "tasks", "country", "tiles")
BEHIND = {part: lambda options: () for part in PARTS} | {
    part: lambda options: (*options.methods, "scenes") for part in ("labels", "halos", "border")
}
"""Methods whose labels a part counts. The others measure time and memory, or compare files."""
LARGE = ("ign_semis_2023_0292_6833", "ign_bridge_0299_6802")
"""Labelled tiles of 1 km2. All others are at most 300 m wide: with a halo of 240 m most windows hold the whole of them."""
HALOS = (0.0, 15.0, 30.0, 60.0, 120.0)


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
        rows, columns, text = _WAYS[part](options)
        write_csv(options.out / f"{part}.csv", rows)
        command = shlex.join(["python", "experiments/tiling/run.py", part, *asked])
        write_page(options.out / f"{part}.md", f"# {text}\n\n{markdown(columns, rows)}", command, BEHIND[part](options))
    print(f"results are in {options.out}")


def generated(folder: Path, side: int, files: int, density: float, layout: str = "mixed") -> list[Path]:
    """``files`` times ``files`` LAZ files of a simulated scene of ``side`` metres, with the truth as classes."""
    name = folder / f"{layout}-{side}-{files}-{density:g}"
    paths = [name / f"{i}-{j}.laz" for i in range(files) for j in range(files)]
    if all(path.exists() for path in paths):
        return paths
    name.mkdir(parents=True, exist_ok=True)
    scene = jf.scenes.make(layout, size=float(side), density=density, seed=7)
    xyz, cloud = scene.cloud.coordinates(), scene.cloud
    cell = np.minimum((xyz[:, :2] - scene.cloud.origin[:2]) // (side / files), files - 1).astype(int)
    for path, number in zip(paths, np.ndindex(files, files), strict=True):
        rows = np.flatnonzero((cell == number).all(axis=1))
        las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
        las.header.scales, las.header.offsets = np.full(3, 0.01), np.floor(xyz.min(axis=0))
        las.x, las.y, las.z = xyz[rows].T
        las.return_number, las.number_of_returns = cloud.return_number[rows], cloud.number_of_returns[rows]
        las.classification = scene.classes[rows]
        las.write(path)
    return paths


def _labels(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    rows: list[Row] = []
    folder = samples.data_folder(options.data) / "tiles"
    for name in LARGE:
        one = labels.survey(name, [next(folder.glob(f"{name}.la[sz]"))])
        rows += labels.rows(one, options.methods, 4, [None], options.work)
    for layout, side, density in (("mixed", options.side, 1.0), ("mountain", 2 * options.side, 0.3)):
        files = generated(options.work, side, 4, density, layout)
        one = labels.survey(f"simulated, {layout}, {side} m", files)
        rows += labels.rows(one, options.methods, 4, [None], options.work)
    return rows, _LABELS, "Labels of tiles and of the whole, default halo"


def _halos(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    one = labels.survey("generated, 9 files", generated(options.work, options.small, 3, 1.0))
    rows = list(labels.rows(one, options.methods, 3, options.halos, options.work))
    labels.draw(rows, options.out / "halos.png")
    table: list[Row] = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        table.append(
            {"method": method, "own": jf.FILTERS[method]().halo(), **{f"{r['halo']:g}": r["differ"] for r in own}}
        )
    write_csv(options.out / "halos-all.csv", rows)
    columns: list[Column] = [("method", "method", ""), ("own", "default halo, m", ".0f")]
    columns += [(f"{halo:g}", f"{halo:g} m", ",d") for halo in options.halos]
    side = options.small / 3
    text = f"Labels that differ from those of the whole, of {len(one.cloud):,}, in tiles of about {side:g} m, by halo"
    return table, columns, text


def _border(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    rows: list[Row] = []
    folder = samples.data_folder(options.data) / "tiles"
    for name in TILES:
        cloud = jf.read(next(folder.glob(f"{name}.la[sz]")), units="m")
        row: Row = {"survey": name, "reference": _cut(cloud, cloud.classification == 2)}
        for method in options.methods:
            result = jf.FILTERS[method].for_cloud(cloud)(cloud)
            start = time.perf_counter()
            row[method] = _cut(cloud, result)
            row["seconds"] = time.perf_counter() - start
        rows.append(row)
        print(row, file=sys.stderr, flush=True)
    columns: list[Column] = [("survey", "survey", ""), ("reference", "by reference", "d")]
    columns += [(method, f"by {method.upper()}", "d") for method in options.methods]
    columns.append(("seconds", "seconds to find them", ".2f"))
    return rows, columns, "Places named as canopies or roofs cut by the edge of the data"


def _cut(cloud: jf.PointCloud, result: jf.FilterResult | np.ndarray) -> int:
    """How many places are named as cut."""
    return int((jf.review(cloud, result)["reason"] == REASONS[0]).sum())


_LABELS: list[Column] = [
    ("survey", "survey", ""), ("method", "method", ""), ("points", "points", ",d"), ("tiles", "tiles", "d"),
    ("partial", "that see but a part", "d"), ("seen", "of all points, median", ".0%"), ("halo", "halo, m", ".0f"),
    ("differ", "labels that differ", ",d"), ("share", "share", ".5%"),
    ("total", "total error of the whole, %", ".3f"), ("moved", "moved by, points", "+.3f"),
]  # fmt: skip
_WAYS = {
    "labels": _labels,
    "halos": _halos,
    "border": _border,
    "scale": scale.table,
    "kills": robustness.kills,
    "cluster": robustness.cluster,
    "tasks": robustness.tasks,
    "country": country.table,
    "tiles": country.collection,
}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=PARTS, help=f"of {', '.join(PARTS)}")
    parser.add_argument("--data", type=Path, help="folder with tiles/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    parser.add_argument("--work", type=Path, default=HERE / "out", help="folder for what is generated [%(default)s]")
    parser.add_argument("--methods", nargs="+", default=list(jf.FILTERS), choices=list(jf.FILTERS), metavar="METHOD")
    parser.add_argument("--side", type=int, default=1000, help="of the generated survey, metres [%(default)s]")
    parser.add_argument(
        "--files", type=int, nargs="+", default=[3, 7, 14, 27], help="of 3.7 million points each, for scale"
    )
    parser.add_argument("--small", type=int, default=600, help="the same for halos, kills and cluster [%(default)s]")
    parser.add_argument("--halos", type=float, nargs="+", default=HALOS, help="metres, for halos [%(default)s]")
    parser.add_argument(
        "--tasks", type=int, nargs="+", default=[1000, 10_000, 100_000], help="empty ones, for tasks [%(default)s]"
    )
    parser.add_argument(
        "--densities", type=float, nargs="+", default=[0.5, 2.0, 5.0, 10.0, 20.0], help="points per m2, for country"
    )
    parser.add_argument("--millions", type=float, default=6.0, help="points of each file, for country [%(default)s]")
    parser.add_argument(
        "--costs",
        nargs="+",
        default=["ost", "smrf", "fptd", "ptd", "csf"],
        choices=list(jf.FILTERS),
        metavar="METHOD",
        help="for country",
    )
    parser.add_argument("--trials", type=int, default=30, help="kills [%(default)s]")
    return parser


if __name__ == "__main__":
    main()
