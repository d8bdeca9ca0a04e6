"""The ``report`` command: one HTML file on a classification, for people who check terrain models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from . import building
from .checks import check_reading, check_target
from .commands import main
from .output import print_json
from .session import BadUsage, Session, session_options

OWN = "own"
"""The word for the labels of IN as a reference."""


@main.command()
@click.argument("source", metavar="IN", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("target", metavar="OUT.html", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--filter", "method", metavar="METHOD", help="Find the ground with this filter instead of by class or label."
)
@building.set_option
@building.preset_option
@click.option("--for-cloud", is_flag=True, help="Set what depends on point spacing from the cloud.")
@building.largest_option
@click.option(
    "--reference",
    metavar="FILE|own",
    help="Show errors against the ground labels of this file with the same points, in any order; own: against those of IN.",
)
@click.option(
    "--ground-class", type=click.IntRange(0, 255), default=2, show_default=True, help="Of IN, without --filter."
)
@click.option(
    "--steps",
    type=click.IntRange(0, 250),
    help="Positions of the slider; 0 for none. Of thresholds that are not applied last each is a classification, at most 15."
    "  [default: as many as are quick]",
)
@click.option("--max-points", type=click.IntRange(1), default=1_500_000, show_default=True, help="That are drawn.")
@click.option("--title", help="Of the page.  [default: the name of IN]")
@click.option(
    "--bounds", nargs=4, type=float, metavar="XMIN YMIN XMAX YMAX", help="Read only the points within, file units."
)
@building.units_option
@building.workers_option
@click.option("--overwrite", is_flag=True, help="Replace OUT.html if it exists.")
def report(
    source: Path,
    target: Path,
    method: str | None,
    fixed: tuple[str, ...],
    preset: str | None,
    for_cloud: bool,
    largest_building: float | None,
    reference: str | None,
    ground_class: int,
    bounds: tuple[float, ...] | None,
    units: str | None,
    workers: int | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    debug: bool,
    **settings: Any,
) -> None:
    """Make a page on a classification: maps, profiles, doubtful places, and a slider for the threshold.

    The page is one HTML file that needs no network. The ground is what --filter finds, with a slider that labels the points
    anew, or the points of class 2 of IN, or of label 0 in text. IN is not changed.
    """
    from ..core.errors import InputError
    from ..files.reading import read
    from ..reports import report as write_report
    from ..reports.page import SUFFIXES

    with Session(quiet=quiet, debug=debug) as session:
        if target.suffix.lower() not in SUFFIXES:
            raise BadUsage(f"{target}: the suffix must be one of {', '.join(SUFFIXES)}")
        if check_target(target, overwrite, source):
            raise BadUsage(f"{target} is both input and output: name another file")
        check_reading(units, "last,only")
        build = None
        if method is not None:
            build = building.builder(method, fixed, preset, largest_building, for_cloud)
            build.alone()
        elif fixed or preset or for_cloud or largest_building:
            raise BadUsage("--set, --preset, --for-cloud and --largest-building need --filter METHOD")
        elif reference == OWN:
            raise BadUsage("--reference own: the labels of IN are what is shown; name a file, or pass --filter METHOD")
        if reference not in (None, OWN) and not Path(str(reference)).is_file():
            raise BadUsage(f"--reference {reference}: there is no such file; the labels of IN are called own")
        with session.reading(source):
            cloud = read(source, units=units, bounds=bounds, progress=session.progress)
            truth = None if reference is None else _reference(cloud, source, reference, units, bounds)
        result: Any
        if build is not None:
            filter_ = build.on(cloud)
            with session.step("filter", len(cloud)):
                result = filter_(cloud, workers=workers, progress=session.progress)
            ground = result.ground
        elif cloud.classification is not None:
            result = ground = cloud.classification == ground_class
        elif cloud.reference is not None:
            result = ground = cloud.reference
        elif not len(cloud):
            result = ground = cloud.candidate
        else:
            raise InputError(f"{source} has neither classes nor labels: find the ground with --filter")
        with session.step("report", len(cloud)):
            write_report(
                cloud, result, target, reference=truth, overwrite=overwrite, workers=workers,
                progress=session.progress, **settings,
            )  # fmt: skip
    size = target.stat().st_size
    if as_json:
        facts = {"input": str(source), "output": str(target), "points": len(cloud), "ground": int(ground.sum())}
        print_json(facts | {"bytes": size} | session.as_dict())
    elif not quiet:
        seconds = ", ".join(f"{name} {value:.2f} s" for name, value in session.seconds.items())
        click.echo(
            f"{target}: {int(ground.sum()):,} of {len(cloud):,} points are ground; {size / 1e6:.1f} MB; {seconds}"
        )


report.params += session_options()


def _reference(cloud: Any, source: Path, reference: str, units: str | None, bounds: Any) -> Any:
    """i8[n] for the points of the cloud: 1 = ground, 0 = object, -1 = unlabelled. Raises InputError."""
    import numpy as np

    from ..core.errors import InputError
    from ..files.reading import read
    from ..scoring import match_points, reference_labels

    labelled = cloud if reference == OWN else read(reference, units=units or cloud.units, bounds=bounds)
    if labelled.reference is None:
        name = source if reference == OWN else reference
        raise InputError(f"{name} has no ground labels: give a file with class 2 or with a label column as --reference")
    truth, counted = reference_labels(labelled)
    labels = np.where(counted, truth, -1).astype(np.int8)
    return labels if labelled is cloud else labels[match_points(cloud, labelled, (str(source), reference))]
