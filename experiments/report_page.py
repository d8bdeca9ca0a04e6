"""docs/results/README.md: the measured results on one page, from the CSV files that the experiments left.

    python experiments/report_page.py

It measures nothing. Parts whose files are missing are left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.isprs import protocols, tables
from experiments.report import Column, Row, markdown, read_csv

ROOT = Path(__file__).resolve().parents[1]

COMMANDS = (
    (
        "python experiments/isprs/run.py --out experiments/isprs/results",
        "every method on the ISPRS samples, three protocols",
    ),
    (
        "python experiments/tiles/run.py --out experiments/tiles/results",
        "every method on six labelled tiles",
    ),
    ("python experiments/defaults/run.py", "defaults that are chosen on simulated scenes and tiles"),
    ("python experiments/ablations/run.py", "choices within the methods"),
    ("python experiments/papers/<paper>.py", "each paper's tables, measured beside printed"),
    ("python experiments/outliers/run.py --out experiments/outliers/results", "search for clusters of low points"),
    ("python experiments/bench/run.py --out experiments/bench/results", "speed and memory"),
    ("python experiments/report_page.py", "this page"),
)

CAVEATS = ROOT / "experiments" / "isprs" / "caveats.md"
"""What cannot be reproduced, or only in part, and why."""


def main(arguments: list[str] | None = None) -> None:
    """Read the results and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--experiments", type=Path, default=ROOT / "experiments", help="folder with the results [%(default)s]"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "README.md", help="file [%(default)s]")
    options = parser.parse_args(arguments)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(page(options.experiments, _link(options.out, options.experiments)))
    print(f"wrote {options.out}")


def _link(page: Path, folder: Path) -> str:
    """The folder as seen from the page."""
    start, target = page.resolve().parent, folder.resolve()
    common = next(p for p in (start, *start.parents) if target.is_relative_to(p))
    return "/".join([".."] * len(start.relative_to(common).parts) + list(target.relative_to(common).parts))


def page(folder: Path, link: str) -> str:
    """The whole page as Markdown. ``link``: the folder of the experiments as seen from the page."""
    isprs = folder / "isprs" / "results"
    chosen = {name: rows for name in protocols.PROTOCOLS if (rows := _rows(isprs / f"{name}.csv"))}
    text = [
        "# Results",
        "Measured on the 15 labelled samples of ISPRS Working Group III/3 (Sithole and Vosselman 2004), 384 955 points. Errors "
        "and kappa in percent over all points. T.I: ground lost, T.II: objects accepted, TE: total error. This page is made "
        "from the files that these commands leave:",
        markdown(
            [("command", "command", ""), ("what", "what", "")], [{"command": f"`{c}`", "what": w} for c, w in COMMANDS]
        ),
    ]
    for name, rows in chosen.items():
        text += [f"## {name.capitalize()} protocol", tables.MEANING[name], tables.summary(rows)]
        text += [tables.shared_note(tables.order(rows)).replace("docs/fidelity.md", "[fidelity.md](../fidelity.md)")]
        for key in ("total", "kappa"):
            text += [f"{tables.TITLES[key].capitalize()} per sample:", tables.per_sample(rows, key)]
        if name == "fixed":
            text += ["Seconds per sample, a warm call without I/O:", tables.per_sample(rows, "seconds")]
            text += _figures(isprs, f"{link}/isprs/results", ("errors", "time"))
    if chosen:
        text += _figures(isprs, f"{link}/isprs/results", ("totals",))
        text += [
            f"Type I and Type II errors per sample, the thresholds chosen, and the ranges they were chosen from: "
            f"[{link}/isprs/results/results.md]({link}/isprs/results/results.md)."
        ]
    if claims := _rows(isprs / "claims.csv"):
        text += [
            "## Do the improvements improve on classic PTD?",
            tables.CLAIMS_NOTE,
            tables.claims(claims),
        ]
    if printed := _rows(isprs / "printed.csv"):
        text += [
            "## Beside published figures",
            "Means over the samples that both have; the nearest of our protocols stands beside each.",
            tables.printed_table(printed),
        ]
    text += _ablations(folder, link) + _bench(folder, link) + _papers(folder, link)
    text += ["## What cannot be reproduced, and why", CAVEATS.read_text().rstrip()]
    return "\n\n".join(text) + "\n"


