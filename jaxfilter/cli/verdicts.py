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
    option("--classified classes", "Class of the ground points of IN.", CLASS, multiple=True, default=(2,)),
    *STATED,
    *_RUN,
)
def review(session: Session, names: tuple[str, ...], classes: tuple[int, ...], **options: Any) -> Answer:
    """List the places of classified files where the terrain may be wrong, worst first.

    IN is a file, or IN are folders, patterns, several files, a virtual point cloud (.vpc) or URLs, all with ground classes. OUT
    is a GeoPackage (.gpkg) or GeoJSON (.geojson). Its column verdict is empty: fill it in, in any GIS, and jaxfilter apply
    changes the files. jaxfilter ground IN OUT --review places.gpkg finds places better, since OST knows how sure it is.
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
    option("--other-class", "Class for points that are no ground any more.", CLASS, default=1),
    option("--bridge-class bridge", "Class for points of bridges that were ground (ASPRS: 17).", CLASS),
    option("--water-class water", "Class for points of water (ASPRS: 9).", CLASS),
    *(one for one in READING if one.name not in ("bounds", "aoi", "drop_duplicates")),
    *_RUN,
)
def apply(session: Session, places: Path, names: tuple[str, ...], **options: Any) -> Answer:
    """Change classified files by what people have decided at places.

    PLACES is what --review or jaxfilter review has written, with the column verdict filled in: ground, object, bridge, water or
    fine. Empty verdicts are passed over. SURVEY are the files that jaxfilter ground has written, .las or .laz, or their folder.
    They are changed in place, each as a whole or not at all. Files in which no point changes are not touched.

    Ground grows again at these places and 4 m around them, from what was said. verdicts.json beside the files lists what was
    carried out; it is not carried out again. Verdicts that contradict each other, are no verdicts, or lie beside the data are
    named and left out. The exit code is 1 if no verdict could be carried out.
    """
    from ..files.classes import Classes
    from ..reviews.survey import apply_survey

    reading, run, classes = take(Reading, options), take_run(options, session), take(Classes, options)
    collection = open_survey(session, names, reading)
    with session.step("run", collection.count):
        report = apply_survey(places, collection, classes=classes, reading=reading, run=run)
    tell(session, report)
    said = ", ".join(f"{n} {word}" for word, n in report.applied.items()) or "none"
    text = f"{places}: {count(sum(report.applied.values()), 'verdict')} carried out ({said}), {report.before:,} were before"
    changed = f"{count(report.changed, 'point')} in {count(len(report.files), 'file')}"
    text += f"; {changed} changed in {report.elapsed:.1f} s"
    if report.problems:
        text += f"; {count(len(report.problems), 'verdict')} left out"
    return Answer(run_facts(session, report), text, complete=report.complete)


@command(
    click.Argument(["names"], metavar="CLASSIFIED... MODEL OUT", nargs=-1, required=True),
    option("--checkpoints", "Check points as CSV: x, y, z, and if you like land_cover and vertical_datum.", INPUT),
    option("--classified ground", "Class of the ground points.", CLASS, multiple=True, default=(2,)),
    *STATED,
    *_RUN,
)
def accuracy(session: Session, names: tuple[str, ...], checkpoints: Path | None, **options: Any) -> Answer:
    """State how accurate a terrain model is, on a page for a client, and as JSON.

    CLASSIFIED are the files, or their folder, that MODEL, a GeoTIFF of heights, was made of. OUT is a .html file; the JSON has
    the same name. The page has NVA and VVA of the check points by the ASPRS standards of 2014 and 2023, expected wrong points
    per km2 by doubt, the area of places where the terrain may be wrong, density of ground points, voids, versions and
    parameters. Check points in another vertical datum than that of the model are refused.
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
