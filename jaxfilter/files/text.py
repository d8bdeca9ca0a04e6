"""Point clouds as text: the ISPRS reference samples, xyz and csv; read in runs of lines, rewritten line by line.

A record is a line, and ``delimited.py`` decides where its cells are. The numbers are parsed from what it makes of a line,
and the positions at which labels are exchanged are found in that, so reading and rewriting cannot differ.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from ..core.errors import InputError
from ..core.inputs import COLUMNS, LARGEST
from .delimited import BLANK, blanked, cell_pattern, cells_of, check_line, open_quote, shown, spans_of
from .disk import Bounds, Replay
from .records import inside, reading

SUFFIXES = (".txt", ".xyz", ".csv")
GROUND, OBJECT = 0, 1
"""Labels as the ISPRS samples have them."""

_BLOCK = 1_000_000  # bytes that are read at a time
_LONGEST = 1_000_000  # bytes of a line
_PREAMBLE = 1000  # lines before the first point, and of comments that may name columns
_PROBED = 1000  # lines of points whose decimals are counted
_MARK = b"\xef\xbb\xbf"  # byte order mark of UTF-8
_DELIMITERS = (b";", b",", b"\t", None)
_WORDS = {b";": "semicolons", b",": "commas", b"\t": "tabs", None: "white space"}
_NUMBER = re.compile(rb"[+-]?(?:(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE)
_NAMES = {  # column names, without case and punctuation
    "x": "x", "y": "y", "z": "z", "label": "label", "class": "classification", "classification": "classification",
    "returnnumber": "return_number", "numberofreturns": "number_of_returns", "numreturns": "number_of_returns",
    "withheld": "withheld", "overlap": "overlap",
}  # fmt: skip
_UNNAMED = [b"x", b"y", b"z", b"label"]
_LARGEST = LARGEST | {"withheld": 1, "overlap": 1, "label": 1}


@dataclasses.dataclass(frozen=True)
class Layout:
    """How a text file is laid out.

    Attributes:
        delimiter: comma, semicolon, tab, or None for white space.
        columns: position by name, for the columns that are understood.
        width: number of columns that every line of data has.
        header: number of the line (from 0) that names the columns, or None.
        first: number of the first line of data; that of the lines, if none holds data.
        decimals: most digits behind the point of a coordinate among the first lines.
    """

    delimiter: bytes | None
    columns: dict[str, int]
    width: int
    header: int | None
    first: int
    decimals: int

    def __str__(self) -> str:
        return f"text separated by {_WORDS[self.delimiter]}: {' '.join(self.columns)}"


def layout_of(path: Path) -> Layout:
    """From the first lines. Raises InputError if the columns cannot be told, or if names and columns do not match."""
    lines, first = _head(path)
    before = [i for i, line in enumerate(lines[:first]) if line.strip(BLANK)]
    comments = list(itertools.takewhile(lambda i: _is_comment(lines[i]), reversed(before)))
    other = before[: len(before) - len(comments)][-1:]  # the line above
    headers = [  # what may name the columns, and how
        (delimiter, i, cells)
        for delimiter in _DELIMITERS
        for i in other + comments[:_PREAMBLE]
        if {"x", "y", "z"} <= set(map(_meaning, cells := _names(lines[i], delimiter)))
    ]
    if first is None:
        if other and other[0] not in {i for _, i, _ in headers}:
            raise InputError(f"{path}: no line holds three numbers; this is not a text file of points")
        headers = [header for header in headers if header[1] in other]
        delimiter, at, cells = headers[0] if headers else (None, None, _UNNAMED[:3])
        if at is not None:
            check_line(path, at, lines[at], _plain_names(lines[at], delimiter), delimiter)
        return Layout(delimiter, _columns(path, at, cells), len(cells), at, len(lines), 0)
    point = lines[first]
    widths = {delimiter: len(cells_of(blanked(point, delimiter), delimiter)) for delimiter in _DELIMITERS}
    if fitting := [header for header in headers if len(header[2]) == widths[header[0]]]:
        delimiter, at, cells = fitting[0]
        check_line(path, at, lines[at], _plain_names(lines[at], delimiter), delimiter)
    elif headers:
        delimiter, at, cells = max(headers, key=lambda header: widths[header[0]])
        check_line(path, first, point, blanked(point, delimiter), delimiter)
        hint = " (if it is a mere comment, take the names out of it)" if at in comments else ""
        raise InputError(
            f"{path}: line {at + 1} names {len(cells)} columns{hint}, "
            f"{_ragged(first, point, widths[delimiter], delimiter)}"
        )
    elif other:
        raise InputError(f"{path}: line {other[0] + 1}, {shown(lines[other[0]])}, names no columns x, y and z")
    else:
        delimiter = next((delimiter for delimiter in (b";", b",", None) if widths[delimiter] >= 3), None)
        width = widths[delimiter]
        if width not in (3, 4):
            raise InputError(
                f"{path}: {width} columns without names; x y z and x y z label are understood, others need a header line"
            )
        at, cells = None, _UNNAMED[:width]
    columns = _columns(path, at, cells)
    return Layout(delimiter, columns, len(cells), at, first, _decimals(lines[first:], delimiter, columns))


def read_text(
    path: Path, layout: Layout, bounds: Bounds | None = None, drop_invalid: bool = True
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Runs of coordinates f64[k, 3] in file units and of attributes, named as a PointCloud's fields.

    ``reference`` (True = ground) comes from a column ``label``. Points outside ``bounds`` are left out.

    Raises: InputError naming the line and column of what cannot be read: lines of another width, cells that are not
    numbers, labels and classes out of range; NaN and infinite coordinates unless ``drop_invalid``.
    """
    names, axes = list(layout.columns), _axes(layout)
    for run in _runs(path, layout):
        xyz = run.values[:, axes]
        keep = np.ones(len(xyz), bool) if bounds is None else inside(xyz, bounds)
        if not drop_invalid:
            odd = ~np.isfinite(xyz)
            odd &= (keep | odd[:, :2].any(axis=1))[:, None]  # points beyond the bounds do not matter
            if odd.any():
                row, axis = np.argwhere(odd)[0]
                raise InputError(
                    f"{path}: {run.place(row)}: {'xyz'[axis]} is {xyz[row, axis]:g}; remove points with NaN or infinite "
                    "coordinates, or pass drop_invalid=True to label them non-ground"
                )
        attributes = {}
        for i, name in enumerate(names):
            if name not in _LARGEST:
                continue
            column = run.values[keep, i]
            odd = ~((column >= 0) & (column <= _LARGEST[name]) & (column == np.rint(column)))
            if odd.any():
                place, value = run.place(np.flatnonzero(keep)[odd.argmax()]), column[odd.argmax()]
                hint = f"{GROUND} (ground) or {OBJECT} (object)" if name == "label" else f"0 to {_LARGEST[name]}"
                raise InputError(f"{path}: {place}: {name} {value:g}: whole numbers, {hint}, are needed")
            key, kind = ("reference", bool) if name == "label" else (name, COLUMNS[name])
            attributes[key] = (column == GROUND) if name == "label" else column.astype(kind)
        yield xyz[keep], attributes


