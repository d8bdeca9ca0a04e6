"""Pipelines of PDAL: what its ground stages filters.smrf, filters.pmf and filters.csf are in terms of this library.

Names and defaults are those of PDAL's sources (``SMRFilter.cpp``, ``PMFFilter.cpp``, ``CSFilter.cpp``).
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .core.errors import InputError, ParameterError, warn

if TYPE_CHECKING:
    from .core.filter import Filter
    from .core.units import Units


@dataclasses.dataclass(frozen=True)
class Option:
    """An option of a stage: the ``field`` that it is here, and the unit of its values as powers of the units of X and Y and
    of Z, such as (-1, 1) for a slope. PDAL takes lengths in the units of the coordinates, filters take metres."""

    field: str
    xy: float
    z: float


@dataclasses.dataclass(frozen=True)
class Stage:
    """A ground stage of PDAL: name of the ``method``, the ``preset`` that has its defaults, and its ``options`` by name."""

    method: str
    preset: str
    options: Mapping[str, Option]


def _in(xy: float = 0, z: float = 0, **fields: str) -> dict[str, Option]:
    """Options in the same unit: fields by name."""
    return {name: Option(field, xy, z) for name, field in fields.items()}


STAGES: Mapping[str, Stage] = {
    "filters.smrf": Stage(
        "smrf",
        "paper",
        _in(xy=1, cell="cell", window="window", scalar="scaling", cut="cut")
        | _in(xy=-1, z=1, slope="slope")
        | _in(z=1, threshold="threshold"),
    ),
    "filters.pmf": Stage(
        "pmf",
        "pdal",
        _in(xy=1, cell_size="cell", max_window_size="max_window")
        | _in(xy=-2, z=1, slope="slope")  # the program multiplies by the cell twice
        | _in(z=1, initial_distance="initial_distance", max_distance="max_distance")
        | _in(exponential="exponential"),
    ),
    "filters.csf": Stage(
        "csf",
        "wheel",
        _in(xy=1, resolution="resolution")
        | _in(z=1, threshold="threshold", hdiff="max_step")
        | _in(z=0.25, step="time_step")  # a particle falls by 0.2 step^4 units
        | _in(rigidness="rigidness", smooth="smooth", iterations="iterations"),
    ),
}
"""The ground stages by name."""

_CELLS = 18
"""Cells in the ``window`` of filters.smrf where it is not given."""

_UNMATCHED = dict.fromkeys(("where", "where_merge", "dir"), "has no counterpart") | dict.fromkeys(
    ("tag", "inputs", "user_data", "log", "option_file", "threads"), "has no effect on labels and is left out"
)
"""What is said of options of any stage that are not done here."""

_ARGUMENTS = {"ignore": "ignore_classes", "classbits": "keep_withheld"}
"""Options whose arguments of ``read`` have other names."""

_HINTS = {
    "filters.range": "all points are written, with their classes",
    "filters.crop": "--bounds reads a part",
    "filters.assign": "--reset says which old classes are lost",
    "filters.outlier": "methods but SMRF bar low outliers themselves, and --noise-class 7 writes their class",
    "filters.hag_nn": "jaxfilter height writes HeightAboveGround",
    "filters.splitter": "with a folder as OUT a file is filtered in tiles",
    "filters.merge": "several files are filtered as a collection, into a folder",
    "writers.gdal": "jaxfilter dtm writes a terrain model",
}
_HINTS |= {
    "filters.expression": _HINTS["filters.range"],
    "filters.elm": _HINTS["filters.outlier"],
    "filters.hag_delaunay": _HINTS["filters.hag_nn"],
}


@dataclasses.dataclass(frozen=True)
class Translation:
    """What a pipeline with a ground stage is here.

    Attributes:
        stage: its name in PDAL.
        preset: of the method, which has PDAL's defaults; fields that the stage sets come on top.
        filter: the filter, in metres.
        reading: arguments of :func:`jaxfilter.read`; writing: of :func:`jaxfilter.write`; asked: names of those that the
            stage sets itself.
        inputs, outputs: files that the pipeline names.
        remarks: what else the pipeline does, which is not done here.
        unmatched: what the stage asks for and has no counterpart.
    """

    stage: str
    preset: str
    filter: Filter
    reading: Mapping[str, Any]
    writing: Mapping[str, Any]
    asked: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    remarks: tuple[str, ...]
    unmatched: tuple[str, ...]


def from_pdal(what: Any, *, units: str | Units = "m") -> Filter:
    """The filter that a ground stage of PDAL corresponds to: filters.smrf, filters.pmf or filters.csf, with PDAL's defaults.

    Args:
        what: a stage, such as ``{"type": "filters.smrf", "cell": 2.0}``; or a pipeline with one of them: JSON, what it
            parses to, or the name of a file with it.
        units: of the coordinates that the stage was written for, see :func:`jaxfilter.read`. PDAL takes its lengths in them;
            those of filters are metres.

    Returns: SMRF, PMF or CSF, with the preset that has PDAL's defaults.
    Raises: InputError if there is no such stage, or more than one, or no JSON; ParameterError for an option that the stage
    does not have, and for a value out of range.
    Warns: JaxfilterWarning for each option of the stage that a filter does not have, with its counterpart in
    :func:`jaxfilter.read` or :func:`jaxfilter.write`, if any.

    >>> jf.from_pdal({"type": "filters.smrf", "cell": 2.0})
    SMRF(cell=2.0, slope=0.15, window=36.0, threshold=0.5, scaling=1.25, cut=0.0)
    >>> jf.from_pdal({"type": "filters.smrf", "cell": 10.0}, units="ft").cell
    3.048
    """
    found = translate(what, units=units)
    for function, arguments in (("read", found.reading), ("write", found.writing)):
        for name in [name for name in arguments if name in found.asked]:
            warn(f"{found.stage}: a filter has no {name}: pass {name}={arguments[name]!r} to jaxfilter.{function}")
    for text in found.unmatched:
        warn(text)
    return found.filter


def translate(what: Any, *, units: str | Units = "m") -> Translation:
    """All of a pipeline that has a counterpart, and what has none. Arguments and errors as of :func:`from_pdal`. Reading and
    writing are as PDAL does it: it judges the points of all classes unless told to ``ignore`` some, withheld points too, and
    all that it judges lose their class."""
    from .core.reading import ECHOES
    from .core.units import parse_units
    from .methods import FILTERS

    scale, steps = parse_units(units), _steps(what)
    name, options = _ground_stage(steps)
    stage = STAGES[name]
    method = FILTERS[stage.method]
    reading: dict[str, Any] = {"ignore_classes": (), "keep_withheld": True}
    writing: dict[str, Any] = {"reset": "all"}
    unmatched = []
    # PDAL's defaults are in the units of the coordinates too
    preset = method.preset(stage.preset)
    factors = {one.field: float(scale.xy**one.xy * scale.z**one.z) for one in stage.options.values()}
    changes = {field: _scaled(getattr(preset, field), factor) for field, factor in factors.items() if factor != 1}
    for key, value in options.items():
        if key in stage.options:
            field = stage.options[key].field
            changes[field] = _value(name, key, value, getattr(preset, field), factors[field])
        elif key == "returns":
            reading["returns"] = ",".join(_words(value)) or "all"
            if unknown := [word for word in _words(value) if word not in ECHOES]:
                raise ParameterError(f"{name}: returns={unknown[0]!r}: must be some of {', '.join(ECHOES)}")
        elif key == "ignore":
            reading["ignore_classes"], unfit = _classes(name, _words(value))
            unmatched += unfit
        elif key == "classbits":
            flags = {word.lower() for word in _words(value)}
            reading["keep_withheld"] = "withheld" not in flags
            unmatched += [f"{name}: classbits={flag} has no counterpart" for flag in sorted(flags - {"withheld"})]
        elif key in ("ground_class", "other_class"):
            writing[key] = _value(name, key, value, 0, 1)
        elif key == "only_ground":
            writing |= {"only_ground": True} if _value(name, key, value, False, 1) else {}
        elif key in _UNMATCHED:
            unmatched.append(f"{name}: {key}={value!r} {_UNMATCHED[key]}")
        elif key != "type":
            known = ", ".join((*stage.options, "returns", "ignore", "classbits"))
            raise ParameterError(f"{name}: there is no option {key}={value!r}; there are {known}")
    if name == "filters.smrf" and "window" not in options:
        changes["window"] = _CELLS * changes.get("cell", scale.xy)
    try:
        filter_ = method.preset(stage.preset, **changes)
    except ParameterError as error:
        raise ParameterError(f"{name}: {error}") from error
    if stage.method == "pmf" and filter_.cell != scale.xy:
        unmatched.append(
            f"{name}: with cell_size={filter_.cell / scale.xy:g} PDAL opens with other windows: it takes their width in units of "
            "the coordinates for a number of cells"
        )
    if writing.get("only_ground"):
        del writing["reset"]
    asked = tuple(_ARGUMENTS.get(key, key) for key in options)
    return Translation(name, stage.preset, filter_, reading, writing, asked, *_surroundings(steps), tuple(unmatched))


def aliases(method: str) -> dict[str, str]:
    """PDAL's names of the fields of a method, by field, where they differ."""
    return {
        option.field: name
        for stage in STAGES.values()
        if stage.method == method
        for name, option in stage.options.items()
        if name != option.field
    }


