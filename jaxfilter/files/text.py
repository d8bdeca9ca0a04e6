"""Point clouds as text: the ISPRS reference samples, xyz and csv; read and rewritten in runs of lines.

A record is a line. Comments, names and the number of cells are looked after here; what the cells of a line are is for pandas
to say, in reading and in rewriting.
"""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from ..core.errors import InputError
from ..core.inputs import COLUMNS, LARGEST
from ..core.reading import inside
from .disk import Bounds
from .guard import reading_errors

SUFFIXES = (".txt", ".xyz", ".csv")
GROUND, OBJECT = 0, 1
"""Labels as the ISPRS samples have them."""

_BLOCK = 1_000_000  # bytes that are read at a time
_LONGEST = 1_000_000  # bytes of a line
_PREAMBLE = 1000  # lines before the first point, and of comments that may name columns
_PROBED = 1000  # lines of points whose decimals are counted
_MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8
_BLANK = b" \t\r\n"
_PLAIN = bytes(i for i in range(256) if i > 0x1F or i in _BLANK)  # no control characters
_ASIDE = (b"#", b"\n ", b"\n\t", b"\n\r", b"\n\n")  # where one of these is, a line may hold no data
_END = 8e88  # no cell of points
_DELIMITERS = (";", ",", "\t", None)
_WORDS = {";": "semicolons", ",": "commas", "\t": "tabs", None: "white space"}
_NUMBER = re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE | re.ASCII)
_NAMES = {  # column names, without case and punctuation
    "x": "x", "y": "y", "z": "z", "label": "label", "class": "classification", "classification": "classification",
    "returnnumber": "return_number", "numberofreturns": "number_of_returns", "numreturns": "number_of_returns",
    "withheld": "withheld", "overlap": "overlap",
}  # fmt: skip
_UNNAMED = ["x", "y", "z", "label"]
_LARGEST = LARGEST | {"withheld": 1, "overlap": 1, "label": 1}


@dataclass(frozen=True)
class Layout:
    """A text file, and how it is laid out.

    Attributes:
        delimiter: comma, semicolon, tab, or None for white space.
        columns: position by name, for the columns that are understood.
        width: number of columns that every line of data has.
        header: number of the line (from 0) that names the columns, or None.
        first: number of the first line of data; that of the lines, if none holds data.
        decimals: most digits behind the point of a coordinate among the first lines.
        between: what is written between cells: the delimiter, or a tab or blank for white space.
    """

    path: Path
    delimiter: str | None
    columns: dict[str, int]
    width: int
    header: int | None
    first: int
    decimals: int
    between: str

    def __str__(self) -> str:
        return f"text separated by {_WORDS[self.delimiter]}: {' '.join(self.columns)}"


def layout_of(path: Path) -> Layout:
    """From the first lines. Raises InputError if the columns cannot be told, or if names and columns do not match."""
    lines, first = _head(path)
    before = [i for i, line in enumerate(lines[:first]) if line.strip(_BLANK)]
    comments = list(itertools.takewhile(lambda i: not _holds_data(lines[i]), reversed(before)))
    other = before[: len(before) - len(comments)][-1:]  # the line above
    headers = []  # what may name the columns, and how
    for delimiter, i in itertools.product(_DELIMITERS, other + comments[:_PREAMBLE]):
        names = _cells(lines[i].lstrip(b"/# \t"), delimiter)
        headers += [(delimiter, i, names)] if {"x", "y", "z"} <= set(map(_meaning, names)) else []
    if first is None:
        if other and not headers:
            raise InputError(f"{path}: no line holds three numbers; this is not a text file of points")
        delimiter, at, names = next((header for header in headers if header[1] in other), (None, None, _UNNAMED[:3]))
        return Layout(path, delimiter, _columns(path, at, names), len(names), at, len(lines), 0, delimiter or " ")
    widths = {delimiter: len(_cells(lines[first], delimiter)) for delimiter in _DELIMITERS}
    fitting = [header for header in headers if len(header[2]) == widths[header[0]]]
    if headers:
        delimiter, at, names = fitting[0] if fitting else max(headers, key=lambda header: widths[header[0]])
    elif other:
        raise InputError(f"{path}: line {other[0] + 1}, {_shown(lines[other[0]])}, names no columns x, y and z")
    else:
        delimiter = next((delimiter for delimiter in (";", ",", None) if widths[delimiter] >= 3), None)
        at, names = None, _UNNAMED[: widths[delimiter]]
        if not 3 <= widths[delimiter] <= 4:
            found = f"{widths[delimiter]} columns without names"
            raise InputError(f"{path}: {found}; x y z and x y z label are understood, others need a header line")
    columns = _columns(path, at, names)
    if at is not None and not fitting:
        hint = " (if it is a mere comment, take the names out of it)" if at in comments else ""
        ragged = _ragged(first, lines[first], widths[delimiter], delimiter)
        raise InputError(f"{path}: line {at + 1} names {len(names)} columns{hint}, {ragged}")
    rows = [line.split() if delimiter is None else line.split(delimiter.encode()) for line in lines[first:]]
    cells = [row[columns[axis]] for row in rows if len(row) == len(names) for axis in "xyz"]
    decimals = max((len(re.match(rb"[^.]*\.?(\d*)", cell)[1]) for cell in cells), default=0)  # type: ignore[index]
    between = delimiter or ("\t" if b"\t" in lines[first].strip(_BLANK) else " ")
    return Layout(path, delimiter, columns, len(names), at, first, decimals, between)


