"""Sound small files, and what may happen to them: seeds and mutations of LAS, LAZ, COPC and text."""

from __future__ import annotations

import dataclasses
import io
import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import lazrs
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from las_files import make_copc, make_las, patch

from jaxfilter.files.header import RECORD_LENGTHS, laszip_record

KINDS = ("las", "laz", "copc", "text")
"""Of seeds; the first three are one group, see :func:`mutant`."""

_FIRST = (0, 0, 2, 2, 3, 3, 4, 4, 4, 4, 4)  # minor version in which each point format came
_REALS = (
    0.0,
    -0.0,
    1.0,
    -1.0,
    np.nan,
    np.inf,
    -np.inf,
    1e300,
    -1e300,
    1e-300,
    5e-324,
    1e15,
    1e9,
    1e5,
    100.0,
    1e-3,
    1e-12,
)
_HEADER = (  # layout and place of the fields of the public header block, LAS 1.4 R15 table 3
    ("H", 4), ("H", 6), ("B", 24), ("B", 25), ("H", 90), ("H", 92), ("H", 94), ("I", 96), ("I", 100), ("B", 104), ("H", 105),
    *(("I", at) for at in range(107, 131, 4)), *(("d", at) for at in range(131, 227, 8)),
    ("Q", 227), ("Q", 235), ("I", 243), *(("Q", at) for at in range(247, 375, 8)),
)  # fmt: skip

Mutation = Callable[[bytearray, np.random.Generator], bytes | bytearray]


@dataclasses.dataclass(frozen=True)
class Seed:
    """A sound file: one of :data:`KINDS`, its suffix, and its bytes."""

    kind: str
    name: str
    suffix: str
    content: bytes


def seeds(folder: Path) -> list[Seed]:
    """LAS and LAZ of every point format and version, with and without extra bytes, CRS, waveforms and chunks of their own;
    COPC; text in many layouts. ``folder`` is for files on the way."""
    found = []

    def add(kind: str, name: str, path: Path) -> None:
        found.append(Seed(kind, name, path.suffix, path.read_bytes()))

    for number, first in enumerate(_FIRST):
        for minor in sorted({first, 2, 4} if number < 4 else {first, 4}):
            for suffix in (".las", ".laz"):
                path = folder / f"{number}-{minor}{suffix}"
                crs = (32632, 2225, "EPSG:32632+8228" if minor == 4 and number >= 6 else 2992, None)[
                    (number + minor) % 4
                ]
                one = {"scanner_channel": np.full(60, 2)} if number > 8 else {}
                make_las(path, number, f"1.{max(minor, 2)}", n=60, crs=crs, extra=number % 2 == 1, seed=number, **one)
                if minor < 2:
                    patch(path, "B", 25, minor)
                add(path.suffix[1:], path.name, path)
    for number in (1, 6):  # LAZ of several chunks
        path = folder / f"chunks-{number}.laz"
        path.write_bytes(in_chunks((folder / f"{number}-{2 if number < 6 else 4}.las").read_bytes()))
        add("laz", path.name, path)
    for seed in range(3):
        path = folder / f"octree-{seed}.copc.laz"
        make_copc(path, 120 + 60 * seed, seed)
        found.append(Seed("copc", path.name, ".laz", path.read_bytes()))
    return found + _texts()


def in_chunks(content: bytes) -> bytes:
    """Uncompressed LAS, without what follows its points, as LAZ in chunks of 16 points."""
    start, kind, length = struct.unpack_from("<I4xBH", content, 96)
    size, records = struct.unpack_from("<H4xI", content, 94)
    points = np.frombuffer(content, np.uint8, 60 * length, start)
    data = bytearray(laszip_record(kind, length - RECORD_LENGTHS[kind]))
    struct.pack_into("<I", data, 12, 16)
    record = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(data), b"") + data
    head = bytearray(content[:start] + record)
    struct.pack_into("<I", head, 96, len(head))
    struct.pack_into("<IB", head, 100, records + 1, kind | 0x80)
    if size >= 375:
        struct.pack_into("<QI", head, 235, 0, 0)
    body = io.BytesIO()
    body.write(head)
    compressor = lazrs.LasZipCompressor(body, lazrs.LazVlr(bytes(data)))
    compressor.compress_many(points.copy())
    compressor.done()
    return body.getvalue()


