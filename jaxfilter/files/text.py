"""Point clouds as text: the ISPRS reference samples, xyz and csv. pandas reads the cells, and pandas writes them.

A record is a line. Blank lines and comments (``#``) are passed over, and are not written again.
"""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import functools
import io
import itertools
import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..core.cloud import GROUND_CLASS, PointCloud
from ..core.echoes import Numbering, numbering
from ..core.errors import InputError
from ..core.inputs import COLUMNS, LARGEST
from ..core.reading import Reading, inside
from ..core.units import check_lengths, sampled
from .disk import CHANGED_IN_READING, CHANGED_SINCE, Bounds, Identity
from .guard import reading_errors

SUFFIXES = (".txt", ".xyz", ".csv")
GROUND, OBJECT = 0, 1
"""Labels as the ISPRS samples have them."""

_HEAD = 1000  # lines that may come before the first point, and comments that may name columns
_BLANK = b" \t\n"
_MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8
_PLAIN = bytes(i for i in range(256) if i > 0x1F or i in b"\t\n")  # no control characters
_END = 8e88  # pandas sees this behind the last cell of each line, so that no cell can be missing; no cell of points
_DELIMITERS = {";": "semicolons", ",": "commas", "\t": "tabs", None: "white space"}
_NUMBER = re.compile(r"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE | re.ASCII)
_NAMES = {  # column names, without case and punctuation
    "x": "x", "y": "y", "z": "z", "label": "label", "class": "classification", "classification": "classification",
    "returnnumber": "return_number", "numberofreturns": "number_of_returns", "numreturns": "number_of_returns",
    "withheld": "withheld", "overlap": "overlap",
}  # fmt: skip
_LARGEST = LARGEST | {"withheld": 1, "overlap": 1, "label": 1}


@dataclass(frozen=True, eq=False)
class TextFile:
    """Points of a text file.

    Attributes:
        format: in words. checksum: CRC-32 of all bytes of the file.
        rows: bool of all lines of data, those whose points these are.
        xyz: f64[n, 3], file units. columns: arrays [n], named as those of a cloud; ``reference`` comes from a column ``label``.
        numbering: of the echoes of all points of the file.
    """

    path: Path
    identity: Identity
    format: str
    checksum: int
    rows: np.ndarray
    xyz: np.ndarray
    columns: dict[str, np.ndarray]
    numbering: Numbering

    @property
    def points(self) -> int:
        """Number of points."""
        return len(self.xyz)

    @property
    def fingerprint(self) -> str:
        """Changes with the file, wherever it is mounted: its size, the time of its last change and its checksum."""
        return f"{self.identity.size}-{self.identity.modified}-{self.checksum:08x}"

    @property
    def decimals(self) -> int:
        """How many show the coordinates: 3, or 4 where there are more."""
        thousandths = self.xyz[:_HEAD] * 1000
        return 4 if (np.abs(thousandths - np.rint(thousandths)) > 0.01).any() else 3

    def part(self, some: np.ndarray) -> TextFile:
        """Some of the points, bool[n]."""
        rows = self.rows.copy()
        rows[rows] = some
        columns = {name: column[some] for name, column in self.columns.items()}
        return dataclasses.replace(self, rows=rows, xyz=self.xyz[some], columns=columns)

    def within(self, bounds: Bounds | None) -> TextFile:
        """The points inside bounds."""
        return self if bounds is None else self.part(inside(self.xyz, bounds))

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
        with reading_errors(self.path):
            identity, content = _content(self.path, CHANGED_SINCE)
            if identity != self.identity or zlib.crc32(content) != self.checksum:
                raise InputError(f"{self.path}: {CHANGED_SINCE}")
            lines = _lines(self.path, content)
            names, known = lines.header(), lines.columns
            table = lines.table(range(len(names)), dtype=object, na_filter=False)
        table = table if self.rows.all() else table[self.rows].copy()
        if "label" in known or "classification" not in known:
            table[known.get("label", len(names))] = np.where(ground, GROUND, OBJECT)
            names += [] if "label" in known else ["label"]
        if "classification" in known:
            table[known["classification"]] = classes(self.columns["classification"])
        quoted = b'"' in lines.data and (lines.delimiter is None or b'"#' in lines.data)
        table.to_csv(
            target,
            sep=lines.delimiter or ("\t" if re.match(rb"[^ \n]*\t[^ \n]*\n", lines.data) else " "),
            header=False if lines.named is None else names,
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
        identity, content = _content(path, CHANGED_IN_READING)
        lines = _lines(path, content)
        xyz, columns = lines.points()
        how = numbering(columns, xyz[:, 2])
        found = TextFile(path, identity, str(lines), zlib.crc32(content), np.ones(len(xyz), bool), xyz, columns, how)
        part = found.within(bounds)
        odd = ~np.isfinite(xyz)
        odd &= (part.rows | odd[:, :2].any(axis=1))[:, None]  # points beyond the bounds do not matter
        if odd.any() and not drop_invalid:
            row, axis = np.argwhere(odd)[0]
            hint = "remove it, or pass drop_invalid=True to label points with NaN or infinite coordinates non-ground"
            raise InputError(f"{lines.place(row)}: {'xyz'[axis]} is {xyz[row, axis]:g}; {hint}")
        return part


def kept_text(path: Path) -> TextFile:
    """All points of a text file. Those of the last file are kept, so that a survey does not parse it for every box."""
    with reading_errors(path):
        return _kept_text(path, Identity.of(path))


@functools.lru_cache(1)
def _kept_text(path: Path, identity: Identity) -> TextFile:
    """``identity`` is that of the file now."""
    return open_text(path)


def write_table(target: BinaryIO, xyz: np.ndarray, ground: np.ndarray, decimals: int, delimiter: str) -> None:
    """Append lines of x, y, z (file units) and label."""
    label = np.where(ground, GROUND, OBJECT)
    form = delimiter.join([f"%.{decimals}f"] * 3 + ["%d\n"]).encode()
    target.writelines(form % (*point, flag) for point, flag in zip(xyz.tolist(), label.tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class _Lines:
    """The lines of a file.

    Attributes:
        content: all, without a byte order mark, with line feeds alone at their ends. data: those that hold data.
        delimiter: comma, semicolon, tab, or None for white space. names: of all columns.
        named: number of the line that names the columns, from 0, or None. first: that of the first line of data.
    """

    path: Path
    content: bytes
    data: bytes
    delimiter: str | None
    names: list[str]
    named: int | None
    first: int

    def __str__(self) -> str:
        return f"text separated by {_DELIMITERS[self.delimiter]}: {' '.join(self.columns)}"

    def place(self, row: int) -> str:
        """The file and the line of a row of the data, for messages."""
        numbered = enumerate(io.BytesIO(self.content))
        data = (number for number, line in numbered if number >= self.first and _holds_data(line))
        return f"{self.path}: line {next(itertools.islice(data, row, None)) + 1}"

    @functools.cached_property
    def columns(self) -> dict[str, int]:
        """Position by name of the columns that are understood. Raises: InputError where two have one meaning."""
        columns: dict[str, int] = {}
        for i, cell in enumerate(self.names):
            name = _meaning(cell)
            if name in columns and self.named is not None:
                both = f"the columns {self.names[columns[name]]!r} and {cell!r} both name the {name.replace('_', ' ')}"
                raise InputError(f"{self.path}: line {self.named + 1}: {both}; rename the one that does not count")
            if name is not None:
                columns[name] = i
        return columns

    def header(self) -> list[str]:
        """Names of the columns, as they stand in the file: the first one with the mark of a comment."""
        line = b"" if self.named is None else self.content.split(b"\n", self.named + 1)[self.named]
        mark = line[: len(line) - len(line.lstrip(b"/# \t"))].decode().strip()
        return [mark + self.names[0], *self.names[1:]]

    def points(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Coordinates f64[n, 3] and columns, as of :class:`TextFile`. Raises: InputError."""
        values, columns = self._numbers(), {}
        for name, column in ((name, values[name]) for name in _LARGEST if name in values):
            odd = ~((column >= 0) & (column <= _LARGEST[name]) & (column == np.rint(column)))
            if odd.any():
                row = int(odd.argmax())
                hint = f"{GROUND} (ground) or {OBJECT} (object)" if name == "label" else f"0 to {_LARGEST[name]}"
                raise InputError(f"{self.place(row)}: {name} {column[row]:g}: whole numbers, {hint}, are needed")
            columns[name] = column.astype(COLUMNS.get(name, bool))
        if "label" in columns:
            columns["reference"] = ~columns.pop("label")
        return np.column_stack([values[axis] for axis in "xyz"]), columns

    def _numbers(self) -> dict[str, np.ndarray]:
        """The columns that are understood, f64[n]. Raises InputError with line and name of the first cell that is no number."""
        end, n = len(self.names), self.data.count(b"\n")
        self._checked(1)  # a column of the words True and False alone would be numbers to pandas
        if not self.data.translate(None, _PLAIN):
            with contextlib.suppress(ValueError):  # pandas' own errors, too
                table = self.table([*self.columns.values(), end], dtype=float, na_values=["nan", "NaN", "NAN"])
                if len(table) == n and (table[end] == _END).all():
                    return {name: table[column].to_numpy(float) for name, column in self.columns.items()}
        return self._checked(n)

    def table(self, columns: Sequence[int], **options: Any) -> Any:
        """The cells of some columns, as a table of pandas; behind the last one of the file is a column of :data:`_END`."""
        import pandas as pd  # late: it takes half a second, which LAS does not need

        if not self.data:
            return pd.DataFrame(columns=columns)
        old = tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1)  # these drop the last of many digits
        return pd.read_csv(
            io.BytesIO(self.data.replace(b"\n", f"{self.delimiter or ' '}{_END}\n".encode())),
            sep=self.delimiter or r"\s+",
            header=None,
            engine="c",
            skipinitialspace=True,
            keep_default_na=False,
            low_memory=False,
            usecols=columns,
            encoding_errors="surrogateescape",
            float_precision="round_trip" if old else None,
            **options,
        )

    def _checked(self, most: int) -> dict[str, np.ndarray]:
        """:meth:`_numbers` of the first lines of data, one by one."""
        lines = list(itertools.islice(io.BytesIO(self.data), most))
        values = {name: np.empty(len(lines)) for name in self.columns}
        for row, line in enumerate(lines):
            if odd := re.search(rb"[\x00-\x08\x0b-\x1f]", line):
                raise InputError(f"{self.place(row)} holds the control character 0x{odd[0][0]:02x}; remove it")
            try:
                cells = _cells(line, self.delimiter, strict=True)
            except csv.Error as error:
                hint = "take line breaks out of cells, and put quotes around whole cells only, doubled within them"
                raise InputError(f"{self.place(row)} cannot be split ({error}); {hint}") from error
            if len(cells) != len(self.names):
                model = self.first if self.named is None else self.named
                raise InputError(
                    f"{self.place(row)} has {len(cells)} columns, {_shown(line)}, and line {model + 1} has {len(self.names)}: "
                    "give every line as many, give comments lines of their own and no names of columns, write decimals with a "
                    f"point, and put quotes around cells that hold {_DELIMITERS[self.delimiter]}"
                )
            for name, cell in ((name, cells[column]) for name, column in self.columns.items()):
                if not _NUMBER.fullmatch(cell):
                    hint = "; write decimals with a point and nothing between thousands" if {*", "} & {*cell} else ""
                    raise InputError(f"{self.place(row)}: {name} is {cell!r}, not a number{hint}")
                values[name][row] = float(cell)
        return values


def _content(path: Path, message: str) -> tuple[Identity, bytes]:
    """All bytes of a file. Raises: InputError with ``message`` if it changes meanwhile; OSError."""
    with open(path, "rb") as file:  # open, so that no other file gets the same number meanwhile
        identity = Identity.of(file.fileno())
        with identity.kept(path, message):
            return identity, file.read()


def _lines(path: Path, content: bytes) -> _Lines:
    """Raises: InputError if the columns cannot be told from the first lines."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: the text is UTF-16; save it as UTF-8")
    content = content.removeprefix(_MARK).replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    head: list[bytes] = []  # the lines before the first point
    first, others = None, 0
    for line in io.BytesIO(content):
        if _is_point(line):
            first = line
            break
        head.append(line)
        others += _holds_data(line)
        if others > _HEAD:
            break
    near = [i for i in reversed(range(len(head))) if head[i].strip(_BLANK)]
    comments = list(itertools.takewhile(lambda i: not _holds_data(head[i]), near))
    above = near[len(comments) :][:1]  # the last other line
    headers: list[tuple[str | None, list[str], int | None]] = []  # what may name the columns, and how
    for delimiter, i in itertools.product(_DELIMITERS, above + comments[:_HEAD]):
        names = _cells(head[i].lstrip(b"/# \t"), delimiter)
        headers += [(delimiter, names, i)] if {"x", "y", "z"} <= set(map(_meaning, names)) else []
    if above and not headers:
        wrong = f"line {above[0] + 1}, {_shown(head[above[0]])}, names no columns x, y and z"
        raise InputError(f"{path}: {wrong if first else 'no line holds three numbers'}; this is no text of points")
    widths = {delimiter: len(_cells(first or b"x y z", delimiter)) for delimiter in _DELIMITERS}
    if headers:  # that which fits
        found = max(headers, key=lambda one: (len(one[1]) == widths[one[0]], widths[one[0]]))
    else:
        unnamed = next((delimiter for delimiter in (";", ",") if widths[delimiter] >= 3), None)
        if not 3 <= widths[unnamed] <= 4:
            wrong = f"{widths[unnamed]} columns without names"
            raise InputError(f"{path}: {wrong}; x y z and x y z label are understood, others need a header line")
        found = unnamed, ["x", "y", "z", "label"][: widths[unnamed]], None
    data = b"" if first is None else content[sum(map(len, head)) :].removesuffix(b"\n") + b"\n"
    letters = np.frombuffer(data, np.uint8)
    if np.isin(letters[1:][letters[:-1] == ord("\n")], list(b"# \t\n")).any():  # a line may hold no data
        data = re.sub(rb"(?m)^[ \t]*(?:#.*)?\n", b"", data)
    return _Lines(path, content, data, *found, len(head))


def _holds_data(line: bytes) -> bool:
    return line.lstrip(_BLANK)[:1] not in (b"", b"#")  # neither blank nor a comment


def _is_point(line: bytes) -> bool:
    """Whether at least three of its columns are numbers, which no line of names has."""
    cells = re.split(r'[\s,;"]+', line.decode("latin-1"))
    return _holds_data(line) and sum(_NUMBER.fullmatch(cell) is not None for cell in cells) >= 3


def _shown(line: bytes) -> str:
    """Bytes of a file, for messages."""
    return repr(line.strip()[:60].decode("utf-8", "replace"))


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
