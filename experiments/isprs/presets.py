"""Presets of every method on the 15 ISPRS samples, beside what papers print for their own method on them.

    python experiments/isprs/presets.py

Writes ``results/presets.csv`` (a row per sample, method and way of choosing), ``results/preset_means.csv`` and
``results/presets.md``. What ``for_cloud`` gives is taken from ``results/fixed.csv`` of ``run.py``.
"""

from __future__ import annotations

import statistics
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.isprs import samples, search, spaces, tables
from experiments.papers.oracle import TUNED, tuned
from experiments.report import Column, CommandLine, Row, markdown, read_csv, write_csv, write_page
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
TERRAIN = samples.terrain_classes()
SCORES = ("total", "kappa", "type1", "type2")
GROUPS = {
    "all": samples.SAMPLES,
    **{name: [s for s in samples.SAMPLES if TERRAIN[f"samp{s}"] == name] for name in ("D1", "D2", "D3", "D4")},
    "urban": [s for s in samples.SAMPLES if s < "5"],
    "rural": [s for s in samples.SAMPLES if s > "5"],
}
"""Samples by the terrain classes of Li et al. (2021), Table I, and by site: 1 to 4 are urban, 5 to 7 rural."""
KINDS = {
    "fixed": "one set for all samples",
    "class": "a set per terrain class",
    "oracle": "a set per sample, by its labels",
}
WAYS = {
    "paper": ("fixed", 'the preset "paper"'),
    "recommended": ("fixed", "`for_cloud`"),
    "class": ("class", 'the presets "D1" to "D4": limits of Li et al. (2021), Table I, all else recommended'),
    "paper_class": ("class", 'the preset "paper" with the limits of "D1" to "D4"'),
    "sample": ("oracle", "`papers/oracle.csv`: values that the authors chose for each sample"),
}
"""Ways of choosing the parameters: the kind, and what they are."""
PRINTED = {row["method"]: row for row in tables.PRINTED if row["source"]}
"""What its authors print for each method."""


def main() -> None:
    """Run what is not in ``fixed.csv`` and write the tables."""
    parser = CommandLine(__file__, __doc__, "results")
    options = parser.options(None)
    folder = samples.data_folder(options.data)
    tasks = [(samples.sample_path(folder, number),) for number in samples.SAMPLES]
    rows = [row for _, found in search.results(measured, tasks, 2) for row in found]
    for row in read_csv(HERE / "results" / "fixed.csv"):
        rows.append({"way": "recommended"} | {key: row[key] for key in ("sample", "method", *SCORES)})
    order = [*samples.SAMPLES]
    methods = spaces.method_names()
    rows.sort(key=lambda r: (methods.index(r["method"]), [*WAYS].index(r["way"]), order.index(r["sample"][4:])))
    write_csv(options.out / "presets.csv", rows)
    means = [*_means(rows), *_means([*_printed()])]
    write_csv(options.out / "preset_means.csv", means)
    write_page(options.out / "presets.md", _report(rows, means), options.command, methods)


def filters(sample: str) -> Iterator[tuple[str, str, jf.Filter]]:
    """Method, way and filter of what has to be run on a sample such as "samp11"."""
    limits = TERRAIN[sample]
    for method in spaces.method_names():
        cls = jf.FILTERS[method]
        yield method, "paper", cls.preset("paper")
        if limits in cls.PRESETS:
            yield method, "class", cls.preset(limits)
            yield method, "paper_class", cls.preset("paper", **cls.PRESETS[limits])
        if (method, sample) in TUNED:
            yield method, "sample", tuned(method, sample)


def measured(path: Path) -> list[Row]:
    """Errors and kappa on a sample, percent, and the warnings that were given."""
    keep_compilations()
    cloud, rows = jf.read(path), []
    for method, way, filter_ in filters(path.stem):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", jf.JaxfilterWarning)
            scores = jf.evaluate(filter_(cloud), cloud)
        words = "; ".join(dict.fromkeys(str(one.message) for one in caught))
        row: Row = {"sample": path.stem, "method": method, "way": way}
        rows.append(row | {key: getattr(scores, key) for key in SCORES} | {"warning": words})
    return rows


def _printed() -> Iterator[Row]:
    for method, printed in PRINTED.items():
        for row in samples.published(printed["table"]):
            if row.get("method", method) == method and row["sample"].startswith("samp"):
                scores = {key: row.get(printed[key]) for key in ("total", "kappa")}
                yield {"sample": row["sample"], "method": method, "way": "printed", **scores}


def _means(rows: Sequence[Row]) -> list[Row]:
    """A row per method and way: means of total error and kappa over each of :data:`GROUPS`, and over how many samples."""
    out: list[Row] = []
    for method, way in dict.fromkeys((row["method"], row["way"]) for row in rows):
        found = {row["sample"][4:]: row for row in rows if (row["method"], row["way"]) == (method, way)}
        line: Row = {"method": method, "way": way, "samples": len(found)}
        for key in ("total", "kappa"):
            for name, members in GROUPS.items():
                values = [v for s in members if s in found and isinstance(v := found[s].get(key), (int, float))]
                if values:
                    line[key if name == "all" else f"{key}_{name}"] = statistics.fmean(values)
        out.append(line)
    return out


