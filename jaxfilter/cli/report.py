"""The ``report`` command: one HTML file on a classification, for people who check terrain models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from ..core.errors import InputError
from ..core.reading import Reading
from .commands import command
from .options import BOUNDS, FILTER, REPLACE, STATED, THREADS, check_target, files_of, take, take_recipe
from .output import Answer, times
from .session import BadUsage, Session
from .values import CLASS, COUNT, OUTPUT, option

if TYPE_CHECKING:
    from ..core.cloud import PointCloud

OWN = "own"
"""The word for the labels of IN as a reference."""


@command(
    click.Argument(["source"], metavar="IN", type=click.Path(exists=True, path_type=Path)),
    click.Argument(["target"], metavar="OUT.html", type=OUTPUT),
    *FILTER,
    option(
        "--reference",
        "Show errors against the ground labels of this file. It holds the same points, in any order. own: the labels of IN.",
        "FILE|own",
    ),
    option("--ground-class", "Class of the ground points of IN, if there is no --filter.", CLASS, default=2),
    option(
        "--steps",
        "Positions of the slider; at most 15 if each needs a classification.  [default: as many as are quick]",
        click.IntRange(0, 250),
    ),
    option("--max-points", "Draw no more points than this.", COUNT, default=1_500_000),
    option("--title", "Title of the page.  [default: the name of IN]"),
    *(BOUNDS, *STATED, THREADS, REPLACE),
)
def report(session: Session, source: Path, target: Path, reference: str | None, **options: Any) -> Answer:
    """Make a page on a classification: maps, profiles, places to look at.

    IN is a file, or a folder whose LAS and LAZ files are shown together. The page is one HTML file that needs no network. The
    ground is what --filter finds, with a slider that labels the points anew, or the points of class 2 of IN, or of label 0 in
    text. IN is not changed. OUT may be - for standard output.
    """
    from ..reports.page import PAGE_SUFFIXES, ReportOptions
    from ..reports.page import report as make_page

    name, overwrite = target, options["overwrite"]
    if str(target) == "-":
        target = session.piped(PAGE_SUFFIXES[0])
    check_target(target, overwrite, PAGE_SUFFIXES)
    if target.exists() and target.samefile(source):
        raise BadUsage(f"{target} is both input and output: name another file")
    how, recipe, shown = take(Reading, options), take_recipe(options), take(ReportOptions, options)
    if recipe is None and reference == OWN:
        raise BadUsage("--reference own: the labels of IN are what is shown; name a file, or pass --filter METHOD")
    if reference not in (None, OWN) and not Path(str(reference)).is_file():
        raise BadUsage(f"--reference {reference}: there is no such file; the labels of IN are called own")
    files = files_of(source)
    with session.reading(*files):
        cloud = _joined(files, how, session)
        truth = None if reference is None else _reference(cloud, source, reference, how)
    result: Any
    if recipe is not None:
        filter_ = recipe.on(cloud)
        with session.step("filter", len(cloud)):
            result = filter_(cloud, workers=shown.workers, progress=session.progress)
        ground = result.ground
    else:
        ground = cloud.reference if cloud.classification is None else cloud.classification == options["ground_class"]
        if ground is None and len(cloud):
            raise InputError(f"{source} has neither classes nor labels: find the ground with --filter")
        result = ground = cloud.candidate if ground is None else ground
    with session.step("report", len(cloud)):
        make_page(cloud, result, target, reference=truth, options=shown, overwrite=overwrite, progress=session.progress)
    size, count = target.stat().st_size, int(ground.sum())
    facts = {"input": str(source), "output": str(name), "points": len(cloud), "ground": count, "bytes": size}
    text = f"{name}: {count:,} of {len(cloud):,} points are ground; {size / 1e6:.1f} MB; {times(session.seconds)}"
    return Answer(facts, text)


def _joined(files: list[Path], how: Reading, session: Session) -> PointCloud:
    """The points of all files in one cloud. Raises: InputError for a file that cannot be read, or files of several CRS."""
    from ..files.reading import read
    from ..surveys.collection import open as open_collection
    from ..surveys.tiles import joined

    if len(files) == 1:
        return read(files[0], units=how.units, crs=how.crs, bounds=how.bounds, progress=session.progress)
    collection = open_collection([str(path) for path in files], units=how.units, crs=how.crs)
    return joined([read(path, units=collection.units, crs=how.crs, bounds=how.bounds) for path in files])


def _reference(cloud: PointCloud, source: Path, reference: str, how: Reading) -> Any:
    """i8[n] for the points of the cloud: 1 = ground, 0 = object, -1 = unlabelled. Raises InputError."""
    from ..files.reading import read
    from ..scoring import match_points, reference_labels

    labelled = cloud if reference == OWN else read(reference, units=how.units or cloud.units, bounds=how.bounds)
    if labelled.reference is None:
        name = source if reference == OWN else reference
        raise InputError(f"{name} has no ground labels: give a file with class 2 or with a label column as --reference")
    truth, counted = reference_labels(labelled)
    labels = np.where(counted, truth, -1).astype(np.int8)
    return labels if labelled is cloud else labels[match_points(cloud, labelled, (str(source), reference))]
