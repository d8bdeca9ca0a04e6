"""Which bytes of a line of text belong to which cell.

It is decided in one place, :func:`blanked`, which blanks out what quotes protect and keeps the length: its lines split at
every delimiter. A record is a line.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path

from ..core.errors import InputError

BLANK = b" \t\r\n"


def shown(cell: bytes) -> str:
    """Bytes of a file, for messages."""
    return repr(cell.strip(BLANK)[:60].decode("utf-8", "replace"))


def blanked(lines: bytes, delimiter: bytes | None) -> bytes:
    """Whole lines, byte for byte as long, which split into cells at every delimiter.

    A cell that begins with a quote ends with the next one that is not doubled (RFC 4180, section 2); blanks may surround
    it. Its quotes become blanks, and whatever in it has a meaning outside of quotes becomes a question mark, which no
    number has; so do bytes that are not ASCII. Other control characters than tabs and ends of lines become zeros. A
    quote where a cell begins is left only if it does not close in its line, or if more than blanks follow in the cell.
    """
    if b'"' not in lines:
        return lines.translate(_TABLE)
    if 2 * len(_simply_quoted(delimiter).findall(b"\n" + lines)) == lines.count(b'"'):  # much faster, and the same
        return lines.translate(_TABLE_WITHOUT_QUOTES)
    return _quoted(delimiter).sub(_unquoted, b"\n" + lines)[1:].translate(_TABLE)


_TABLE = bytes(0x3F if i > 0x7E else 0 if i < 0x20 and i not in BLANK else i for i in range(256))
_TABLE_WITHOUT_QUOTES = _TABLE.replace(b'"', b" ")
_PROTECTED = bytes.maketrans(b' \t,;"', b"?????")  # in quotes
_ENDS = {b";": rb";\r\n", b",": rb",\r\n", b"\t": rb"\t\r\n", None: rb" \t\r\n"}  # what a cell ends with
_PADS = {b";": rb"[ \t]*", b",": rb"[ \t]*", b"\t": rb" *", None: rb""}  # blanks around it


@functools.cache
def _simply_quoted(delimiter: bytes | None) -> re.Pattern[bytes]:
    """Quoted cells without blanks around them, and in which nothing needs the quotes; each has an end before it."""
    return re.compile(rb'[%b]"[^" \t\r\n,;]+"(?=[%b]|\Z)' % (_ENDS[delimiter], _ENDS[delimiter]))


@functools.cache
def _quoted(delimiter: bytes | None) -> re.Pattern[bytes]:
    ends, pad = _ENDS[delimiter], _PADS[delimiter]
    return re.compile(rb'([%b]%b)"((?:[^"\r\n]++|"")*+)"(?=%b(?:[%b]|\Z))' % (ends, pad, pad, ends))


@functools.cache
def open_quote(delimiter: bytes | None) -> re.Pattern[bytes]:
    """A quote where a cell begins, in what :func:`blanked` gives: one that does not close as it should."""
    return re.compile(rb'[%b]%b"' % (_ENDS[delimiter], _PADS[delimiter]))


def _unquoted(match: re.Match[bytes]) -> bytes:
    before, content = match.groups()
    kept = content.strip(b" \t")
    if not kept:
        return before + b"?" * (len(content) + 2)
    begin = 1 + len(content) - len(content.lstrip(b" \t"))
    return before + b" " * begin + kept.translate(_PROTECTED) + b" " * (len(content) + 2 - begin - len(kept))


def check_line(path: Path, number: int, line: bytes, plain: bytes, delimiter: bytes | None) -> None:
    """Raises InputError naming the line (number from 0) where :func:`blanked` says that it cannot be split."""
    if b"\0" in plain:
        value = line[plain.index(b"\0")]
        raise InputError(f"{path}: line {number + 1} holds the control character 0x{value:02x}; remove it")
    if found := open_quote(delimiter).search(b"\n" + plain):
        column = len(cells_of(plain[: found.end() - 1], delimiter))
        raise InputError(
            f"{path}: line {number + 1}: the quote at the start of column {column} does not close at the end of a cell in "
            "this line; take line breaks out of cells, and double the quotes within them"
        )


def spans_of(plain: bytes, delimiter: bytes | None) -> list[slice]:
    """Where in a plain line its cells are, without the blanks around them."""
    if delimiter is None:
        return [slice(*token.span()) for token in re.finditer(rb"[^ \t\r\n]+", plain)]
    spans, at = [], 0
    for cell in plain.split(delimiter):
        begin = at + len(cell) - len(cell.lstrip(BLANK))
        spans.append(slice(begin, max(begin, at + len(cell.rstrip(BLANK)))))
        at += len(cell) + 1
    return spans


def cells_of(plain: bytes, delimiter: bytes | None) -> list[bytes]:
    """The cells of a plain line, without the blanks around them."""
    return plain.split() if delimiter is None else [cell.strip(BLANK) for cell in plain.split(delimiter)]


@functools.cache
def cell_pattern(column: int, delimiter: bytes | None) -> re.Pattern[bytes]:
    """What matches a plain line from its start, with a cell that holds a number as group 1; faster than the spans."""
    if delimiter is None:
        return re.compile(rb"[ \t]*(?:[^ \t]+[ \t]+){%d}([^ \t\r\n]+)" % column)
    pad, ends = _PADS[delimiter], _ENDS[delimiter]
    return re.compile(rb"(?:[^%b]*%b){%d}%b([^%b \t]+)" % (delimiter, delimiter, column, pad, ends))
