"""Point clouds as text: the ISPRS reference samples, xyz and csv. pandas reads the cells, and pandas writes them.

A record is a line. Blank lines and comments (``#``) are passed over, and are not written again.
"""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import itertools
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..core.cloud import GROUND_CLASS, PointCloud
from ..core.echoes import Numbering, numbering
from ..core.errors import InputError
from ..core.inputs import COLUMN_TYPES, LARGEST
from ..core.reading import Bounds, Reading, inside
from ..core.units import check_lengths, sampled
from .disk import CHANGED_SINCE, Identity, opened
from .guard import reading_errors

TEXT_SUFFIXES = (".txt", ".xyz", ".csv")

_MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8
_END = 8e88  # pandas sees this behind the last cell of each line, so that no cell can be missing; no cell of points
_DELIMITERS = {";": "semicolons", ",": "commas", "\t": "tabs", None: "white space"}
_NANS = [sign + word for sign in ("", "-") for word in ("nan", "NaN", "NAN")]
_NUMBER = re.compile(rf"{'|'.join(_NANS)}|(?i:[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?|inf|infinity))", re.ASCII)
_NAMES = {  # column names, without case and punctuation
    "x": "x", "y": "y", "z": "z", "label": "label", "class": "classification", "classification": "classification",
    "returnnumber": "return_number", "numberofreturns": "number_of_returns", "numreturns": "number_of_returns",
    "withheld": "withheld", "overlap": "overlap",
}  # fmt: skip
_LARGEST = LARGEST | {"withheld": 1, "overlap": 1, "label": 1}