def _report(rows: Sequence[Row], means: Sequence[Row]) -> str:
    by_way = {(row["method"], row["way"]): row for row in means}
    lines = []
    for method in spaces.method_names():
        line: Row = {"method": method.upper()}
        for way in ("printed", *WAYS):
            there = by_way.get((method, way), {})
            line |= {f"{key}_{way}": there.get(key) for key in ("total", "kappa")}
        if method in PRINTED:
            own = by_way[method, "printed"]
            line["how"] = f"{PRINTED[method]['protocol']}, {own['samples']} samples"
        if (method, "sample") in by_way:
            line["of"] = by_way[method, "sample"]["samples"]
        lines.append(line)
    columns: list[Column] = [
        ("method", "method", ""), ("total_printed", "as printed: TE", ".2f"), ("kappa_printed", "kappa", ".2f"),
        ("how", "chosen by", ""), ("total_paper", "paper: TE", ".2f"), ("kappa_paper", "kappa", ".2f"),
        ("total_recommended", "recommended: TE", ".2f"), ("kappa_recommended", "kappa", ".2f"),
        ("total_class", "class: TE", ".2f"), ("kappa_class", "kappa", ".2f"), ("total_paper_class", "paper, class: TE", ".2f"),
        ("kappa_paper_class", "kappa", ".2f"), ("total_sample", "sample: TE", ".2f"), ("kappa_sample", "kappa", ".2f"),
        ("of", "samples", "d"),
    ]  # fmt: skip
    text = [
        "# Presets on the 15 ISPRS samples",
        "Total error (TE) and kappa in percent, means over the samples, by grids that count from zero of the coordinates. The "
        "papers begin their grids at the lower left point of a cloud; [places](places.md) shows what that decides, and the pages "
        "of the papers (`experiments/papers`) have figures by that corner.",
        "## All methods",
        markdown(columns, lines),
        "Columns of different kinds must not be compared with each other:\n\n"
        + "\n".join(
            f"- **{kind}**, {what}: {'; '.join(f'*{way}*: {w}' for way, (k, w) in WAYS.items() if k == kind)}."
            for kind, what in KINDS.items()
        ),
        "*As printed* is what the authors print for their own method: "
        + "; ".join(f"{method.upper()}: {row['source']}" for method, row in PRINTED.items())
        + '. Methods without a figure were published on other data. The preset "paper" has one set for all samples, so where '
        "authors chose values per sample or class its error is no measure of their method as they used it. Li et al. chose the "
        "limits of the classes for FPTD, and print none for PTD. The kappa of SMRF that is published for one set stands on [its "
        'page](../../papers/results/pingel2013/results.md). OST is of this library; its preset "paper" is the default.',
    ]
    for kind, what in KINDS.items():
        own = [way for way, (k, _) in WAYS.items() if k == kind]
        chosen = [row | {"method": row["method"].upper()} for row in means
                  if row["way"] in own or (row["way"] == "printed" and PRINTED[row["method"]]["protocol"] == kind)]  # fmt: skip
        chosen.sort(key=lambda row: (["printed", *own].index(row["way"]), row["total"]))
        for key, title in (("total", "Total error"), ("kappa", "Kappa")):
            columns = [
                ("way", "values", ""),
                ("method", "method", ""),
                ("samples", "samples", "d"),
                (key, "all", ".2f"),
            ]
            columns += [(f"{key}_{name}", name, ".2f") for name in GROUPS if name != "all"]
            lines = [row for row in chosen if key in row]
            text += [f"## {title} by terrain, {kind}: {what}", markdown(columns, lines)]
    named = {name: ", ".join(members) for name, members in GROUPS.items() if name != "all"}
    text.append("Samples: " + "; ".join(f"{name}: {members}" for name, members in named.items()) + ".")
    for way, (_, what) in WAYS.items():
        if way != "recommended":
            own_rows = [row for row in rows if row["way"] == way]
            text += [f"## Total error per sample: {what}", _per_sample(own_rows)]
    text.append("Those of `for_cloud` stand on the [page of the protocols](results.md).")
    said = [row for row in rows if row.get("warning")]
    columns = [("sample", "sample", ""), ("method", "method", ""), ("way", "values", ""), ("total", "TE", ".2f"),
               ("warning", "warning", "")]  # fmt: skip
    text += ["## Runs with a warning", markdown(columns, said) if said else "There is none."]
    return "\n\n".join(text)


def _per_sample(rows: Sequence[Row]) -> str:
    methods = list(dict.fromkeys(row["method"] for row in rows))
    lines: dict[str, Row] = {}
    for row in rows:
        lines.setdefault(row["sample"], {"sample": row["sample"]})[row["method"]] = row["total"]
    ordered = [lines[name] for s in samples.SAMPLES if (name := f"samp{s}") in lines]
    return markdown([("sample", "sample", ""), *((m, m.upper(), ".2f") for m in methods)], ordered)


if __name__ == "__main__":
    main()
