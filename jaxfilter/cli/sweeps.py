"""The commands ``sweep``, many sets of parameters, and ``calibrate``, those that suit a cloud by labels of some of its points."""

from __future__ import annotations

import dataclasses
import functools
import shlex
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.reading import Reading
from ..sweeps.best import SCORES, axes_of, best_sets, word
from .commands import command
from .options import REPLACE, SWEPT, check_target, pairs, take, take_recipe
from .output import Answer, count, json_text, times
from .session import BadUsage, Session
from .values import BOX, CLASS, COUNT, FOLDER, INPUT, METRES, OUTPUT, SEED, option

if TYPE_CHECKING:
    import pandas
    import xarray

    from ..core.cloud import PointCloud
    from ..core.filter import Filter
    from ..surveys.measures import Recipe

DATASET, TABLE, CHECKPOINT = "sweep.nc", "sets.csv", "checkpoint.npz"
_VALUES = "Values of a field. V,V,..., or START:STOP:STEP (with STOP), or LOW..HIGH to draw from."
_DESIGN = "All combinations; --size sets drawn randomly or by Sobol; or the first values of all axes, the second, ..."
_SEARCHED = "Search this field between these values.  [default: the thresholds of the method]"


@command(
    click.Argument(["filter"], metavar="METHOD"),
    click.Argument(["sources"], metavar="IN [IN ...]", nargs=-1, required=True, type=INPUT),
    click.Argument(["directory"], metavar="OUT_DIR", type=FOLDER),
    option("--axis axes", _VALUES, "FIELD=VALUES", multiple=True, required=True),
    option("--design", _DESIGN, click.Choice(["grid", "random", "sobol", "list"]), default="grid"),
    option("--size", "Number of sets of a random or sobol design.", int),
    option("--seed", "Seed of a random or sobol design.", SEED, default=0),
    option("--votes", "Count for every point how many sets call it ground.", bool),
    option("--score", "The sets are sorted by this score.", click.Choice(SCORES), default="total"),
    *SWEPT,
    click.Option(["--resume/--fresh"], default=True, help="Go on with the sweep in OUT_DIR, or replace it."),
)
def sweep(session: Session, sources: tuple[Path, ...], directory: Path, resume: bool, **options: Any) -> Answer:
    """Score many sets of parameters against the labels of IN.

    Labels are class 2 of LAS (points of class 0 do not count), or a label column of text. OUT_DIR gets sweep.nc, all scores
    (NetCDF, for xarray); sets.csv, a line for each set, best first; and pictures. If a sweep was stopped, give the same command
    again to continue it.
    """
    from ..core.errors import InputError
    from ..sweeps import sweep as sweeps
    from ..sweeps.design import make_design

    recipe, filter_, reading = _take_method(options)
    design, score = {name: options.pop(name) for name in ("design", "size", "seed")}, options.pop("score")
    drawn, axes = design["design"] in ("random", "sobol"), pairs("--axis", options.pop("axes"))
    ranges = {name: axis(type(filter_), name, text, drawn) for name, text in axes.items()}
    plan = make_design(filter_, ranges, *design.values())
    checkpoint = directory / CHECKPOINT
    if links := [name for name in (CHECKPOINT, DATASET, TABLE) if (directory / name).is_symlink()]:
        raise BadUsage(f"{directory / links[0]} is a link, which is not followed: remove it, or name another folder")
    if resume and (directory / DATASET).exists() and not checkpoint.exists():
        raise BadUsage(f"{directory} holds {DATASET} of another sweep: name another folder, or pass --fresh")
    with session.reading(*sources):
        clouds = _read_all(sources, reading)
        for source, cloud in zip(sources, clouds.values(), strict=True):
            if cloud.reference is None and not options["votes"]:
                raise InputError(f"{source} has no labels (class 2, or a label column) to score against: pass --votes")
    first = next(iter(clouds.values()))
    filter_ = recipe.on(first)
    directory.mkdir(parents=True, exist_ok=True)
    if not resume:
        checkpoint.unlink(missing_ok=True)
    options |= design | {"checkpoint": checkpoint, "progress": session.progress}
    try:
        with session.step("sweep", len(clouds) * len(plan.sets), "sets"):
            dataset = sweeps.sweep(filter_, clouds if len(clouds) > 1 else first, ranges, **options)
    except InputError as error:
        if str(checkpoint) not in str(error):
            raise
        raise BadUsage(f"{error}; --fresh replaces it") from error
    except KeyboardInterrupt as error:
        error.add_note(f"finished sets are kept in {directory}, the same command goes on from there")
        raise
    with session.step("write"):
        table = best_sets(dataset, score, None)
        files = _write(directory, dataset, table, clouds, score)
    scored = bool(dataset[score].notnull().any())
    sets, groups = dataset.attrs["sets"], dataset.attrs["groups"]
    facts: dict[str, Any] = {
        "method": type(filter_).__name__,
        "input": [str(source) for source in sources],
        "output": str(directory),
        "sets": sets,
        "groups": groups,
        "score": score if scored else None,
        "best": table.reset_index().head(10).to_dict("records") if scored else [],
        "parameters": dataclasses.asdict(filter_),  # type: ignore[call-overload]
        "files": files,
    }
    text, axes_swept, heads = "", axes_of(dataset), {"type1": "Type I", "type2": "Type II"}
    if scored:
        shown = table.head(10)[[*axes_swept, *SCORES]].reset_index().rename(columns=heads)
        means = ", means over the clouds" * ("cloud" in dataset.dims)
        lines = shown.to_string(index=False, float_format="%.2f", formatters=dict.fromkeys(axes_swept, word))
        text = f"best sets by {heads.get(score, score)}, percent{means}\n{lines}\n"
    text += f"{type(filter_).__name__}: {sets:,} sets, {count(len(clouds), 'cloud')}, {count(groups, 'group')}; "
    return Answer(facts, f"{text}{times(session.seconds)}\nin {directory}: {', '.join(files)}")