@dataclasses.dataclass(frozen=True, eq=False)
class TextFile:
    """Points of a text file."""

    path: Path
    identity: Identity
    format: str  # in words
    rows: np.ndarray  # bool of all lines of data, those whose points these are
    xyz: np.ndarray  # f64[n, 3], file units
    columns: dict[str, np.ndarray]  # [n], named as those of a cloud; "reference" comes from a column "label"
    numbering: Numbering  # of the echoes of all points of the file

    @property
    def points(self) -> int:
        """Number of points."""
        return len(self.xyz)

    @property
    def fingerprint(self) -> str:
        """Changes with the file, wherever it is mounted: its size and the time of its last change."""
        return f"{self.identity.size}-{self.identity.modified}"

    @property
    def decimals(self) -> int:
        """How many show the coordinates: 3, or 4 where there are more."""
        thousandths = self.xyz[:1000] * 1000
        return 4 if (np.abs(thousandths - np.rint(thousandths)) > 0.01).any() else 3

    def within(self, bounds: Bounds | None) -> TextFile:
        """The points inside bounds."""
        if bounds is None:
            return self
        rows, some = self.rows.copy(), inside(self.xyz, bounds)
        rows[rows] = some
        columns = {name: column[some] for name, column in self.columns.items()}
        return dataclasses.replace(self, rows=rows, xyz=self.xyz[some], columns=columns)

    def cloud(self, reading: Reading, *, strict: bool = True) -> PointCloud:
        """The points as a cloud; they are those inside ``reading.bounds``. ``strict``: coordinates that cannot be lengths are an
        error, not a warning, where no units are asked for. Raises: InputError."""
        columns: dict[str, Any] = dict(self.columns)
        if "reference" not in columns and (columns.get("classification", np.zeros(0)) == GROUND_CLASS).any():
            columns["reference"] = columns["classification"] == GROUND_CLASS
        if reading.units is None:
            some = self.xyz[sampled(self.points)]
            some = some[np.isfinite(some).all(axis=1)]
            check_lengths(self.path, some, self.points, reading.bounds is not None, strict)
        fields = reading.of_points() | {"units": reading.metres, "numbering": self.numbering}
        source = dataclasses.replace(self, path=self.path.absolute())
        return PointCloud.from_arrays(self.xyz, name=str(self.path), source=source, **columns, **fields)

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units, to the last digit."""
        return self.xyz

    def rewrite(self, target: Path, ground: np.ndarray, classes: Callable[[np.ndarray], np.ndarray]) -> None:
        """Write the points with all their cells, and the results in the label column, or else in the class column, or else in a
        new last column of labels.

        ``ground`` is bool[n]; ``classes`` makes new classes u8[n] of the old ones. Raises: InputError if the file is gone or has
        changed; OSError.
        """
        with reading_errors(self.path), opened(self.path, self.identity, CHANGED_SINCE) as (file, _):
            content = file.read()
            lines = _split(self.path, content)
            table = lines.table(range(len(lines.names)), dtype=object, na_filter=False)[self.rows]
        names, known = list(lines.names), lines.columns
        if "classification" in known:
            table[known["classification"]] = classes(self.columns["classification"])
        if "label" in known or "classification" not in known:
            table[known.get("label", len(names))] = (~ground).astype(np.uint8)
            names += [] if "label" in known else ["label"]
        quoted = b'"' in lines.data and (lines.delimiter is None or b'"#' in lines.data)
        table.to_csv(
            target,
            sep=lines.delimiter or ("\t" if re.match(rb"[^ \n]*\t[^ \n]*\n", lines.data) else " "),
            header=names if lines.named else False,
            index=False,
            quoting=csv.QUOTE_ALL if quoted else csv.QUOTE_MINIMAL,
            encoding="utf-8-sig" if content.startswith(_MARK) else "utf-8",
            errors="surrogateescape",
            lineterminator="\r\n" if b"\r\n" in content else "\n",
        )


def open_text(path: Path, bounds: Bounds | None = None, drop_invalid: bool = True) -> TextFile:
    """The points of a text file that are inside bounds.

    Raises: InputError naming the line and column of what cannot be read: lines of another width, cells that are not numbers,
    labels and classes out of range; NaN and infinite coordinates unless ``drop_invalid``; if columns cannot be told.
    """
    with reading_errors(path):
        with opened(path) as (file, identity):
            content = file.read()
        lines = _split(path, content)
        values = lines.numbers()
    xyz, columns = np.column_stack([values.pop(axis) for axis in "xyz"]), {}
    for name, column in values.items():
        odd = ~((column >= 0) & (column <= _LARGEST[name]) & (column == np.rint(column)))
        if odd.any():
            row, needed = int(odd.argmax()), f"whole numbers from 0 to {_LARGEST[name]} are needed"
            raise InputError(f"{lines.place(row)}: {name} is {column[row]:g}; {needed}")
        columns[name] = column.astype(COLUMN_TYPES.get(name, bool))
    if "label" in columns:
        columns["reference"] = ~columns.pop("label")
    words = f"text separated by {_DELIMITERS[lines.delimiter]}: {' '.join(lines.columns)}"
    how = numbering(columns, xyz[:, 2])
    found = TextFile(path, identity, words, np.ones(len(xyz), bool), xyz, columns, how)
    part = found.within(bounds)
    odd = ~np.isfinite(xyz)
    odd &= (part.rows | odd[:, :2].any(axis=1))[:, None]  # points beyond the bounds do not matter
    if odd.any() and not drop_invalid:
        row, axis = np.argwhere(odd)[0]
        hint = "remove it, or pass drop_invalid=True to label points with NaN or infinite coordinates non-ground"
        raise InputError(f"{lines.place(row)}: {'xyz'[axis]} is {xyz[row, axis]:g}; {hint}")
    return part


class _Lines(NamedTuple):
    """The lines of a file, and how they are split into cells."""

    path: Path
    content: bytes  # all lines, each with a line feed at its end
    data: bytes  # those from the first point on that are neither blank nor comments
    delimiter: str | None  # None: white space
    names: list[str]  # of all columns; the first one with the mark of a comment
    columns: dict[str, int]  # positions of those that are understood
    named: int  # the line of the names, from 1; 0 if there is none
    first: int  # that of the first point

    def place(self, row: int) -> str:
        """The file and the line of a row of the data, for messages."""
        lines = enumerate(io.BytesIO(self.content), 1)
        numbers = (number for number, line in lines if number >= self.first and _holds_data(line))
        return f"{self.path}: line {next(itertools.islice(numbers, row, None))}"

    def numbers(self) -> dict[str, np.ndarray]:
        """The columns that are understood, f64[n]. Raises: InputError with line and name of the first cell that is no number."""
        end, n = len(self.names), self.data.count(b"\n")
        self._check(1)  # a column of the words True and False alone would be numbers to pandas
        with contextlib.suppress(ValueError):  # pandas' own errors, too
            table = self.table([*self.columns.values(), end], dtype=float, na_values=_NANS)
            if len(table) == n and (table[end] == _END).all():
                return {name: table[column].to_numpy(float) for name, column in self.columns.items()}
        self._check(n)
        raise InputError(f"{self.path}: cannot be split into cells; close quotes, and take line breaks out of cells")

    def table(self, columns: Sequence[int], **options: Any) -> Any:
        """The cells of some columns, as a table of pandas; behind the last one of the file is a column of :data:`_END`."""
        import pandas as pd  # late: it takes half a second, which LAS does not need

        if not self.data:
            return pd.DataFrame(columns=columns)
        return pd.read_csv(
            io.BytesIO(self.data.replace(b"\n", f"{self.delimiter or ' '}{_END}\n".encode())),
            sep=self.delimiter or r"\s+",
            header=None,
            usecols=columns,
            skipinitialspace=True,
            keep_default_na=False,
            encoding_errors="surrogateescape",
            **options,
        )

    def _check(self, most: int) -> None:
        """Raises: InputError if one of the first lines of data is not as wide as the others, or has a cell that is no number."""
        for row, line in enumerate(itertools.islice(io.BytesIO(self.data), most)):
            cells = _cells(line, self.delimiter)
            if len(cells) != len(self.names):
                raise InputError(
                    f"{self.place(row)} has {len(cells)} columns, {line[:60]!r}, and line {self.named or self.first} has "
                    f"{len(self.names)}: give every line as many, give comments lines of their own, write decimals with a point, "
                    f"and put quotes, doubled inside, around cells that hold {_DELIMITERS[self.delimiter]}"
                )
            for name, column in self.columns.items():
                if not _NUMBER.fullmatch(cells[column]):
                    hint = "write decimals with a point and nothing between thousands"
                    raise InputError(f"{self.place(row)}: {name} is {cells[column]!r}, not a number; {hint}")


def _split(path: Path, content: bytes) -> _Lines:
    """Raises: InputError if the columns cannot be told from the lines above the first point."""
    if b"\0" in content:
        raise InputError(f"{path}: holds zero bytes, as UTF-16 does, and text has none; save it as UTF-8")
    content = content.removeprefix(_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n").removesuffix(b"\n") + b"\n"
    head = dict(enumerate(itertools.takewhile(lambda line: not _is_point(line), io.BytesIO(content)), 1))
    data = content[sum(map(len, head.values())) :]
    first = next(io.BytesIO(data), b"x y z")
    near = [i for i in reversed(head) if head[i].strip()]
    comments = list(itertools.takewhile(lambda i: not _holds_data(head[i]), near))
    above = near[len(comments) :][:1]  # the last line that is none
    found: list[tuple[int, str | None, list[str], int]] = []
    for delimiter in _DELIMITERS:
        width = len(_cells(first, delimiter))
        for i in above + comments:
            names = _cells(head[i].lstrip(b"/# \t"), delimiter)
            if {"x", "y", "z"} <= set(map(_meaning, names)):
                found.append((len(names) != width, delimiter, names, i))
        if 3 <= width <= 4 and not above and delimiter != "\t":
            found.append((2, delimiter, ["x", "y", "z", "label"][:width], 0))
    if not found:
        i = above[0] if above else len(head) + 1
        wrong = "holds no point x y z or x y z label, and names no columns x, y and z"
        raise InputError(f"{path}: line {i}, {head.get(i, first)[:60]!r}, {wrong}; this is no text of points")
    _, delimiter, names, line = min(found, key=lambda one: one[0])
    known = list(map(_meaning, names))
    columns = {name: known.index(name) for name in known if name}
    if twice := [name.replace("_", " ") for name in columns if known.count(name) > 1]:
        raise InputError(f"{path}: line {line}: two columns name the {twice[0]}; rename the one that does not count")
    if line:
        names[0] = re.match(rb"[/# \t]*", head[line])[0].decode().strip() + names[0]  # type: ignore[index]
    data = re.sub(rb"(?m)^[ \t]*(?:#.*)?\n", b"", data) if re.search(rb"\n[ \t]*[#\n]", data) else data
    return _Lines(path, content, data, delimiter, names, columns, line, len(head) + 1)


def _holds_data(line: bytes) -> bool:
    return line.strip()[:1] not in (b"", b"#")  # neither blank nor a comment


def _is_point(line: bytes) -> bool:
    """Whether at least three of its columns are numbers, which no line of names has."""
    cells = re.split(r'[\s,;"]+', line.decode("latin-1"))
    return _holds_data(line) and sum(_NUMBER.fullmatch(cell) is not None for cell in cells) >= 3


def _cells(line: bytes, delimiter: str | None) -> list[str]:
    """The cells of a line, without the blanks around them; none if quotes do not enclose whole cells, or do not close."""
    text = line.decode("utf-8", "surrogateescape").strip("\r\n")
    if delimiter is None:
        text = re.sub(r"[ \t]+", " ", text.strip(" \t"))
    else:
        text = re.sub(f'" +(?={delimiter}|$)', '"', text)
    try:
        row = next(csv.reader([text], delimiter=delimiter or " ", skipinitialspace=True, strict=True), [])
    except csv.Error:
        return []
    return [cell.strip(" \t") for cell in row]


def _meaning(name: str) -> str | None:
    return _NAMES.get(re.sub(r"[^a-z0-9]", "", name.lower()))
