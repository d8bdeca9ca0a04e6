"""The figures that pages quote, from the files of results.

    python experiments/quoted.py

A figure stands between two comments, of which the first says where it is from, and a table likewise:

    <!-- = isprs/summary.csv protocol=fixed method=ost total .1f -->3.4<!-- / -->
    <!-- = ablation "PTD: 30 degrees" -->6.4<!-- / -->
    <!-- = table methods -->
    ...
    <!-- / -->

``isprs/summary.csv`` is ``experiments/isprs/results/summary.csv``. Conditions choose its rows; the mean of the column over these
is shown, in the format, or with one decimal. Two such places with a minus between them are a difference. The words of
:data:`SHORT` stand for files that are quoted often; the column is then the total error. It measures nothing.
"""

from __future__ import annotations

import re
import shlex
import statistics
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.report import Column, Row, markdown, read_csv
from experiments.sensors.run import means

HERE = Path(__file__).parent
ROOT = HERE.parent
SHORT = {
    "ablation": (["ablations/summary.csv"], ["variant"], "total"),
    "defaults": (["defaults/means.csv"], ["choice", "alternative"], "mean"),
    "isprs": (["isprs/summary.csv", "protocol=fixed"], ["method"], "total"),
    "sample": (["isprs/fixed.csv"], ["sample", "method"], "total"),
    "tile": (["tiles/tiles.csv"], ["tile", "method"], "total"),
}
"""Files with fixed conditions, the columns whose values are named, and the column that is shown where none is named."""
_FORM = re.compile(r"[+,]*(\.\d)?[dfg%]")
_FIGURE = re.compile(r"(<!-- = ((?:(?!-->).)+) -->)(.*?)(<!-- / -->)", re.DOTALL)


def pages() -> list[Path]:
    """The pages that may quote figures."""
    found = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "filters").glob("*.md")]
    return sorted([*found, *HERE.glob("*/README.md")])


def filled(text: str) -> str:
    """The text of a page with the figures and tables of the files of today.

    Raises: ValueError for a place that no file has.
    """
    return _FIGURE.sub(lambda found: found[1] + quoted(found[2]) + found[4], text)


def quoted(what: str) -> str:
    """What stands between the comments. ``what``: as in the first one. Raises: ValueError."""
    words = shlex.split(what.replace("\n", " "))
    if words[0] == "table":
        return f"\n\n{TABLES[words[1]]()}\n\n"
    form = words.pop() if _FORM.fullmatch(words[-1]) else ".1f"
    if "-" not in words:
        return f"{value(words):{form}}"
    at = words.index("-")
    return f"{value(words[:at]) - value(words[at + 1 :]):{form}}"


def value(words: list[str]) -> float:
    """The mean of a column over some rows: file, conditions, column. Raises: ValueError."""
    if words[0] in SHORT:
        file, keys, column = SHORT[words[0]]
        given = [f"{key}={text}" for key, text in zip(keys, words[1:], strict=False)]
        words = [*file, *given, *(words[1 + len(keys) :] or [column])]
    file, *conditions, column = words
    wanted = [condition.split("=", 1) for condition in conditions]
    found = [row[column] for row in _rows(file) if all(str(row[key]) == text for key, text in wanted)]
    if not found or not all(isinstance(one, (int, float)) for one in found):
        raise ValueError(f"{' '.join(words)}: {'no number' if found else 'no such row'}")
    return statistics.fmean(found)


@cache
def _rows(file: str) -> list[Row]:
    folder, _, name = file.rpartition("/")
    first, *others = folder.split("/")
    return read_csv(HERE.joinpath(first, "results", *others, name))


