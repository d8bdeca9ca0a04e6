"""What commands share on collections (folders, patterns, several files, virtual point clouds, URLs), and ``ground`` of them."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from .session import BadUsage, Session, logger

if TYPE_CHECKING:
    from ..core.filter import Filter
    from ..surveys.run import RunReport, Standing

_CUT_LISTED = 5
_UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_SINGLE = ("bounds", "in_place", "review", "review_area")
"""Options that only a single file takes."""
READING = ("returns", "ignore_classes", "ignore_overlap", "keep_withheld", "drop_invalid")
"""Options on which points are judged."""


class Bytes(click.ParamType):
    """A number of bytes: 4e9, 4GB, 512MiB."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Bytes of a text."""
        if isinstance(value, float):
            return value
        found = re.fullmatch(r"([\d.]+(?:e\d+)?)\s*([kmgt]?i?)b?", str(value).strip().lower())
        if found is None or float(found[1]) <= 0:
            self.fail(f"{value!r} is no number of bytes, such as 4GB or 512MiB.", param, ctx)
        return float(found[1]) * _UNITS[found[2]]


def options() -> list[click.Parameter]:
    """The options that only collections take."""
    return [
        click.Option(
            ["--halo"],
            type=click.FloatRange(0),
            metavar="METRES",
            help=of_collections("width read around each tile", "by METHOD"),
        ),
        *resources(RESOURCES),
    ]


RESOURCES = ("tile", "memory", "scheduler", "work", "resume")
"""Options on where and in which pieces a collection is worked on."""


def resources(names: Sequence[str]) -> list[click.Option]:
    """Those of :data:`RESOURCES` that a command takes."""
    made = {
        "tile": click.Option(
            ["--tile"],
            type=click.FloatRange(0, min_open=True),
            metavar="METRES",
            help=of_collections("side of the tiles", "by the memory"),
        ),
        "memory": click.Option(
            ["--memory"], type=Bytes(), help=of_collections("for all processes, such as 4GB", "70 % of what is free")
        ),
        "scheduler": click.Option(
            ["--scheduler"], metavar="ADDRESS", help=of_collections("a Dask scheduler that has the work done")
        ),
        "work": click.Option(
            ["--work"],
            metavar="FOLDER",
            help=of_collections("for the journal; needed if OUT is a URL", "OUT"),
        ),
        "resume": click.Option(
            ["--resume"], is_flag=True, help=of_collections("go on with the run that was begun for OUT")
        ),
    }
    return [made[name] for name in names]


def of_collections(words: str, default: str = "") -> str:
    """Help on an option that only collections take."""
    return f"Of a collection: {words}." + (f"  [default: {default}]" if default else "")


def is_collection(paths: Sequence[str]) -> bool:
    """Whether the words IN... OUT name more than a file and a file.

    Of URLs the name decides: OUT is a file if it ends as one. IN is a file if OUT is one of points.
    """
    from ..files.text import SUFFIXES as TEXT
    from ..files.writing import LAS_SUFFIXES as LAS
    from ..terrain.raster import SUFFIXES

    *inputs, last = paths
    if len(inputs) != 1:
        return len(inputs) > 1
    name = inputs[0]
    into_points = last.lower().endswith((*LAS, *TEXT))
    many = (
        ("://" in name and not (into_points and name.lower().endswith(LAS)))
        or ("://" in last and not (into_points or last.lower().endswith(SUFFIXES)))
        or os.path.isdir(name)
        or name.lower().endswith(".vpc")
    )
    pattern = any(c in name for c in "*?[") and not os.path.exists(name)
    return many or pattern or os.path.isdir(last) or last.endswith(("/", "\\"))


def ground_collection(
    ctx: click.Context,
    method: type[Filter] | None,
    changes: dict[str, Any],
    paths: Sequence[str],
    *,
    quiet: bool,
    as_json: bool,
    debug: bool,
    **options: Any,
) -> None:
    """Run ``ground`` on a collection and print what it did. Exit code 1 if anything could not be done."""
    from .checks import check_reading
    from .output import print_json

    for name in _SINGLE:
        if ctx.get_parameter_source(name) == ParameterSource.COMMANDLINE:
            raise BadUsage(f"--{name.replace('_', '-')} is for a single file, and {named(paths)} is a collection")
    *inputs, out = paths
    check_named(inputs, method is None)
    reading = {k: options[k] for k in READING}
    reading["ignore_classes"] = tuple(c for c in options["ignore_classes"] if c is not None)
    kept = ("halo", "tile", "memory", "workers", "work", "resume", "overwrite", "ground_class", "other_class", "reset")
    with Session(quiet=quiet, debug=debug) as session:
        if method is not None:  # what is wrong with the parameters is said before anything is read
            method.preset(options["preset"], **changes) if options["preset"] else method(**changes)
        check_reading(options["units"], options["returns"])
        from ..surveys.collection import open as open_collection
        from ..surveys.ground import ground
        from ..surveys.setup import filter_for, sampled, whole_for

        with session.step("headers"):
            collection = open_collection(inputs, units=options["units"])
            findings = dataclasses.replace(collection.check(), mixed=None)  # the run says that in its error
            for line in findings.lines():
                if not quiet:
                    click.echo(f"note: {line}", err=True)
        chosen: list[Filter] = []

        def setup(files: Any, how: dict[str, Any], index: Path) -> tuple[Filter, Any]:
            sample = sampled(files, how, index)
            filter_ = filter_for(
                sample,
                method,
                changes,
                preset=options["preset"],
                for_cloud=options["for_cloud"],
                largest_building=options["largest_building"],
            )
            chosen.append(filter_)
            return filter_, whole_for(filter_, sample, files, how, index)

        with session.step("filter", collection.count), to_be_resumed():
            report = ground(
                collection,
                out,
                setup=setup,
                client=options["scheduler"],
                only_ground=options["only_ground"],
                noise_class=options["noise_class"],
                extra=options["extra"],
                progress=shown(session),
                **{name: options[name] for name in kept},
                **reading,
            )
        tell(session, report)
        logger.info(f"{out}: {len(report.files):,} files, {report.ground:,} of {report.points:,} points are ground")
    facts = report.as_dict() | {
        "method": type(chosen[0]).__name__,
        "parameters": dataclasses.asdict(chosen[0]),  # type: ignore[call-overload]
        "output": str(out),
        **session.as_dict(),
    }
    if as_json:
        print_json(facts)
    elif not quiet:
        _print(report, facts)
    if not report.complete:
        ctx.exit(1)


