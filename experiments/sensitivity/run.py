"""What parameters decide: SMRF over four, and what a fixed set loses to the oracle. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, spaces
from experiments.report import Row, markdown, read_csv, save_png, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
SMRF_AXES: dict[str, list[float]] = {
    "slope": [0.05, 0.1, 0.15, 0.2, 0.3, 0.45],
    "threshold": [0.2, 0.35, 0.5, 0.75, 1.0],
    "scaling": [0.0, 0.6, 1.25, 2.0, 3.0],
    "window": [6.0, 12.0, 18.0, 30.0],
}


def main(arguments: list[str] | None = None) -> None:
    """Run all sweeps, and write tables and figures."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with isprs/ [JAXFILTER_DATA]")
    parser.add_argument("--out", type=Path, default=HERE / "results", help="folder for the results [%(default)s]")
    parser.add_argument(
        "--samples", type=samples.sample_name, nargs="+", default=list(samples.SAMPLES), help="for SMRF"
    )
    parser.add_argument("--isprs", type=Path, default=HERE.parent / "isprs" / "results", help="results of isprs/run.py")
    options = parser.parse_args(given)
    folder = samples.data_folder(options.data)
    options.out.mkdir(parents=True, exist_ok=True)
    keep_compilations()
    text = ["# What the parameters decide"]
    text += smrf(folder, options.samples, options.out)
    text += losses(options.isprs, options.out)
    command = shlex.join(["python", "experiments/sensitivity/run.py", *given])
    write_page(options.out / "results.md", "\n\n".join(part for part in text if part), command, jf.FILTERS)
    print(f"results are in {options.out}")


def smrf(folder: Path, numbers: list[str], out: Path) -> list[str]:
    """SMRF over its four parameters on all samples: what each is worth, and where labels depend on them."""
    from matplotlib.figure import Figure

    clouds = {f"samp{n}": jf.read(samples.sample_path(folder, n)) for n in numbers}
    data = jf.sweep(jf.SMRF(), clouds, SMRF_AXES, votes=True)
    mean = data.total.mean("cloud")
    given = {name: getattr(jf.SMRF(), name) for name in SMRF_AXES}
    best = mean.stack(set=list(SMRF_AXES))
    best = best.isel(set=int(best.values.argmin()))
    at_default = mean.sel(**given, method="nearest")
    own = data.total.min(list(SMRF_AXES))
    rows = []
    figure = Figure(figsize=(9.2, 2.6), layout="constrained")
    for ax, name in zip(figure.subplots(1, len(SMRF_AXES), sharey=True), SMRF_AXES, strict=True):
        others = [other for other in SMRF_AXES if other != name]
        line = mean.sel({other: given[other] for other in others}, method="nearest")
        envelope = mean.min(others)
        per_cloud = data.total.sel({other: given[other] for other in others}, method="nearest")
        ax.fill_between(
            line[name], *per_cloud.quantile([0.25, 0.75], "cloud"), color="0.9", label="half of the samples"
        )
        ax.plot(line[name], line, color="black", marker="o", markersize=3, label="others as given")
        ax.plot(line[name], envelope, color="#0072B2", linestyle="--", label="others at their best")
        ax.axvline(given[name], color="0.5", linestyle=":")
        unit = data[name].attrs.get("units", "")
        ax.set_xlabel(f"{name} ({unit})", fontsize=8)
        ax.tick_params(labelsize=7)
        ax.set_ylim(0, 20)
        ax.spines[["top", "right"]].set_visible(False)
        here = line.sel({name: given[name]}, method="nearest")
        rows.append(
            {
                "parameter": name, "given": given[name], "best": float(best[name]),
                "range": float(line.max() - line.min()), "gain": float(here - line.min()),
                "envelope": float(envelope.max() - envelope.min()),
            }
        )  # fmt: skip
    figure.axes[0].set_ylabel("mean total error (%)", fontsize=8)
    figure.axes[0].legend(fontsize=6.5, frameon=False, loc="upper right")
    save_png(figure, out / "smrf.png", 170)
    write_csv(out / "smrf.csv", rows)
    disputed = []
    for name, cloud in clouds.items():
        share = data[f"votes_{name}"].values
        wrong = jf.SMRF()(cloud).ground != cloud.reference
        split = (share > 0.05) & (share < 0.95)
        disputed.append(
            {
                "sample": name, "best": float(own.sel(cloud=name)), "default": 100 * float(wrong.mean()),
                "disputed": 100 * float(split.mean()), "errors": 100 * float(split[wrong].mean()),
                "always": 100 * float(((share < 0.05) & cloud.reference | (share > 0.95) & ~cloud.reference).mean()),
            }
        )  # fmt: skip
    write_csv(out / "smrf_votes.csv", disputed)
    shown = [name for name in ("samp11", "samp53") if name in clouds]
    if shown:
        figure = Figure(figsize=(4.6 * len(shown), 4.2), layout="constrained")
        for ax, name in zip(np.atleast_1d(figure.subplots(1, len(shown))), shown, strict=True):
            jf.plots.votes_map(clouds[name], data[f"votes_{name}"].values, ax=ax, title=name)
        save_png(figure, out / "votes.png", 170)
    count = int(np.prod([len(values) for values in SMRF_AXES.values()]))
    return [
        "## SMRF over four parameters",
        f"{count} sets on each of {len(clouds)} samples; total error in percent, mean over the samples. The given set has "
        f"{float(at_default):.2f} %, the best one set for all {float(best):.2f} % (an oracle), the best of each sample "
        f"{float(own.mean()):.2f} % (an oracle).",
        markdown(
            [
                ("parameter", "parameter", ""), ("given", "given", "g"), ("best", "in the best set", "g"),
                ("range", "largest change, others as given, points", ".2f"), ("gain", "gained by it alone", ".2f"),
                ("envelope", "largest change, others at their best", ".2f"),
            ],
            rows,
        ),
        "![Mean total error of SMRF against each parameter](smrf.png)",
        "Where do the parameters matter? *Disputed* are points that 5 to 95 % of the sets call ground. *Of the errors* is the "
        "share of the default's errors that are disputed; *never right* are points that 95 % of the sets get wrong.",
        markdown(
            [
                ("sample", "sample", ""), ("default", "default, total error, %", ".2f"), ("best", "best set, %", ".2f"),
                ("disputed", "disputed, %", ".1f"), ("errors", "of the errors, %", ".1f"), ("always", "never right, %", ".2f"),
            ],
            disputed,
        ),
        "![Share of sets that call a point ground, where they differ](votes.png)" if shown else "",
    ]  # fmt: skip


