"""What the experiments share: tables as Markdown and CSV, small PNG files, and the machine that figures were measured on."""

from __future__ import annotations

import csv
import io
import math
import os
import platform
import statistics
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from jaxfilter.sweeps.tables import Column, markdown

__all__ = ["Column", "Row", "cores", "machine", "markdown", "read_csv", "save_png", "with_averages", "write_csv"]

Row = dict[str, Any]


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
