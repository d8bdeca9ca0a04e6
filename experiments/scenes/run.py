"""What methods do on labelled tiles and on scenes: terrain that is hard, other sensors, halls, dikes, water, cuts, named places.

    python experiments/scenes/run.py [--only halls "coast 2" ...]

Rows are kept in files of ``--out``: only those that are missing, or of other labels than the code's, are made. See README.md.
"""

from __future__ import annotations

import resource
import sys
import time
import warnings
from functools import partial
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
from jaxfilter.plots.maps import GROUND_COLOUR, new_figure

HERE = Path(__file__).parent
PICTURES = HERE.parents[1] / "docs" / "static"
PROFILES = {"odmsem3d_brighton_small": 0.25, "rf4pcc_test": 0.27, "sea_cliff": 0.5, "spanner_UAS": 0.5}
"""Clouds that are drawn for docs/sensors.md with the ground of OST, and at which share of their extent from the south."""


def main(arguments: list[str] | None = None) -> None:
    """Make what is missing, and write the page."""
    options = search.options(__file__, __doc__, arguments)
    declared = {one.name: one for one in clouds.every(samples.data_folder(options.data))}
    order = {name: number for number, name in enumerate(declared)}
    words = {name: word(name) for name in (*jf.FILTERS, SCENES)}

    def labels(row: Row) -> str | None:
        """By which a row is kept: the word of its method, and that of the simulator if it has made the cloud."""
        cloud = declared.get(row["cloud"])
        return cloud and words.get(row["method"], "") + f"-{words[SCENES]}" * cloud.simulated

    tables: dict[str, list[Row]] = {}
    for measure in MEASURES:
        rows = read_csv(path) if (path := options.out / f"{measure}.csv").exists() else []
        tables[measure] = [row for row in rows if row["labels"] == labels(row)]
    have = {(measure, row["method"], row["cloud"]) for measure, rows in tables.items() for row in rows}
    chosen = [one for one in declared.values() if not options.only or {one.kind, one.name} & {*options.only}]
    todo = [(one, [pair for pair in one.measured if (*pair, one.name) not in have]) for one in chosen]
    tasks = [task for task in todo if task[1]]
    drawing = partial(work, PICTURES if options.out.resolve() == HERE / "results" else options.out)
    for number, ((cloud, _), rows) in enumerate(search.results(drawing, tasks, options.processes), 1):
        for row in rows:
            own = {"kind": cloud.kind, "cloud": cloud.name, "method": row["method"]} | cloud.facts
            tables[row.pop("measure")].append(own | row | {"labels": labels(own)})
        for measure, known in tables.items():
            known.sort(key=lambda row: (order[row["cloud"]], row["method"]))
            write_csv(options.out / f"{measure}.csv", known)
        print(f"{number} of {len(tasks)} clouds", file=sys.stderr, flush=True)
    write_page(options.out / "results.md", page.page(tables), options.command, words, keeps=True)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    print(f"results are in {options.out}, {sum(one.ru_utime + one.ru_stime for one in used):,.0f} s of processors")


def work(pictures: Path, cloud: clouds.Cloud, todo: list[tuple[str, str]]) -> list[Row]:
    """Rows of a cloud, each with its measure and method; ``todo``: measures and methods. Drawings go into ``pictures``."""
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
        draw(site, results["ost"], PROFILES[cloud.name], pictures / f"sensors_{cloud.name.partition('_')[0]}.png")
    print(f"{cloud.name}: {time.process_time() - start:.0f} s of a processor", file=sys.stderr, flush=True)
    return [{key: float(f"{v:.5g}") if isinstance(v, float) else v for key, v in row.items()} for row in rows]


def draw(site: clouds.Site, result: jf.FilterResult, share: float, path: Path) -> None:
    """A map and a section of a cloud with its ground, as a small picture."""
    figure = new_figure((11, 3.6))
    plan, section = figure.subplots(1, 2, width_ratios=(1, 2.2))
    xy = site.cloud.xyz[:, :2]
    (left, south), (right, north) = xy.min(axis=0), xy.max(axis=0)
    y, some = south + share * (north - south), slice(None, None, max(1, len(xy) // 60_000))
    plan.scatter(*xy[some].T, s=0.3, c=np.where(result.ground, GROUND_COLOUR, "0.7")[some])
    plan.axhline(y, color="k", lw=0.5)
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    width = 2.0 if right - left > 200 else 0.5
    jf.plots.profile(site.cloud, result, ((left, y), (right, y)), width, ax=section, title=str(result.info["sensor"]))
    save_png(figure, path, 75)


if __name__ == "__main__":
    main()
