"""Every method on any folder of labelled clouds: tables, significance and a figure. See README.md."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import machine, markdown, save_png
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
TITLES = {
    "total": "Total error, %",
    "kappa": "Kappa, %",
    "type1": "Type I, %",
    "type2": "Type II, %",
    "seconds": "Seconds",
}


def main(arguments: list[str] | None = None) -> None:
    """Run all methods on all clouds of a folder, and write the page."""
    given = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(given)
    keep_compilations()
    reading = jf.Reading(returns=options.returns, ignore_classes=options.set_aside, units=options.units)
    try:
        data = jf.datasets.folder(options.folder, ground=options.ground, ignore=options.ignore, reading=reading)
        data = data.split(options.split) if options.split else data
    except jf.JaxfilterError as error:
        raise SystemExit(f"benchmark: {error}") from None
    groups = (
        {name: name.rpartition("/")[0] or name[: options.group_letters] for name in data}
        if options.group_letters
        else None
    )
    found = jf.compare(
        {name.upper(): name for name in options.methods},
        data,
        groups=groups,
        repeats=options.repeats,
        progress=lambda done, step: print(f"{100 * done:5.1f} % {step}", file=sys.stderr, flush=True),
    )
    options.out.mkdir(parents=True, exist_ok=True)
    found.table.to_csv(options.out / "runs.csv", index=False)
    scored = [score for score in TITLES if found.table[score].notna().any()]
    (options.out / "tables.tex").write_text("".join(f"% {TITLES[s]}\n{found.latex(s)}\n" for s in scored))
    (options.out / "results.md").write_text(
        page(found, scored, shlex.join(["python", "experiments/benchmark/run.py", *given]))
    )
    if "total" in scored:
        save_png(heat(found.by_method("total")), options.out / "totals.png", 150)
    print(f"results are in {options.out}")


def page(found: jf.Comparison, scored: list[str], command: str) -> str:
    """The page as Markdown."""
    text = [
        "# All methods on a folder of labelled clouds",
        f"`{command}` on {machine()}.",
        "Every method as `for_cloud(cloud)` gives it: defaults, and what follows from the point spacing. Points without a "
        "reference are filtered and not scored. Seconds, by the clock: the median of the calls after the first, or of the first "
        "if there is no other.",
    ]
    for score in scored:
        text += [f"## {TITLES[score]}", found.markdown(score)]
    failed = found.table[found.table["total"].isna() & found.table["status"].str.contains(":")]
    text += [f"{row['method']} failed on {row['cloud']}: {row['status']}" for row in failed.to_dict("records")]
    if "total" in scored and found.by_method("total").shape[1] > 1:
        best = found.by_method("total").mean().idxmin()
        by = "group" if found.table["group"].nunique() < found.table["cloud"].nunique() else "cloud"
        pairs = found.significance("total", against=best, by=by)
        columns = [("method", "method", ""), ("clouds", f"{by}s", "d"), ("difference", "mean difference", "+.2f")]
        columns += [("better", "better", "d"), ("worse", "worse", "d"), ("effect", "effect", "+.2f")]
        columns += [("p", "p", ".4f"), ("p_holm", "p, Holm", ".4f")]
        text += [
            f"## Against {best}, which has the lowest mean",
            f"Total errors, by {by}. Effect: matched-pairs rank-biserial correlation, -1 = worse everywhere. p: Wilcoxon's "
            "signed-rank test, two-sided. That the best mean was chosen on these clouds makes p a little too small.",
            markdown(columns, pairs.to_dict("records")),
            "![Total error of every method on every cloud](totals.png)",
        ]
    return "\n\n".join(text) + "\n"


def heat(wide: Any) -> Any:
    """Total errors as a table of colours, methods by clouds."""
    from matplotlib.figure import Figure

    values = wide.to_numpy().T
    figure = Figure(figsize=(1.6 + 0.7 * values.shape[1], 1.6 + 0.32 * len(values)), layout="constrained")
    ax = figure.subplots()
    ax.imshow(np.log10(np.maximum(values, 0.1)), cmap="YlOrRd", aspect="auto", vmin=0, vmax=np.log10(40))
    for (i, j), v in np.ndenumerate(values):
        if np.isfinite(v):
            ax.text(j, i, f"{v:.1f}", ha="center", va="center", fontsize=8, color="white" if v > 20 else "black")
    ax.set_xticks(range(values.shape[1]), wide.index, fontsize=8, rotation=90)
    ax.set_yticks(range(len(values)), wide.columns, fontsize=8)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    ax.set_title("total error (%)", fontsize=9)
    return figure


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="of labelled LAS, LAZ or text files, or its name among the data sets: isprs")
    parser.add_argument("--out", type=Path, default=HERE / "out", help="folder for the results [%(default)s]")
    parser.add_argument("--methods", nargs="+", choices=list(jf.FILTERS), default=list(jf.FILTERS), metavar="METHOD")
    parser.add_argument("--ground", nargs="+", type=int, default=[2], help="classes that are ground [2]")
    parser.add_argument(
        "--ignore", nargs="*", type=int, default=[7, 9, 12, 18], help="classes that are not scored [7 9 12 18]"
    )
    parser.add_argument("--set-aside", nargs="*", type=int, default=[7, 18], help="classes that no method sees [7 18]")
    parser.add_argument("--returns", default="last,only", help="echoes that are judged [%(default)s]")
    parser.add_argument("--units", default="m", help="of the coordinates [%(default)s]")
    parser.add_argument("--split", help="a folder in FOLDER: only its clouds")
    parser.add_argument(
        "--group-letters",
        type=int,
        default=0,
        metavar="N",
        help="clouds of one folder, or else those whose names begin with the same N letters, are one group in tests",
    )
    parser.add_argument("--repeats", type=int, default=1, help="timed calls after the first [%(default)s]")
    return parser


if __name__ == "__main__":
    main()