PAPERS = {
    "ost": "this library's own, the default", "fptd": "Li et al. 2021", "stin": "Uray and Varlik 2024",
    "agptd": "Zheng et al. 2024", "spf": "Chen et al. 2023", "ppdf": "Cai et al. 2023",
    "ptd": "Axelsson 2000; Zhang and Lin 2013", "ptdf": "the same, upward only",
    "atin": "the same, adaptive limits as an option", "iptd": "Zhao et al. 2016", "smrf": "Pingel et al. 2013",
    "pmf": "Zhang et al. 2003", "msf": "Vosselman 2000", "csf": "Zhang et al. 2016",
}  # fmt: skip


def methods() -> str:
    """Every method with its mean errors on samples and tiles, and its seconds for a million points."""
    from experiments.isprs import tables
    from experiments.tiles import run as tiles

    marked = dict.fromkeys(tables.SHARED, f" {tables.MARK}")
    on_tiles = dict.fromkeys((*tiles.SHARED, "ost"), f" {tables.MARK}")
    largest = max(row["points"] for row in _rows("bench/bench.csv"))
    rows = []
    for name, paper in PAPERS.items():
        fixed = ["isprs/summary.csv", "protocol=fixed", f"method={name}"]
        seconds = value(["bench/bench.csv", f"name={name}", f"points={largest}", "density=1.0", "warm_seconds"])
        rows.append({
            "method": f"`{name}`", "paper": paper, "seconds": seconds,
            "total": f"{value([*fixed, 'total']):.1f}{marked.get(name, '')}",
            "kappa": f"{value([*fixed, 'kappa']):.1f}{marked.get(name, '')}",
            "tiles": f"{value(['tiles/tiles.csv', f'method={name}', 'total']):.1f}{on_tiles.get(name, '')}",
        })  # fmt: skip
    columns: list[Column] = [
        ("method", "method", ""), ("paper", "paper", ""), ("total", "ISPRS, total error, %", ""), ("kappa", "kappa, %", ""),
        ("tiles", "tiles, total error, %", ""), ("seconds", "1 M points, s", ".1f"),
    ]  # fmt: skip
    return markdown(columns, rows)


def country() -> str:
    """What a country of 40,000 km2 takes, by density and method."""
    columns: list[Column] = [
        ("name", "method", ""), ("density", "points per m2", ".0f"), ("per_million", "CPU s per million points read", ".1f"),
        ("halo", "halo, m", ".0f"), ("tile", "tile, m", ",.0f"), ("times", "times a point is read", ".2f"),
        ("hours", "core-hours", ",.0f"), ("worker", "memory of a worker, GB", ".1f"),
    ]  # fmt: skip
    return markdown(columns, [row | {"name": row["method"].upper()} for row in _rows("tiling/country.csv")])


def as_collection() -> str:
    """OST over 16 files, file by file and as a collection."""
    columns: list[Column] = [
        ("how", "", ""), ("tiles", "tiles", "d"), ("times", "times a point is read", ".2f"),
        ("per_million", "CPU s per million points", ".1f"), ("peak", "memory of all processes, GB", ".1f"),
    ]  # fmt: skip
    rows = [row | {"per_million": 1e6 * row["cpu"] / row["points"]} for row in _rows("tiling/tiles.csv")]
    return markdown(columns, rows)


def scale() -> str:
    """Surveys of more and more files."""
    columns: list[Column] = [
        ("how", "", ""), ("points", "points", ",d"), ("tiles", "tiles", ""), ("wall", "seconds", ".0f"),
        ("cpu", "CPU seconds", ".0f"), ("per_million", "per million points", ".2f"),
        ("peak", "memory of all processes, GB", ".2f"),
    ]  # fmt: skip
    return markdown(columns, _rows("tiling/scale.csv"))


def tile_labels() -> str:
    """Labels of tiles that differ from those of the whole, by method and survey."""
    rows = [row for row in _rows("tiling/labels.csv") if row["default"] == "True"]
    surveys = {row["survey"]: row["points"] for row in rows}
    lines = [
        {"method": name.upper(), "halo": own[0]["halo"]} | {row["survey"]: row["differ"] for row in own}
        for name in dict.fromkeys(sorted(row["method"] for row in rows))
        for own in [[row for row in rows if row["method"] == name]]
    ]
    columns: list[Column] = [("method", "method", ""), ("halo", "default halo, m", ".0f")]
    return markdown([*columns, *((name, f"{name}, {points:,}", ",d") for name, points in surveys.items())], lines)


