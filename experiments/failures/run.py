"""Where methods fail: terrain along borders and inside, cuts through clouds, the place of the grid, and named places. See
README.md.

    python experiments/failures/run.py measures
    python experiments/failures/run.py cuts --methods ost smrf --count 200
    python experiments/failures/run.py places --methods ost
    python experiments/failures/run.py spots --methods ost

Every row is kept in a file of ``--out`` and not made again; ``--fresh`` makes the rows of the given methods anew.
"""

from __future__ import annotations

import argparse
import dataclasses
import shlex
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.defaults.clouds import Known, tile
from experiments.failures import cuts, pages, places, spots
from experiments.isprs import samples
from experiments.remake import word
from experiments.report import Row, read_csv, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.core.points import canonical_points
from jaxfilter.scoring import reference_labels

HERE = Path(__file__).parent
JUNGLE = dataclasses.replace(jf.scenes.LAYOUTS["canopy"], tilt=0.6, forest=0.95, penetration=0.01)
"""Forest on a slope of 31 degrees: of the pulses that meet a crown a hundredth reaches the ground. OST's rule for seeds on plants
was found on such forests of other seeds; its part for sparse clouds with this one in view."""
LAYOUTS = jf.scenes.LAYOUTS | {"jungle": JUNGLE}
SCENES = ("coast", "gorge", "benches", "vineyard", "canopy", "jungle")
SIZES = {0.5: (400.0, 300.0), 2.0: (400.0, 300.0), 8.0: (400.0, 160.0)}
"""Extents in metres by density in pulses per square metre."""
METHODS = {"measures": tuple(jf.FILTERS), "cuts": ("ost", "smrf"), "places": ("ost", "smrf", "pmf"), "spots": ("ost",)}
"""Methods of each part, where none are named."""
SEED, SWATH = 101, 250.0
FILLED = jf.Interpolation(fill=True)
"""Every cell has a height, so that none is left out where ground was lost."""