def _rows(path: Path) -> list[Row]:
    return read_csv(path) if path.exists() else []


CAPTIONS = {
    "errors": "Errors of every method over the shaded reference ground, fixed protocol; below each map the total error.",
    "time": "Mean kappa against time, fixed protocol.",
    "totals": "Total error per sample and method under each protocol, in percent; the lowest per column is bold.",
}


def _figures(place: Path, link: str, names: Sequence[str]) -> list[str]:
    return [
        part
        for name in names
        if (place / "figures" / f"{name}.png").exists()
        for part in (f"![{CAPTIONS[name]}]({link}/figures/{name}.png)", CAPTIONS[name])
    ]


def _ablations(folder: Path, link: str) -> list[str]:
    rows = [
        row for row in _rows(folder / "ablations" / "results" / "summary.csv") if isinstance(row.get("total"), float)
    ]
    if not rows:
        return []
    lines = []
    for group in dict.fromkeys((row["choice"], row["variant"].split(":")[0]) for row in rows):
        part = [
            row
            for row in rows
            if (row["choice"], row["variant"].split(":")[0]) == group and str(row["labels"]) == "False"
        ]
        base = next((row for row in part if str(row["baseline"]) == "True"), None)
        if base is None or group[0].startswith("11"):
            continue
        best, worst = (f(part, key=lambda row: row["total"]) for f in (min, max))
        line: Row = {"choice": group[0]}
        for key, row in (("base", base), ("best", best), ("worst", worst)):
            line |= {key: row["variant"], f"{key}_total": row["total"]}
        lines.append(line)
    columns: list[Column] = [
        ("choice", "choice", ""),
        ("base", "as in the fixed set", ""),
        ("base_total", "TE, mean", ".2f"),
        ("best", "best", ""),
        ("best_total", "TE, mean", ".2f"),
        ("worst", "worst", ""),
        ("worst_total", "TE, mean", ".2f"),
    ]
    path = f"{link}/ablations/results/results.md"
    return [
        "## Choices within the methods",
        f"Mean total error when one choice is made otherwise, all else the same, as [its README]({link}/ablations/README.md) "
        f"says. All variants: [{path}]({path}).",
        markdown(columns, lines),
    ]


def _bench(folder: Path, link: str) -> list[str]:
    rows = [
        row for row in _rows(folder / "bench" / "results" / "bench.csv") if isinstance(row.get("warm_seconds"), float)
    ]
    if not rows:
        return []
    largest = max(row["points"] for row in rows)
    lines = [
        row | {"rate": row["points"] / row["warm_seconds"] / 1e6, "peak": row["command_peak_bytes"] / 1e9}
        for row in rows
        if row["points"] > 0.9 * largest
    ]
    columns: list[Column] = [
        ("name", "method", ""),
        ("density", "points/m²", "g"),
        ("points", "points", ",d"),
        ("warm_seconds", "s, warm", ".2f"),
        ("rate", "million points/s", ".2f"),
        ("peak", "peak memory of the command, GB", ".2f"),
    ]
    path = f"{link}/bench/results/results.md"
    text = f"The largest simulated scenes; all: [{path}]({path})."
    return ["## Speed and memory", text, markdown(columns, lines)]


def _papers(folder: Path, link: str) -> list[str]:
    found = sorted((folder / "papers" / "results").glob("*/results.md"))
    if not found:
        return []
    lines = []
    for path in found:
        title = path.read_text().splitlines()[0].lstrip("# ")
        lines.append(f"- [{title}]({link}/papers/results/{path.parent.name}/results.md)")
    return ["## Each paper's tables, measured beside printed", "\n".join(lines)]


if __name__ == "__main__":
    main()
