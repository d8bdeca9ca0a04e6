"""``jaxfilter ground`` for collections: folders, patterns, several files, virtual point clouds, URLs."""

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
    from ..tiles.run import RunReport, Standing

_UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}
_SINGLE = ("bounds", "in_place", "review", "review_area")
"""Options that only a single file takes."""


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
    metres: dict[str, Any] = {"metavar": "METRES"}
    positive = click.FloatRange(0, min_open=True)
    return [
        click.Option(
            ["--halo"],
            type=click.FloatRange(0),
            help=of_collections("width read around each tile", "by METHOD"),
            **metres,
        ),
        click.Option(["--tile"], type=positive, help=of_collections("side of the tiles", "by the memory"), **metres),
        click.Option(
            ["--memory"], type=Bytes(), help=of_collections("for all processes, such as 4GB", "70 % of what is free")
        ),
        click.Option(
            ["--scheduler"], metavar="ADDRESS", help=of_collections("a Dask scheduler that has the work done")
        ),
        click.Option(["--resume"], is_flag=True, help=of_collections("go on with the run that was begun in OUT")),
    ]


def of_collections(words: str, default: str = "") -> str:
    """Help on an option that only collections take."""
    return f"Of a collection: {words}." + (f"  [default: {default}]" if default else "")


def is_collection(paths: Sequence[str]) -> bool:
    """Whether the words IN... OUT name more than a file and a file."""
    *inputs, last = paths
    if len(inputs) != 1:
        return len(inputs) > 1
    name = inputs[0]
    many = "://" in name or os.path.isdir(name) or name.lower().endswith(".vpc")
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
    from .commands import check_reading, print_json

    for name in _SINGLE:
        if ctx.get_parameter_source(name) == ParameterSource.COMMANDLINE:
            raise BadUsage(
                f"--{name.replace('_', '-')} is for a single file, and {', '.join(paths[:-1])} is a collection"
            )
    *inputs, out = paths
    check_named(inputs, method is None)
    reading = {k: options[k] for k in ("returns", "keep_withheld", "drop_invalid")}
    reading["ignore_classes"] = tuple(c for c in options["ignore_classes"] if c is not None)
    kept = ("halo", "tile", "memory", "workers", "resume", "overwrite", "ground_class", "other_class", "reset")
    with Session(quiet=quiet, debug=debug) as session:
        if method is not None:  # what is wrong with the parameters is said before anything is read
            method.preset(options["preset"], **changes) if options["preset"] else method(**changes)
        check_reading(options["units"], options["returns"])
        from ..tiles.collection import open as open_collection
        from ..tiles.ground import ground
        from ..tiles.setup import filter_for, sampled

        with session.step("headers"):
            collection = open_collection(inputs, units=options["units"])
            for line in collection.check().lines():
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
            return filter_, sample.whole

        with session.step("filter", collection.count), _to_be_resumed():
            report = ground(
                collection,
                Path(out),
                setup=setup,
                client=options["scheduler"],
                only_ground=options["only_ground"],
                noise_class=options["noise_class"],
                extra=options["extra"],
                progress=shown(session),
                **{name: options[name] for name in kept},
                **reading,
            )
        for line in _faults(report):
            session.warn(line)
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
    from ..filters import FILTERS

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


@contextlib.contextmanager
def _to_be_resumed() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note("the same command with --resume goes on")
        raise


def _print(report: RunReport, facts: dict[str, Any]) -> None:
    from .commands import print_classes

    share = 100 * report.ground / max(report.points, 1)
    click.echo(
        f"{facts['output']}: {len(report.files):,} files, {report.ground:,} of {report.points:,} points are ground "
        f"({share:.1f} %), {report.candidates:,} were judged"
    )
    click.echo(
        f"{facts['method']}: {report.tiles:,} tiles in {report.seconds:.1f} s; with their halos they hold "
        f"{report.read / max(report.points, 1):.2f} times the points"
    )
    if facts["classes"]:
        print_classes(facts["classes"])


def _faults(report: RunReport) -> list[str]:
    """A line on everything that was warned of, or could not be done."""
    lines = [remark + (f" ({times} times)" if times > 1 else "") for remark, times in report.remarks.items()]
    lines += [f"tile {one['tile']} {one['core']} was set aside: {one['reason']}" for one in report.set_aside]
    lines += [
        f"left out, so that tiles beside it lack its points: {one['file']}: {one['reason']}" for one in report.left_out
    ]
    return lines + [f"not written: {one['file']}: {one['reason']}" for one in report.failed]
