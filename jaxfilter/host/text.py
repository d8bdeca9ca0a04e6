"""Point clouds as text: the ISPRS reference samples, xyz and csv; read in chunks, rewritten line by line."""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from ..core.errors import InputError
from .files import Bounds, Replay
from .records import inside, reading

SUFFIXES = (".txt", ".xyz", ".csv")
GROUND, OBJECT = 0, 1
"""Labels as the ISPRS samples have them."""

_LINES = 200_000
_MARK = "\u00ef\u00bb\u00bf"  # byte order mark, read as Latin-1
_PREFIX = _MARK + "/# \t"  # what may stand before the names of columns
_NAMES = {  # column names, without case and punctuation
    "x": "x", "y": "y", "z": "z", "label": "label", "class": "classification", "classification": "classification",
    "returnnumber": "return_number", "numberofreturns": "number_of_returns", "numreturns": "number_of_returns",
    "withheld": "withheld",
}  # fmt: skip
_LARGEST = {"classification": 255, "return_number": 15, "number_of_returns": 15, "withheld": 1, "label": 1}


@dataclasses.dataclass(frozen=True)
class Layout:
    """How a text file is laid out.

    Attributes:
        delimiter: comma, semicolon, or None for white space.
        columns: position by name, for the columns that are understood.
        header: number of the line (from 0) that names the columns, or None.
        first: number of the first line of data.
        decimals: most digits behind the point of a coordinate among the first lines.
    """

    delimiter: str | None
    columns: dict[str, int]
    header: int | None
    first: int
    decimals: int

    def __str__(self) -> str:
        kind = {",": "comma-separated", ";": "semicolon-separated", None: "white space separated"}[self.delimiter]
        return f"text, {kind}: {' '.join(self.columns)}"


def layout_of(path: Path) -> Layout | None:
    """From the first lines; None if the file has no data lines. Raises InputError if the columns cannot be told."""
    with reading(path), _open(path) as file:
        lines = list(itertools.islice(file, 1000))
    first = next((i for i, line in enumerate(lines) if _is_point(line)), None)
    before = [i for i, line in enumerate(lines[:first]) if line.strip()]
    if first is None:
        if not before or all(lines[i].lstrip().startswith("#") for i in before):
            return None
        raise InputError(f"{path}: no line holds three numbers; this is not a text file of points")
    delimiter = ";" if ";" in lines[first] else "," if "," in lines[first] else None
    for i in reversed(before):
        names = [re.sub(r"[^a-z0-9]", "", name.lower()) for name in _tokens(lines[i].lstrip(_PREFIX), delimiter)]
        columns = {_NAMES[name]: at for at, name in enumerate(names) if name in _NAMES}
        if {"x", "y", "z"} <= columns.keys():
            return Layout(delimiter, columns, i, first, _decimals(lines[first:], delimiter, columns))
        if not lines[i].lstrip().startswith("#"):
            raise InputError(f"{path}: line {i + 1}, {lines[i].strip()[:60]!r}, names no columns x, y and z")
    width = len(_tokens(lines[first], delimiter))
    if width not in (3, 4):
        raise InputError(
            f"{path}: {width} columns without names; x y z and x y z label are understood, others need a header line"
        )
    columns = dict(zip(("x", "y", "z", "label"), range(width), strict=False))
    return Layout(delimiter, columns, None, first, _decimals(lines[first:], delimiter, columns))