def halos() -> str:
    """Labels of tiles that differ from those of the whole, by method and halo."""
    rows = [row | {"method": row["method"].upper()} for row in _rows("tiling/halos.csv")]
    halos = ("0", "15", "30", "60", "120")
    columns: list[Column] = [("method", "method", ""), *((halo, f"{halo} m", ",d") for halo in halos)]
    return markdown(columns, rows)


def doubts() -> str:
    """What the doubts of OST are worth."""
    columns: list[Column] = [
        ("what", "clouds", ""), ("points", "points", ",d"), ("errors", "errors %", ".2f"), ("doubt", "mean doubt %", ".2f"),
        ("ece", "ECE", ".3f"), ("found", "errors in the most doubtful 10 % of points, %", ".1f"),
    ]  # fmt: skip
    return markdown(columns, [row for row in _rows("default/doubt.csv") if row["unnamed"] == ""])


def named() -> str:
    """What the places that are named hold."""
    import pandas as pd

    from experiments.failures.pages import shares

    table = pd.DataFrame([row for row in _rows("failures/spots.csv") if row["method"] == "ost"])
    parts = {kind: part for kind, part in table.groupby("kind", sort=False) if kind != "samples"}
    parts |= {"all three": table[table["kind"] != "samples"], "samples": table[table["kind"] == "samples"]}
    columns: list[Column] = [
        ("kind", "clouds", ""), ("found", "of the area that is off, named %", ".0f"), ("hit", "places that hold some, %", ".0f"),
        ("tenths", "a tenth of their area, %", ".0f"), ("times", "named area / area off", ".2f"),
    ]  # fmt: skip
    return markdown(columns, [{"kind": kind, **shares(part.sum(numeric_only=True))} for kind, part in parts.items()])


def sensors() -> str:
    """OST beside the best of the other methods on clouds of other sensors."""
    return _beside_best(_rows("sensors/methods.csv"))


def sensors_anew() -> str:
    """The same in the mean of scenes of further seeds."""
    return _beside_best([row for key in ("total", "rmse") for row in means(_rows("sensors/draws.csv"), key)])


def _beside_best(rows: list[Row]) -> str:
    lines = []
    for cloud in dict.fromkeys(row["cloud"] for row in rows):
        line: Row = {"cloud": cloud}
        for key, form in (("total", ".2f"), ("rmse", ".3f")):
            found = {
                row["method"]: row[key]
                for row in rows
                if row["cloud"] == cloud
                and isinstance(row.get(key), (int, float))
                and not (cloud.startswith("spanner") and key == "total")  # labels of software
            }
            if "ost" in found:
                own, best = found.pop("ost"), min(found, key=lambda name: found[name])
                line |= {key: f"{own:{form}}", f"best_{key}": f"{found[best]:{form}} ({best.upper()})"}
        if len(line) > 1:
            lines.append(line)
    columns: list[Column] = [
        ("cloud", "cloud", ""), ("total", "total error, OST", ""), ("best_total", "best", ""),
        ("rmse", "terrain RMSE, OST", ""), ("best_rmse", "best", ""),
    ]  # fmt: skip
    return markdown(columns, lines)


TABLES: dict[str, Callable[[], str]] = {
    "methods": methods, "country": country, "tiles": as_collection, "scale": scale, "tile_labels": tile_labels,
    "halos": halos, "doubts": doubts, "named": named, "sensors": sensors, "sensors_anew": sensors_anew,
}  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Write the figures into the pages."""
    for path in pages():
        before = path.read_text()
        if (after := filled(before)) != before:
            path.write_text(after)
            print(f"wrote {path}")


if __name__ == "__main__":
    main()