@command(
    click.Argument(["filter"], metavar="METHOD"),
    click.Argument(["source"], metavar="IN", type=INPUT),
    option("--labels labels_file", "File with some of the points and their classes or labels.  [default: IN]", INPUT),
    option("--unlabelled", "Points of this class have no label.", CLASS, multiple=True, default=(0,)),
    option("--bounds patches", "Take only the labels within.", float, nargs=4, multiple=True, metavar=BOX),
    option("--axis axes", _SEARCHED, "FIELD=LOW..HIGH", multiple=True),
    option("--size", "Number of sets that each round tries.", COUNT, default=256),
    option("--rounds", "Rounds; all but the first search around the best set so far.", COUNT, default=2),
    option("--score", "The score that decides.", click.Choice(["total", "kappa"]), default="total"),
    option("--folds", "Number of parts for the cross-validation.", click.IntRange(2), default=5),
    option("--block", "The parts are made of square blocks with this side.", METRES),
    option("--seed", "Seed of the sets that are drawn.", SEED, default=0),
    *SWEPT,
    option("--out", "Write the result to this JSON file as well.", OUTPUT),
    REPLACE,
)
def calibrate(session: Session, source: Path, labels_file: Path | None, out: Path | None, **options: Any) -> Answer:
    """Find parameters by the labels of some points of IN.

    Label a few patches in different places by hand: ground as class 2, all else there as another class. Leave the rest at
    class 0. If the rest has class 1, pass --unlabelled 0 --unlabelled 1 and give objects another class, or name the patches
    with --bounds. The score is cross-validated: each fold of blocks is scored with the set that the other folds chose.
    """
    from ..core.reading import check_bounds
    from ..files.disk import new_file
    from ..files.reading import read
    from ..sweeps import calibrate as sweeps
    from ..sweeps import labels as labelling
    from ..sweeps.design import make_design
    from . import flags

    stated = [word for name in ("units", "crs") if options[name] for word in (f"--{name}", options[name])]
    recipe, alone, reading = _take_method(options)
    given, overwrite = pairs("--axis", options.pop("axes")), options.pop("overwrite")
    ranges = {name: axis(type(alone), name, text, True) for name, text in given.items()} or None
    if ranges is not None:
        if lists := [name for name, ends in ranges.items() if isinstance(ends, list)]:
            raise BadUsage(f"--axis {lists[0]}={given[lists[0]]}: write a range as LOW..HIGH")
        make_design(alone, ranges, "random", 1)  # checks fields and limits
    unlabelled, patches = options.pop("unlabelled"), [check_bounds(patch) for patch in options.pop("patches")]
    if out is not None:
        check_target(out, overwrite)
    with session.reading(source):
        cloud = read(source, units=reading.units, crs=reading.crs, progress=session.progress)
        some = cloud if labels_file is None else read(labels_file, units=reading.units or cloud.units)
        labels = labelling.point_labels(some, unlabelled, str(labels_file or source))
        if some is not cloud:
            labels = labelling.labels_from(cloud, some, labels, str(labels_file), options["workers"])
        if patches:
            labels = labelling.within(cloud, patches, labels)
    filter_ = recipe.on(cloud)
    with session.step("calibrate", options["size"] * options["rounds"], "sets"):
        session.progress(0.0, "labels")
        found = sweeps.calibrate(filter_, cloud, labels, axes=ranges, progress=session.progress, **options)
    method, best, trials = type(filter_), found.filter, found.trials
    facts = {
        "method": method.__name__,
        "input": str(source),
        "labels": str(labels_file or source),
        "labelled": {"ground": int((labels == 1).sum()), "object": int((labels == 0).sum())},
        "score": trials.attrs["score"],
        "cross_validated": found.score,
        "spread": found.spread,
        "before": found.before,
        "sets": trials.sizes["set"],
        "folds": trials.sizes["fold"],
        "found": {name: getattr(best, name) for name in found.searched},
        "changed": flags.changed(best, method()),
        "parameters": dataclasses.asdict(best),  # type: ignore[call-overload]
        "command": shlex.join(flags.command_for(best, [str(source), "OUT", *stated], method())),
        **session.as_dict(),
    }
    if out is not None:
        with new_file(out, overwrite=overwrite) as temporary:
            temporary.write_text(json_text(facts) + "\n")
    text = f"{found}\n{times(session.seconds)}\n{facts['command']}"
    return Answer(facts, text + (f"\nin {out}" if out is not None else ""))