def check_named(inputs: Sequence[str], bare: bool = False) -> None:
    """Raises BadUsage for a name that stands for nothing; ``bare``: the first of them might be meant as a method."""
    from ..methods import FILTERS

    for number, name in enumerate(inputs):
        if "://" in name or any(c in name for c in "*?[") or Path(name).exists():
            continue
        words = (
            f", and no method: choose one of {', '.join(FILTERS)}" if bare and number == 0 and "." not in name else ""
        )
        raise BadUsage(f"{name}: no such file or folder{words}")


def shown(session: Session) -> Any:
    """The callback that shows how far a run is."""

    def show(standing: Standing) -> None:
        note = f"{standing.tiles_done:,} of {standing.tiles:,}"
        session.progress(standing.tiles_done / max(standing.tiles, 1), standing.step, note, standing.rate)

    return show


def count(number: int, noun: str) -> str:
    """1 tile, 1,200 tiles."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def named(paths: Sequence[str]) -> str:
    """The words IN of IN... OUT."""
    return ", ".join(paths[:-1])


@contextlib.contextmanager
def to_be_resumed() -> Iterator[None]:
    """A block of which whoever stops it is told how it goes on."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note("the same command with --resume goes on")
        raise


def _print(report: RunReport, facts: dict[str, Any]) -> None:
    from .output import print_classes, print_overlap

    share = 100 * report.ground / max(report.points, 1)
    click.echo(
        f"{facts['output']}: {count(len(report.files), 'file')}, {report.ground:,} of {report.points:,} points are ground "
        f"({share:.1f} %), {report.candidates:,} were judged"
    )
    click.echo(
        f"{facts['method']}: {count(report.tiles, 'tile')} in {report.seconds:.1f} s; with their halos they hold "
        f"{report.read / max(report.points, 1):.2f} times the points"
    )
    print_overlap(facts["overlap"])
    if facts["classes"]:
        print_classes(facts["classes"])


def tell(session: Session, report: RunReport) -> None:
    """Lines on what a run warned of, and what it could not do."""
    tell_cut(session, report.cut_objects)
    for remark, times in report.remarks.items():
        session.warn(remark + (f" ({times} times)" if times > 1 else ""))
    for one in report.set_aside:
        session.warn(f"tile {one['tile']} {one['core']} was set aside: {one['reason']}")
    for one in report.left_out:
        session.warn(f"left out, so that tiles beside it lack its points: {one['file']}: {one['reason']}")
    for one in report.again:
        session.warn(f"{one['file']}: {one['reason']}, so it had to be made again")
    for one in report.failed:
        session.warn(f"not written: {one['file']}: {one['reason']}")


def tell_cut(session: Session, objects: Sequence[dict[str, Any]]) -> None:
    """Lines on objects that the border of the data cuts, given as dicts of ``jaxfilter.CutObject``."""
    if not objects:
        return
    wrong = sorted((one for one in objects if one["ground"] >= 0.5), key=lambda one: -one["area"])
    rest = len(objects) - len(wrong)
    if rest:
        what, are = ("1 object", "is") if rest == 1 else (f"{rest:,} objects", "are")
        session.note(f"{what} that the border of the data cuts {are} not ground")
    if not wrong:
        return
    listed = [f"{one['area']:,.0f} m2 at {one['x']:.10g} {one['y']:.10g}" for one in wrong[:_CUT_LISTED]]
    more = f" and {len(wrong) - len(listed):,} more (--json lists all)" if len(wrong) > len(listed) else ""
    what = "1 object" if len(wrong) == 1 else f"{len(wrong):,} objects"
    may = "a cut roof" if len(wrong) == 1 else "cut roofs"
    session.warn(f"{what} at the border of the data may be {may} and became ground: {'; '.join(listed)}{more}")