def _texts() -> list[Seed]:
    rng = np.random.default_rng(5)
    xyz = np.round(rng.uniform(0, 40, (30, 3)) * [1, 1, 0.2] + [512700, 5403500, 300], 2)
    label = rng.integers(0, 2, 30)
    classes, number = rng.integers(0, 8, 30), rng.integers(1, 3, 30)
    rows = list(zip(xyz.tolist(), label.tolist(), classes.tolist(), number.tolist(), strict=True))
    plain = {
        "isprs.txt": [f"{x:.2f}\t{y:.2f}\t{z:.2f}\t{k}" for (x, y, z), k, _, _ in rows],
        "spaces.xyz": [f"  {x:.2f} {y:.2f}   {z:.2f} " for (x, y, z), _, _, _ in rows],
        "commas.csv": ["x,y,z", *(f"{x:.2f},{y:.2f},{z:.2f}" for (x, y, z), _, _, _ in rows)],
        "names.csv": [
            '"name",X,Y,Z,Classification,Return Number,NumberOfReturns,withheld',
            *(f'"a tree, {i}",{x:.3f},{y:.3f},{z:.3f},{c},{r},2,0' for i, ((x, y, z), _, c, r) in enumerate(rows)),
        ],
        "semicolons.csv": ["# made by hand", "X;label;Y;Z", *(f"{x};{k};{y};{z}" for (x, y, z), k, _, _ in rows)],
        "comment.txt": ["//X Y Z label", *(f"{x:.2f} {y:.2f} {z:.2f} {k}" for (x, y, z), k, _, _ in rows)],
    }
    ends = ("\n", "\r\n")
    found = []
    for i, (name, lines) in enumerate(plain.items()):
        end = ends[i % 2]
        text = end.join(lines) + (end if i % 3 else "")
        mark = b"\xef\xbb\xbf" if name == "commas.csv" else b""
        found.append(Seed("text", name, Path(name).suffix, mark + text.encode()))
    return found


def mutant(group: list[Seed], seed: int, number: int) -> tuple[Seed, str, bytes]:
    """The mutant of this number: the sound file that it was, what was done to it, and its bytes.

    The same group, seed and number give the same mutant.
    """
    rng = np.random.default_rng([seed, number])
    kinds = sorted({one.kind for one in group})
    kind = kinds[int(rng.integers(len(kinds)))]
    of_kind = [one for one in group if one.kind == kind]
    origin = of_kind[int(rng.integers(len(of_kind)))]
    acts = TEXT if kind == "text" else BINARY
    names = [name for name in acts if name != "octree"] + 3 * ["octree"] * (kind == "copc")
    content, done = bytearray(origin.content), []
    for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
        name = names[int(rng.integers(len(names)))]
        if int(rng.integers(12)) == 0:
            name, content = "splice", _splice(content, group[int(rng.integers(len(group)))].content, rng)
        else:
            content = bytearray(acts[name](content, rng))
        done.append(name)
    return origin, "+".join(done), bytes(content)


# any bytes


def _place(content: bytearray, rng: np.random.Generator) -> int:
    """Half of the places in LAS lie before the points, a quarter in the points or soon behind them."""
    head = struct.unpack_from("<I", content, 96)[0] if len(content) > 100 and content[:4] == b"LASF" else 0
    share = rng.random()
    limit = len(content) if not head or share < 0.25 else head + 5000 if share < 0.5 else head
    return int(rng.integers(max(min(limit, len(content)), 1)))


def _bits(content: bytearray, rng: np.random.Generator) -> bytearray:
    for _ in range(int(rng.integers(1, 9))):
        at = _place(content, rng)
        if at < len(content):
            content[at] ^= 1 << int(rng.integers(8))
    return content


