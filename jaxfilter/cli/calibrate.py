"""The ``calibrate`` command: the parameters that suit a cloud, from labels of some of its points."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .answer import Answer, in_session
from .commands import main
from .options import check_target, pairs, take_reading, take_recipe, with_options
from .output import json_text, times
from .session import BadUsage, Session
from .sweeps import MEMORY, drawn_range
from .values import CLASS, INPUT, OUTPUT

if TYPE_CHECKING:
    from ..sweeps.calibrate import Calibration


@main.command()
@click.argument("method", metavar="METHOD")
@click.argument("source", metavar="IN", type=INPUT)
@click.option(
    "--labels",
    "labels_file",
    metavar="FILE",
    type=INPUT,
    help="LAS or text file with some of the points of IN and their classes or labels.  [default: the classes or labels of IN]",
)
@click.option(
    "--unlabelled",
    type=CLASS,
    multiple=True,
    default=(0,),
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
    help="Take only the labels within, file units; may be repeated.",
)
@click.option(
    "--axis",
    "axes",
    metavar="FIELD=LOW..HIGH",
    multiple=True,
    help="Search this field between these values; may be repeated.  [default: the thresholds of the method]",
)
@click.option("--size", type=click.IntRange(1), default=256, help="Number of sets that each round tries.")
@click.option(
    "--rounds",
    type=click.IntRange(1),
    default=2,
    help="Rounds; all but the first search around the best set so far.",
)
@click.option("--score", type=click.Choice(["total", "kappa"]), default="total", help="The score that decides.")
@click.option("--folds", type=click.IntRange(2), default=5, help="Number of parts for the cross-validation.")
@click.option(
    "--block",
    type=click.FloatRange(0, min_open=True),
    metavar="METRES",
    help="The parts are made of square blocks with this side.",
)
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of the sets that are drawn.")
@with_options("set", "preset", "largest_building", "units", MEMORY, "threads")
@click.option("--out", metavar="FILE.json", type=OUTPUT, help="Write the result to this file as well.")
@click.option("--overwrite", is_flag=True, help="Replace the file of --out if it exists.")
@in_session
def calibrate(
    session: Session,
    source: Path,
    labels_file: Path | None,
    axes: tuple[str, ...],
    out: Path | None,
    overwrite: bool,
    **options: Any,
) -> Answer:
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

    recipe = take_recipe(options)
    assert recipe is not None
    alone = recipe.alone()
    assert alone is not None
    ranges = {name: drawn_range(type(alone), name, text) for name, text in pairs("--axis", axes)} or None
    if ranges is not None:
        make_design(alone, ranges, "random", 1)  # checks fields and limits
    words, reading, unlabelled = options["units"], take_reading(options), options.pop("unlabelled")
    try:
        patches = [check_bounds(patch) for patch in options.pop("patches")]
    except InputError as error:
        raise BadUsage(str(error)) from error
    if out is not None:
        check_target(out, overwrite)
    with session.reading(source):
        cloud = read(source, units=reading.units, progress=session.progress)
        some = cloud if labels_file is None else read(labels_file, units=reading.units or cloud.units)
        labels = labelling.point_labels(some, unlabelled, str(labels_file or source))
        if some is not cloud:
            labels = labelling.labels_from(cloud, some, labels, str(labels_file), options["workers"])
        if patches:
            labels = labelling.within(cloud, patches, labels)
    filter_, memory = recipe.on(cloud), options.pop("memory") * 1e9
    with session.step("calibrate", options["size"] * options["rounds"], "sets"):
        session.progress(0.0, "labels")
        found = sweeps.calibrate(
            filter_, cloud, labels, axes=ranges, memory=memory, progress=session.progress, **options
        )
    facts = {
        "method": type(filter_).__name__,
        "input": str(source),
        "labels": str(labels_file or source),
        "labelled": {"ground": int((labels == 1).sum()), "object": int((labels == 0).sum())},
    }
    facts |= _facts(found, [str(source), "OUT", *(["--units", words] if words else [])]) | session.as_dict()
    if out is not None:
        with new_file(out, overwrite=overwrite) as temporary:
            temporary.write_text(json_text(facts) + "\n")
    return Answer(facts, _text(facts) + (f"\nin {out}" if out is not None else ""))


def _facts(found: Calibration, words: list[str]) -> dict[str, Any]:
    """What was found, in plain Python values; ``words``: what follows the method in the command that uses it."""
    from . import flags

    method = type(found.filter)
    defaults = {name: field.default for name, field in flags.fields(method).items()}
    values = {name: getattr(found.filter, name) for name in defaults}
    changed = {name: value for name, value in values.items() if value != defaults[name]}
    fields = [word for name, value in changed.items() for word in flags.words_for(name, value)]
    return {
        "score": found.trials.attrs["score"],
        "cross_validated": found.score,
        "spread": found.spread,
        "before": found.before,
        "sets": found.trials.sizes["set"],
        "folds": found.trials.sizes["fold"],
        "found": {name: values[name] for name in found.searched},
        "changed": changed,
        "parameters": values,
        "command": shlex.join(["jaxfilter", "ground", method.__name__.lower(), *words[:2], *fields, *words[2:]]),
    }


def _text(facts: dict[str, Any]) -> str:
    """The facts for people."""
    from ..sweeps.best import word

    what = "total error" if facts["score"] == "total" else "kappa"
    parameters = ", ".join(f"{name} {word(value)}" for name, value in facts["found"].items())
    labelled = facts["labelled"]
    return (
        f"{facts['method']}: {parameters}\n"
        f"{what} {facts['cross_validated']:.2f} +- {facts['spread']:.2f} %, cross-validated over {facts['folds']} folds of "
        f"{labelled['ground']:,} ground and {labelled['object']:,} object points; {facts['before']:.2f} % before\n"
        f"{facts['sets']:,} sets; {times(facts['seconds'])}\n{facts['command']}"
    )
