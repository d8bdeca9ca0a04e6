"""What parameters decide: SMRF over four of them on the ISPRS samples. See README.md."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Column, Row, markdown, save_png
from experiments.sensitivity.study import Study
from jaxfilter.core.compilation import keep_compilations

AXES: dict[str, list[float]] = {
    "slope": [0.05, 0.1, 0.15, 0.2, 0.3, 0.45], "threshold": [0.2, 0.35, 0.5, 0.75, 1.0],
    "scaling": [0.0, 0.6, 1.25, 2.0, 3.0], "window": [6.0, 12.0, 18.0, 30.0],
}  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Run the sweep, and write tables and figures."""
    study = Study("run", __doc__, arguments)
    keep_compilations()
    clouds = study.clouds()
    data = jf.sweep(jf.SMRF(), clouds, AXES, votes=True)
    best = data.total.mean("cloud").stack(set=list(AXES))
    best = best.isel(set=int(best.values.argmin()))
    given_set = {name: getattr(jf.SMRF(), name) for name in AXES}
    rows = [parameter(name, data, given_set, best) for name in AXES]
    votes = [disputed(name, cloud, data) for name, cloud in clouds.items()]
    at_given = float(data.total.mean("cloud").sel(**given_set, method="nearest"))
    columns: list[Column] = [
        ("parameter", "parameter", ""), ("given", "given", "g"), ("best", "in the best set", "g"),
        ("range", "largest change, others as given, points", ".2f"), ("gain", "gained by it alone", ".2f"),
        ("envelope", "largest change, others at their best", ".2f"),
    ]  # fmt: skip
    of_votes: list[Column] = [
        ("sample", "sample", ""), ("default", "default, total error, %", ".2f"), ("best", "best set, %", ".2f"),
        ("disputed", "disputed, %", ".1f"), ("errors", "of the errors, %", ".1f"), ("always", "never right, %", ".2f"),
    ]  # fmt: skip
    text = [
        "# What the parameters decide",
        f"SMRF with {np.prod([len(values) for values in AXES.values()])} sets of four parameters on each of {len(clouds)} "
        f"samples; total error in percent, mean over the samples. The given set has {at_given:.2f} %, the best one set for all "
        f"{float(best):.2f} % (an oracle), the best of each sample {np.mean([row['best'] for row in votes]):.2f} % (an oracle).",
        markdown(columns, rows),
        "![Mean total error of SMRF against each parameter](smrf.png)",
        "Where do the parameters matter? *Disputed* are points that 5 to 95 % of the sets call ground. *Of the errors* is the "
        "share of the default's errors that are disputed; *never right* are points that 95 % of the sets get wrong.",
        markdown(of_votes, votes),
    ]
    save_png(jf.plots.sweep_curves(data), study.options.out / "smrf.png", 100)
    study.write("results", text, [*rows, *votes], ["smrf"])


def parameter(name: str, data: Any, given: dict[str, float], best: Any) -> Row:
    """What one parameter changes, with the others as given and at their best."""
    mean, others = data.total.mean("cloud"), {other: given[other] for other in AXES if other != name}
    line, envelope = mean.sel(others, method="nearest"), mean.min(list(others))
    here = line.sel({name: given[name]}, method="nearest")
    return {
        "parameter": name, "given": given[name], "best": float(best[name]), "range": float(line.max() - line.min()),
        "gain": float(here - line.min()), "envelope": float(envelope.max() - envelope.min()),
    }  # fmt: skip


def disputed(name: str, cloud: jf.PointCloud, data: Any) -> Row:
    """Where labels of a sample depend on the parameters, and how many errors lie there."""
    share = data[f"votes_{name}"].values
    wrong = jf.SMRF()(cloud).ground != cloud.reference
    split = (share > 0.05) & (share < 0.95)
    always = (share < 0.05) & cloud.reference | (share > 0.95) & ~cloud.reference
    return {
        "sample": name, "best": float(data.total.sel(cloud=name).min()), "default": 100 * float(wrong.mean()),
        "disputed": 100 * float(split.mean()), "errors": 100 * float(split[wrong].mean()), "always": 100 * float(always.mean()),
    }  # fmt: skip


if __name__ == "__main__":
    main()
