"""What commands print: the summary of a run, tables of classes, JSON; and how they run, in a session."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.result import Status, plain
from .session import LINE_EVERY, BadUsage, Session, logger
from .values import OUTPUT, option

if TYPE_CHECKING:
    from ..surveys.report import Forecast, RunReport
    from .options import Files

_PLACES_LISTED, _FILES_LISTED = 5, 5
_COMPLETE = "is complete already, and nothing was done. Pass --overwrite to make it again"


def run_facts(session: Session, report: RunReport, files: Files | None = None) -> dict[str, Any]:
    """The summary of a run, in plain Python values."""
    facts = session.as_dict() | report.as_dict()
    if report.tiles == 1 and len(report.statuses) == 1:
        (status,) = report.statuses
        facts |= {"status": status, "message": Status[status].message}
    if files is not None:
        facts |= {"input": files.inputs[0] if len(files.inputs) == 1 else files.inputs, "output": files.output}
    return facts


def report_text(report: dict[str, Any]) -> str:
    """What `run_facts` tells of a run, a line each: points, units, seconds, and what was kept or listed."""
    if report["was_complete"]:
        return f"{report['output']} {_COMPLETE}"
    ground, points = report["ground"], report["points"]
    files = f"{count(len(report['files']), 'file')}, " if len(report["files"]) > 1 else ""
    share, judged = 100 * ground / max(points, 1), f"{report['candidates']:,} were judged"
    lines = [f"{report['output']}: {files}{ground:,} of {points:,} points are ground ({share:.1f} %), {judged}"]
    marked = report["overlap"]
    if kept := max(0, (report.get("of_ground_class") or 0) - ground + marked.get("kept", 0)):
        which = "were not judged" if report["all_reset"] else "are not ground"
        words = f"points that {which} keep class {report['ground_class']}: {kept:,}"
        lines.append(f"{words}; in all {report['of_ground_class']:,} points have it")
    xy, z = report.get("metres_per_unit", (1.0, 1.0))
    if (xy, z) != (1.0, 1.0):
        lines.append(f"coordinates are in {report['units']}: X and Y times {xy:.10g}, Z times {z:.10g} gave metres")
    ended = report.get("message") or ", ".join(f"{Status[k].message}: {n:,}" for k, n in report["statuses"].items())
    sensor = (report["parameters"] or {}).get("sensor")
    done = "; ".join(part for part in (ended, times(report["seconds"])) if part)
    lines.append(f"{report['method']}{f' for {sensor}' if sensor else ''}: {done}")
    if report["tiles"] > 1:
        lines.append(f"{count(report['tiles'], 'tile')} in {report['elapsed']:.1f} s")
    if report.get("review"):
        from ..reports.places import UNKNOWN_AREA  # late: it brings SciPy's image functions

        volume = sum(place["volume"] for place in report["places"] if place["reason"] != UNKNOWN_AREA)
        places = count(len(report["places"]), "place")
        lines.append(f"{report['review']}: {places}, {volume:,.0f} m3 of errors to expect")
    if report.get("breaklines"):
        lines.append(f"{report['breaklines']}: {count(report['water_bodies'], 'outline')} of water")
    if labels := report.get("labels"):
        lines.append("the file holds " + ", ".join(f"label {one['label']}: {one['points']:,}" for one in labels))
    if marked.get("points"):
        what = f"{marked['judged']:,} of them were judged and {marked['ground']:,} are ground; --ignore-overlap sets them aside"
        what = what if marked["judged"] else "were not judged"
        lines.append(f"{marked['points']:,} points are of class 12 or have the overlap flag: {what}")
    if report["classes"]:
        from ..files.classes import class_name

        moves = [(one["before"], one["after"], one["points"]) for one in report["classes"]]
        rows = [(class_name(old), "kept" if old == new else class_name(new), f"{n:,}") for old, new, n in moves]
        lines.append(table_text(("class before", "class after", "points"), rows, left=2))
    return "\n".join(lines)


def tell(session: Session, report: RunReport) -> None:
    """Lines on the steps of a run, on what it warned of, and on what it could not do."""
    for name, seconds in report.seconds.items():
        logger.info(f"{name}: {seconds:.2f} s")
    unknown = []
    if report.places:
        from ..reports.places import UNKNOWN_AREA  # late: it brings SciPy's image functions

        unknown = [place["area"] for place in report.places if place["reason"] == UNKNOWN_AREA]
    if places := report.places[: len(report.places) - len(unknown)]:
        top = places[:_PLACES_LISTED]
        listed = [f"{one['area']:,.0f} m2 at {one['x']:.10g} {one['y']:.10g} ({one['reason']})" for one in top]
        more = f"; and {len(places) - len(listed):,} more (--json lists all)" if len(places) > len(listed) else ""
        words = f"{count(len(places), 'place')} where the terrain may be wrong, please check"
        session.note(f"{words}: {'; '.join(listed)}{more}")
    if unknown:
        session.note(f"{UNKNOWN_AREA}: {sum(unknown):,.0f} m2 in {count(len(unknown), 'place')}")
    alike: dict[str, list[str]] = {}  # what is said of many files is said once
    for remark in report.remarks:
        alike.setdefault(remark.partition(": ")[2] or remark, []).append(remark)
    for what, remarks in alike.items():
        first, others = remarks[0], len(remarks) - 1
        if others:
            name = first.removesuffix(f": {what}")
            session.warn(f"{name} and {count(others, 'other file')}: {what}")
        else:
            session.warn(first, report.remarks[first])
    for one in report.set_aside:
        session.warn(f"tile {one['tile']} {one['core']} was set aside: {one['reason']}")
    named = " ".join(session.warnings)
    for one in (one for one in report.left_out if one["file"] not in named):
        session.warn(f"{one['file']} was left out, so that tiles beside it lack its points: {one['reason']}")
    for one in report.failed:
        session.warn(f"{one['file']} was not written: {one['reason']}")


def answer_of(files: Files, report: RunReport, text: str) -> Answer:
    """What a run has found, with lines on what it warned of and could not do."""
    tell(files.session, report)
    text = f"{files.output} {_COMPLETE}" if report.was_complete else text
    if lost := list(dict.fromkeys(one["file"] for one in (*report.failed, *report.left_out))):
        text += (
            f"\n{count(len(lost), 'file')} could not be read, and outputs are empty where they lie: {', '.join(lost)}"
        )
    return Answer(run_facts(files.session, report, files), text, complete=report.complete)


def plan_answer(plan: Forecast) -> Answer:
    """What a run would do."""
    each = "" if plan.tiles == 1 else f" of {plan.side:,.0f} m with {plan.halo:,.0f} m around"
    read = "" if plan.tiles == 1 else f", each point read {plan.times_read:.1f} times"
    more = ", ..." * (len(plan.files) > _FILES_LISTED)
    lines = [
        f"points  {plan.points:,} in {count(plan.tiles, 'tile')}{each}{read}",
        f"memory  {plan.memory / 1e9:.1f} GB for {count(plan.workers, 'worker')}",
        f"time    about {_span(plan.seconds)}, by the number of points and a rate; other machines differ by a factor of two",
        f"files   {len(plan.files):,} to write: {', '.join(plan.files[:_FILES_LISTED])}{more}",
        "nothing was written, since --dry-run was given",
    ]
    return Answer(plan._asdict(), "\n".join(lines), always=True)


def _span(seconds: float) -> str:
    if seconds < 120:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def times(seconds: Mapping[str, float]) -> str:
    """Seconds of each step: read 0.12 s, write 0.30 s."""
    return ", ".join(f"{name} {value:.2f} s" for name, value in seconds.items())


def count(number: int, noun: str) -> str:
    """1 tile, 1,200 tiles."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def table_text(heading: Sequence[str], rows: Iterable[Sequence[str]], left: int = 0) -> str:
    """A table, a line for each row; columns are set to the right, but the first ``left`` ones."""
    lines = [heading, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    cells = ([f"{cell:{'<' if k < left else '>'}{widths[k]}}" for k, cell in enumerate(line)] for line in lines)
    return "\n".join("  ".join(line).rstrip() for line in cells)


def json_text(value: Any) -> str:
    """A value as JSON: NumPy values become numbers and lists, NaN becomes null, what else JSON does not know text."""
    text = json.dumps(value, default=plain)
    known = json.loads(text, parse_constant={"NaN": None, "Infinity": "inf", "-Infinity": "-inf"}.get)
    return json.dumps(known, indent=2)


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a command has found.

    Attributes:
        facts: printed by --json.
        text: for people.
        always: printed with --quiet as well.
        complete: False: something could not be done, and the exit code is 1.
    """

    facts: dict[str, Any]
    text: str
    always: bool = False
    complete: bool = True


_EVERY = "Seconds between lines of progress, if standard error is no terminal."
SESSION = [
    option("--quiet -q", "Print warnings and errors only. Answers of info, evaluate and --dry-run stay.", bool),
    option("--json as_json", "Print the result as JSON.", bool),
    option("--log", "Append each step with its time, warnings and errors to this file.", OUTPUT),
    option("--progress-every", _EVERY, click.FloatRange(0), default=LINE_EVERY),
    option("--debug", "Show the traceback of an error.", bool),
]
"""The options of every command that works."""


def in_session(command: Callable[..., Answer]) -> Callable[..., None]:
    """``command``, which gets a Session before its arguments, with the options of all commands that work."""

    @functools.wraps(command)
    def run(as_json: bool, log: Path | None, **arguments: Any) -> None:
        how = {name: arguments.pop(name) for name in ("quiet", "debug", "progress_every")}
        names = [one for value in arguments.values() for one in (value if isinstance(value, tuple) else [value])]
        files = [name for name in names if log is not None and isinstance(name, (str, Path))]
        if log is not None and os.path.realpath(log) in map(os.path.realpath, files):
            raise BadUsage(f"--log {log}: is an input or output as well: name another file")
        with Session(log=log, **how) as session:
            answer = command(session, **arguments)
            if session.pipe is not None and session.pipe.exists():
                with session.pipe.open("rb") as file:
                    shutil.copyfileobj(file, sys.stdout.buffer)
        if as_json or answer.always or not session.quiet:
            text = json_text(session.as_dict() | answer.facts) if as_json else answer.text
            click.echo(text, err=session.pipe is not None)
        if not answer.complete:
            click.get_current_context().exit(1)

    return run
