"""Options that commands share, and the values of the library that they make."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..core.reading import KEPT_CLASSES
from .session import BadUsage, Session, in_flags
from .values import Bytes, Number

if TYPE_CHECKING:
    from ..core.reading import Reading
    from ..files.storage import Place
    from ..surveys.collection import Collection
    from ..surveys.measures import Recipe
    from ..surveys.options import RunOptions

Metres = click.FloatRange(0, min_open=True)
OPTIONS = {
    "units": click.Option(
        ["--units"],
        metavar="UNIT",
        help="Units of the coordinates: m, ft, us-ft, or XY,Z such as us-ft,m.  [default: as the CRS says]",
    ),
    "bounds": click.Option(
        ["--bounds"],
        nargs=4,
        type=float,
        metavar="XMIN YMIN XMAX YMAX",
        help="Read and write only the points within this box, in file units.",
    ),
    "returns": click.Option(
        ["--returns"],
        default="last,only",
        help="Echoes to judge: first, intermediate, last, only, or all.",
    ),
    "ignore_classes": click.Option(
        ["--ignore-class", "ignore_classes"],
        type=Number(int, optional=True),
        multiple=True,
        default=KEPT_CLASSES,
        show_default="7, 9, and all from 17 on",
        help="Points of this class are not judged and keep it; may be repeated. Replaces the default; none judges all.",
    ),
    "ignore_overlap": click.Option(
        ["--ignore-overlap"], is_flag=True, help="Points of class 12 or with the overlap flag are not judged either."
    ),
    "keep_withheld": click.Option(
        ["--keep-withheld"], is_flag=True, help="Judge points with the withheld flag as well."
    ),
    "drop_invalid": click.Option(
        ["--drop-invalid"], is_flag=True, help="Label NaN and infinite coordinates non-ground."
    ),
    "for_cloud": click.Option(
        ["--for-cloud"], is_flag=True, help="Set parameters that depend on point spacing from the data."
    ),
    "largest_building": click.Option(
        ["--largest-building"],
        type=Metres,
        metavar="METRES",
        help="Width of the largest building. Set the parameters that depend on it, and those of --for-cloud.",
    ),
    "set": click.Option(
        ["--set", "fields"],
        metavar="NAME=VALUE",
        multiple=True,
        help="A parameter of the filter; may be repeated.",
    ),
    "preset": click.Option(["--preset"], metavar="NAME", help="A named set of parameters of the filter to start from."),
    "filter": click.Option(
        ["--filter", "method"],
        metavar="METHOD",
        help="Find the ground with this filter instead of by class or label.",
    ),
    "ground_classes": click.Option(
        ["--ground-class", "ground_classes"],
        type=click.IntRange(0, 255),
        multiple=True,
        default=(2,),
        help="Class of the ground points; may be repeated.",
    ),
    "tile": click.Option(
        ["--tile"],
        type=Metres,
        metavar="METRES",
        help="Side of the tiles that large data are cut into.  [default: as holds about 5 million points]",
    ),
    "halo": click.Option(
        ["--halo"],
        type=click.FloatRange(0),
        metavar="METRES",
        help="Width around each tile that the filter sees as well.  [default: what the method needs]",
    ),
    "workers": click.Option(
        ["--workers"],
        type=click.IntRange(1),
        help="Number of processes, or of threads if there is one tile.  [default: one per core]",
    ),
    "threads": click.Option(
        ["--workers"], type=click.IntRange(1), help="Number of threads for triangulation.  [default: one per core]"
    ),
    "memory": click.Option(
        ["--memory"],
        type=Bytes(),
        help="Memory for all processes together, such as 4GB.  [default: 70 % of what is free]",
    ),
    "client": click.Option(
        ["--scheduler", "client"],
        metavar="ADDRESS",
        help="Address of a Dask scheduler, whose workers then do the work.",
    ),
    "work": click.Option(
        ["--work"],
        metavar="FOLDER",
        help="Local folder where a run keeps what it needs to go on; needed for several files into a URL.  [default: beside OUT]",
    ),
    "resume": click.Option(["--resume"], is_flag=True, help="Go on with the run that was begun for OUT."),
    "overwrite": click.Option(["--overwrite"], is_flag=True, help="Replace OUT if it exists, and begin the run anew."),
    "in_place": click.Option(
        ["--in-place"], is_flag=True, help="Replace the files IN. Then all names are IN; there is no OUT."
    ),
}
"""Every shared option."""
READING = ("units", "bounds", "returns", "ignore_classes", "ignore_overlap", "keep_withheld", "drop_invalid")
RUN = ("tile", "halo", "workers", "memory", "client", "work", "resume", "overwrite", "in_place")


def with_options(*given: str | click.Option) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator that gives a command these options, in this order."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        made = [OPTIONS[one] if isinstance(one, str) else one for one in given]
        command.__dict__.setdefault("__click_params__", []).extend(reversed(made))
        return command

    return decorate


def take_reading(options: dict[str, Any]) -> Reading:
    """The value of the options of :data:`READING` that a command has, which are taken out. Raises BadUsage."""
    from ..core.errors import InputError
    from ..core.reading import Reading

    given = {name: options.pop(name) for name in READING if name in options}
    if "ignore_classes" in given:
        given["ignore_classes"] = tuple(c for c in given["ignore_classes"] if c is not None)
    try:
        return Reading(**given)
    except InputError as error:
        raise BadUsage(in_flags(str(error))) from error


def take_run(options: dict[str, Any], session: Session) -> RunOptions:
    """The value of the options of :data:`RUN`, which are taken out; the session shows progress. Raises ParameterError."""
    from ..surveys.options import RunOptions
    from ..surveys.report import Standing

    def show(standing: Standing) -> None:
        many = standing.tiles > 1
        note = f"{standing.tiles_done:,} of {standing.tiles:,}" if many else ""
        session.progress(standing.share, standing.step, note, standing.rate if many else None)

    return RunOptions(**{name: options.pop(name) for name in RUN if name in options}, progress=show)


def take_recipe(options: dict[str, Any]) -> Recipe | None:
    """The filter that ``method``, ``fields``, ``preset``, ``for_cloud`` and ``largest_building`` describe, which are taken out;
    None without a method. Raises BadUsage for names that there are not, ParameterError for values."""
    from ..methods import FILTERS
    from ..surveys.measures import Recipe
    from . import flags

    method, fields, preset, width = (
        options.pop(name, None) for name in ("method", "fields", "preset", "largest_building")
    )
    for_cloud = options.pop("for_cloud", False)
    if method is None:
        if fields or preset or for_cloud or width:
            raise BadUsage("--set, --preset, --for-cloud and --largest-building need --filter METHOD")
        return None
    if method not in FILTERS:
        raise BadUsage(f"no method {method!r}: choose one of {', '.join(FILTERS)}")
    kind = FILTERS[method]
    if preset is not None and preset not in kind.PRESETS:
        raise BadUsage(f"--preset {preset!r}: {kind.__name__} has {', '.join(kind.PRESETS)}")
    changes = {name: flags.value_of(kind, name, text, "--set") for name, text in pairs("--set", fields or ())}
    recipe = Recipe(kind, changes, preset, for_cloud, width)
    recipe.alone()
    return recipe


def pairs(option: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    """Field and value of FIELD=VALUE; a field with dashes is the one with underscores. Raises BadUsage."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise BadUsage(f"{option} {text!r}: write it as FIELD=...")
        if name in found:
            raise BadUsage(f"{option} {name}: given twice")
        found[name] = value.strip()
    return list(found.items())