def rewrite_text(
    path: Path,
    layout: Layout,
    target: BinaryIO,
    bounds: Bounds | None,
    labels: Callable[[slice], np.ndarray],
    classes: Callable[[np.ndarray, slice], np.ndarray],
    replay: Replay,
) -> None:
    """Copy a text file byte for byte, but for the results in its label column, or else in its class column, or else in a
    new last column of labels.

    ``labels(rows)`` and ``classes(old, rows)`` give the values for a run of the cloud's points, which ``replay`` counts.
    """
    axes = _axes(layout)
    replaced = [name for name in ("label", "classification") if name in layout.columns]
    replaced.sort(key=lambda name: -layout.columns[name])  # from the right, so that positions stay
    start = 0
    for run in _runs(path, layout):
        keep = np.ones(len(run.values), bool)
        if bounds is not None:
            keep = inside(run.values[:, axes], bounds)
        replay.add(run.values[keep][:, axes])
        rows = slice(start, replay.points)
        start = rows.stop
        lines = list(run.lines)
        if layout.header is not None and not replaced and 0 <= layout.header - run.start < len(lines):
            lines[layout.header - run.start] = _appended(lines[layout.header - run.start], b"label", layout)
        for i in itertools.compress(run.at, ~keep):
            marked = run.start + i == 0 and lines[0].startswith(_MARK)
            lines[i] = _MARK if marked else b""
        at, plain = list(itertools.compress(run.at, keep)), list(itertools.compress(run.plain, keep))
        for name in replaced:
            if name == "label":
                values = labels(rows)
            else:
                old = run.values[keep, list(layout.columns).index(name)].astype(np.uint8)
                values = classes(old, rows)
            find = cell_pattern(layout.columns[name], layout.delimiter).match
            for i, line, value in zip(at, plain, values.tolist(), strict=True):
                begin, end = find(line).span(1)  # type: ignore[union-attr]
                lines[i] = b"%b%d%b" % (lines[i][:begin], value, lines[i][end:])
        if not replaced:
            for i, value in zip(at, labels(rows).tolist(), strict=True):
                lines[i] = _appended(lines[i], b"%d" % value, layout)
        target.writelines(lines)