def main(arguments: list[str] | None = None) -> None:
    """Run one part, or all, and write the page."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    folder = samples.data_folder(options.data)
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    options.out.mkdir(parents=True, exist_ok=True)
    known = list(names(folder, options.clouds))
    if options.part in ("measures", "all"):
        table = Rows(options.out / "measures.csv", options)
        for name, method in table.open(known, options.methods or METHODS["measures"]):
            table.add(measured(load(folder, name), method))
    if options.part in ("cuts", "all"):
        table = Rows(options.out / "cuts.csv", options)
        known = [name for name in known if not name.endswith((" 0.5", " 8"))]
        share = -(-options.count // max(len(known), 1))
        for name, method in table.open(known, options.methods or METHODS["cuts"], share):
            table.add(*cuts.rows(load(folder, name), method, share))
    if options.part in ("places", "all"):
        table = Rows(options.out / "places.csv", options)
        for number, method in table.open(options.samples, options.methods or METHODS["places"], options.places):
            table.add(*places.rows(samples.sample_path(folder, number), number, method, options.places))
    if options.part in ("spots", "all"):
        table = Rows(options.out / "spots.csv", options)
        every = [*spot_names(folder, options.clouds), *(f"samp{number}" for number in options.samples)]
        for name, method in table.open(every, options.methods or METHODS["spots"]):
            table.add(*spots.rows(load(folder, name), method))
    if options.part == "fit":
        clouds = (load(folder, name) for name in spot_names(folder, options.clouds))
        print(spots.fitted((known, jf.default_filter(known.cloud)(known.cloud)) for known in clouds).round(2).tolist())
    command = shlex.join(["python", "experiments/failures/run.py", *given])
    tables = {
        part: read_csv(path)
        for part in ("measures", "cuts", "places", "spots")
        if (path := options.out / f"{part}.csv").exists()
    }
    behind = {row["method"] for rows in tables.values() for row in rows}
    write_page(options.out / "results.md", pages.page(tables), command, (*behind, "scenes"))
    print(f"results are in {options.out}")


class Rows:
    """Rows of a file, which is written after each addition."""

    def __init__(self, path: Path, options: argparse.Namespace) -> None:
        """Without rows of other labels than now; with ``options.fresh``, without those of its clouds and methods."""
        self._path = path
        rows = read_csv(path) if path.exists() else []
        self._rows: list[Row] = [row for row in rows if row.get("labels") == word(row["method"])]
        if options.fresh:
            self._rows = [
                row
                for row in self._rows
                if row["method"] not in (options.methods or jf.FILTERS) or not _wanted(row["cloud"], options.clouds)
            ]

    def open(self, clouds: list[str], methods: list[str], count: int = 1) -> Iterator[tuple[str, str]]:
        """Clouds and methods with fewer rows than ``count``; what they have is dropped."""
        for cloud in clouds:
            for method in methods:
                own = [row for row in self._rows if (str(row["cloud"]), row["method"]) == (cloud, method)]
                if len(own) < count:
                    self._rows = [row for row in self._rows if row not in own]
                    print(self._path.stem, cloud, method, file=sys.stderr, flush=True)
                    yield cloud, method

    def add(self, *rows: Row) -> None:
        """Keep further rows."""
        self._rows += [
            {key: _short(value) for key, value in row.items()} | {"labels": word(row["method"])} for row in rows
        ]
        write_csv(self._path, self._rows)


def names(folder: Path, only: list[str]) -> Iterator[str]:
    """Tiles, hard tiles, and scenes with their density."""
    for part in ("tiles", "tiles_hard"):
        yield from (path.stem for path in sorted((folder / part).glob("*.la[sz]")) if _wanted(path.stem, only))
    yield from (name for density in SIZES for layout in SCENES if _wanted(name := f"{layout} {density:g}", only))


def _short(value: object) -> object:
    return float(f"{value:.5g}") if isinstance(value, float) else value


def spot_names(folder: Path, only: list[str]) -> list[str]:
    """Tiles, hard tiles, and all scenes at 2 pulses per m2: what the places that are named are calibrated on."""
    files = [name for name in names(folder, only) if " " not in name]
    return files + [name for layout in jf.scenes.LAYOUTS if _wanted(name := f"{layout} 2", only)]


def _wanted(name: object, only: list[str]) -> bool:
    return not only or any(str(name).startswith(one) for one in only)


def load(folder: Path, name: str) -> Known:
    """A cloud of :func:`names`. Of scenes last echoes are filtered and scored."""
    layout, _, density = name.partition(" ")
    if name.startswith("samp"):
        cloud = jf.read(samples.sample_path(folder, name[4:]))
        return Known(name, "samples", cloud, *reference_labels(cloud))
    if layout in LAYOUTS:
        scene = jf.scenes.make(
            LAYOUTS[layout], size=SIZES[float(density)], density=float(density), seed=SEED, swath=SWATH
        )
        return Known(name, "scenes", scene.cloud, scene.truth, scene.cloud.candidate)
    group, path = next(
        (part, path) for part in ("tiles", "tiles_hard") for path in (folder / part).glob(f"{name}.la[sz]")
    )
    return tile(name, "hard tiles" if group == "tiles_hard" else group, path)


def measured(known: Known, method: str) -> Row:
    """Scores and terrain errors of a method as ``for_cloud`` gives it."""
    cloud = known.cloud
    row: Row = {"cloud": known.name, "kind": known.group, "method": method, "points": len(cloud)}
    start = time.process_time()
    try:
        result = jf.FILTERS[method].for_cloud(cloud)(cloud)
        row["seconds"] = time.process_time() - start
        errors = jf.dtm_rmse(cloud, result, known.ground, interpolation=FILLED)
    except jf.JaxfilterError as error:
        return row | {"status": f"{type(error).__name__}: {error}"}
    scores = jf.evaluate(result, known.ground, ignore=~known.scored)
    row |= {"density": 1 / canonical_points(cloud).spacing() ** 2, "type1": scores.type1, "type2": scores.type2}
    return row | {"total": scores.total, "kappa": scores.kappa, **errors.as_dict(), "status": result.status.name}


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["measures", "cuts", "places", "spots", "fit", "all", "page"])
    parser.add_argument("--data", type=Path, help="folder with isprs/, tiles/ and tiles_hard/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument(
        "--methods", nargs="+", choices=list(jf.FILTERS), metavar="METHOD", help="[as many as the part has time for]"
    )
    parser.add_argument(
        "--clouds", nargs="*", default=[], metavar="NAME", help="begins of names, such as coast or ign_mnx"
    )
    parser.add_argument(
        "--samples",
        type=samples.sample_name,
        nargs="+",
        default=list(samples.SAMPLES),
        metavar="NUMBER",
        help="of places",
    )
    parser.add_argument("--count", type=int, default=200, help="cuts of all clouds together [%(default)s]")
    parser.add_argument("--places", type=int, default=16, help="places of the grid [%(default)s]")
    parser.add_argument("--fresh", action="store_true", help="make the rows of the methods and clouds anew")
    return parser


if __name__ == "__main__":
    main()