def _bytes(content: bytearray, rng: np.random.Generator) -> bytearray:
    at, length = _place(content, rng), int(rng.integers(1, 17))
    length = min(length, len(content) - at)
    fill = int(rng.integers(3))
    content[at : at + length] = rng.bytes(length) if fill == 0 else bytes(length) if fill == 1 else b"\xff" * length
    return content


def _truncated(content: bytearray, rng: np.random.Generator) -> bytearray:
    return content[: _place(content, rng)]


def _removed(content: bytearray, rng: np.random.Generator) -> bytearray:
    at = _place(content, rng)
    del content[at : at + int(rng.integers(1, 400))]
    return content


def _doubled(content: bytearray, rng: np.random.Generator) -> bytearray:
    at, to = _place(content, rng), _place(content, rng)
    content[to:to] = content[at : at + int(rng.integers(1, 400))]
    return content


def _appended(content: bytearray, rng: np.random.Generator) -> bytearray:
    return content + rng.bytes(int(rng.integers(1, 3000)))


def _splice(content: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    """The beginning of one file and the end of another, cut at the same place or anywhere."""
    at = _place(content, rng)
    return content[:at] + other[at if rng.random() < 0.5 else int(rng.integers(max(len(other), 1))) :]


# fields of LAS


def _extreme(layout: str, rng: np.random.Generator) -> float | int:
    if layout == "d":
        return float(rng.choice(_REALS)) * (1 if rng.random() < 0.8 else float(rng.normal()))
    size = 8 * struct.calcsize(layout)
    value = int(rng.choice([0, 1, 2, 255, 2**8, 2**16, 2**31, 2**32])) + int(rng.integers(-1, 2))
    value = (1 << int(rng.integers(size + 1))) - 1 if rng.random() < 0.4 else value
    return value % (1 << size) if layout.isupper() else (value + (1 << size - 1)) % (1 << size) - (1 << size - 1)


def _put(content: bytearray, layout: str, at: int, rng: np.random.Generator) -> bytearray:
    """An extreme value, or a little more or less than what was there, if the field is in the file."""
    if not 0 <= at <= len(content) - struct.calcsize(layout):
        return content
    old = struct.unpack_from("<" + layout, content, at)[0]
    new = _extreme(layout, rng)
    if layout.isupper() and rng.random() < 0.4:
        new = (old + int(rng.integers(-3, 4))) % (1 << 8 * struct.calcsize(layout))
    elif layout == "d" and rng.random() < 0.3 and np.isfinite(old):
        new = float(old) * float(rng.choice([10.0, 0.1, -1.0, 1e6, 1e-6, 1 + 1e-9]))
    struct.pack_into("<" + layout, content, at, new)
    return content


def _field(content: bytearray, rng: np.random.Generator) -> bytearray:
    return _put(content, *_HEADER[int(rng.integers(len(_HEADER)))], rng)


def _records(content: bytearray) -> list[tuple[int, bytes, int, int, bool]]:
    """Start, user, number, length and whether it is extended, of the records that are where they should be."""
    found = []
    if len(content) < 375 or content[:4] != b"LASF":
        return found
    at, count = struct.unpack_from("<H4xI", content, 94)
    for _ in range(min(count, 50)):
        if at + 54 > len(content):
            break
        user, number, length = struct.unpack_from("<16sHH", content, at + 2)
        found.append((at, user.rstrip(b"\0"), number, length, False))
        at += 54 + length
    at, count = struct.unpack_from("<QI", content, 235)
    for _ in range(min(count, 50) if content[25] >= 4 else 0):
        if at + 60 > len(content):
            break
        user, number, length = struct.unpack_from("<16sHQ", content, at + 2)
        found.append((at, user.rstrip(b"\0"), number, length, True))
        at += 60 + length
    return found


def _record(content: bytearray, rng: np.random.Generator) -> bytearray:
    """Header or data of a record: user, number, length, or some bytes of its data."""
    records = _records(content)
    if not records:
        return _bits(content, rng)
    at, _, _, length, extended = records[int(rng.integers(len(records)))]
    start, what = at + (60 if extended else 54), int(rng.integers(5))
    if what == 0:
        content[at + 2 + int(rng.integers(16))] = int(rng.integers(256))
    elif what == 1:
        _put(content, "H", at + 18, rng)
    elif what == 2:
        _put(content, "Q" if extended else "H", at + 20, rng)
    elif length:
        layout = "BHIQd"[int(rng.integers(5))]
        _put(content, layout, start + int(rng.integers(min(length, 2000))), rng)
    return content


def _extra_bytes(content: bytearray, rng: np.random.Generator) -> bytearray:
    """A field of a description of extra bytes: type, options, name, no data, least, largest, scale, offset."""
    for at, user, number, length, extended in _records(content):
        if (user, number) == (b"LASF_Spec", 4) and length:
            entry = at + (60 if extended else 54) + 192 * int(rng.integers(max(1, length // 192)))
            layout, place = (("B", 2), ("B", 3), ("B", 4), ("d", 40), ("d", 112), ("d", 136))[int(rng.integers(6))]
            return _put(content, layout, entry + place, rng)
    return _field(content, rng)


def _crs(content: bytearray, rng: np.random.Generator) -> bytearray:
    """Another length of the unit, another key, or damage within the WKT."""
    for at, user, number, length, extended in _records(content):
        start = at + (60 if extended else 54)
        if user != b"LASF_Projection" or number not in (2112, 34735) or not length:
            continue
        if number == 34735:
            return _put(content, "H", start + 2 * int(rng.integers(max(1, length // 2))), rng)
        found = list(re.finditer(rb"(UNIT\[[^,]*,)([0-9.eE+-]+)", bytes(content[start : start + length])))
        if found and rng.random() < 0.6:
            one = found[int(rng.integers(len(found)))]
            size = len(one[2])
            text = rng.choice(["1e300", "0", "-1", "1e-300", "nan", "inf", "2", "0.3", "1e4", "9", "x", ""]).encode()
            content[start + one.start(2) : start + one.end(2)] = text[:size].ljust(size)
            return content
        return _put(content, "B", start + int(rng.integers(length)), rng)
    return _field(content, rng)


def _chunk_table(content: bytearray, rng: np.random.Generator) -> bytearray:
    """Where the table of chunks is, how many there are, or its bytes; or a layer's size in the first chunk."""
    if len(content) < 227:
        return _bits(content, rng)
    start = struct.unpack_from("<I", content, 96)[0]
    if not content[104] & 0x80 or start + 8 > len(content):
        return _point(content, rng)
    table, what = struct.unpack_from("<q", content, start)[0], int(rng.integers(4))
    if what == 0:
        return _put(content, "q", start, rng)
    if what == 1:
        length = struct.unpack_from("<H", content, 105)[0]
        return _put(content, "I", start + 8 + length + 4 * int(rng.integers(12)), rng)
    if not 0 < table < len(content) - 8:
        return _bits(content, rng)
    return _put(content, "I", table + 4 * (what - 2), rng) if what == 2 else _put(content, "B", table + 8, rng)


def _point(content: bytearray, rng: np.random.Generator) -> bytearray:
    """Coordinates of a point; compressed files have their first one as it is."""
    start, kind, length = struct.unpack_from("<I4xBH", content.ljust(107, b"\0"), 96)
    at = start + (8 if kind & 0x80 else length * int(rng.integers(60)))
    return _put(content, "i", at + 4 * int(rng.integers(3)), rng)


def _octree(content: bytearray, rng: np.random.Generator) -> bytearray:
    """A field of the info record, or of an entry of the hierarchy."""
    layouts = ("i", "i", "i", "i", "Q", "i", "i")
    for at, user, number, length, extended in _records(content):
        start = at + (60 if extended else 54)
        if user == b"copc" and number == 1 and rng.random() < 0.4:
            which = int(rng.integers(9))
            return _put(content, "Q" if which in (5, 6) else "d", start + 8 * which, rng)
        if user == b"copc" and number == 1000 and length >= 32:
            which = int(rng.integers(7))
            place = struct.calcsize("<" + "".join(layouts[:which]))
            return _put(content, layouts[which], start + 32 * int(rng.integers(length // 32)) + place, rng)
    return _field(content, rng)


BINARY: dict[str, Mutation] = {
    "bits": _bits, "bytes": _bytes, "truncated": _truncated, "removed": _removed, "doubled": _doubled, "appended": _appended,
    "header": _field, "record": _record, "extra bytes": _extra_bytes, "crs": _crs, "chunks": _chunk_table, "point": _point,
    "octree": _octree,
}  # fmt: skip
"""Mutations of LAS, LAZ and COPC by name."""


# text

_CELLS = (
    "", " ", "nan", "NaN", "inf", "-Infinity", "1e300", "-1e300", "1e-300", "1e400", "1,5", "1.5.2", "0x10", "1_000", "+5", "1d5",
    "#", "-", "256", "255", "-1", "7", "0.5", "99999999999999999999", '"', '""', '"5"', '"a,b"', '"a;b"', '"a b"', '"a\nb"',
    '"a""b"', "'5'", "١٢", "5 # five", "//", "=1+1", "None", "True", "1e9", "\x00", "\u00a05", "512700.00", "1e5",
)  # fmt: skip
_NAMES = (
    "x",
    "X",
    "y",
    "z",
    "Z",
    "label",
    "class",
    "Classification",
    "withheld",
    "Return Number",
    "",
    '"x"',
    "a,b",
    "#x",
    "\u00e9",
    "x y",
)
_ENDS = ("\n", "\r\n", "\r", "\n\n", "\n \n", "\x0b", "\x0c", "\x85", "\u2028", "")


def _lines(content: bytearray) -> list[str]:
    return content.decode("latin-1").split("\n")


def _joined(lines: list[str]) -> bytes:
    return b"\n".join(line.encode("latin-1", "replace") for line in lines)


def _delimiter(line: str) -> str:
    return next((d for d in ";,\t" if d in line), " ")


def _any(options: tuple[str, ...], rng: np.random.Generator) -> str:
    return options[int(rng.integers(len(options)))]


def _cell(content: bytearray, rng: np.random.Generator) -> bytes:
    lines = _lines(content)
    at = int(rng.integers(len(lines)))
    mark = _delimiter(lines[at])
    cells = lines[at].split(mark)
    cells[int(rng.integers(len(cells)))] = _utf8(_any(_CELLS, rng))
    lines[at] = mark.join(cells)
    return _joined(lines)


def _utf8(text: str) -> str:
    """Characters that are the bytes of the text in UTF-8."""
    return text.encode().decode("latin-1")


def _column(content: bytearray, rng: np.random.Generator) -> bytes:
    """The same cell in every line, a column left out, doubled or exchanged."""
    lines, what, value = _lines(content), int(rng.integers(4)), _utf8(_any(_CELLS, rng))
    mark = _delimiter(lines[len(lines) // 2])
    width = len(lines[len(lines) // 2].split(mark))
    at, other = (int(v) for v in rng.integers(max(width, 1), size=2))
    for i, line in enumerate(lines):
        cells = line.split(mark)
        if len(cells) <= max(at, other):
            continue
        if what == 0:
            cells[at] = value
        elif what == 1:
            del cells[at]
        elif what == 2:
            cells.insert(at, cells[other])
        else:
            cells[at], cells[other] = cells[other], cells[at]
        lines[i] = mark.join(cells)
    return _joined(lines)


def _delimiters(content: bytearray, rng: np.random.Generator) -> bytes:
    """Other delimiters in one line or in all."""
    lines, new = _lines(content), _any((",", ";", "\t", " ", "|", ",,", ", ", "  ", "; "), rng)
    one = int(rng.integers(len(lines))) if rng.random() < 0.5 else None
    for i, line in enumerate(lines):
        if one is None or i == one:
            lines[i] = line.replace(_delimiter(line), new)
    return _joined(lines)


def _quotes(content: bytearray, rng: np.random.Generator) -> bytes:
    """A lone quote somewhere, or a cell, a line or a column in quotes."""
    lines, what = _lines(content), int(rng.integers(4))
    at = int(rng.integers(len(lines)))
    mark = _delimiter(lines[at])
    if what == 0:
        cut = int(rng.integers(len(lines[at]) + 1))
        lines[at] = lines[at][:cut] + '"' + lines[at][cut:]
    elif what == 1:
        lines[at] = f'"{lines[at]}"'
    else:
        column = int(rng.integers(4))
        for i in range(len(lines)) if what == 3 else (at,):
            cells = lines[i].split(mark)
            if column < len(cells):
                cells[column] = f'"{cells[column]}"'
                lines[i] = mark.join(cells)
    return _joined(lines)


def _line_ends(content: bytearray, rng: np.random.Generator) -> bytes:
    """Another end of one line or of all."""
    end = _any(_ENDS, rng).encode()
    plain = bytes(content).replace(b"\r\n", b"\n")
    if rng.random() < 0.5:
        return plain.replace(b"\n", end)
    parts = plain.split(b"\n")
    at = int(rng.integers(len(parts)))
    return b"\n".join(parts[:at]) + end + b"\n".join(parts[at:])


def _rows(content: bytearray, rng: np.random.Generator) -> bytes:
    """A line left out, doubled, exchanged, cut short, made longer, made a comment, or a strange one put in."""
    lines, what = _lines(content), int(rng.integers(9))
    at, other = (int(v) for v in rng.integers(len(lines), size=2))
    mark = _delimiter(lines[at])
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(at, lines[other])
    elif what == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif what == 3:
        lines[at] = lines[at][: int(rng.integers(len(lines[at]) + 1))]
    elif what == 4:
        lines[at] += mark + _utf8(_any(_CELLS, rng))
    elif what == 5:
        lines[at] += " # a remark"
    elif what == 6:
        lines.insert(
            at,
            _utf8(_any(("# x y z", "//", "x,y,z", "\ufeff", "total: 30", " ", "\t", "5", '"', "1 2 3 4 5 6 7"), rng)),
        )
    elif what == 7:
        lines = lines[:at]
    else:
        lines[at] = lines[at].rpartition(mark)[0]
    return _joined(lines)


def _names(content: bytearray, rng: np.random.Generator) -> bytes:
    """Another name of a column in the first lines, or a line of names put first."""
    lines = _lines(content)
    if rng.random() < 0.3:
        mark = _delimiter(lines[-2] if len(lines) > 1 else lines[0])
        lines.insert(0, mark.join(_utf8(_any(_NAMES, rng)) for _ in range(int(rng.integers(2, 7)))))
        return _joined(lines)
    at = int(rng.integers(min(2, len(lines))))
    mark = _delimiter(lines[at])
    cells = lines[at].split(mark)
    cells[int(rng.integers(len(cells)))] = _utf8(_any(_NAMES, rng))
    lines[at] = mark.join(cells)
    return _joined(lines)


def _encoding(content: bytearray, rng: np.random.Generator) -> bytes:
    """UTF-16, a byte order mark, bytes that are no UTF-8, NUL bytes."""
    what, text = int(rng.integers(6)), bytes(content)
    at = int(rng.integers(len(text) + 1))
    if what == 0:
        return text.decode("latin-1").encode("utf-16")
    if what == 1:
        return b"\xef\xbb\xbf" + text
    if what == 2:
        return text[:at] + b"\xef\xbb\xbf" + text[at:]
    strange = (b"\xff\xfe", b"\x00", b"\xe9", b"\xc2\xa0", b"\x1a", b"\xe2\x80\x83", b"\xa0")
    return text[:at] + strange[int(rng.integers(len(strange)))] + text[at:]


TEXT: dict[str, Mutation] = {
    "cell": _cell, "column": _column, "delimiters": _delimiters, "quotes": _quotes, "line ends": _line_ends, "rows": _rows,
    "names": _names, "encoding": _encoding, "bits": _bits, "bytes": _bytes, "truncated": _truncated, "removed": _removed,
    "doubled": _doubled,
}  # fmt: skip
"""Mutations of text by name."""
