"""Options that commands share, and the values of the library that they make."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from ..core.reading import KEPT_CLASSES, Reading
from .session import BadUsage, Session
from .values import BOX, CLASS, COUNT, METRES, OUTPUT, Number, on_command_line, option, size

if TYPE_CHECKING:
    from ..files.classes import Classes
    from ..files.storage import Place
    from ..surveys.collection import Collection
    from ..surveys.measures import Recipe
    from ..surveys.options import RunOptions

T = TypeVar("T")
STATED = [
    option(
        "--units", "Units of X, Y and Z: m, ft, us-ft, or two with a comma, XY,Z.  [default: those of the CRS]", "UNIT"
    ),
    option(
        "--crs",
        "CRS for files that state none, such as EPSG:25832. Outputs state it. Coordinates stay as they are.",
        "CRS",
    ),
]
BOUNDS = option("--bounds", "Read only the points in this box, in the units of the files.", float, nargs=4, metavar=BOX)
AOI = option(
    "--aoi",
    "A file of polygons, such as a .gpkg. Only points inside are written; points outside help to find the ground.",
    click.Path(exists=True, path_type=Path),
)
DUPLICATES = option(
    "--drop-duplicates",
    "If several LAS files hold the same echo, as tiles with a buffer do, write it to the first of them only.",
    bool,
)
DROP_INVALID = option("--drop-invalid", "Accept points with NaN or infinite coordinates. They become non-ground.", bool)
READING = [
    *STATED,
    BOUNDS,
    AOI,
    option(
        "--returns",
        "Echoes that are judged: first, intermediate, last, only, or all; several with commas.",
        default="last,only",
    ),
    option(
        "--ignore-class ignore_classes",
        "Do not judge points of this class; they keep it. This replaces the default. none: judge all points.",
        Number(int, optional=True),
        multiple=True,
        default=KEPT_CLASSES,
        show_default="7, 9, and all from 17 on",
        callback=lambda context, parameter, given: tuple(number for number in given if number is not None),
    ),
    option("--ignore-overlap", "Do not judge points of class 12 or with the overlap flag.", bool),
    option("--keep-withheld", "Judge points with the withheld flag, too.", bool),
    DROP_INVALID,
    DUPLICATES,
]
"""Fields of Reading."""
PRESET_OF_CLASSES = option(
    "--classes preset_of_classes",
    "The classes that are written. ground: 2 and 1. usgs: 1, 2, 7, 9, 17 and the overlap flag.",
    click.Choice(["ground", "usgs"]),
    default="ground",
)
WRITTEN = [
    PRESET_OF_CLASSES,
    option("--ground-class", "Class for ground points.", CLASS, default=2),
    option("--other-class", "Class for points that lose their class because they are no ground.", CLASS, default=1),
    option(
        "--reset",
        "Points found to be no ground get --other-class: those of class 2 (ground), all, or none of them.",
        click.Choice(["ground", "all", "none"]),
        default="ground",
    ),
    option(
        "--only-ground",
        "Write ground points only. All other points keep their class, unless an option below changes it.",
        bool,
    ),
    option("--noise-class", "Class for low outliers (ASPRS: 7). All methods but SMRF find them.", CLASS),
    option("--water-class water", "Class for points of water (ASPRS: 9). OST finds them.", CLASS),
    option("--bridge-class bridge", "Class for points of bridge decks (ASPRS: 17). OST finds them.", CLASS),
    option("--unjudged-class unjudged", "Class for those points of class 0 that are not judged.", CLASS),
    option(
        "--overlap-flag",
        "Points of class 12 that are judged get the overlap flag and another class (point formats 6 to 10).",
        bool,
    ),
]
"""Fields of Classes."""
FIELDS = option("--set fields", "Set a parameter of the filter.", "NAME=VALUE", multiple=True)
PRESET = option("--preset", "Start from this named set of parameters of the filter.", "NAME")
FOR_CLOUD = option("--for-cloud", "Set the parameters that depend on the point spacing by that of the data.", bool)
_WIDTH = "Width of the largest building. Sets the parameters that depend on it, and does what --for-cloud does."
LARGEST_BUILDING = option("--largest-building", _WIDTH, METRES)
BY_DATA = [FOR_CLOUD, LARGEST_BUILDING]
FINDER = option(
    "--filter",
    "Find the ground with this method. Without it, the classes or labels of IN say what is ground.",
    "METHOD",
)
BREAKLINES = option(
    "--breaklines", "Also write the outlines of waters with their level, to this .gpkg or .geojson.", OUTPUT
)
FILTER = [FINDER, FIELDS, PRESET, *BY_DATA]
"""What makes a Recipe."""
_OF_GROUND = (
    "Class of the ground points of IN, if there is no --filter. With class 40 (bed of waters), water is not made level."
)
CLASSES = option("--ground-class ground_classes", _OF_GROUND, CLASS, multiple=True, default=(2,))
GROUND_OPTIONS = [*FILTER, CLASSES, *STATED, AOI, DROP_INVALID]
"""What is ground."""
RUN_OPTIONS = [
    option("--tile", "Side of the tiles into which large data are cut.  [default: by number of points]", METRES),
    option(
        "--halo",
        "Each tile is read with a border of this width.  [default: what the method needs]",
        click.FloatRange(0),
    ),
    option(
        "--wide-halos",
        "Allow tiles that are so small that their borders (--halo) hold more than twice their points.",
        bool,
    ),
    option("--workers", "Number of processes; of threads if there is one tile.  [default: one for each core]", COUNT),
    option(
        "--memory", "Memory that all processes together may use, such as 4GB.  [default: 70 % of what is free]", size
    ),
    option("--scheduler client", "Address of a Dask scheduler. Its workers do the work.", "ADDRESS"),
    option(
        "--work",
        "Local folder in which a run keeps its progress. Needed if OUT is a URL and IN are several files.",
        "FOLDER",
    ),
    option("--resume", "Continue the run of this OUT that was stopped.", bool),
    option("--overwrite", "Replace OUT if it exists, and start from the beginning.", bool),
    option("--dry-run", "Write nothing; say which tiles, files, memory and time the run would need.", bool),
    option("--in-place", "Change the files IN themselves. Name no OUT.", bool),
]
"""Fields of RunOptions."""
THREADS = option("--workers", "Number of threads for triangulation.  [default: one for each core]", COUNT)
MEMORY = option(
    "--memory", "Memory for sets of parameters that are computed at the same time, such as 4GB.", size, default="2GB"
)
SWEPT = [FIELDS, PRESET, LARGEST_BUILDING, *STATED, MEMORY, THREADS]
"""What sweeps and calibrations share."""
REPLACE = option("--overwrite", "Replace outputs that exist.", bool)


def take(kind: type[T], options: dict[str, Any], **more: Any) -> T:
    """A value of the library, a dataclass, from the options that are named as its fields, which are taken out, and ``more``."""
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        if field.name in options:
            more[field.name] = options.pop(field.name)
    return kind(**more)


def take_classes(options: dict[str, Any]) -> Classes:
    """The classes to write: of the preset, with what the command line says besides. Raises ParameterError."""
    from ..files.classes import Classes

    return Classes.preset(options.pop("preset_of_classes"), **on_command_line(vars(Classes())))


def take_run(options: dict[str, Any], session: Session) -> RunOptions:
    """How a run is carried out; the session shows its progress. Raises ParameterError."""
    from ..surveys.options import RunOptions
    from ..surveys.report import Standing

    noted = False

    def show(standing: Standing) -> None:
        nonlocal noted
        many = standing.tiles > 1
        if many and not noted:
            noted = True
            read = f"each point is read {standing.times_read:.1f} times"
            session.note(f"{standing.tiles:,} tiles; with their surroundings {read}")
        note = f"{standing.tiles_done:,} of {standing.tiles:,}" if many else ""
        session.progress(standing.share, standing.step, note, standing.rate if many else None)

    return take(RunOptions, options, progress=show)


def take_recipe(options: dict[str, Any]) -> Recipe | None:
    """The filter that the options of :data:`FILTER` describe, which are taken out; None without a method. Raises BadUsage for
    names that there are not, ParameterError for values."""
    from ..surveys.measures import Recipe
    from . import flags

    name, fields = options.pop("filter"), options.pop("fields")
    if name is None:
        if any([fields, *(options.pop(one) for one in ("preset", "for_cloud", "largest_building"))]):
            raise BadUsage("--set, --preset, --for-cloud and --largest-building need --filter METHOD")
        return None
    method = flags.method_of(name)
    changes = {field: flags.value_of(method, field, text, "--set") for field, text in pairs("--set", fields).items()}
    recipe = take(Recipe, options, method=method, changes=changes)
    recipe.alone()
    return recipe


def pairs(flag: str, texts: Sequence[str]) -> dict[str, str]:
    """Field and value of FIELD=VALUE; a field with dashes is the one with underscores. Raises BadUsage."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise BadUsage(f"{flag} {text!r}: write it as FIELD=...")
        if name in found:
            raise BadUsage(f"{flag} {name}: given twice")
        found[name] = value.strip()
    return found


