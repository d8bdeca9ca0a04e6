"""What the studies of single papers share: the command line, the samples, and a report of measured beside printed figures."""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import jaxfilter as jf
from experiments.isprs import samples
from experiments.report import Column, CommandLine, Row, markdown, save_png, with_averages, write_csv, write_page
from jaxfilter import plots
from jaxfilter.core.compilation import keep_compilations

HERE = Path(__file__).parent
SCORES = ("type1", "type2", "total", "kappa")
HEADINGS = {
    "type1": "T.I",
    "type2": "T.II",
    "total": "TE",
    "kappa": "kappa",
    "seconds": "s",
    "points": "points",
    "ground": "ground points",
    "seeds": "seeds",
    "sample": "sample",
    "method": "method",
}
FORMATS = {"points": ",.0f", "ground": ",.0f", "seeds": ",.0f", "seconds": ".3f"}
"""Of values that are not shown with two decimals."""


def arguments(name: str, description: str | None, given: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of a study called ``name``: data, out, samples, quick; ``command``: what was typed, for the report."""
    parser = CommandLine(str(HERE / f"{name}.py"), description, f"../out/papers/{name}")
    parser.add_argument(
        "--samples", type=samples.sample_name, nargs="+", metavar="SAMPLE", help="such as 11 24 [all of the paper]"
    )
    parser.add_argument("--quick", action="store_true", help="a few small samples and one call each")
    options = parser.options(given)
    keep_compilations()
    return options


def clouds(
    options: argparse.Namespace, of_paper: Sequence[str] = samples.SAMPLES
) -> Iterator[tuple[str, jf.PointCloud]]:
    """Name and cloud of each ISPRS sample that is asked for, such as "samp11": by default those ``of_paper``."""
    folder = samples.data_folder(options.data)
    quick = [s for s in ("24", "41", "54", "71", "52") if s in of_paper][:2]
    for number in options.samples or (quick if options.quick else of_paper):
        yield f"samp{number}", jf.read(samples.sample_path(folder, number))


def from_corner(options: argparse.Namespace, name: str, cloud: jf.PointCloud) -> jf.PointCloud:
    """The sample of :func:`clouds` with grids that count from its lower left point, as in the papers that say where."""
    path = samples.sample_path(samples.data_folder(options.data), name.removeprefix("samp"))
    return jf.read(path, anchor=cloud.coordinates()[:, :2].min(axis=0))


def agreed(answers: Iterable[bool | None]) -> bool | None:
    """The answer of all, or None where they differ."""
    found = set(answers)
    return found.pop() if len(found) == 1 else None


def score_row(
    sample: str, method: str, filter_: jf.Filter, cloud: jf.PointCloud, repeats: int = 1
) -> tuple[Row, jf.FilterResult]:
    """Errors in percent over all points, seconds of a warm call, and the counts of the run (``seeds``, ``rounds``, ...)."""
    from jaxfilter.sweeps.comparison import timed

    result, first, seconds = timed(filter_, cloud, repeats)
    scores = jf.evaluate(result, cloud.reference)
    row = {"sample": sample, "method": method, "points": len(cloud)} | {key: getattr(scores, key) for key in SCORES}
    row |= {"seconds": seconds, "first_call_seconds": first, "status": result.status.name}
    return row | {key: result.info.get(key) for key in ("seeds", "border_points", "rounds")}, result


def cpu_seconds(
    filters: Mapping[str, jf.Filter], cloud: jf.PointCloud, repeats: int, workers: int | None = 1
) -> dict[str, list[float]]:
    """By name, CPU seconds of ``repeats`` calls after a first one; one filter after the other in each repeat.

    They are those of all threads of this process, so that other work on the machine does not count.
    """
    spent: dict[str, list[float]] = {name: [] for name in filters}
    for _ in range(repeats + 1):
        for name, filter_ in filters.items():
            start = time.process_time()
            filter_(cloud, workers=workers)
            spent[name].append(time.process_time() - start)
    return {name: found[1:] for name, found in spent.items()}


def all_less(first: Sequence[float], second: Sequence[float]) -> bool | None:
    """Whether each of the first is less than each of the second; False: more, None: neither, the difference is not decided."""
    if max(first) < min(second):
        return True
    return False if min(first) > max(second) else None


def join(measured: Sequence[Row], printed: Sequence[Row], keys: Sequence[str], values: Sequence[str]) -> list[Row]:
    """The measured rows with ``printed_*`` and ``off_*`` (measured minus printed) for each of the ``values``.

    ``keys``: which columns name the same thing in both, such as ("sample", "method"). What was not printed stays absent.
    """
    table = {tuple(row[key] for key in keys): row for row in printed}
    out = []
    for row in measured:
        there: Mapping[str, Any] = table.get(tuple(row[key] for key in keys), {})
        row = dict(row)
        for value in values:
            if isinstance(there.get(value), (int, float)):
                row[f"printed_{value}"] = there[value]
                if isinstance(row.get(value), (int, float)):
                    row[f"off_{value}"] = row[value] - there[value]
        out.append(row)
    return out


def columns(rows: Sequence[Row], keys: Sequence[str], values: Sequence[str], off: bool = False) -> list[Column]:
    """Columns of a table of :func:`join`: each value, printed beside measured, where ``off`` with the difference."""
    out: list[Column] = [(key, HEADINGS.get(key, key), "") for key in keys]
    for value in values:
        title, form = HEADINGS.get(value, value), FORMATS.get(value, ".2f")
        out.append((value, title, form))
        if any(f"printed_{value}" in row for row in rows):
            out.append((f"printed_{value}", f"{title}, printed", form))
            if off:
                out.append((f"off_{value}", "difference", "+" + form))
    return out


def error_maps(cloud: jf.PointCloud, results: Mapping[str, jf.FilterResult]) -> Figure:
    """Error maps of the results side by side over the shaded reference ground, with their errors in the titles."""
    width, height = np.ptp(cloud.xyz[:, :2], axis=0)
    figure = Figure(figsize=(4.6 * len(results), 4.3 * min(float(height / width), 1.6) + 1.1), layout="constrained")
    surface = plots.rasterise(cloud.xyz[cloud.reference], over=cloud.xyz)
    for ax, (name, result) in zip(figure.subplots(1, len(results), squeeze=False)[0], results.items(), strict=True):
        scores = jf.evaluate(result, cloud.reference)
        title = f"{name}\nT.I {scores.type1:.1f}, T.II {scores.type2:.1f}, total error {scores.total:.2f} %"
        plots.error_map(cloud, result, cloud.reference, surface=surface, ax=ax, title=title)
        ax.label_outer()
    return figure


class Report:
    """Collects sections, tables and figures, writes each table and figure when it is added, and the text at the end.

    Files in the folder ``out``: ``results.md``, and per table ``<name>.csv``, per figure ``<name>.png``.
    """

    def __init__(self, title: str, source: str, options: argparse.Namespace) -> None:
        """``source``: the paper, in full. ``options``: of :func:`arguments`."""
        self.out: Path = options.out
        self._command: str = options.command
        self.parts = [f"# {title}", source]

    def text(self, *paragraphs: str) -> None:
        """Add paragraphs of Markdown."""
        self.parts.extend(paragraphs)

    def table(
        self, name: str, title: str, columns: Sequence[Column], rows: Sequence[Row], *, averages: str = ""
    ) -> None:
        """Add a section with a table, and write ``<name>.csv``. ``averages``: column to write mean and median under."""
        write_csv(self.out / f"{name}.csv", rows)
        self.text(f"## {title}", markdown(columns, with_averages(rows, averages) if averages else rows))

    def beside(
        self,
        name: str,
        title: str,
        measured: Sequence[Row],
        printed: Sequence[Row],
        *,
        keys: Sequence[str] = ("sample",),
        values: Sequence[str] = SCORES,
        averages: bool = True,
        off: bool = False,
    ) -> list[Row]:
        """Add a table of measured beside printed values, joined by ``keys``; returns its rows (see :func:`join`)."""
        rows = join(measured, printed, keys, values)
        self.table(name, title, columns(rows, keys, values, off), rows, averages=keys[0] if averages else "")
        return rows

    def figure(self, figure: Any, name: str, caption: str, dpi: int = 130) -> None:
        """Save a matplotlib figure as ``<name>.png`` and show it in the report."""
        save_png(figure, self.out / f"{name}.png", dpi)
        self.text(f"![{caption}]({name}.png)", caption)

    def verdict(self, claim: str, printed: str, measured: str, holds: bool | None) -> None:
        """Add a line on a claim of the paper: what it prints, what was measured; ``holds`` None = cannot be decided."""
        word = {True: "confirmed", False: "refuted", None: "undecided"}[holds]
        self.text(f"- **{claim}** Printed: {printed}. Measured: {measured}. **{word.capitalize()}.**")

    def write(self, *methods: str) -> None:
        """Write ``results.md``. ``methods``: those whose labels it stands on, and "scenes" (see ``report.write_page``)."""
        write_page(self.out / "results.md", "\n\n".join(self.parts), self._command, methods)
        print(f"results are in {self.out}")