def read_text(
    layout: Layout, bounds: Bounds | None = None, drop_invalid: bool = True
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Runs of coordinates f64[k, 3] in file units and of attributes, named as a PointCloud's fields.

    ``reference`` (True = ground) comes from a column ``label``. Points outside ``bounds`` are left out.

    Raises: InputError naming the line and column of what cannot be read: lines of another width, cells that are not
    numbers, labels and classes out of range; NaN and infinite coordinates unless ``drop_invalid``.
    """
    for run in _runs(layout):
        values, xyz, keep = run.points(bounds)
        if not drop_invalid:
            odd = ~np.isfinite(xyz)
            odd &= (keep | odd[:, :2].any(axis=1))[:, None]  # points beyond the bounds do not matter
            if odd.any():
                row, axis = np.argwhere(odd)[0]
                hint = (
                    "remove it, or pass drop_invalid=True to label points with NaN or infinite coordinates non-ground"
                )
                raise InputError(f"{run.place(row)}: {'xyz'[axis]} is {xyz[row, axis]:g}; {hint}")
        attributes = {}
        for name in _LARGEST.keys() & values.keys():
            column = values[name][keep]
            odd = ~((column >= 0) & (column <= _LARGEST[name]) & (column == np.rint(column)))
            if odd.any():
                place, value = run.place(np.flatnonzero(keep)[odd.argmax()]), column[odd.argmax()]
                hint = f"{GROUND} (ground) or {OBJECT} (object)" if name == "label" else f"0 to {_LARGEST[name]}"
                raise InputError(f"{place}: {name} {value:g}: whole numbers, {hint}, are needed")
            if name == "label":
                attributes["reference"] = column == GROUND
            else:
                attributes[name] = column.astype(COLUMNS[name])
        yield xyz[keep], attributes


def rewrite_text(
    layout: Layout,
    target: BinaryIO,
    bounds: Bounds | None,
    ground: np.ndarray,
    classes: Callable[[np.ndarray, slice], np.ndarray],
) -> None:
    """Write a text file again, with the results in its label column, or else in its class column, or else in a new last
    column of labels. Other cells, comments and ends of lines stay; what separates cells becomes alike in all lines.

    ``ground`` is bool[n], and ``classes(old, rows)`` gives the classes of a run of the cloud's points.
    """
    with open(layout.path, "rb") as file:
        target.write(_MARK if file.read(len(_MARK)) == _MARK else b"")
    replaced = [name for name in ("label", "classification") if name in layout.columns]
    done = 0
    for run in _runs(layout):
        values, xyz, keep = run.points(bounds)
        rows = slice(done, done := done + int(keep.sum()))
        cells = run.texts(keep)
        if "label" in layout.columns or not replaced:
            column = layout.columns.get("label", layout.width)
            cells[column : column + 1] = [np.where(ground[rows], GROUND, OBJECT).astype(str).tolist()]
        if "classification" in layout.columns:
            new = classes(values["classification"][keep].astype(np.uint8), rows)
            cells[layout.columns["classification"]] = new.astype(str).tolist()
        lines, at = list(run.lines), np.array(run.at, np.int64)
        if layout.header is not None and not replaced and 0 <= (i := layout.header - run.start) < len(lines):
            body = lines[i].rstrip(b"\r\n")
            lines[i] = body + layout.between.encode() + b"label" + lines[i][len(body) :]
        for i in at[~keep].tolist():
            lines[i] = b""
        texts = map(layout.between.join, zip(*cells, strict=True))
        for i, text in zip(at[keep].tolist(), texts, strict=True):
            lines[i] = text.encode("utf-8", "surrogateescape") + lines[i][len(lines[i].rstrip(b"\r\n")) :]
        target.writelines(lines)


def write_table(target: BinaryIO, xyz: np.ndarray, ground: np.ndarray, decimals: int, delimiter: str) -> None:
    """Append lines of x, y, z (file units) and label."""
    label = np.where(ground, GROUND, OBJECT)
    form = delimiter.join([f"%.{decimals}f"] * 3 + ["%d\n"]).encode()
    target.writelines(form % (*point, flag) for point, flag in zip(xyz.tolist(), label.tolist(), strict=True))


# lines


@dataclass(frozen=True, eq=False)
class Lines:
    """Some whole lines of a file, the first of which has the number ``start``, from 0. ``at``: those that hold data, which are
    ``data`` together."""

    layout: Layout
    start: int
    lines: list[bytes]
    at: Sequence[int]
    data: bytes

    def place(self, row: int) -> str:
        """The file and the line of a row of the data, for messages."""
        return f"{self.layout.path}: line {self.start + self.at[row] + 1}"

    def points(self, bounds: Bounds | None) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
        """The named columns, f64[k] each; coordinates, f64[k, 3]; which are within bounds, bool[k]. Raises: InputError."""
        values = self.numbers()
        xyz = np.column_stack([values[axis] for axis in "xyz"])
        return values, xyz, np.ones(len(xyz), bool) if bounds is None else inside(xyz, bounds)

    def numbers(self) -> dict[str, np.ndarray]:
        """The named columns, f64[k]. Raises InputError with line and name of the first cell that is no number."""
        columns = self.layout.columns
        if not self.at:
            return {name: np.zeros(0) for name in columns}
        self._checked(1)  # a column of the words True and False alone would be numbers to pandas
        if self.data.translate(None, _PLAIN) or self.data.count(b"\r") > self.data.count(b"\r\n"):
            self._checked(len(self.at))
        used = [*columns.values(), self.layout.width]
        with contextlib.suppress(ValueError):
            table = self._table(usecols=used, dtype=float, na_values=["nan", "NaN", "NAN"])
            if len(table) == len(self.at) and (table[self.layout.width] == _END).all():
                return {name: table[column].to_numpy() for name, column in columns.items()}
        return self._checked(len(self.at))

    def texts(self, keep: np.ndarray) -> list[list[str]]:
        """Column by column, the cells of some rows, bool[k], with quotes where they need them."""
        if not keep.any():
            return [[] for _ in range(self.layout.width)]
        table = self._table(dtype=object, na_filter=False)[keep]
        columns = [table[column].tolist() for column in range(self.layout.width)]
        if b'"' not in self.data:
            return columns
        odd = re.compile(r'$|["#]|.*[ \t]' if self.layout.delimiter is None else rf' *["#]|.*{self.layout.delimiter}')
        return [['"' + c.replace('"', '""') + '"' if odd.match(c) else c for c in column] for column in columns]

    def _table(self, **options: Any) -> Any:
        """The cells as a table of pandas; behind the last of each line is one more, :data:`_END`, so that none can be missing."""
        import pandas as pd  # late: it takes half a second, which LAS does not need

        delimiter = self.layout.delimiter
        old = tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1)  # these drop the last of many digits
        return pd.read_csv(
            io.BytesIO(self.data.replace(b"\r\n", b"\n").replace(b"\n", f"{delimiter or ' '}{_END}\n".encode())),
            sep=r"\s+" if delimiter is None else delimiter,
            header=None,
            engine="c",
            skipinitialspace=True,
            keep_default_na=False,
            low_memory=False,
            encoding_errors="surrogateescape",
            float_precision="round_trip" if old else None,
            **options,
        )

    def _checked(self, count: int) -> dict[str, np.ndarray]:
        """:meth:`numbers` of the first lines of data, one by one."""
        layout, values = self.layout, {name: np.empty(count) for name in self.layout.columns}
        for row, number in enumerate(self.at[:count]):
            line, place = self.lines[number], self.place(row)
            if odd := re.search(rb"[\x00-\x08\x0a-\x1f]", line.rstrip(b"\r\n")):
                raise InputError(f"{place} holds the control character 0x{odd[0][0]:02x}; remove it")
            try:
                cells = _cells(line, layout.delimiter, strict=True)
            except csv.Error as error:
                hint = "take line breaks out of cells, and put quotes around whole cells only, doubled within them"
                raise InputError(f"{place} cannot be split ({error}); {hint}") from error
            if len(cells) != layout.width:
                model = layout.first if layout.header is None else layout.header
                ragged = _ragged(self.start + number, line, len(cells), layout.delimiter)
                raise InputError(f"{layout.path}: line {model + 1} has {layout.width} columns, {ragged}")
            for name, cell in ((name, cells[column]) for name, column in layout.columns.items()):
                if not _NUMBER.fullmatch(cell):
                    hint = "; write decimals with a point and nothing between thousands" if {*", "} & {*cell} else ""
                    raise InputError(f"{place}: {name} is {cell!r}, not a number{hint}")
                values[name][row] = float(cell)
        return values


def _runs(layout: Layout) -> Iterator[Lines]:
    start = 0
    with reading_errors(layout.path):
        for lines in _blocks(layout.path):
            data, at = b"".join(lines), cast(Sequence[int], range(len(lines)))
            data += b"" if data.endswith(b"\n") else b"\n"
            if start < layout.first or data[:1] in b"# \t\r\n" or any(mark in data for mark in _ASIDE):
                at = [i for i, line in enumerate(lines) if start + i >= layout.first and _holds_data(line)]
                data = b"".join(lines[i].rstrip(b"\r\n") + b"\n" for i in at)
            yield Lines(layout, start, lines, at, data)
            start += len(lines)


def _blocks(path: Path) -> Iterator[list[bytes]]:
    """Runs of whole lines with their endings, without the byte order mark."""
    passed = 0
    with open(path, "rb") as file:
        file.seek(len(_MARK) if file.read(len(_MARK)) == _MARK else 0)
        while block := file.read(_BLOCK):
            lines = io.BytesIO(block + file.readline(_LONGEST)).readlines()
            passed += len(lines)
            if len(lines[-1]) >= _LONGEST:
                raise InputError(f"{path}: line {passed} has more than {_LONGEST} bytes; it is no text of points")
            yield lines


def _head(path: Path) -> tuple[list[bytes], int | None]:
    """The lines up to the first point and some after it, and the number of that line."""
    lines: list[bytes] = []
    first, others = None, 0
    with reading_errors(path):
        for line in itertools.chain.from_iterable(_blocks(path)):
            if not lines and line.startswith((b"\xff\xfe", b"\xfe\xff")):
                raise InputError(f"{path}: the text is UTF-16; save it as UTF-8")
            if not lines and b"\r" in line.rstrip(b"\r\n"):
                raise InputError(f"{path}: its lines end with carriage returns alone; save it with line feeds")
            lines.append(line)
            if first is None and _holds_data(line):
                first = len(lines) - 1 if _is_point(line) else None
                others += 1
            if (len(lines) - first > _PROBED) if first is not None else (others > _PREAMBLE):
                break
    return lines, first


def _holds_data(line: bytes) -> bool:
    return line.lstrip(_BLANK)[:1] not in (b"", b"#")  # neither blank nor a comment


def _is_point(line: bytes) -> bool:
    """Whether at least three of its columns are numbers, which no line of names has."""
    return sum(_NUMBER.fullmatch(cell) is not None for cell in re.split(r'[\s,;"]+', line.decode("latin-1"))) >= 3


def _ragged(number: int, line: bytes, width: int, delimiter: str | None) -> str:
    """What to say of a line that has another number of columns than it should."""
    hints = ["give every line as many"]
    if b"#" in line:
        hints.append("give comments lines of their own")
    if delimiter == ",":
        hints.append("write decimals with a point")
    hints.append(f"put quotes around cells that hold {_WORDS[delimiter]}")
    return f"line {number + 1} has {width}, {_shown(line)}; {', '.join(hints)}"


def _shown(cell: bytes) -> str:
    """Bytes of a file, for messages."""
    return repr(cell.strip(_BLANK)[:60].decode("utf-8", "replace"))


# names


def _cells(line: bytes, delimiter: str | None, strict: bool = False) -> list[str]:
    """The cells of one line, without the blanks around them; none if it cannot be split. Raises csv.Error instead if ``strict``,
    and for quotes that do not close where a cell ends."""
    text = line.decode("utf-8", "surrogateescape").strip("\r\n")
    if delimiter is None:
        text = " ".join(re.split(r"[ \t]+", text.strip(" \t")))
    text = re.sub(f'" +(?={delimiter}|$)', '"', text) if delimiter and strict else text
    with contextlib.nullcontext() if strict else contextlib.suppress(csv.Error):
        row = next(csv.reader([text], delimiter=delimiter or " ", skipinitialspace=True, strict=strict), [])
        return [cell.strip(" \t") for cell in row]
    return []


def _meaning(name: str) -> str | None:
    return _NAMES.get(re.sub(r"[^a-z0-9]", "", name.lower()))


def _columns(path: Path, header: int | None, names: list[str]) -> dict[str, int]:
    """Positions of the columns that are understood. Raises InputError where two have one meaning."""
    columns: dict[str, int] = {}
    for i, cell in enumerate(names):
        name = _meaning(cell)
        if name in columns and header is not None:
            both = f"the columns {names[columns[name]]!r} and {cell!r} both name the {name.replace('_', ' ')}"
            raise InputError(f"{path}: line {header + 1}: {both}; rename the one that does not count")
        if name is not None:
            columns[name] = i
    return columns
