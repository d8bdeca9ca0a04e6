"""What methods do on labelled tiles and on scenes: terrain that is hard, other sensors, halls, dikes, water, cuts, named places.

    python experiments/scenes/run.py [--only halls "coast 2" ...]

Rows are kept in files of ``--out``: only those that are missing, or of other labels than the code's, are made. See README.md.
"""

from __future__ import annotations

import argparse
import resource
import shlex
import sys
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, search
from experiments.remake import SCENES, word
from experiments.report import Row, read_csv, save_png, write_csv, write_page
from experiments.scenes import clouds, page
from experiments.scenes.measures import MEASURES
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
PICTURES = HERE.parents[1] / "docs" / "static"
PROFILES = {"odmsem3d_brighton_small": 0.25, "rf4pcc_test": 0.27, "sea_cliff": 0.5, "spanner_UAS": 0.5}
"""Clouds that are drawn for docs/sensors.md with the ground of OST, and at which share of their extent from the south."""


def main(arguments: list[str] | None = None) -> None:
    """Make what is missing, and write the page."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    declared = {one.name: one for one in clouds.every(samples.data_folder(options.data))}
    words = {name: word(name) for name in (*clouds.EVERY, SCENES)}
    options.out.mkdir(parents=True, exist_ok=True)
    tables = {measure: kept(options.out / f"{measure}.csv", declared, words) for measure in MEASURES}
    tasks = []
    for cloud in declared.values():
        if not options.only or {cloud.kind, cloud.name} & {*options.only}:
            have = {
                (measure, row["method"]) for measure in tables for row in tables[measure] if row["cloud"] == cloud.name
            }
            if todo := [one for one in cloud.measured if one not in have]:
                tasks.append((cloud, todo))
    order = [*declared], [*clouds.EVERY]
    for number, ((cloud, _), rows) in enumerate(search.results(work, tasks, options.processes), 1):
        for row in rows:
            mine = {"kind": cloud.kind, "cloud": cloud.name, "method": row["method"]} | cloud.facts
            tables[row.pop("measure")].append(mine | row | {"labels": labels(cloud, row["method"], words)})
        for measure, known in tables.items():
            known.sort(key=lambda row: (order[0].index(row["cloud"]), order[1].index(row["method"])))
            write_csv(options.out / f"{measure}.csv", known)
        print(f"{number} of {len(tasks)} clouds", file=sys.stderr, flush=True)
    command = shlex.join(["python", "experiments/scenes/run.py", *given])
    write_page(options.out / "results.md", page.page(tables), command, words)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(f"results are in {options.out}, {sum(one.ru_utime + one.ru_stime for one in used):,.0f} s of processors")


def kept(path: Path, declared: dict[str, clouds.Cloud], words: dict[str, str]) -> list[Row]:
    """The rows of a file that are of clouds as declared, and of the labels of the code."""
    rows = read_csv(path) if path.exists() else []
    known = [(row, declared[row["cloud"]]) for row in rows if row["cloud"] in declared and row["method"] in words]
    return [row for row, cloud in known if row["labels"] == labels(cloud, row["method"], words)]


def labels(cloud: clouds.Cloud, method: str, words: dict[str, str]) -> str:
    """By which a row is kept: the word of the method, and that of the simulator if it has made the cloud."""
    return words[method] + f"-{words[SCENES]}" * cloud.simulated


def work(cloud: clouds.Cloud, todo: list[tuple[str, str]]) -> list[Row]:
    """Rows of a cloud, each with its measure and method; ``todo``: measures and methods."""
    keep_compilations()
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    start, site, rows, results = time.process_time(), cloud.make(), [], {}
    for measure, method in todo:
        head = {"measure": measure, "method": method}
        try:
            if method not in results:
                results[method] = jf.FILTERS[method].for_cloud(site.cloud)(site.cloud, workers=1)
            rows += [head | row for row in MEASURES[measure](site, method, results[method])]
        except jf.JaxfilterError as error:
            rows.append(head | {"status": f"{type(error).__name__}: {error}"})
    if cloud.name in PROFILES and "ost" in results:
        draw(site, results["ost"], PROFILES[cloud.name], PICTURES / f"sensors_{cloud.name.partition('_')[0]}.png")
    print(
        f"{cloud.kind}, {cloud.name}: {time.process_time() - start:.0f} s of a processor", file=sys.stderr, flush=True
    )
    return [{key: float(f"{v:.5g}") if isinstance(v, float) else v for key, v in row.items()} for row in rows]


def draw(site: clouds.Site, result: jf.FilterResult, share: float, path: Path) -> None:
    """A map and a profile of a cloud with its ground, as a small picture."""
    from matplotlib.figure import Figure

    xyz, colour = site.cloud.xyz, np.where(result.ground, "saddlebrown", "mediumseagreen")
    middle = xyz[:, 1].min() + share * np.ptp(xyz[:, 1])
    near = np.abs(xyz[:, 1] - middle) < (1.0 if np.ptp(xyz[:, 0]) > 200 else 0.25)
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    plan, profile = figure.subplots(1, 2, width_ratios=(1, 2.2))
    some = slice(None, None, max(1, len(xyz) // 60_000))
    plan.scatter(xyz[some, 0], xyz[some, 1], s=0.3, c=colour[some])
    plan.axhline(middle, color="k", lw=0.5)
    plan.set_aspect("equal")
    plan.set(xlabel="easting, m", ylabel="northing, m")
    profile.scatter(xyz[near, 0], xyz[near, 2], s=1, c=colour[near])
    profile.set_title(f"{site.name.partition('_')[0]}: {result.info['sensor']}; brown is ground", fontsize=9)
    profile.set(xlabel="easting, m", ylabel="elevation, m")
    save_png(figure, path, 75)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, help="folder with isprs, tiles, tiles_hard, other_sensors [JAXFILTER_DATA]"
    )
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="kinds of clouds, or clouds")
    parser.add_argument("--processes", type=int, default=2, help="of one thread each [%(default)s]")
    return parser


if __name__ == "__main__":
    main()
