"""What the experiments share: tables as Markdown and CSV, small PNG files, and pages that say what they stand on."""

from __future__ import annotations

import argparse
import csv
import io
import math
import os
import platform
import re
import shlex
import statistics
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from jaxfilter.sweeps.comparison import Column, markdown

__all__ = [
    "Column", "CommandLine", "Made", "Row", "cores", "machine", "made", "markdown", "read_csv", "save_png", "with_averages",
    "write_csv", "write_page",
]  # fmt: skip

Row = dict[str, Any]
_started = time.perf_counter()
_spent: dict[Path, float] = {}


@dataclass(frozen=True)
class Made:
    """What a page says of itself: the command, when (UTC) and how long, and the labels it stands on by method."""

    command: str
    date: str
    seconds: int
    labels: dict[str, str]


class CommandLine(argparse.ArgumentParser):
    """The options of a script of these folders: ``--data``, ``--out``, and what is added.

    Args:
        script: its ``__file__``. text: its ``__doc__``. out: the folder for results beside it, if none is given.
    """

    def __init__(self, script: str, text: str | None, out: str = "out") -> None:
        super().__init__(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
        self.script = Path(script).resolve()
        self.add_argument("--data", type=Path, help="folder with isprs, tiles and so on [JAXFILTER_DATA]")
        folder = self.script.parent / out
        self.add_argument("--out", type=Path, default=folder, help="folder for the results [%(default)s]")

    def options(self, given: Sequence[str] | None) -> argparse.Namespace:
        """What is given, and the ``command`` for a page of results. The folder ``out`` is made."""
        given = sys.argv[1:] if given is None else list(given)
        found = self.parse_args(given)
        found.out.mkdir(parents=True, exist_ok=True)
        place = self.script.relative_to(Path(__file__).resolve().parents[1])
        found.command = shlex.join(["python", place.as_posix(), *given])
        return found


_MADE = re.compile(r"^`(python [^`]+)`, (\d{4}-\d\d-\d\d \d\d:\d\d) UTC, ([\d,]+) s on ", re.MULTILINE)
_LABELS = re.compile(r"^Labels: .*", re.MULTILINE)
_COUNTS = re.compile(r"`(\w+) ([\d ]+)`")


def made(path: Path) -> Made | None:
    """What the page says of itself; None if it does not exist or was not written by :func:`write_page`."""
    text = path.read_text() if path.exists() else ""
    found, labels = _MADE.search(text), _LABELS.search(text)
    if found is None or labels is None:
        return None
    return Made(found[1], found[2], int(found[3].replace(",", "")), dict(_COUNTS.findall(labels[0])))


def write_page(path: Path, text: str, command: str, methods: Iterable[str] = (), *, keeps: bool = False) -> None:
    """Write a page of results: after its title the command, date, duration and machine, and at its end the labels that it
    stands on, by which ``experiments/remake.py`` tells whether it is stale.

    Args:
        text: Markdown; the first line is the title.
        command: what makes this page anew, such as "python experiments/tiles/run.py".
        methods: whose labels the figures depend on, and "scenes" if simulated scenes are behind them. Names that are no
            method are passed over. None for pages on speed or files only.
        keeps: rows of methods whose labels have not changed are kept; then the duration is that of the longest run.
    """
    global _started
    from experiments.remake import SCENES
    from experiments.remake import counts as labels_of
    from jaxfilter import FILTERS

    wanted = set(methods)
    counts = {name: labels_of(name) for name in (*sorted(FILTERS), SCENES) if name in wanted}
    spent, _started = time.perf_counter() - _started, time.perf_counter()
    seconds = _spent[path] = _spent.get(path, 0.0) + spent  # a page may be written again and again
    before = made(path)
    if keeps and before and before.labels.items() & counts.items():
        seconds = max(seconds, before.seconds)
    command = re.sub(r" --data \S+", "", command)
    date = time.strftime("%Y-%m-%d %H:%M", time.gmtime())
    title, _, body = text.partition("\n")
    behind = ", ".join(f"`{name} {numbers}`" for name, numbers in counts.items())
    last = (
        f"ground points on the clouds of `experiments/remake.py`: {behind}" if behind else "none are behind this page"
    )
    head = f"`{command}`, {date} UTC, {max(seconds, 1):,.0f} s on {machine()}."
    part = path.with_name(path.name + ".part")
    part.write_text(f"{title}\n\n{head}\n\n{body.strip()}\n\nLabels: {last}.\n")
    part.replace(path)


def read_csv(path: Path) -> list[Row]:
    """Rows of a CSV file with a header; numbers become float, or int if they look like it."""
    with open(path, newline="") as file:
        return [{key: _number(value) for key, value in row.items()} for row in csv.DictReader(file)]


def _number(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Rows as CSV; the columns are the keys in the order in which they first appear, absent values stay empty."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def with_averages(rows: Sequence[Row], label: str) -> list[Row]:
    """The rows, and below them mean and median of every numeric column over the rows that have a value."""
    out = list(rows)
    for name, average in (("mean", statistics.fmean), ("median", statistics.median)):
        summary: Row = {label: name}
        for key in dict.fromkeys(key for row in rows for key in row):
            values = [v for row in rows if isinstance(v := row.get(key), (int, float)) and not math.isnan(v)]
            if values and key != label:
                summary[key] = average(values)
        out.append(summary)
    return out


def cores() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def machine() -> str:
    """One line on the hardware and the versions."""
    import jax

    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    packages = ", ".join(f"{name} {import_module(name).__version__}" for name in ("jaxfilter", "jax", "numpy", "scipy"))
    device = jax.devices()[0]
    return f"{cores()} cores of {model}; JAX on {device.device_kind}; Python {platform.python_version()}, {packages}"


def save_png(figure: Any, path: Path, dpi: int) -> None:
    """Save a matplotlib figure as PNG with a palette of 256 colours: a quarter of the size, and no difference to the eye."""
    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi)
    buffer.seek(0)
    picture = Image.open(buffer).convert("RGB")
    picture.quantize(256, kmeans=1, dither=Image.Dither.NONE).save(path, optimize=True)
