"""The ``from-pdal`` command: a pipeline of PDAL as a command line."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .commands import command
from .options import UNITS
from .output import Answer
from .session import Session
from .values import INPUT

if TYPE_CHECKING:
    from ..core.units import Units
    from ..pdal import Translation

_SUFFIXES = (".las", ".laz")


@command(click.Argument(["pipeline"], metavar="PIPELINE.json", type=INPUT), UNITS)
def from_pdal(session: Session, pipeline: Path, units: str | None) -> Answer:
    """Print the command that does what the ground stage of a pipeline of PDAL does.

    The stage is filters.smrf, filters.pmf or filters.csf. Its lengths are in the units of the coordinates (--units, or the CRS
    of the file that the pipeline reads, if it is there); those of the command are metres. Standard error lists what has no
    counterpart.
    """
    from ..pdal import translate

    found = translate(pipeline, units=units or "m")
    own = _units_of(found.inputs) if units is None else None
    if own is not None and (own.xy, own.z) != (1.0, 1.0):
        found = translate(pipeline, units=own)
    words, remarks = _words(found, units)
    if units is None and own is None:
        remarks = ["lengths are taken as metres: pass --units if the coordinates are in feet", *remarks]
    remarks = [*found.unmatched, *found.remarks, *remarks]
    facts = {
        "stage": found.stage,
        "method": type(found.filter).__name__,
        "preset": found.preset,
        "parameters": dataclasses.asdict(found.filter),  # type: ignore[call-overload]
        "reading": found.reading,
        "writing": found.writing,
        "command": shlex.join(words),
        "notes": remarks,
    }
    for text in remarks:
        session.note(f"note: {text}")
    return Answer(facts, shlex.join(words), always=True)


def _units_of(inputs: tuple[str, ...]) -> Units | None:
    """Of the first file, if it is a LAS file that can be read."""
    from ..core.errors import JaxfilterError
    from ..core.units import linear_units
    from ..files.reading import open_las

    if not inputs or not Path(inputs[0]).is_file() or Path(inputs[0]).suffix.lower() not in _SUFFIXES:
        return None
    try:
        return linear_units(open_las(Path(inputs[0])).reference, inputs[0])
    except JaxfilterError:
        return None


def _words(found: Translation, units: str | None) -> tuple[list[str], list[str]]:
    """The words of the command, and remarks on the names of files in it."""
    from . import flags

    filter_, base = found.filter, type(found.filter).preset(found.preset)
    remarks = []
    inputs = found.inputs or ("IN.laz",)
    out = found.outputs[-1] if found.outputs else "OUT.laz"
    if len(inputs) > 1:
        remarks.append(f"several files are filtered as a collection, into a folder, so OUT is one, and not {out}")
        out = "OUT/"
    elif Path(out).suffix.lower() not in _SUFFIXES or out.lower().endswith(".copc.laz"):
        remarks.append(f"{out} cannot be written: OUT is LAS or LAZ")
        out = "OUT.laz"
    preset = ["--preset", found.preset] if base != type(filter_)() else []
    words = flags.command_for(filter_, [*inputs, out, *preset], base)
    reading = dict(found.reading)
    for number in reading.pop("ignore_classes") or ("none",):
        words += ["--ignore-class", str(number)]
    if units:
        reading["units"] = units
    for name, value in {**reading, **found.writing}.items():
        words += [] if value is False else flags.words_for(name, value)
    return words, remarks