def split_names(names: Sequence[str], in_place: bool, bare: bool = False) -> tuple[list[str], str | None]:
    """IN and OUT. Raises BadUsage if one is missing, or a local IN stands for nothing; ``bare``: the first might be meant as a
    method."""
    from ..methods import FILTERS

    *inputs, out = (*names, None) if in_place else names
    if not inputs:
        raise BadUsage("OUT is missing: name a file or a folder to write, or pass --in-place")
    for number, name in enumerate(inputs):
        assert name is not None
        if "://" in name or any(c in name for c in "*?[") or Path(name).exists():
            continue
        first = bare and number == 0 and "." not in name
        words = f", and no method: choose one of {', '.join(FILTERS)}" if first else ""
        raise BadUsage(f"{name}: no such file or folder{words}")
    return inputs, out  # type: ignore[return-value]


def check_target(target: Place, overwrite: bool, suffixes: Sequence[str] = ()) -> None:
    """Raises BadUsage if ``target`` exists and not ``overwrite``, cannot be written, or has none of the suffixes."""
    from ..core.errors import JaxfilterError
    from ..files.disk import is_there

    if suffixes and target.suffix.lower() not in suffixes:
        raise BadUsage(f"{target}: the suffix must be one of {', '.join(suffixes)}")
    try:
        there = is_there(target)
    except JaxfilterError as error:
        raise BadUsage(str(error)) from error
    if there and not overwrite:
        raise BadUsage(f"{target} exists: name another file, or pass --overwrite")
    if isinstance(target, Path) and not target.absolute().parent.is_dir():
        raise BadUsage(f"{target.absolute().parent} is not a folder: make it first")


def check_out(out: str | None, inputs: Sequence[str], run: RunOptions) -> None:
    """Refuse an output that cannot be, before anything is read. Raises BadUsage."""
    from ..core.errors import JaxfilterError
    from ..surveys import targets

    try:
        if out is not None:
            targets.check_out(out, inputs, run)
    except JaxfilterError as error:
        raise BadUsage(in_flags(str(error))) from error


def open_inputs(session: Session, inputs: Sequence[str], reading: Reading) -> Collection:
    """The files that are named; what does not fit together in several of them is noted."""
    from ..surveys.collection import open as open_collection

    with session.step("headers"):
        collection = open_collection(inputs, units=reading.units)
        findings = [] if len(collection) < 2 else dataclasses.replace(collection.check(), mixed=None).lines()
    for line in findings:  # mixed units are an error of the run
        session.note(f"note: {line}")
    return collection
