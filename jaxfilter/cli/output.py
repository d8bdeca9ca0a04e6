"""What commands print: the summary of a run, tables of classes, JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click
from rich.console import Console

from ..core.result import Status
from .session import Session, logger

if TYPE_CHECKING:
    from ..surveys.report import RunReport

_CUT_LISTED = 5


def run_facts(report: RunReport, session: Session) -> dict[str, Any]:
    """The summary of a run, in plain Python values."""
    facts = report.as_dict() | session.as_dict()
    facts |= {"seconds": dict(report.seconds), "remarks": dict(report.remarks)}
    if report.tiles == 1 and len(report.statuses) == 1:
        (status,) = report.statuses
        facts |= {"status": status, "message": Status[status].message}
    return facts


def print_report(report: dict[str, Any]) -> None:
    """Print what `run_facts` tells of a run, a line each: points, units, seconds, and what was kept or listed."""
    ground, points = report["ground"], report["points"]
    files = f"{count(len(report['files']), 'file')}, " if len(report["files"]) > 1 else ""
    click.echo(
        f"{report['output']}: {files}{ground:,} of {points:,} points are ground ({100 * ground / max(points, 1):.1f} %), "
        f"{report['candidates']:,} were judged"
    )
    kept = (report.get("of_ground_class") or ground) - ground
    if kept:
        name, what = report["ground_class"], "that were not judged" if report["all_reset"] else "that are not ground"
        holder = "the files now have" if files else "the file now has"
        verb = "keeps" if kept == 1 else "keep"
        click.echo(
            f"{count(kept, 'point')} {what} {verb} class {name}; {holder} {count(report['of_ground_class'], 'point')} of it"
        )
    xy, z = report.get("metres_per_unit", (1.0, 1.0))
    if (xy, z) != (1.0, 1.0):
        click.echo(f"coordinates are in {report['units']}: X and Y times {xy:.10g}, Z times {z:.10g} gave metres")
    if report["barred"]:
        click.echo(
            f"{count(report['barred'], 'point')} could not be seeds, since they are outliers; {report['barred_ground']:,} of "
            "them became ground later"
        )
    ended = report.get("message") or ", ".join(f"{Status[k].message}: {n:,}" for k, n in report["statuses"].items())
    compiled = report["compilations"]
    click.echo(
        f"{report['method']}: {ended}; {times(report['seconds'])}; {compiled['count']} compilations in "
        f"{compiled['seconds']:.2f} s"
    )
    if report.get("tiles", 1) > 1:
        click.echo(
            f"{count(report['tiles'], 'tile')} in {report['elapsed']:.1f} s; with their halos they hold "
            f"{report['read'] / max(points, 1):.2f} times the points"
        )
    if listed := report.get("review"):
        click.echo(
            f"{listed['output']}: {listed['places']:,} places with {listed['expected_errors']:,.0f} expected errors"
        )
    if labels := report.get("labels"):
        click.echo("the file holds " + ", ".join(f"label {one['label']}: {one['points']:,}" for one in labels))
    print_overlap(report.get("overlap", {}))
    if report.get("classes"):
        print_classes(report["classes"])


def tell(session: Session, report: RunReport) -> None:
    """Lines on the steps of a run, on what it warned of, and on what it could not do."""
    for name, seconds in report.seconds.items():
        logger.info(f"{name}: {seconds:.2f} s")
    tell_cut(session, report.cut_objects)
    for remark, times in report.remarks.items():
        session.warn_of(remark + (f" ({times} times)" if times > 1 else ""))
    for one in report.set_aside:
        session.warn(f"tile {one['tile']} {one['core']} was set aside: {one['reason']}")
    for one in report.left_out:
        session.warn(f"{one['file']} was left out, so that tiles beside it lack its points: {one['reason']}")
    for one in report.again:
        session.warn(f"{one['file']}: {one['reason']}, so it had to be made again")
    for one in report.failed:
        session.warn(f"{one['file']} was not written: {one['reason']}")


def tell_cut(session: Session, objects: Sequence[dict[str, Any]]) -> None:
    """Lines on objects that the border of the data cuts, given as dicts of ``jaxfilter.CutObject``."""
    wrong = sorted((one for one in objects if one["ground"] >= 0.5), key=lambda one: -one["area"])
    if rest := len(objects) - len(wrong):
        were, them = ("was", "it") if rest == 1 else ("were", "them")
        session.note(
            f"{count(rest, 'object')} cut by the edge of the data {were} classified as non-ground; please check {them}"
        )
    if wrong:
        listed = [f"{one['area']:,.0f} m2 at {one['x']:.10g} {one['y']:.10g}" for one in wrong[:_CUT_LISTED]]
        more = f" and {len(wrong) - len(listed):,} more (--json lists all)" if len(wrong) > len(listed) else ""
        were, may = ("was", "a cut roof") if len(wrong) == 1 else ("were", "cut roofs")
        session.warn(
            f"{count(len(wrong), 'object')} at the edge of the data may be {may} and {were} classified as ground: "
            f"{'; '.join(listed)}{more}"
        )


def times(seconds: Mapping[str, float]) -> str:
    """Seconds of each step: read 0.12 s, write 0.30 s."""
    return ", ".join(f"{name} {value:.2f} s" for name, value in seconds.items())


def count(number: int, noun: str) -> str:
    """1 tile, 1,200 tiles."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


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
    moves = ((change["before"], change["after"], change["points"]) for change in changes)
    rows = [(str(old), "kept" if old == new else str(new), f"{points:,}") for old, new, points in moves]
    print_table(("class before", "class after", "points"), rows)


def print_table(heading: Sequence[str], rows: Iterable[Sequence[str]], left: int = 0, title: str | None = None) -> None:
    """Print a table on standard output; columns are set to the right, but the first ``left`` ones.

    Values that are too long for a terminal are folded, since a number that is cut off is of no use; other programs get a line
    for each row.
    """
    from rich.table import Table

    table = Table(title=title)
    for number, name in enumerate(heading):
        table.add_column(name, justify="left" if number < left else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console = Console()
    if not console.is_terminal:
        console.width = 10_000
    console.print(table)


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
