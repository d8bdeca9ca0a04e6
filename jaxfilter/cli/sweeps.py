"""The ``sweep`` command: many sets of parameters."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .answer import Answer, in_session
from .commands import main
from .options import pairs, take_reading, take_recipe, with_options
from .output import count, print_table, times
from .session import BadUsage, Session
from .values import FOLDER, INPUT

if TYPE_CHECKING:
    import pandas
    import xarray

    from ..core.cloud import PointCloud
    from ..core.filter import Filter
    from ..core.reading import Reading

MEMORY = click.Option(
    ["--memory"],
    type=click.FloatRange(0, min_open=True),
    default=2.0,
    metavar="GB",
    help="Sets that are computed at the same time hold at most this much memory.",
)
DATASET, TABLE, CHECKPOINT = "sweep.nc", "sets.csv", "checkpoint.npz"


@main.command()
@click.argument("method", metavar="METHOD")
@click.argument("sources", metavar="IN [IN ...]", nargs=-1, required=True, type=INPUT)
@click.argument("directory", metavar="OUT_DIR", type=FOLDER)
@click.option(
    "--axis",
    "axes",
    metavar="FIELD=VALUES",
    multiple=True,
    required=True,
    help="Values of a field: V,V,... or START:STOP:STEP (with STOP), or LOW..HIGH to draw from; may be repeated.",
)
@click.option(
    "--design",
    type=click.Choice(["grid", "random", "sobol", "list"]),
    default="grid",
    help="grid runs all combinations, random and sobol draw --size sets, list takes the first values of all axes, then the "
    "second ones, and so on.",
)
@click.option("--size", type=int, help="Number of sets of a random or sobol design.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of a random or sobol design.")
@with_options("set", "preset", "largest_building")
@click.option("--votes", is_flag=True, help="Count for every point how many sets call it ground.")
@click.option(
    "--score",
    type=click.Choice(["total", "kappa", "type1", "type2"]),
    default="total",
    help="The sets are sorted by this score.",
)
@with_options("units", MEMORY, "threads")
@click.option("--resume/--fresh", default=True, help="Go on with the sweep in OUT_DIR, or replace it.")
@in_session
def sweep(
    session: Session,
    sources: tuple[Path, ...],
    directory: Path,
    axes: tuple[str, ...],
    score: str,
    resume: bool,
    **options: Any,
) -> Answer:
    """Classify with many sets of parameters, and score each against the labels of IN.

    Labels are class 2 of LAS (points of class 0 do not count), or a label column of text. Writes into OUT_DIR: sweep.nc, all
    scores (NetCDF, for xarray); sets.csv, a line per set, best first; and pictures, where matplotlib is installed. An
    interrupted sweep goes on where it was when the command is given again.
    """
    from ..core.errors import InputError
    from ..sweeps import sweep as sweeps
    from ..sweeps.best import best_sets
    from ..sweeps.design import make_design

    recipe, memory, reading = take_recipe(options), options.pop("memory"), take_reading(options)
    assert recipe is not None
    filter_ = recipe.alone()
    assert filter_ is not None
    design = {name: options.pop(name) for name in ("design", "size", "seed")}
    ranges = {name: _axis(type(filter_), name, text, design["design"]) for name, text in pairs("--axis", axes)}
    plan = make_design(filter_, ranges, design["design"], design["size"], design["seed"])
    checkpoint = directory / CHECKPOINT
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
    options |= design | {"memory": memory * 1e9, "checkpoint": checkpoint, "progress": session.progress}
    with session.step("sweep", len(clouds) * len(plan.sets), "sets"), _explained(checkpoint):
        dataset = sweeps.sweep(filter_, clouds if len(clouds) > 1 else first, ranges, **options)
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

    def show() -> None:
        if scored:
            _print_sets(dataset, table.head(10), score)
        click.echo(
            f"{type(filter_).__name__}: {sets:,} sets, {count(len(clouds), 'cloud')}, {count(groups, 'group')}; "
            f"{times(session.seconds)}\nin {directory}: {', '.join(files)}"
        )

    return Answer(facts | session.as_dict(), show)


def _axis(method: type[Filter], name: str, text: str, design: str) -> list[Any] | tuple[Any, Any]:
    """The values of an axis of a sweep, or the range to draw them from."""
    from . import flags

    def value(piece: str) -> Any:
        return flags.value_of(method, name, piece, "--axis")

    if not text:
        raise BadUsage(f"--axis {name} is empty: give values")
    if ".." in text:
        if design not in ("random", "sobol"):
            raise BadUsage(f"--axis {name}={text}: a range needs --design random or sobol, and --size")
        return drawn_range(method, name, text)
    if ":" in text:
        return [value(piece) for piece in _steps(name, text)]
    return [value(piece.strip()) for piece in text.split(",")]


def drawn_range(method: type[Filter], name: str, text: str) -> tuple[Any, Any]:
    """The ends of LOW..HIGH."""
    from . import flags

    low, dots, high = text.partition("..")
    if not (dots and low and high):
        raise BadUsage(f"--axis {name}={text}: write a range as LOW..HIGH")
    ends = flags.value_of(method, name, low, "--axis"), flags.value_of(method, name, high, "--axis")
    if not all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in ends):
        raise BadUsage(f"--axis {name}={text}: a range needs numbers; give words as a list")
    return ends


def _steps(name: str, text: str) -> list[str]:
    """START:STOP:STEP as numbers, STOP included."""
    try:
        start, stop, step = (float(piece) for piece in text.split(":"))
        count = int((stop - start) / step + 1e-9) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise BadUsage(f"--axis {name}={text}: write a series as START:STOP:STEP, three finite numbers") from None
    if not (step > 0 and stop >= start and count <= 10_000):
        raise BadUsage(f"--axis {name}={text}: a series goes up from START to STOP, in at most 10,000 steps")
    return [f"{start + i * step:.10g}" for i in range(count)]


def _read_all(sources: tuple[Path, ...], reading: Reading) -> dict[str, PointCloud]:
    """Clouds by the names of their files, made fit for names in NetCDF and apart from each other."""
    from ..files.reading import read

    names: list[str] = []
    for source in sources:
        stem = "".join(c if c.isalnum() and c.isascii() else "_" for c in source.stem)
        names.append(stem if stem not in names else f"{stem}_{len(names) + 1}")
    return {name: read(source, units=reading.units) for name, source in zip(names, sources, strict=True)}


@contextlib.contextmanager
def _explained(checkpoint: Path) -> Iterator[None]:
    """Say what to do when a checkpoint does not fit, or the sweep is interrupted."""
    from ..core.errors import InputError

    try:
        yield
    except InputError as error:
        if str(checkpoint) in str(error):
            raise BadUsage(f"{error}; --fresh replaces it") from error
        raise
    except KeyboardInterrupt as error:
        error.add_note(f"finished sets are kept in {checkpoint.parent}, the same command goes on from there")
        raise


def _write(
    directory: Path, dataset: xarray.Dataset, table: pandas.DataFrame, clouds: dict[str, PointCloud], score: str
) -> list[str]:
    """All files of a sweep; their names. Pictures of a sweep that was replaced are removed."""
    from ..files.disk import new_file

    writers: dict[str, Callable[[Path], Any]] = {
        DATASET: lambda path: _storable(dataset).to_netcdf(path, engine="scipy"),
        TABLE: lambda path: table.to_csv(path),
    }
    for name, figure in _pictures(dataset, clouds, score).items():
        if figure is None:
            (directory / name).unlink(missing_ok=True)
        else:
            writers[name] = functools.partial(figure.savefig, format="png")
    for name, write in writers.items():
        with new_file(directory / name, overwrite=True) as path:
            write(path)
    return list(writers)


def _storable(dataset: xarray.Dataset) -> xarray.Dataset:
    """With values that are not all of one type as words, which NetCDF can hold."""
    from ..sweeps.best import word

    words = {
        name: (values.dims, [word(value) for value in values.values], values.attrs)
        for name, values in dataset.coords.items()
        if values.dtype == object
    }
    return dataset.assign_coords(words)


def _pictures(dataset: xarray.Dataset, clouds: dict[str, PointCloud], score: str) -> dict[str, Any]:
    """Figures by the names of their files; None where there is nothing to draw, or no matplotlib to draw it."""
    ends = {name: f"_{name}" if len(clouds) > 1 else "" for name in clouds}
    every = ["", *(f"_{name}" for name in clouds)]
    figures: dict[str, Any] = dict.fromkeys(["curves.png", "maps.png", *(f"votes{end}.png" for end in every)])
    if importlib.util.find_spec("matplotlib") is None:
        return figures
    from .. import plots
    from ..sweeps.best import axes_of

    if dataset[score].notnull().any():
        figures["curves.png"] = plots.sweep_curves(dataset, score)
        if len(axes_of(dataset)) > 1:
            figures["maps.png"] = plots.sweep_maps(dataset, score)
    for name, end in ends.items():
        if f"votes{end}" in dataset and len(clouds[name]):
            votes = dataset[f"votes{end}"].values
            figures[f"votes{end}.png"] = plots.votes_map(clouds[name], votes, title=name if end else "").figure
    return figures


def _print_sets(dataset: xarray.Dataset, table: pandas.DataFrame, score: str) -> None:
    from ..sweeps.best import SCORES, axes_of, word

    names, heads = axes_of(dataset), {"type1": "Type I", "type2": "Type II"}
    rows = [
        (str(number), *(word(row[name]) for name in names), *(f"{row[name]:.2f}" for name in SCORES))
        for number, row in table.iterrows()
    ]
    title = f"best sets by {heads.get(score, score)}, percent" + ", means over the clouds" * ("cloud" in dataset.dims)
    print_table(("set", *names, *(heads.get(name, name) for name in SCORES)), rows, title=title)
