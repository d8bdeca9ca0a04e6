"""Fits by gradient beside searches of equal cost, on the ISPRS samples with each site left out in turn. See README.md."""

from __future__ import annotations

import argparse
import copy
import math
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Row, markdown, read_csv, save_png, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations
from jaxfilter.sweeps.best import best_sets
from jaxfilter.sweeps.ranges import search_ranges

HERE = Path(__file__).parent
SETS = {"smrf": {"calibrate": 44, "random": 48}, "pmf": {"calibrate": 40, "random": 52}}
"""Sets that a search tries, so that it takes about as long as a fit."""
WAYS = {"start": "start", "fit": "`fit`", "calibrate": "`calibrate`", "random": "random search"}


def main(arguments: list[str] | None = None) -> None:
    """Run what is not in ``runs.csv`` yet, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument("--samples", nargs="+", type=samples.sample_name, default=samples.SAMPLES, metavar="SAMPLE")
    parser.add_argument("--methods", nargs="+", choices=SETS, default=list(SETS), metavar="METHOD")
    parser.add_argument("--steps", type=int, default=16, help="of each fit [%(default)s]")
    parser.add_argument("--fresh", action="store_true", help="run everything anew")
    given = sys.argv[1:] if arguments is None else arguments
    options = parser.parse_args(given)
    keep_compilations()
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "runs.csv"
    rows = read_csv(path) if path.exists() and not options.fresh else []
    folder = samples.data_folder(options.data)
    clouds = {f"samp{number}": jf.read(samples.sample_path(folder, number)) for number in options.samples}
    sites = sorted({name[4] for name in clouds})
    for method in options.methods:
        missing = [
            site for site in sites if not any((row["method"], str(row["site"])) == (method, site) for row in rows)
        ]
        searches = _Searches(method, clouds) if missing else None
        for site in missing:
            seen = {name: cloud for name, cloud in clouds.items() if name[4] != site}
            rows += _left_out(method, site, seen, clouds, searches, options)
            write_csv(path, rows)
    command = shlex.join(["python", "experiments/fits/run.py", *given])
    write_page(options.out / "results.md", page(rows), command, {row["method"] for row in rows})
    print(f"results are in {options.out}")


def _left_out(
    method: str,
    site: str,
    seen: dict[str, jf.PointCloud],
    clouds: dict[str, jf.PointCloud],
    searches: _Searches,
    options: Any,
) -> list[Row]:
    """A row for each way to parameters and each sample of the site that no way has seen."""
    start = jf.FILTERS[method]()
    begin = time.process_time()
    found = jf.fit(
        start,
        seen,
        groups={name: name[4] for name in seen},
        validation=jf.CrossValidation(3),
        steps=options.steps,
    )
    seconds = time.process_time() - begin
    print(f"{method}, without site {site}: {found}, {seconds:.0f} CPU s", file=sys.stderr, flush=True)
    ax = jf.plots.fit_curves(found, title=f"{method.upper()}, without site {site}")
    save_png(ax.figure, options.out / f"{method}_{site}.png", 110)
    ways = {
        "start": (start, 0.0),
        "fit": (found.filter, seconds),
        "calibrate": searches.calibrate(list(seen)),
        "random": searches.random(list(seen)),
    }
    rows = []
    for way, (filter_, cost) in ways.items():
        values = {name: getattr(filter_, name) for name in search_ranges(start)}
        for name in (name for name in clouds if name not in seen):
            total = jf.evaluate(filter_(clouds[name]), clouds[name]).total
            row: Row = {"method": method, "site": site, "way": way, "sample": name, "total": total, "cpu_seconds": cost}
            row["parameters"] = " ".join(f"{field}={value:.4g}" for field, value in values.items())
            rows.append(row | {"moved": filter_ != start})
    return rows


class _Searches:
    """Searches over the same ranges. What does not depend on the site that is left out is done once, and its time is
    counted for each cloud."""

    def __init__(self, method: str, clouds: dict[str, jf.PointCloud]) -> None:
        self.start, self.size = jf.FILTERS[method](), SETS[method]["calibrate"]
        self.ranges = search_ranges(self.start)
        drawn = self._sets(np.random.default_rng(0).random((SETS[method]["random"], len(self.ranges))))
        first = self._sets(_sobol(self.size // 2, len(self.ranges)))
        first[0] = {name: getattr(self.start, name) for name in self.ranges}
        self.swept, self.studies, self.cost = {}, {}, {}
        axes = {field: [one[field] for one in drawn] for field in self.ranges}
        for name, cloud in clouds.items():
            jf.sweep(self.start, cloud, axes, design="list")  # compiles
            self.swept[name], swept = _timed(lambda: jf.sweep(self.start, cloud, axes, design="list"))  # noqa: B023
            study = jf.Study(self.start, cloud, cloud.reference)
            self.studies[name], tried = study, _timed(lambda: study.evaluate(first))[1]  # noqa: B023
            self.cost[name] = swept, tried

    def _sets(self, unit: np.ndarray) -> list[dict[str, float]]:
        return [{name: r.at(u) for u, (name, r) in zip(row, self.ranges.items(), strict=True)} for row in unit]

    def random(self, names: list[str]) -> tuple[jf.Filter, float]:
        """The set with the best mean total error."""
        total = np.mean([self.swept[name]["total"].values for name in names], axis=0)
        best = best_sets(self.swept[names[0]].assign(total=("set", total)), count=1)[list(self.ranges)].to_dict(
            "records"
        )
        return self.start.replace(**best[0]), sum(self.cost[name][0] for name in names)

    def calibrate(self, names: list[str]) -> tuple[jf.Filter, float]:
        """Two rounds as of ``jf.calibrate``, judged by the mean over the clouds of the scores to expect."""
        studies = [copy.copy(self.studies[name]) for name in names]
        for study in studies:
            study.sets = list(study.sets)

        def judged() -> dict[str, float]:
            score = np.mean([study.expected()[0] for study in studies], axis=0)
            return studies[0].sets[int(np.argmin(score))]

        def second_round() -> None:
            best = judged()
            centre = np.array([r.position(best[name]) for name, r in self.ranges.items()])
            low = np.clip(centre - 0.125, 0, 0.75)
            sets = self._sets(low + 0.25 * _sobol(self.size - self.size // 2, len(self.ranges), 1))
            for study in studies:
                study.evaluate(sets)

        seconds = _timed(second_round)[1]
        return self.start.replace(**judged()), seconds + sum(self.cost[name][1] for name in names)


def _sobol(size: int, fields: int, turn: int = 0) -> np.ndarray:
    return qmc.Sobol(fields, rng=np.random.default_rng([0, turn])).random_base2(math.ceil(math.log2(size)))[:size]


def _timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """What a call gives, and its CPU seconds."""
    begin = time.process_time()
    return call(), time.process_time() - begin


def page(rows: list[Row]) -> str:
    """The results as Markdown."""
    ways = ("calibrate", "random")
    tried = {way: " and ".join(f"{n[way]} sets of {m.upper()}" for m, n in SETS.items()) for way in ways}
    text = [
        "# Fits by gradient, beside searches",
        "Each site of the ISPRS samples is left out in turn. Parameters are found on the samples of the other sites, from the "
        "method's defaults and within the same ranges, and the samples of the site are scored with them: total error, percent. "
        "`fit` holds out thirds of the other sites to know when to stop, and returns the start where they show no gain above "
        "its standard error. `calibrate` are its two rounds, judged by the mean over the clouds; random search takes the best. "
        f"`calibrate` tries {tried['calibrate']}, random search {tried['random']}, to take about as long as a fit. CPU seconds "
        "are the median of the sites left out, without compilation. SMRF's defaults are those that its authors found best for "
        "all 15 samples together, with their labels: what is found on some of them starts from a set that has seen the rest.",
    ]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    for method in methods:
        of = {way: [row for row in rows if (row["method"], row["way"]) == (method, way)] for way in WAYS}
        start = {row["sample"]: row["total"] for row in of["start"]}
        lines = []
        for way, mine in of.items():
            sites = {str(row["site"]): row for row in mine}
            by = {s: float(np.mean([r["total"] for r in mine if str(r["site"]) == s])) for s in sites}
            change = {
                s: by[s] - float(np.mean([start[r["sample"]] for r in mine if str(r["site"]) == s])) for s in sites
            }
            lines.append({
                "way": WAYS[way], **by, "mean": float(np.mean([row["total"] for row in mine])),
                "difference": float(np.mean([row["total"] - start[row["sample"]] for row in mine])),
                "moved": f"{sum(str(row['moved']) == 'True' for row in sites.values())} of {len(sites)}",
                "better": f"{sum(c < 0 for c in change.values())} / {sum(c > 0 for c in change.values())}",
                "cpu": float(np.median([row["cpu_seconds"] for row in sites.values()])),
            })  # fmt: skip
        columns = [("way", "parameters", ""), *((s, f"site {s}", ".2f") for s in sites), ("mean", "mean of samples", ".2f"),
                   ("difference", "less start", "+.2f"), ("moved", "sites where it moved", ""),
                   ("better", "sites better / worse", ""), ("cpu", "CPU s", ".0f")]  # fmt: skip
        fits = [
            {"site": row["site"], "parameters": row["parameters"]} for row in {r["site"]: r for r in of["fit"]}.values()
        ]
        pictures = "\n".join(
            f"![Curves of the fit of {method.upper()} without site {s}]({method}_{s}.png)" for s in sites
        )
        text += [f"## {method.upper()}", markdown(columns, lines), "What `fit` returned:",
                 markdown([("site", "site left out", ""), ("parameters", "parameters", "")], fits), pictures]  # fmt: skip
    return "\n\n".join(text) + "\n"


if __name__ == "__main__":
    main()
