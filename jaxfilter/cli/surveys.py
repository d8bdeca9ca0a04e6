"""The ``info`` command: what a file says of itself, or a survey of many."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.reading import Reading
from .commands import command
from .options import REPLACE, STATED, check_target, open_survey, take
from .output import Answer, count, table_text
from .session import Session
from .values import OUTPUT, option

if TYPE_CHECKING:
    from ..surveys.collection import Collection

_ROWS = 40  # of a table on the screen
_WORDS = {"spacing": "metres between candidates", "density": "candidates per m2"}  # of the facts on a file


@command(
    click.Argument(["names"], metavar="FILE|FOLDER|PATTERN|VPC|URL...", nargs=-1, required=True),
    *STATED,
    option("--vpc", "Write the survey as a virtual point cloud.", OUTPUT),
    option("--map picture", "Draw a map of the files as PNG, PDF or SVG.", OUTPUT),
    REPLACE,
)
def info(session: Session, names: tuple[str, ...], vpc: Path | None, picture: Path | None, **options: Any) -> Answer:
    """Show points, extent, CRS, units, classes and echoes of a file.

    For several files, a folder, a pattern or a virtual point cloud (.vpc), it prints a table from the headers and some points. It
    also lists overlaps, gaps, doubles, files that cannot be read, and mixed CRS or units. The exit code is 1 if a file cannot be
    read.
    """
    from ..files.disk import new_file
    from ..files.storage import place_of
    from ..reports import info as of_file

    how, overwrite = take(Reading, options), options["overwrite"]
    for target, suffixes in ((vpc, (".vpc",)), (picture, (".png", ".pdf", ".svg"))):
        if target is not None:
            check_target(target, overwrite, suffixes)
    place = place_of(names[0])
    one_file = len(names) == 1 and isinstance(place, Path) and place.is_file() and place.suffix.lower() != ".vpc"
    if one_file and vpc is None and picture is None:
        with session.reading(place):
            about = of_file.info(place, units=how.units, crs=how.crs)
        lines = {_WORDS.get(key, key.replace("_", " ")): _plain(value) for key, value in about.items()}
        width = max(len(k) for k in lines)
        return Answer(about, "\n".join(f"{key:{width}}  {value}" for key, value in lines.items()), always=True)
    survey = open_survey(session, names, how)
    with session.step("check"):
        survey = survey.probed()
        findings = survey.check()
    if vpc is not None:
        survey.to_vpc(vpc, overwrite=overwrite)
    if picture is not None:
        with new_file(picture, overwrite=overwrite) as part:
            survey.plot().figure.savefig(part, format=picture.suffix[1:].lower())
    mixed, area = findings.mixed is not None, float(survey.areas.sum())
    facts = {
        "files": len(survey),
        "points": survey.count,
        "bounds": None if mixed else survey.bounds,
        "area": area,
        "density": survey.count / area if area else math.nan,
        "crs": None if mixed or survey.crs is None else survey.crs.name,
        "units": None if mixed else str(survey.units),
        "findings": dataclasses.asdict(findings),
        "members": survey.table().to_dict(orient="records"),
    }
    text = "\n".join([_survey_text(survey), *map(session.in_flags, findings.lines())])
    return Answer(facts, text, always=True, complete=not findings.unreadable)


def _plain(value: Any) -> str:
    """A fact on a file in words: no brackets, and no digits that say nothing."""
    if isinstance(value, dict):
        return ", ".join(f"{key}: {one:,}" for key, one in value.items() if one) or "none"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    return "none" if value is None else f"{value:,}" if isinstance(value, int) else str(value)


def _survey_text(survey: Collection) -> str:
    frame = survey.table()
    rows = []
    for row in frame.head(_ROWS).itertuples():
        spans = [f"{low:.2f} to {high:.2f}" for low, high in ((row.xmin, row.xmax), (row.ymin, row.ymax))]
        crs = row.crs if isinstance(row.crs, str) else ""
        heights, density = f"{row.zmin:.2f} to {row.zmax:.2f}", f"{row.density:.3g}"
        rows.append((Path(str(row.uri)).name, str(row.format), f"{row.points:,}", *spans, heights, density, crs))
    table = table_text(("file", "format", "points", "x", "y", "z", "per m2", "CRS"), rows, left=2)
    area = float(survey.areas.sum())
    more = f"{len(frame) - _ROWS:,} more files; " if len(frame) > _ROWS else ""
    points = f"{survey.count:,} points on {area / 1e6:,.4g} km2, {survey.count / max(area, 1e-9):.3g} per m2"
    return f"{table}\n{more}{count(len(frame), 'file')}, {points}"