def _take_method(options: dict[str, Any]) -> tuple[Recipe, Filter, Reading]:
    """What the options say of METHOD, which has to be named, the filter before any cloud is read, and how clouds are read."""
    recipe = take_recipe(options)
    assert recipe is not None
    filter_ = recipe.alone()
    assert filter_ is not None
    return recipe, filter_, take(Reading, options)


def axis(method: type[Filter], name: str, text: str, drawn: bool) -> list[Any] | tuple[Any, Any]:
    """The values V,V,... or START:STOP:STEP of a field; or the ends of LOW..HIGH, if values are ``drawn`` from it. Raises:
    BadUsage, ParameterError."""
    from . import flags

    def values(pieces: Iterable[str]) -> list[Any]:
        return [flags.value_of(method, name, piece.strip(), "--axis") for piece in pieces]

    given = f"--axis {name}={text}"
    if not text:
        raise BadUsage(f"{given} is empty: give values")
    if ".." in text:
        if not drawn:
            raise BadUsage(f"{given}: a range needs --design random or sobol, and --size")
        low, _, high = text.partition("..")
        ends = values((low, high)) if low and high else []
        if not ends or any(isinstance(end, bool) or not isinstance(end, (int, float)) for end in ends):
            raise BadUsage(f"{given}: write a range of numbers as LOW..HIGH, and words as a list")
        return ends[0], ends[1]
    if ":" not in text:
        return values(text.split(","))
    try:
        start, stop, step = map(float, text.split(":"))
        count = int((stop - start) / step + 1e-9) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise BadUsage(f"{given}: write a series as START:STOP:STEP, three finite numbers") from None
    if not (step > 0 and stop >= start and count <= 10_000):
        raise BadUsage(f"{given}: a series goes up from START to STOP, in at most 10,000 steps")
    return values(f"{start + i * step:.10g}" for i in range(count))


def _read_all(sources: tuple[Path, ...], reading: Reading) -> dict[str, PointCloud]:
    """Clouds by the names of their files, made fit for names in NetCDF and apart from each other."""
    from ..files.reading import read

    names: list[str] = []
    for source in sources:
        stem = "".join(c if c.isalnum() and c.isascii() else "_" for c in source.stem)
        names.append(stem if stem not in names else f"{stem}_{len(names) + 1}")
    clouds = (read(source, units=reading.units, crs=reading.crs) for source in sources)
    return dict(zip(names, clouds, strict=True))


def _write(
    directory: Path, dataset: xarray.Dataset, table: pandas.DataFrame, clouds: dict[str, PointCloud], score: str
) -> list[str]:
    """All files of a sweep; their names. Pictures of a sweep that was replaced, and links, are removed."""
    from .. import plots
    from ..files.disk import new_file

    of_words = {  # values that are not all of one type, which NetCDF cannot hold
        name: (values.dims, [word(value) for value in values.values], values.attrs)
        for name, values in dataset.coords.items()
        if values.dtype == object
    }
    writers: dict[str, Callable[[Path], Any]] = {
        DATASET: lambda path: dataset.assign_coords(of_words).to_netcdf(path, engine="scipy"),
        TABLE: lambda path: table.to_csv(path),
    }
    ends = {name: f"_{name}" if len(clouds) > 1 else "" for name in clouds}
    figures: dict[str, Any] = {}
    if dataset[score].notnull().any():
        figures["curves.png"] = plots.sweep_curves(dataset, score)
        if len(axes_of(dataset)) > 1:
            figures["maps.png"] = plots.sweep_maps(dataset, score)
    for name, end in ends.items():
        if f"votes{end}" in dataset and len(clouds[name]):
            votes = dataset[f"votes{end}"].values
            figures[f"votes{end}.png"] = plots.votes_map(clouds[name], votes, title=name if end else "").figure
    writers |= {name: functools.partial(figure.savefig, format="png") for name, figure in figures.items()}
    for name in ("curves.png", "maps.png", "votes.png", *(f"votes_{one}.png" for one in clouds)):
        if name not in figures or (directory / name).is_symlink():
            (directory / name).unlink(missing_ok=True)
    for name, write in writers.items():
        with new_file(directory / name, overwrite=True) as path:
            write(path)
    return list(writers)
