"""Checked by people: ``review`` lists places, ``apply`` does what was decided there, ``accuracy`` makes a statement."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..core.reading import Reading
from .commands import command
from .options import READING, RUN_OPTIONS, STATED, check_inputs, check_target, open_files, open_survey, take, take_run
from .output import Answer, answer_of, count, run_facts, tell
from .session import BadUsage, Session
from .values import CLASS, IN_OUT, INPUT, option

_RUN = [one for one in RUN_OPTIONS if one.name in ("workers", "memory", "client", "work", "resume", "overwrite")]


@command(
    IN_OUT,
    option("--ground-class classes", "Class of the ground points of IN.", CLASS, multiple=True, default=(2,)),
    *STATED,
    *_RUN,
)
def review(session: Session, names: tuple[str, ...], classes: tuple[int, ...], **options: Any) -> Answer:
    """List places where the terrain may be wrong, worst first.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs. All hold ground classes. OUT
    is a GeoPackage (.gpkg) or GeoJSON (.geojson). Its column verdict is empty. Fill it in, in any GIS; jaxfilter apply then
    changes the files. jaxfilter ground IN OUT --review places.gpkg finds such places better, since OST states its doubt.
    """
    from ..files.vectors import VECTOR_SUFFIXES
    from ..reviews.survey import review_survey
    from ..reviews.verdicts import WORDS

    files = open_files(session, names, options, VECTOR_SUFFIXES)
    report = files.do(review_survey, files.out, classes)
    area = sum(place["area"] for place in report.places)
    text = f"{files.out}: {count(len(report.places), 'place')} of {area:,.0f} m2 in all; column verdict takes {', '.join(WORDS)}"
    return answer_of(files, report, text)


@command(
    click.Argument(["places"], metavar="PLACES", type=INPUT),
    click.Argument(["names"], metavar="SURVEY...", nargs=-1, required=True),
    option("--ground-class", "Class of ground points.", CLASS, default=2),
    option("--other-class", "Class for points that were ground and are not any more.", CLASS, default=1),
    option("--bridge-class bridge", "Class for points of bridges (ASPRS: 17).", CLASS),
    option("--water-class water", "Class for points of water (ASPRS: 9).", CLASS),
    *(one for one in READING if one.name not in ("bounds", "aoi", "drop_duplicates")),
    *_RUN,
)
def apply(session: Session, places: Path, names: tuple[str, ...], **options: Any) -> Answer:
    """Carry out what people have decided at places.

    PLACES is a file of --review or of jaxfilter review. Its column verdict says ground, object, bridge, water or fine; rows
    without a verdict are skipped. SURVEY are the .las or .laz files that jaxfilter ground has written, or their folder. These
    files are changed. A file is replaced as a whole or stays as it is.

    The ground is found again at these places and 4 m around them. verdicts.json beside the files lists the verdicts that were
    carried out; they are not carried out twice. Verdicts that contradict each other, that are no known word, or that lie
    outside the data are listed and skipped. The exit code is 1 if no verdict could be carried out.
    """
    from ..files.classes import Classes
    from ..reviews.survey import apply_survey

    reading, run, classes = take(Reading, options), take_run(options, session), take(Classes, options)
    collection = open_survey(session, names, reading)
    with session.step("run", collection.count):
        report = apply_survey(places, collection, classes=classes, reading=reading, run=run)
    tell(session, report)
    said = ", ".join(f"{n} {word}" for word, n in report.applied.items()) or "none"
    text = f"{places}: {count(sum(report.applied.values()), 'verdict')} carried out ({said}), {report.before:,} earlier"
    changed = f"{count(report.changed, 'point')} in {count(len(report.files), 'file')}"
    text += f"; {changed} changed in {report.elapsed:.1f} s"
    if report.problems:
        text += f"; {count(len(report.problems), 'verdict')} left out"
    return Answer(run_facts(session, report), text, complete=report.complete)


@command(
    click.Argument(["names"], metavar="CLASSIFIED... MODEL OUT", nargs=-1, required=True),
    option(
        "--checkpoints",
        "Check points as CSV with columns x, y, z, and optionally land_cover and vertical_datum.",
        INPUT,
    ),
    option("--ground-class ground", "Class of the ground points.", CLASS, multiple=True, default=(2,)),
    *STATED,
    *_RUN,
)
def accuracy(session: Session, names: tuple[str, ...], checkpoints: Path | None, **options: Any) -> Answer:
    """State how accurate a terrain model is, on a page for a client.

    MODEL is a GeoTIFF of heights. CLASSIFIED are the files, or the folder, that it was made of. OUT is a .html file; a JSON file
    of the same name holds the same figures. The page states NVA and VVA of the check points by the ASPRS standards of 2014 and
    2023, expected wrong points per km2 by doubt, the area of places where the terrain may be wrong, density of ground points,
    voids, versions and parameters. Check points must have the vertical datum of the model.
    """
    from ..reports.page import PAGE_SUFFIXES
    from ..reviews.accuracy import accuracy_statement

    if len(names) < 3:
        raise BadUsage("name the classified files, the model, and the page to write: CLASSIFIED... MODEL OUT.html")
    *inputs, model, out = names
    check_inputs([model])
    reading, run, ground = take(Reading, options), take_run(options, session), options["ground"]
    check_target(Path(out), run.overwrite, PAGE_SUFFIXES)
    collection = open_survey(session, inputs, reading)
    with session.step("run", collection.count):
        facts = accuracy_statement(collection, model, out, checkpoints, ground=ground, reading=reading, run=run)
    for note in facts["notes"]:
        session.note(f"note: {note}")
    points, labels = facts["checkpoints"], facts["labels"]
    text = f"{out}: {labels['ground']:,} ground points, {count(labels['named_places'], 'place')} of {labels['named_m2']:,.0f} m2"
    if points is not None:
        nva, vva = points["nva"], points["vva"]
        if nva["points"]:
            text += f"; NVA: RMSEz {nva['rmse_m']:.3f} m of {count(nva['points'], 'point')}"
        if vva["points"]:
            text += f"; VVA: 95 % within {vva['p95_m']:.3f} m of {count(vva['points'], 'point')}"
    return Answer(facts, text)