def check_inputs(names: Sequence[str], bare: bool = False) -> None:
    """Raises BadUsage for a local name of nothing; ``bare``: the first might be meant as a method."""
    from ..methods import FILTERS

    for name in names:
        if "://" not in name and not any(c in name for c in "*?[") and not Path(name).exists():
            method = bare and name == names[0] and "." not in name
            words = f", folder or method; the methods are {', '.join(FILTERS)}" if method else " or folder"
            raise BadUsage(f"{name}: there is no such file{words}")


def check_target(target: Place, overwrite: bool, suffixes: Sequence[str] = (), made: str = "") -> None:
    """Raises BadUsage if ``target`` exists and not ``overwrite``, or has none of the suffixes; OutputError if it cannot be
    written. ``made``: a folder that will be made."""
    from ..files.disk import is_there

    if suffixes and target.suffix.lower() not in suffixes:
        raise BadUsage(f"{target}: the suffix must be one of {', '.join(suffixes)}")
    if is_there(target) and not overwrite:
        raise BadUsage(f"{target} exists: name another file, or pass --overwrite")
    parent = target.absolute().parent if isinstance(target, Path) else None
    if parent is not None and not parent.is_dir() and parent != Path(made).absolute():
        raise BadUsage(f"{parent} is not a folder: make it first")