def write_table(target: BinaryIO, xyz: np.ndarray, ground: np.ndarray, decimals: int, delimiter: str) -> None:
    """Append lines of x, y, z (file units) and label."""
    label = np.where(ground, GROUND, OBJECT)
    form = delimiter.join([f"%.{decimals}f"] * 3 + ["%d\n"]).encode()
    target.writelines(form % (*point, flag) for point, flag in zip(xyz.tolist(), label.tolist(), strict=True))


# lines


def _blocks(path: Path) -> Iterator[list[bytes]]:
    """Runs of whole lines with their endings, which are those of Unix, Windows or the old Macintosh."""
    passed, rest = 0, b""
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            block = rest + block
            end = max(block.rfind(b"\n"), block.rfind(b"\r", 0, -1)) + 1  # the last byte may be half an ending
            if len(block) - end > _LONGEST:
                number = passed + len(block[:end].splitlines()) + 1
                raise InputError(
                    f"{path}: line {number} has more than {_LONGEST} bytes; this is not a text file of points"
                )
            rest = block[end:]
            if end:
                lines = block[:end].splitlines(keepends=True)
                passed += len(lines)
                yield lines
    if rest:
        yield rest.splitlines(keepends=True)


def _head(path: Path) -> tuple[list[bytes], int | None]:
    """The lines up to the first point and some after it, without the byte order mark, and the number of that line."""
    lines: list[bytes] = []
    first, others = None, 0
    with reading(path):
        for line in itertools.chain.from_iterable(_blocks(path)):
            if not lines:
                if line.startswith((b"\xff\xfe", b"\xfe\xff")):
                    raise InputError(f"{path}: the text is UTF-16; save it as UTF-8")
                line = _unmarked(line)
            lines.append(line)
            if first is None and _holds_data(line):
                if _is_point(line):
                    first = len(lines) - 1
                others += 1
            if (len(lines) - first > _PROBED) if first is not None else (others > _PREAMBLE):
                break
    return lines, first


def _unmarked(line: bytes) -> bytes:
    """The first line of a file with blanks for the byte order mark."""
    return line.replace(_MARK, b" " * len(_MARK), 1) if line.startswith(_MARK) else line


def _is_comment(line: bytes) -> bool:
    return line.lstrip(BLANK).startswith(b"#")


def _holds_data(line: bytes) -> bool:
    held = line.lstrip(BLANK)
    return bool(held) and held[0] != 0x23  # not a comment


def _is_point(line: bytes) -> bool:
    """Whether at least three of its columns are numbers, which no line of names has."""
    return sum(_NUMBER.fullmatch(token) is not None for token in re.split(rb'[\s,;"]+', line)) >= 3


def _appended(line: bytes, text: bytes, layout: Layout) -> bytes:
    """A line with one more cell."""
    if layout.delimiter is None:
        body = line.rstrip(BLANK)
        return b"%b%b%b%b" % (body, b"\t" if b"\t" in body else b" ", text, line[len(body) :])
    body = line.rstrip(b"\r\n")
    return b"%b%b%b%b" % (body, layout.delimiter, text, line[len(body) :])


# names


def _plain_names(line: bytes, delimiter: bytes | None) -> bytes:
    """A line that may name columns, plain and with blanks for the signs of a comment before it."""
    prefix = re.match(rb"[/# \t]*", line)[0]  # type: ignore[index]
    return blanked(b" " * len(prefix) + line[len(prefix) :], delimiter)


def _names(line: bytes, delimiter: bytes | None) -> list[bytes]:
    return [line[span] for span in spans_of(_plain_names(line, delimiter), delimiter)]


def _meaning(name: bytes) -> str | None:
    return _NAMES.get(re.sub(r"[^a-z0-9]", "", name.decode("latin-1").lower()))


def _columns(path: Path, header: int | None, cells: list[bytes]) -> dict[str, int]:
    """Positions of the columns that are understood. Raises InputError where two have one meaning."""
    columns: dict[str, int] = {}
    for i, cell in enumerate(cells):
        name = _meaning(cell)
        if name in columns and header is not None:
            raise InputError(
                f"{path}: line {header + 1}: the columns {shown(cells[columns[name]])} and {shown(cell)} both name the "
                f"{name.replace('_', ' ')}; rename the one that does not count"
            )
        if name is not None:
            columns[name] = i
    return columns


# numbers


class Run(NamedTuple):
    """Some whole lines of a file.

    Attributes:
        start: number of the first line, from 0.
        lines: as in the file.
        at: which of them hold data.
        plain: those lines as :func:`blanked` gives them.
        values: f64[data lines, named columns], the named columns in the order of ``Layout.columns``.
    """

    start: int
    lines: list[bytes]
    at: list[int]
    plain: list[bytes]
    values: np.ndarray

    def place(self, row: int) -> str:
        """The line of a row of ``values``, for messages."""
        return f"line {self.start + self.at[row] + 1}"


def _axes(layout: Layout) -> list[int]:
    return [list(layout.columns).index(axis) for axis in "xyz"]


