"""The ``sweep`` command: many sets of parameters."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from . import building
from .checks import check_reading
from .commands import main
from .output import print_json
from .session import BadUsage, Session, session_options

if TYPE_CHECKING:
    import pandas
    import xarray

    from ..core.cloud import PointCloud
    from ..core.filter import Filter

DATASET, TABLE, CHECKPOINT = "sweep.nc", "sets.csv", "checkpoint.npz"
CURVES, MAPS, VOTES = "curves.png", "maps.png", "votes{}.png"


@main.command()
@building.method_argument
@click.argument(
    "sources",
    metavar="IN [IN ...]",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
)
@click.argument("directory", metavar="OUT_DIR", type=click.Path(file_okay=False, path_type=Path))
@click.option(
    "--axis",
    "axes",
    metavar="FIELD=VALUES",
    multiple=True,
    required=True,
    help="V,V,... or START:STOP:STEP (with STOP), or LOW..HIGH to draw from; may be repeated.",
)
@click.option(
    "--design",
    type=click.Choice(["grid", "random", "sobol", "list"]),
    default="grid",
    show_default=True,
    help="All combinations; --size sets that are drawn; or the first values of all axes, the second, ...",
)
@click.option("--size", type=int, help="Number of sets of a random or sobol design.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of a random or sobol design.")
@building.set_option
@building.preset_option
@building.largest_option
@click.option("--votes", is_flag=True, help="Count for every point the sets that call it ground.")
@click.option(
    "--score",
    type=click.Choice(["total", "kappa", "type1", "type2"]),
    default="total",
    show_default=True,
    help="What makes a set good.",
)
@building.units_option
@building.memory_option
@building.workers_option
@click.option(
    "--resume/--fresh", default=True, show_default=True, help="Go on with the sweep in OUT_DIR, or replace it."
)
def sweep(
    method: str,
    sources: tuple[Path, ...],
    directory: Path,
    axes: tuple[str, ...],
    design: str,
    size: int | None,
    seed: int,
    fixed: tuple[str, ...],
    preset: str | None,
    largest_building: float | None,
    votes: bool,
    score: str,
    units: str | None,
    memory: float,
    workers: int | None,
    resume: bool,
    quiet: bool,
    as_json: bool,
    debug: bool,
) -> None:
    """Classify with many sets of parameters, and score each against the labels of IN.

    Labels are class 2 of LAS (points of class 0 do not count), or a label column of text. Writes into OUT_DIR: sweep.nc, all
    scores (NetCDF, for xarray); sets.csv, a line per set, best first; and pictures, where matplotlib is installed. An
    interrupted sweep goes on where it was when the command is given again.
    """
    from ..core.errors import InputError
    from ..sweeps import sweep as sweeps
    from ..sweeps.best import best_sets
    from ..sweeps.design import make_design

    with Session(quiet=quiet, debug=debug) as session:
        build = building.builder(method, fixed, preset, largest_building)
        ranges = {name: _axis(build.method, name, text, design) for name, text in building.pairs("--axis", axes)}
        plan = make_design(build.alone(), ranges, design, size, seed)
        check_reading(units, "last,only")
        _check_directory(directory, resume)
        with session.reading(*sources):
            clouds = _read_all(sources, units)
            for source, cloud in zip(sources, clouds.values(), strict=True):
                if cloud.reference is None and not votes:
                    raise InputError(
                        f"{source} has no labels (class 2, or a label column) to score against: pass --votes"
                    )
        filter_ = build.on(next(iter(clouds.values())))
        directory.mkdir(parents=True, exist_ok=True)
        checkpoint = directory / CHECKPOINT
        if not resume:
            checkpoint.unlink(missing_ok=True)
        with session.step("sweep", len(clouds) * len(plan.sets), "sets"), _explained(checkpoint):
            dataset = sweeps.sweep(
                filter_,
                clouds if len(clouds) > 1 else next(iter(clouds.values())),
                ranges,
                design=design,
                size=size,
                seed=seed,
                votes=votes,
                workers=workers,
                memory=memory * 1e9,
                checkpoint=checkpoint,
                progress=session.progress,
            )
        with session.step("write"):
            table = best_sets(dataset, score, None)
            files = _write(directory, dataset, table, clouds, score)
    scored = bool(dataset[score].notnull().any())
    if as_json:
        first = table.reset_index().head(10).to_dict("records") if scored else []
        facts: dict[str, Any] = {
            "method": type(filter_).__name__,
            "input": [str(source) for source in sources],
            "output": str(directory),
        }
        facts |= {"sets": dataset.attrs["sets"], "groups": dataset.attrs["groups"], "score": score if scored else None}
        parameters = dataclasses.asdict(filter_)  # type: ignore[call-overload]
        print_json(facts | {"best": first, "parameters": parameters, "files": files} | session.as_dict())
    elif not quiet:
        if scored:
            _print_table(dataset, table.head(10), score)
        seconds = ", ".join(f"{name} {value:.2f} s" for name, value in session.seconds.items())
        click.echo(
            f"{type(filter_).__name__}: {dataset.attrs['sets']:,} sets, {_counted(len(clouds), 'cloud')}, "
            f"{_counted(dataset.attrs['groups'], 'group')}; {seconds}\nin {directory}: {', '.join(files)}"
        )


sweep.params += session_options()


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
        return building.drawn_range(method, name, text)
    if ":" in text:
        return [value(piece) for piece in _steps(name, text)]
    return [value(piece.strip()) for piece in text.split(",")]


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


def _check_directory(directory: Path, resume: bool) -> None:
    """Raises BadUsage if results that cannot be gone on with would be replaced."""
    if resume and (directory / DATASET).exists() and not (directory / CHECKPOINT).exists():
        raise BadUsage(f"{directory} holds {DATASET} of another sweep: name another folder, or pass --fresh")


def _read_all(sources: tuple[Path, ...], units: str | None) -> dict[str, PointCloud]:
    """Clouds by the names of their files, made fit for names in NetCDF and apart from each other."""
    from ..files.reading import read

    names: list[str] = []
    for source in sources:
        stem = "".join(c if c.isalnum() and c.isascii() else "_" for c in source.stem)
        names.append(stem if stem not in names else f"{stem}_{len(names) + 1}")
    return {name: read(source, units=units) for name, source in zip(names, sources, strict=True)}


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
    """All files of a sweep; their names."""
    from ..files.disk import new_file

    writers: dict[str, Callable[[Path], Any]] = {
        DATASET: lambda path: _storable(dataset).to_netcdf(path, engine="scipy"),
        TABLE: lambda path: table.to_csv(path),
    }
    if importlib.util.find_spec("matplotlib") is not None:
        for name, figure in _draw(dataset, clouds, score).items():
            writers[name] = lambda path, figure=figure: figure.savefig(path, format="png")  # type: ignore[misc]
    for name, write in writers.items():
        with new_file(directory / name, overwrite=True) as path:
            write(path)
    for name in _pictures_of(clouds).difference(writers):
        (directory / name).unlink(missing_ok=True)  # of a sweep that was replaced
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


def _pictures_of(clouds: dict[str, PointCloud]) -> set[str]:
    return {CURVES, MAPS, VOTES.format(""), *(VOTES.format(f"_{name}") for name in clouds)}


def _draw(dataset: xarray.Dataset, clouds: dict[str, PointCloud], score: str) -> dict[str, Any]:
    """Figures by the names of their files."""
    from .. import plots
    from ..sweeps.best import axes_of

    figures: dict[str, Any] = {}
    if dataset[score].notnull().any():
        figures[CURVES] = plots.sweep_curves(dataset, score)
        if len(axes_of(dataset)) > 1:
            figures[MAPS] = plots.sweep_maps(dataset, score)
    for name, cloud in clouds.items():
        end = f"_{name}" if len(clouds) > 1 else ""
        if f"votes{end}" in dataset and len(cloud):
            votes = dataset[f"votes{end}"].values
            figures[VOTES.format(end)] = plots.votes_map(cloud, votes, title=name if end else "").figure
    return figures


def _print_table(dataset: xarray.Dataset, table: pandas.DataFrame, score: str) -> None:
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table

    from ..sweeps.best import SCORES, axes_of, word

    names = axes_of(dataset)
    heads = {"type1": "Type I", "type2": "Type II"}
    shown = Table(
        "set",
        *names,
        *(heads.get(name, name) for name in SCORES),
        title=f"best sets by {heads.get(score, score)}, percent"
        + ", means over the clouds" * ("cloud" in dataset.dims),
    )
    for column in shown.columns:
        column.justify = "right"
    for number, row in table.iterrows():
        shown.add_row(str(number), *(word(row[name]) for name in names), *(f"{row[name]:.2f}" for name in SCORES))
    console = Console()
    wanted = Measurement.get(console, console.options.update(max_width=10_000), shown).maximum
    console.width = max(console.width, wanted)  # a value that is cut off is worse than a long line
    console.print(shown)


def _counted(number: int, noun: str) -> str:
    return f"{number:,} {noun}" + "s" * (number != 1)
