"""The ``calibrate`` command: the parameters that suit a cloud, from labels of some of its points."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import building
from .checks import check_reading, check_target
from .commands import main
from .output import json_text, print_json
from .session import BadUsage, Session, session_options

if TYPE_CHECKING:
    from ..files.disk import Bounds
    from ..sweeps.calibrate import Calibration


@main.command()
@building.method_argument
@click.argument("source", metavar="IN", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "--labels",
    "labels_file",
    metavar="FILE",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="LAS or text with some of the points of IN and their classes or labels.  [default: those of IN]",
)
@click.option(
    "--unlabelled",
    type=click.IntRange(0, 255),
    multiple=True,
    default=(0,),
    show_default=True,
    metavar="CLASS",
    help="Points of this class have no label; may be repeated.",
)
@click.option(
    "--bounds",
    "patches",
    nargs=4,
    type=float,
    multiple=True,
    metavar="XMIN YMIN XMAX YMAX",
    help="Only labels within count, file units; may be repeated.",
)
@click.option(
    "--axis",
    "axes",
    metavar="FIELD=LOW..HIGH",
    multiple=True,
    help="A field to search, and where; may be repeated.  [default: the thresholds of the method]",
)
@click.option(
    "--size", type=click.IntRange(1), default=256, show_default=True, help="Sets that are tried in each round."
)
@click.option(
    "--rounds",
    type=click.IntRange(1),
    default=2,
    show_default=True,
    help="Each after the first is around the best so far.",
)
@click.option("--score", type=click.Choice(["total", "kappa"]), default="total", show_default=True)
@click.option("--folds", type=click.IntRange(2), default=5, show_default=True, help="Of the cross-validation.")
@click.option(
    "--block",
    type=click.FloatRange(0, min_open=True),
    metavar="METRES",
    help="Side of the blocks that folds are made of.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@building.set_option
@building.preset_option
@building.largest_option
@building.units_option
@building.memory_option
@building.workers_option
@click.option(
    "--out", metavar="FILE.json", type=click.Path(dir_okay=False, path_type=Path), help="Write what was found."
)
@click.option("--overwrite", is_flag=True, help="Replace the file of --out if it exists.")
def calibrate(
    method: str,
    source: Path,
    labels_file: Path | None,
    unlabelled: tuple[int, ...],
    patches: tuple[tuple[float, float, float, float], ...],
    axes: tuple[str, ...],
    fixed: tuple[str, ...],
    preset: str | None,
    largest_building: float | None,
    units: str | None,
    memory: float,
    out: Path | None,
    overwrite: bool,
    quiet: bool,
    as_json: bool,
    debug: bool,
    **search: Any,
) -> None:
    """Find the parameters that suit IN from the labels of some of its points.

    Label a few patches in different places by hand, ground as class 2, everything else in them as any other class, and leave
    the rest at class 0. If the rest is class 1, pass --unlabelled 0 --unlabelled 1 and give objects another class, or name
    the patches with --bounds. The score is cross-validated: each fold of blocks is scored with the set that the others chose.
    """
    from ..core.errors import InputError
    from ..files.disk import check_bounds, new_file
    from ..files.reading import read
    from ..sweeps import calibrate as sweeps
    from ..sweeps import labels as labelling
    from ..sweeps.design import make_design

    with Session(quiet=quiet, debug=debug) as session:
        build = building.builder(method, fixed, preset, largest_building)
        ranges = {
            name: building.drawn_range(build.method, name, text) for name, text in building.pairs("--axis", axes)
        } or None
        if ranges is not None:
            make_design(build.alone(), ranges, "random", 1)  # checks fields and limits
        check_reading(units, "last,only")
        try:
            bounds: list[Bounds] = [check_bounds(patch) for patch in patches]
        except InputError as error:
            raise BadUsage(str(error)) from error
        if out is not None:
            check_target(out, overwrite)
        with session.reading(source):
            cloud = read(source, units=units, progress=session.progress)
            if labels_file is None:
                labels = labelling.point_labels(cloud, unlabelled, str(source))
            else:
                some = read(labels_file, units=units or cloud.units)
                own = labelling.point_labels(some, unlabelled, str(labels_file))
                labels = labelling.labels_from(cloud, some, own, str(labels_file), search["workers"])
            if bounds:
                labels = labelling.within(cloud, bounds, labels)
        filter_ = build.on(cloud)
        with session.step("calibrate", search["size"] * search["rounds"], "sets"):
            session.progress(0.0, "labels")
            found = sweeps.calibrate(
                filter_, cloud, labels, axes=ranges, memory=memory * 1e9, progress=session.progress, **search
            )
        report = _calibration(found, source, labels_file, labels, units) | session.as_dict()
        if out is not None:
            with new_file(out, overwrite=overwrite) as temporary:
                temporary.write_text(json_text(report) + "\n")
    if as_json:
        print_json(report)
    elif not quiet:
        _print_calibration(found, report, out)


calibrate.params += session_options()


def _calibration(
    found: Calibration, source: Path, labels_file: Path | None, labels: Any, units: str | None
) -> dict[str, Any]:
    """What was found, in plain Python values."""
    from . import flags

    method = type(found.filter)
    defaults = {name: field.default for name, field in flags.fields(method).items()}
    values = {name: getattr(found.filter, name) for name in defaults}
    changed = {name: value for name, value in values.items() if value != defaults[name]}
    words = ["jaxfilter", "ground", method.__name__.lower(), str(source), "OUT"]
    for name, value in changed.items():
        words += flags.words_for(name, value)
    words += ["--units", units] if units else []
    return {
        "method": method.__name__,
        "input": str(source),
        "labels": str(labels_file or source),
        "labelled": {"ground": int((labels == 1).sum()), "object": int((labels == 0).sum())},
        "score": found.trials.attrs["score"],
        "cross_validated": found.score,
        "spread": found.spread,
        "before": found.before,
        "sets": found.trials.sizes["set"],
        "folds": found.trials.sizes["fold"],
        "found": {name: values[name] for name in found.searched},
        "changed": changed,
        "parameters": values,
        "command": shlex.join(words),
    }


def _print_calibration(found: Calibration, report: dict[str, Any], out: Path | None) -> None:
    from ..sweeps.best import word

    what = "total error" if report["score"] == "total" else "kappa"
    parameters = ", ".join(f"{name} {word(value)}" for name, value in report["found"].items())
    labelled = report["labelled"]
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in report["seconds"].items())
    click.echo(
        f"{report['method']}: {parameters}\n"
        f"{what} {report['cross_validated']:.2f} +- {report['spread']:.2f} %, cross-validated over {report['folds']} folds of "
        f"{labelled['ground']:,} ground and {labelled['object']:,} object points; {report['before']:.2f} % before\n"
        f"{report['sets']:,} sets; {seconds}\n{report['command']}"
    )
    if out is not None:
        click.echo(f"in {out}")