def _runs(path: Path, layout: Layout) -> Iterator[Run]:
    start = 0
    with reading(path):
        for lines in _blocks(path):
            clean = lines if start else [_unmarked(lines[0]), *lines[1:]]
            skip = max(layout.first - start, 0)
            at = [i for i, line in enumerate(clean[skip:], skip) if _holds_data(line)]
            data = clean if len(at) == len(clean) else [clean[i] for i in at]
            whole = blanked(b"".join(data), layout.delimiter)
            plain = whole.splitlines(keepends=True) if len(whole) else []
            run = Run(start, lines, at, plain, np.zeros((len(at), len(layout.columns))))
            _check_cells(path, layout, run, whole)
            if at:
                yield run._replace(values=_numbers(path, layout, run, whole))
            else:
                yield run
            start += len(lines)


def _check_cells(path: Path, layout: Layout, run: Run, whole: bytes) -> None:
    """Raises InputError for the first line that cannot be split, or has not as many columns as the layout."""
    if b"\0" in whole or (b'"' in whole and open_quote(layout.delimiter).search(b"\n" + whole)):
        for i, line in zip(run.at, run.plain, strict=True):
            check_line(path, run.start + i, run.lines[i], line, layout.delimiter)
    if layout.delimiter is None:
        widths = [len(line.split()) for line in run.plain]
    else:
        widths = [line.count(layout.delimiter) + 1 for line in run.plain]
    if widths.count(layout.width) < len(widths):
        row = next(row for row, width in enumerate(widths) if width != layout.width)
        i = run.at[row]
        model = layout.first if layout.header is None else layout.header
        raise InputError(
            f"{path}: line {model + 1} has {layout.width} columns, "
            f"{_ragged(run.start + i, run.lines[i], widths[row], layout.delimiter)}"
        )


def _ragged(number: int, line: bytes, width: int, delimiter: bytes | None) -> str:
    """What to say of a line that has another number of columns than it should."""
    hints = ["give every line as many"]
    if b"#" in line:
        hints.append("give comments lines of their own")
    if delimiter == b",":
        hints.append("write decimals with a point")
    hints.append(f"put quotes around cells that hold {_WORDS[delimiter]}")
    return f"line {number + 1} has {width}, {shown(line)}; {', '.join(hints)}"


def _numbers(path: Path, layout: Layout, run: Run, whole: bytes) -> np.ndarray:
    """The named columns, by the C parser of pandas where it knows all cells, else one by one."""
    import pandas as pd  # late: it takes half a second, which LAS does not need

    used = list(layout.columns.values())
    old = tuple(int(part) for part in pd.__version__.split(".")[:2]) < (3, 1)  # these drop the last of many digits
    _numbers_one_by_one(path, layout, run, 1)  # a column of the words True and False alone would be numbers to pandas
    try:
        table = pd.read_csv(
            io.BytesIO(whole.replace(b"\r\n", b"\n").replace(b"\r", b"\n")),
            sep=r"\s+" if layout.delimiter is None else layout.delimiter.decode(),
            header=None,
            usecols=used,
            dtype=np.float64,
            engine="c",
            quoting=csv.QUOTE_NONE,
            skipinitialspace=True,
            skip_blank_lines=False,
            keep_default_na=False,
            na_values=["nan", "NaN", "NAN"],
            low_memory=False,
            **({"float_precision": "round_trip"} if old else {}),
        )
    except ValueError:
        return _numbers_one_by_one(path, layout, run, len(run.at))
    return table[used].to_numpy()


def _numbers_one_by_one(path: Path, layout: Layout, run: Run, count: int) -> np.ndarray:
    """The named columns of the first lines. Raises InputError with line and name of the first cell that is no number."""
    values = np.empty((count, len(layout.columns)))
    for row, line in enumerate(run.plain[:count]):
        cells = cells_of(line, layout.delimiter)
        for i, (name, column) in enumerate(layout.columns.items()):
            if not _NUMBER.fullmatch(cells[column]):
                cell = run.lines[run.at[row]][spans_of(line, layout.delimiter)[column]]
                hint = "; write decimals with a point and nothing between thousands" if re.search(b"[, ]", cell) else ""
                raise InputError(f"{path}: {run.place(row)}: {name} is {shown(cell)}, not a number{hint}")
            values[row, i] = float(cells[column])
    return values


def _decimals(lines: list[bytes], delimiter: bytes | None, columns: dict[str, int]) -> int:
    rows = [cells_of(blanked(line, delimiter), delimiter) for line in lines if _holds_data(line)]
    cells = [row[columns[axis]] for row in rows if len(row) > max(columns.values()) for axis in "xyz"]
    return max(len(re.match(rb"[^.]*\.?(\d*)", cell)[1]) for cell in cells)  # type: ignore[index]