def check_shapes(options: dict[str, Any], *targets: Path | None, made: str = "") -> None:
    """As :func:`check_target`, for files of shapes of a run that may go on."""
    for target in filter(None, targets):
        from ..files.vectors import VECTOR_SUFFIXES

        check_target(target, options["overwrite"] or options["resume"], VECTOR_SUFFIXES, made)


@dataclasses.dataclass(frozen=True)
class Files:
    """What a command over files works on.

    Attributes:
        inputs, out: names; no ``out`` in place. output: where the results go, in words.
        collection: the inputs.
        reading, run: what the options say.
    """

    session: Session
    inputs: list[str]
    out: str | None
    collection: Collection
    reading: Reading
    run: RunOptions
    output: str

    def do(self, act: Callable[..., T], *arguments: Any, **options: Any) -> T:
        """What a function of the library returns for these files, as a step of the session."""
        with self.session.step("run", self.collection.count):
            return act(self.collection, *arguments, reading=self.reading, run=self.run, **options)


def files_of(source: Path) -> list[Path]:
    """The file, or the LAS and LAZ files of a folder. Raises: InputError if there are none, or one cannot be read."""
    from ..core.errors import InputError
    from ..surveys.collection import open as open_collection

    if source.is_file():
        return [source]
    collection = open_collection(str(source))
    for _, reason in collection.unreadable:
        raise InputError(reason)
    return list(map(Path, collection.uris))


def open_survey(session: Session, names: Sequence[str], reading: Reading, bare: bool = False) -> Collection:
    """A collection of what is named, in a step; ``bare``: the first name might be meant as a method. Raises: BadUsage,
    JaxfilterError."""
    from ..surveys.collection import open as open_collection

    check_inputs(names, bare)
    with session.step("headers"):
        return open_collection(names, units=reading.units, crs=reading.crs)


def open_files(
    session: Session, names: Sequence[str], options: dict[str, Any], suffixes: Sequence[str] = (), bare: bool = False
) -> Files:
    """The files that a command names; what does not fit together in several of them is noted. ``suffixes``: of an output that
    is no file of points; ``bare``, and errors: as of :func:`open_survey`."""
    from ..files.storage import place_of
    from ..surveys.targets import check_out

    may_replace = "in_place" in options
    reading, run = take(Reading, options), take_run(options, session)
    inputs, out = (list(names), None) if run.in_place else (list(names[:-1]), names[-1])
    if not inputs:
        what = f"a {' or '.join(suffixes) or 'file or a folder'} to write"
        what += ", or pass --in-place" * may_replace
        raise BadUsage(f"OUT is missing: name {what}")
    output = out or ", ".join(inputs)
    if out == "-":
        suffix, several = Path(inputs[0]).suffix, any(c in inputs[0] for c in "*?[") or Path(inputs[0]).is_dir()
        if not suffixes and (several or len(inputs) > 1 or not suffix):
            raise BadUsage("-: standard output takes one file: name a folder")
        out = str(session.piped(suffixes[-1] if suffixes else suffix, run.resume))
    if out is not None:
        if suffixes:
            check_target(place_of(out), run.overwrite or run.resume, suffixes)
        else:
            check_out(out, inputs, run)
    collection = open_survey(session, inputs, reading, bare)
    findings = [] if len(collection) < 2 else dataclasses.replace(collection.check(), mixed=None).lines()
    for line in findings:  # mixed units are an error of the run
        session.note(f"note: {line}")
    return Files(session, inputs, out, collection, reading, run, output)
