"""What commands print: the summary of a run, tables of classes, JSON."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from .session import Session

if TYPE_CHECKING:
    from ..core.filter import Filter
    from ..core.result import FilterResult


def run_report(filter_: Filter, result: FilterResult, session: Session) -> dict[str, Any]:
    """The summary of a run, in plain Python values."""
    return {
        "method": type(filter_).__name__,
        "status": result.status.name,
        "message": result.status.message,
        "points": len(result),
        "candidates": int(result.info["candidates"]),
        "ground": int(result.ground.sum()),
        "barred": int(result.barred.sum()),
        "barred_ground": int((result.barred & result.ground).sum()),
        "parameters": dataclasses.asdict(filter_),  # type: ignore[call-overload]
        "counts": result.info,
        **session.as_dict(),
    }


def print_report(report: dict[str, Any]) -> None:
    """Prints what `run_report` tells of a run, a line each: points, units, seconds, and what was kept or listed."""
    share = 100 * report["ground"] / max(report["points"], 1)
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in report["seconds"].items())
    compiled = report["compilations"]
    click.echo(
        f"{report['output']}: {report['ground']:,} of {report['points']:,} points are ground ({share:.1f} %), "
        f"{report['candidates']:,} were judged"
    )
    kept = (report.get("of_ground_class") or report["ground"]) - report["ground"]
    if kept:
        name, all_ = report["ground_class"], report["of_ground_class"]
        click.echo(f"{kept:,} points keep class {name} without being found ground, so that {all_:,} have it")
    xy, z = report.get("metres_per_unit", (1.0, 1.0))
    if (xy, z) != (1.0, 1.0):
        click.echo(f"coordinates are in {report['units']}: X and Y times {xy:.10g}, Z times {z:.10g} gave metres")
    if report["barred"]:
        click.echo(
            f"{report['barred']:,} points were barred from the seeds as outliers, of which "
            f"{report['barred_ground']:,} are ground in the end"
        )
    click.echo(
        f"{report['method']}: {report['message']}; {seconds}; "
        f"{compiled['count']} compilations in {compiled['seconds']:.2f} s"
    )
    if "review" in report:
        listed = report["review"]
        click.echo(
            f"{listed['output']}: {listed['places']:,} places with {listed['expected_errors']:,.0f} expected errors"
        )
    if report.get("labels"):
        click.echo(
            "the file holds " + ", ".join(f"label {one['label']}: {one['points']:,}" for one in report["labels"])
        )
    print_overlap(report.get("overlap", {}))
    if report.get("classes"):
        print_classes(report["classes"])


def print_overlap(counts: dict[str, int]) -> None:
    """What became of points in the overlap of flight lines, if there are any."""
    if not counts.get("points"):
        return
    what = "were not judged"
    if counts["judged"]:
        what = f"{counts['judged']:,} of them were judged and {counts['ground']:,} are ground; --ignore-overlap sets them aside"
    click.echo(f"{counts['points']:,} points are of class 12 or have the overlap flag: {what}")


def print_classes(changes: list[dict[str, int]]) -> None:
    """A table of old and new classes."""
    from rich.table import Table

    table = Table("class before", "class after", "points")
    for column in table.columns:
        column.justify = "right"
    for change in changes:
        old, new = change["before"], change["after"]
        table.add_row(str(old), "kept" if old == new else str(new), f"{change['points']:,}")
    Console().print(table)


def print_json(value: Any) -> None:
    """Print a value on standard output."""
    click.echo(json_text(value))


def json_text(value: Any) -> str:
    """A value as JSON; see ``_plain`` for what JSON does not know."""
    return json.dumps(_plain(value), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    """Values that JSON knows: NumPy values become numbers and lists, NaN becomes null, the rest strings."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else str(value)
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