def read_text(
    path: Path, layout: Layout, bounds: Bounds | None = None
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Chunks of coordinates f64[k, 3] in file units and of attributes, named as a PointCloud's fields.

    ``reference`` (True = ground) comes from a column ``label``. Points outside ``bounds`` are left out.

    Raises: InputError naming the lines that cannot be read, and labels and classes out of range.
    """
    for _, values in _chunks(path, layout):
        xyz = values[:, [list(layout.columns).index(axis) for axis in "xyz"]]
        keep = slice(None) if bounds is None else inside(xyz, bounds)
        attributes = {}
        for i, name in enumerate(layout.columns):
            if name not in _LARGEST:
                continue
            column = values[keep, i]
            odd = ~((column >= 0) & (column <= _LARGEST[name]) & (column == np.rint(column)))
            if odd.any():
                hint = f"{GROUND} (ground) or {OBJECT} (object)" if name == "label" else f"0 to {_LARGEST[name]}"
                raise InputError(f"{path}: {name} {column[odd.argmax()]:g}: whole numbers, {hint}, are needed")
            key, kind = ("reference", bool) if name == "label" else (name, bool if name == "withheld" else np.uint8)
            attributes[key] = (column == GROUND) if name == "label" else column.astype(kind)
        yield xyz[keep], attributes


def rewrite_text(
    path: Path,
    layout: Layout,
    target: TextIO,
    bounds: Bounds | None,
    labels: Callable[[slice], np.ndarray],
    classes: Callable[[np.ndarray, slice], np.ndarray],
    replay: Replay,
) -> None:
    """Copy a text file with its own number formats, and with the results in its label column, or else in its class
    column, or else in a new last column of labels.

    ``labels(rows)`` and ``classes(old, rows)`` give the values for a run of the cloud's points, which ``replay`` counts.
    """
    names = list(layout.columns)
    replace = {name: layout.columns[name] for name in ("label", "classification") if name in layout.columns}
    start, passed = 0, 0
    for lines, values in _chunks(path, layout):
        keep = np.ones(len(values), bool)
        if bounds is not None:
            keep = inside(values[:, [names.index("x"), names.index("y")]], bounds)
        replay.add(values[keep][:, [names.index(axis) for axis in "xyz"]])
        rows = slice(start, replay.points)
        start = rows.stop
        texts = {"label": map(str, labels(rows).tolist())}
        if "classification" in replace:
            old = values[keep, names.index("classification")].astype(np.uint8)
            texts["classification"] = map(str, classes(old, rows).tolist())
        kept = iter(keep.tolist())
        for number, line in enumerate(lines, passed):
            if number < layout.first or not _holds_data(line):
                target.write(_appended(line, "label", layout) if number == layout.header and not replace else line)
            elif next(kept):
                for name, column in replace.items():
                    line = _replaced(line, column, next(texts[name]), layout)
                target.write(line if replace else _appended(line, next(texts["label"]), layout))
        passed += len(lines)


def write_table(target: TextIO, xyz: np.ndarray, ground: np.ndarray, decimals: int, delimiter: str) -> None:
    """Append lines of x, y, z (file units) and label."""
    label = np.where(ground, GROUND, OBJECT)
    form = delimiter.join([f"%.{decimals}f"] * 3 + ["%d"])
    target.writelines(form % (*point, flag) + "\n" for point, flag in zip(xyz.tolist(), label.tolist(), strict=True))


def _open(path: Path) -> TextIO:
    return open(path, encoding="latin-1", newline="")  # every byte, and every line ending, survives being rewritten


def _tokens(line: str, delimiter: str | None) -> list[str]:
    return [token.strip().strip('"') for token in line.strip().split(delimiter)]


def _is_point(line: str) -> bool:
    """Whether at least three of its columns are numbers, which no line of names has."""
    return _holds_data(line) and sum(map(_is_number, re.split(r'[\s,;"]+', line.removeprefix(_MARK)))) >= 3


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


def _holds_data(line: str) -> bool:
    return bool(line.strip()) and not line.lstrip().startswith("#")


def _decimals(lines: list[str], delimiter: str | None, columns: dict[str, int]) -> int:
    last = max(columns[axis] for axis in "xyz")
    rows = [_tokens(line, delimiter) for line in lines if _holds_data(line)]
    return max(len(row[columns[axis]].partition(".")[2]) for row in rows if len(row) > last for axis in "xyz")


def _chunks(path: Path, layout: Layout) -> Iterator[tuple[list[str], np.ndarray]]:
    """Runs of lines, and the numbers in their data lines: f64[k, named columns], in the order of ``layout.columns``."""
    used = tuple(layout.columns.values())
    with reading(path), _open(path) as file:
        for start in itertools.count(0, _LINES):
            lines = list(itertools.islice(file, _LINES))
            if not lines:
                return
            data = [line for line in lines[max(layout.first - start, 0) :] if _holds_data(line)]
            if start == 0 and data:
                data[0] = data[0].removeprefix(_MARK)
            values = np.zeros((0, len(used)))
            if data:
                try:
                    values = np.loadtxt(data, delimiter=layout.delimiter, usecols=used, ndmin=2, quotechar='"')
                except ValueError as error:
                    reason = _first_bad_line(lines, start, layout) or error
                    raise InputError(f"{path}: {reason}") from error
            yield lines, values


def _first_bad_line(lines: list[str], start: int, layout: Layout) -> str | None:
    for number, line in enumerate(lines, start):
        if number < layout.first or not _holds_data(line):
            continue
        tokens = _tokens(line.removeprefix(_MARK), layout.delimiter)
        for name, column in layout.columns.items():
            try:
                float(tokens[column])
            except IndexError:
                return f"line {number + 1} has {len(tokens)} columns, {name} is in column {column + 1}"
            except ValueError:
                return f"line {number + 1}: {name} is {tokens[column]!r}, not a number"
    return None


def _appended(line: str, text: str, layout: Layout) -> str:
    body = line.rstrip()
    return body + (layout.delimiter or ("\t" if "\t" in body else " ")) + text + (_ending(line) or "\n")


def _replaced(line: str, column: int, text: str, layout: Layout) -> str:
    if layout.delimiter is not None:
        cells = line.rstrip("\r\n").split(layout.delimiter)
        cells[column] = text
        return layout.delimiter.join(cells) + _ending(line)
    token = next(itertools.islice(re.finditer(r"\S+", line), column, None))
    return line[: token.start()] + text + line[token.end() :]


def _ending(line: str) -> str:
    return line[len(line.rstrip("\r\n")) :]