def _steps(what: Any) -> list[Any]:
    """The stages of a pipeline: objects, and names of files. Raises InputError."""
    name = "pipeline"
    try:
        if isinstance(what, os.PathLike) or (isinstance(what, str) and what.lstrip()[:1] not in ("{", "[")):
            name = os.fspath(what)
            what = Path(what).read_text(encoding="utf-8-sig")
        if isinstance(what, str):
            what = json.loads(_COMMENT.sub(lambda found: found[1] or " ", what))
    except (json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"{name}: is no JSON: {error}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if isinstance(what, Mapping):
        what = what.get("pipeline", [what])
    if not isinstance(what, Sequence) or isinstance(what, str):
        raise InputError(f"{name}: neither a stage nor a list of stages, but {type(what).__name__}")
    for step in what:
        if not isinstance(step, (str, Mapping)) or (isinstance(step, Mapping) and not {"type", "filename"} & set(step)):
            lacking = "neither a type, such as filters.smrf, nor a filename"
            raise InputError(f"{name}: {step!r} is no stage of a pipeline: it has {lacking}")
    return list(what)


_COMMENT = re.compile(r'("(?:\\.|[^"\\])*")|//[^\n]*|/\*.*?\*/', re.DOTALL)
"""Strings, which are kept, and comments, which PDAL passes over."""


def _kind(step: Any) -> str:
    return str(step.get("type", "")) if isinstance(step, Mapping) else ""


def _ground_stage(steps: Sequence[Any]) -> tuple[str, Mapping[str, Any]]:
    """Name and options of the one ground stage. Raises InputError."""
    found = [step for step in steps if _kind(step) in STAGES]
    if len(found) != 1:
        there = ", ".join(_kind(step) or str(step) for step in steps) or "none"
        raise InputError(
            f"pipeline: one stage out of {', '.join(STAGES)} is needed, and it has {len(found)}; its stages are {there}"
        )
    return _kind(found[0]), found[0]


def _value(stage: str, key: str, value: Any, like: Any, factor: float) -> Any:
    """An option as a value of the type of ``like``; PDAL takes numbers as text too. Raises ParameterError."""
    text = str(value).strip()
    wanted = "true or false" if isinstance(like, bool) else "a whole number" if isinstance(like, int) else "a number"
    try:
        if isinstance(like, bool):
            return {"true": True, "false": False}[text.lower()]
        number = float(text)
        if isinstance(like, int) and not number.is_integer():
            raise ValueError
        return int(number) if isinstance(like, int) else _scaled(number, factor)
    except (KeyError, ValueError, OverflowError):
        raise ParameterError(f"{stage}: {key}={value!r}: must be {wanted}") from None


def _scaled(value: float, factor: float) -> float:
    """In metres, without the digits that only the arithmetic adds."""
    return float(f"{value * factor:.12g}")


def _words(value: Any) -> list[str]:
    """The words of a list, or of text with commas between them."""
    parts: Iterable[Any] = value.split(",") if isinstance(value, str) else value if isinstance(value, list) else [value]
    return [word for word in (str(part).strip() for part in parts) if word]


_RANGE = re.compile(r"(\w+)(!?)([\[(])([^:]*):([^\])]*)([\])])")


def _classes(stage: str, ranges: Sequence[str]) -> tuple[tuple[int, ...], list[str]]:
    """Classes in ranges such as ``Classification[7:7]``, and what is said of ranges of something else. Raises
    ParameterError."""
    chosen: set[int] = set()
    unfit = []
    for text in ranges:
        found = _RANGE.fullmatch(text)
        try:
            if found is None:
                raise ValueError
            low, high = float(found[4] or "-inf"), float(found[5] or "inf")
        except ValueError:
            raise ParameterError(f"{stage}: ignore={text!r}: must be a range such as Classification[7:7]") from None
        if found[1] != "Classification":
            unfit.append(f"{stage}: ignore={text} has no counterpart: points are set aside by class and echo only")
            continue
        within = {c for c in range(256) if low <= c <= high}
        within -= ({low} if found[3] == "(" else set()) | ({high} if found[6] == ")" else set())
        chosen |= set(range(256)) - within if found[2] else within
    return tuple(sorted(chosen)), unfit


def _surroundings(steps: Sequence[Any]) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
    """Files that are read and written, and a line on each stage and option that is not done here."""
    inputs: list[str] = []
    outputs: list[str] = []
    remarks: list[str] = []
    for number, step in enumerate(steps):
        kind, options = _kind(step), step if isinstance(step, Mapping) else {"filename": step}
        if kind in STAGES:
            continue
        if kind in _HINTS or kind.startswith("filters."):
            remarks.append(f"{kind} is not done: {_HINTS.get(kind, 'it has no counterpart')}")
            continue
        if "filename" in options:
            writes = kind.startswith("writers.") or (not kind and number and number == len(steps) - 1)
            (outputs if writes else inputs).append(str(options["filename"]))
        if more := ", ".join(f"{key}={value!r}" for key, value in options.items() if key not in ("type", "filename")):
            remarks.append(f"{kind or options['filename']}: {more} has no counterpart")
    return tuple(inputs), tuple(outputs), tuple(remarks)