def losses(isprs: Path, out: Path) -> list[str]:
    """What the fixed set of every method loses to the oracle, from the results on the ISPRS samples."""
    from matplotlib.figure import Figure

    if not (isprs / "oracle.csv").exists():
        return [
            "## Fixed set against oracle",
            f"{isprs / 'oracle.csv'} is missing: run experiments/isprs/run.py first.",
        ]
    by: dict[str, dict[tuple[str, str], float]] = {}
    for protocol in ("fixed", "class", "oracle"):
        for row in read_csv(isprs / f"{protocol}.csv"):
            by.setdefault(row["method"], {})[protocol, row["sample"]] = row["total"]
    rows: list[Row] = []
    for method in (name for name in spaces.method_names() if name in by):
        means = {
            p: float(np.mean([v for (q, _), v in by[method].items() if q == p])) for p in ("fixed", "class", "oracle")
        }
        of_sample = [by[method]["fixed", s] - by[method]["oracle", s] for p, s in by[method] if p == "fixed"]
        rows.append(
            {"method": method, **means, "loss": means["fixed"] - means["oracle"], "median": float(np.median(of_sample)),
             "largest": max(of_sample)}
        )  # fmt: skip
    write_csv(out / "losses.csv", rows)
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    ax = figure.subplots()
    order = sorted(rows, key=lambda row: row["oracle"], reverse=True)
    for y, row in enumerate(order):
        ax.plot([row["oracle"], row["fixed"]], [y, y], color="0.7", linewidth=2, zorder=1)
    for name, colour, marker in (("oracle", "#009E73", "o"), ("class", "#E69F00", "D"), ("fixed", "#000000", "s")):
        ax.scatter(
            [row[name] for row in order], range(len(order)), color=colour, marker=marker, s=22, label=name, zorder=2
        )
    ax.set_yticks(range(len(order)), [row["method"].upper() for row in order], fontsize=8)
    ax.set_xlabel("mean total error over the ISPRS samples (%)", fontsize=8)
    ax.tick_params(labelsize=8)
    ax.set_xlim(left=0)
    ax.legend(fontsize=8, frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    save_png(figure, out / "losses.png", 170)
    return [
        "## What a fixed set loses to the oracle",
        "Mean total errors in percent over the ISPRS samples, from `experiments/isprs`. The oracle is the best of the sets that "
        "were tried on each sample's own labels: a ceiling, and a lower one than a longer search would find.",
        markdown(
            [
                ("method", "method", ""), ("fixed", "fixed", ".2f"), ("class", "class", ".2f"), ("oracle", "oracle", ".2f"),
                ("loss", "loss, points", ".2f"), ("median", "median over samples", ".2f"), ("largest", "largest", ".2f"),
            ],
            rows,
        ),
        "![Fixed, class and oracle](losses.png)",
    ]  # fmt: skip


if __name__ == "__main__":
    main()
