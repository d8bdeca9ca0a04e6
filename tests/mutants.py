"""Small sound files of points, damaged in ways that a seed and a number name, and a process in which they are tried.

Nothing here uses jaxfilter: files are made by laspy, lazrs and struct, and the points that are right are known from how a file
was made, not from reading it.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import itertools
import multiprocessing
import os
import resource
import struct
import sys
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import lazrs
import numpy as np
from las_files import make_copc, make_las

KINDS = ("las", "laz", "copc", "text")
ANY = ("bits", "bytes", "swapped", "truncated", "removed", "doubled", "appended", "splice")
TEXT = ("cells", "delimiters", "lines", "ends of lines", "strange bytes")
"""Damages of any file, and of text; those of LAS are :func:`fields` and, of compressed points, "table"."""
_FIRST_MINOR = (0, 0, 2, 2, 3, 3, 4, 4, 4, 4, 4)  # the minor version of LAS in which each point format came
LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)  # bytes of a point record of each point format
_POINTS = 60
_VLR, _EVLR = 54, 60  # bytes of the header of a variable length record, and of an extended one


@dataclasses.dataclass(frozen=True, eq=False)
class Sound:
    """A sound file."""

    kind: str  # one of KINDS
    name: str
    content: bytes
    records: np.ndarray | None = None  # of LAS: u8[n, length], the records of all points in their order
    chunks: tuple[tuple[int, int], ...] = ()  # of LAZ: number of points, and of bytes, of each chunk
    rows: dict[bytes, tuple[float, float, float, bool]] = dataclasses.field(default_factory=dict)
    """Of text: for each line the coordinates of its point, and whether its label is ground."""

    @property
    def start(self) -> int:
        """Of LAS, the byte at which points begin; those of LAZ, 8 bytes after that."""
        return int(struct.unpack_from("<I", self.content, 96)[0])

    def layers(self) -> list[tuple[int, int]]:
        """Of LAZ of point formats 6 and above, for each chunk the byte where the sizes of its layers begin, and their number."""
        kind, length = self.content[104] & 0x3F, struct.unpack_from("<H", self.content, 105)[0]
        if not self.chunks or kind < 6:
            return []
        number = 9 + (0, 1, 2, 1, 3)[kind - 6] + length - LENGTHS[kind]  # each extra byte has its own
        ends = self.start + 8 + np.cumsum([0, *(size for _, size in self.chunks)])
        return [(int(end) + length + 4, number) for end in ends[:-1]]


# sound files


def sound_files(folder: Path) -> list[Sound]:
    """LAS and LAZ of every point format and version, with and without extra bytes, CRS and records; COPC; text in many layouts.
    ``folder`` is for files on the way."""
    found = []
    for number, first in enumerate(_FIRST_MINOR):
        for minor in sorted({first, 2, 4} if number < 4 else {first, 4}):
            crs = (32632, 2225, "EPSG:32632+8228" if minor == 4 and number >= 6 else 2992, None)[(number + minor) % 4]
            more = {"scanner_channel": np.full(_POINTS, 2)} if number > 8 else {}
            path = folder / f"{number}-{minor}.las"
            version = f"1.{max(minor, 2)}"
            make_las(path, number, version, _POINTS, crs=crs, extra=number % 2 == 1, seed=number, **more)
            content = bytearray(path.read_bytes())
            content[25] = minor
            start, _, length = struct.unpack_from("<I4xBH", content, 96)
            records = np.frombuffer(bytes(content), np.uint8, _POINTS * length, start).reshape(_POINTS, length)
            las = Sound("las", path.name, bytes(content), records)
            found += [las, compressed(las, 16), compressed(las, 50_000)]
    for seed in range(3):
        path = folder / f"octree-{seed}.copc.laz"
        records = make_copc(path, _POINTS, seed)
        found.append(Sound("copc", path.name, path.read_bytes(), records, _chunks(path.read_bytes())))
    return found + text_files()


def compressed(sound: Sound, size: int) -> Sound:
    """LAS as LAZ, in chunks of so many points."""
    assert sound.records is not None
    content, length = sound.content, sound.records.shape[1]
    extra = length - LENGTHS[content[104]]
    data = bytearray(lazrs.LazVlr.new_for_compression(content[104], extra, False).record_data())
    for at in range(34, len(data), 6):
        if struct.unpack_from("<H", data, at)[0] == 9:  # wave packets, of which LASzip knows version 1 only
            struct.pack_into("<H", data, at + 4, 1)
    struct.pack_into("<I", data, 12, size)
    record = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(data), b"") + data
    head = bytearray(content[: sound.start] + record)
    struct.pack_into("<II", head, 96, len(head), struct.unpack_from("<I", head, 100)[0] + 1)
    head[104] |= 0x80
    file = io.BytesIO()
    file.write(head)
    compressor = lazrs.LasZipCompressor(file, lazrs.LazVlr(bytes(data)))
    compressor.compress_many(sound.records.reshape(-1))
    compressor.done()
    body = bytearray(file.getvalue())
    if content[25] >= 4:
        extended = struct.unpack_from("<Q", content, 235)[0]
        struct.pack_into("<Q", body, 235, len(body))
        body += content[extended:]
    return Sound("laz", f"{Path(sound.name).stem}-{size}.laz", bytes(body), sound.records, _chunks(bytes(body)))


def _chunks(content: bytes) -> tuple[tuple[int, int], ...]:
    file = io.BytesIO(content)
    file.seek(struct.unpack_from("<I", content, 96)[0])
    return tuple(lazrs.read_chunk_table(file, _laszip(content)))


def _laszip(content: bytes) -> lazrs.LazVlr:
    data = {user: content[at:][:size] for _, user, _, at, size in records(content)}
    return lazrs.LazVlr(data[b"laszip encoded"])


def text_files() -> list[Sound]:
    """Six layouts: with and without names, comments, quotes, a byte order mark, an end of the last line."""
    rng = np.random.default_rng(5)
    xyz = np.round(rng.uniform(0, 40, (30, 3)) * [1, 1, 0.2] + [512700, 5403500, 300], 2)
    points = [(*point, label) for point, label in zip(xyz.tolist(), rng.integers(0, 2, 30).tolist(), strict=True)]
    layouts = {  # lines of names, and of points; label 0 and class 2 are ground
        "isprs.txt": ([], [f"{x:.2f}\t{y:.2f}\t{z:.2f}\t{k}" for x, y, z, k in points]),
        "spaces.xyz": ([], [f"  {x:.2f} {y:.2f}   {z:.2f} " for x, y, z, _ in points]),
        "commas.csv": (["\ufeffx,y,z"], [f"{x:.2f},{y:.2f},{z:.2f}" for x, y, z, _ in points]),
        "names.csv": (
            ['"name",X,Y,Z,Classification,Return Number,NumberOfReturns,withheld'],
            [f'"a tree, {i}",{x:.3f},{y:.3f},{z:.3f},{2 - k},1,2,0' for i, (x, y, z, k) in enumerate(points)],
        ),
        "semicolons.csv": (["# made by hand", "X;label;Y;Z"], [f"{x};{k};{y};{z}" for x, y, z, k in points]),
        "comment.txt": (["//X Y Z label"], [f"{x:.2f} {y:.2f} {z:.2f} {k}" for x, y, z, k in points]),
    }
    found = []
    for i, (name, (head, lines)) in enumerate(layouts.items()):
        end, labels = ("\n", "\r\n")[i % 2], name not in ("spaces.xyz", "commas.csv")
        content = (end.join(head + lines) + (end if i % 3 else "")).encode()
        rows = {line.encode(): (x, y, z, labels and not k) for line, (x, y, z, k) in zip(lines, points, strict=True)}
        found.append(Sound("text", name, content, rows=rows))
    return found


# mutants


def mutant(
    sounds: list[Sound], kind: str, seed: int, number: int, only: Sequence[str] = ()
) -> tuple[Sound, str, bytes]:
    """A sound file, one to three damages, ``only`` some kinds of them if given, and the bytes of the damaged file; the same for
    the same kind, seed and number."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    same = [one for one in sounds if one.kind == kind]
    sound = same[rng.integers(len(same))]
    names = [*ANY, *(TEXT if kind == "text" else fields(sound)), *["table"] * bool(sound.chunks)]
    if only:  # LASzip, too, reads other points where bytes go from one layer to another
        names = [name for name in [*names, *["between layers"] * bool(sound.layers())] if name in only]
    content, damages = bytearray(sound.content), []
    while bytes(content) == sound.content or (rng.random() < 0.3 and len(damages) < 3):
        damages.append(names[rng.integers(len(names))])
        if damages[-1] in TEXT:
            content = damage_text(damages[-1], content, rng)
        elif damages[-1] in ANY:
            content = damage_bytes(damages[-1], content, sounds[rng.integers(len(sounds))].content, rng)
        elif damages[-1] == "table":
            damage_table(content, sound, rng)
        elif damages[-1] == "between layers":
            damage_layers(content, sound, rng)
        else:
            places = fields(sound)[damages[-1]]
            put(content, *places[rng.integers(len(places))], rng)
    return sound, " + ".join(damages), bytes(content)


def _place(content: bytearray, rng: np.random.Generator) -> int:
    """Half of the places in LAS lie before the points, a quarter in the points or soon behind them."""
    head = struct.unpack_from("<I", content, 96)[0] if len(content) > 100 and content[:4] == b"LASF" else 0
    share = rng.random()
    limit = len(content) if not head or share < 0.25 else head + 5000 if share < 0.5 else head
    return int(rng.integers(max(min(limit, len(content)), 1)))


def damage_bytes(what: str, content: bytearray, other: bytes, rng: np.random.Generator) -> bytearray:
    """One of :data:`ANY`; ``other`` is the content of another file."""
    at, to = _place(content, rng), _place(content, rng)
    few, many = int(rng.integers(1, 17)), int(rng.integers(1, 400))
    match what:
        case "bits":
            for place in (at, to)[few % 2 :]:
                content[place : place + 1] = [one ^ 1 << many % 8 for one in content[place : place + 1]]
        case "bytes":
            few = min(few, len(content) - at)
            content[at : at + few] = (rng.bytes(few), bytes(few), b"\xff" * few)[rng.integers(3)]
        case "swapped":  # as numbers of machines with another order of bytes
            few = int(rng.choice([2, 4, 8]))
            content[at : at + few] = content[at : at + few][::-1]
        case "truncated":
            del content[at:]
        case "removed":
            del content[at : at + many]
        case "doubled":
            content[to:to] = content[at : at + many]
        case "appended":
            content += rng.bytes(8 * many)
        case "splice":  # the end of another file, from the same place on or from anywhere
            content[at:] = other[at if rng.random() < 0.5 else int(rng.integers(len(other))) :]
    return content


# damages of LAS, LAZ and COPC


def records(content: bytes) -> list[tuple[int, bytes, int, int, int]]:
    """Of the records of a sound file: the byte where each begins, user, number, the byte where its data begin, their length."""
    found = []
    size, count = struct.unpack_from("<H4xI", content, 94)
    extended, more = struct.unpack_from("<QI", content, 235) if content[25] >= 4 else (0, 0)
    for at, number, layout, head in ((size, count, "<16sHH", _VLR), (extended, more, "<16sHQ", _EVLR)):
        for _ in range(number):
            user, identity, length = struct.unpack_from(layout, content, at + 2)
            found.append((at, user.rstrip(b"\0"), identity, at + head, length))
            at += head + length
    return found


NUMBERS = {  # in the data of records: what they belong to, bytes of an entry, and layouts and places in each entry
    (b"LASF_Spec", 4): ("extra bytes", 192, "B2 B3 B4 d40 d112 d136"),
    (b"LASF_Projection", 34735): ("keys", 2, "H0"),
    (b"LASF_Projection", 2112): ("WKT", 1, "B0"),
    (b"laszip encoded", 22204): ("laszip", 64, "H0 H2 B4 B5 I8 I12 q16 q24 H32 H34 H36 H38 H40 H42 H44 H46 H48 H50"),
    (b"copc", 1): ("octree", 160, "d0 d8 d16 d24 d32 Q40 Q48 d56 d64"),
    (b"copc", 1000): ("nodes", 32, "i0 i4 i8 i12 Q16 i24 i28"),
}
HEADER = "H4 H6 B24 B25 H90 H92 H94 I96 I100 B104 H105 I107 I111 I115 d131 d139 d147 d155 d163 d171 d179 d187 d195 d203 d211 d219"
HEADER_14 = " Q227 Q235 I243 Q247 Q255 Q263"
"""Numbers of the header, and those that LAS 1.4 adds (LAS 1.4 R15, table 3)."""


@functools.cache
def fields(sound: Sound) -> dict[str, list[tuple[str, int]]]:
    """Layout and place of the numbers that readers of LAS believe, by what they belong to."""
    content, start = sound.content, sound.start
    length = struct.unpack_from("<H", content, 105)[0]
    point = start + (8 if sound.chunks else length * (_POINTS // 2))  # the first one of a chunk is not compressed
    found = {"header": [], "records": [], "points": [("i", point + 4 * axis) for axis in range(3)]}
    found["header"] = [(one[0], int(one[1:])) for one in (HEADER + HEADER_14 * (content[25] >= 4)).split()]
    for at, user, number, data, size in records(content):
        found["records"] += [("H", at + 18), ("Q" if data - at == _EVLR else "H", at + 20), ("B", at + 2)]
        if (user, number) in NUMBERS:
            group, entry, places = NUMBERS[user, number]
            entries = itertools.product(range(0, size, entry), places.split())
            found[group] = [(one[0], data + i + int(one[1:])) for i, one in entries if i + int(one[1:]) < size]
    if sound.chunks:
        table = struct.unpack_from("<q", content, start)[0]
        found["chunks"] = [("q", start), ("I", table), ("I", table + 4), *(("B", table + 8 + k) for k in range(8))]
    if layers := sound.layers():
        found["layers"] = [("I", at + 4 * k) for at, number in layers for k in range(-1, number)]
    return found


_REALS = [0, -0.0, 1, -1, np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 5e-324, 1e15, 1e9, 1e5, 100, 1e-3, 1e-12]
_FACTORS = (10.0, 0.1, -1.0, 1e6, 1e-6, 1 + 1e-9)


def put(content: bytearray, layout: str, at: int, rng: np.random.Generator) -> None:
    """An extreme value in place of a number, or a little more or less, or a part or multiple of it."""
    size = struct.calcsize("<" + layout)
    if at < 0 or at + size > len(content):
        return
    old = struct.unpack_from("<" + layout, content, at)[0]
    if layout == "d":
        with np.errstate(over="ignore"):
            new = float(rng.choice(_REALS) if rng.random() < 0.7 else np.float64(old) * rng.choice(_FACTORS))
        struct.pack_into("<d", content, at, new)
        return
    extreme, near = (1 << int(rng.integers(8 * size + 1))) + int(rng.integers(-1, 2)), old + int(rng.integers(-4, 5))
    new = (extreme, near, old // 2, 2 * old, 0, int(rng.integers(1 << 8 * size - 1)))[rng.integers(6)]
    content[at : at + size] = int(new % (1 << 8 * size)).to_bytes(size, "little")


def damage_table(content: bytearray, sound: Sound, rng: np.random.Generator) -> None:
    """An entry of the table of chunks: another size, as that of another, left out, doubled; or bytes moved to another one."""
    table = list(sound.chunks)
    i, j, by, what = (int(v) for v in rng.integers([len(table), len(table), 60, 5]))
    count, size = table[i]
    table[i : i + 1] = ([(count, size + by)], [table[j]], [], [table[i]] * 2, [(count, max(size - by, 0))])[what]
    if what == 4:
        table[j] = (table[j][0], table[j][1] + by)

    def encoded(entries: Sequence[tuple[int, int]]) -> bytes:
        file = io.BytesIO()
        lazrs.write_chunk_table(file, list(entries), _laszip(sound.content))
        return file.getvalue()

    at, old = sound.start + 8 + sum(size for _, size in sound.chunks), encoded(sound.chunks)
    content[at : at + len(old)] = encoded(table).ljust(len(old), b"\0")


def damage_layers(content: bytearray, sound: Sound, rng: np.random.Generator) -> None:
    """Bytes of a layer go to another one of its chunk, so that the sum of both is the same."""
    layers = sound.layers()
    at, number = layers[rng.integers(len(layers))]
    one, other = (at + 4 * int(k) for k in rng.integers(number, size=2))
    size, second = (struct.unpack_from("<I", content, k)[0] for k in (one, other))
    by = min(size, int(rng.choice([1, 2, 3, size, rng.integers(size + 1)])))
    if one != other and second + by < 2**32:
        struct.pack_into("<I", content, one, size - by)
        struct.pack_into("<I", content, other, second + by)


# damages of text

_CELLS = (
    "", " ", "nan", "NaN", "inf", "-Infinity", "1e300", "-1e300", "1e-300", "1e400", "1,5", "1.5.2", "0x10", "1_000", "+5", "1d5",
    "#", "-", "256", "255", "-1", "7", "0.5", "99999999999999999999", '"', '""', '"5"', '"a,b"', '"a;b"', '"a b"', '"a\nb"',
    '"a""b"', "'5'", "١٢", "5 # five", "//", "=1+1", "None", "True", "1e9", "\x00", "\u00a05", "512700.00", "1e5", "x", "X", "y",
    "z", "label", "class", "Classification", "withheld", "Return Number", "#x", "\u00e9", "x y",
)  # fmt: skip
_LINES = (b"# x y z", b"//", b"x,y,z", b"z y x", b"\xef\xbb\xbf", b"total: 30", b" ", b"\t", b"5", b'"', b"1 2 3 4 5")
_MARKS = (b",", b";", b"\t", b" ", b"|", b",,", b", ", b"  ", b"; ", b"")
_ENDS = (b"\r\n", b"\r", b"\n\n", b"\n \n", b"\x0b", b"\x0c", b"")
_STRANGE = (b"\xff\xfe", b"\x00", b"\xe9", b"\xc2\xa0", b"\x1a", b"\xe2\x80\x83", b"\xa0", b"\xef\xbb\xbf", b'"', b"\n")


def damage_text(what: str, content: bytearray, rng: np.random.Generator) -> bytearray:
    """One of :data:`TEXT`, in all lines or in one, often the first or the second."""
    lines = content.split(b"\n")
    cells = [line.split(_mark(line)) for line in lines]
    at = int(rng.choice([0, 1, rng.integers(len(lines))])) % len(lines)
    some, line = range(len(lines)) if rng.random() < 0.5 else [at], bytes(lines[at])
    i, j = rng.integers(len(cells[len(lines) // 2]), size=2)
    value, how, cut = _CELLS[rng.integers(len(_CELLS))].encode(), int(rng.integers(7)), int(rng.integers(20))
    match what:
        case "cells":  # another value, in quotes, left out, doubled, or as another one
            for k in (k for k in some if len(cells[k]) > max(i, j)):
                one, other = cells[k][i], cells[k][j]
                cells[k][i : i + 1] = ([value], [b'"' + one + b'"'], [], [one, other], [other])[how % 5]
                lines[k] = _mark(lines[k]).join(cells[k])
        case "delimiters":
            for k in some:
                lines[k] = _MARKS[cut % len(_MARKS)].join(cells[k])
        case "lines":  # left out, doubled, as another one, cut short, with a remark, in quotes, after a strange one
            other, new = lines[rng.integers(len(lines))], _LINES[rng.integers(len(_LINES))]
            changed = [], [line] * 2, [other], [line[:cut]], [line + b" # five"], [b'"' + line + b'"'], [new, line]
            lines[at : at + 1] = changed[how]
        case "ends of lines":
            return bytearray(_ENDS[how % len(_ENDS)].join(lines))
        case "strange bytes":
            if how == 0:
                return bytearray(content.decode("latin-1").encode("utf-16"))
            place = int(rng.choice([0, rng.integers(len(content) + 1)]))
            return content[:place] + _STRANGE[rng.integers(len(_STRANGE))] + content[place:]
    return bytearray(b"\n".join(lines))


def _mark(line: bytes) -> bytes:
    return next((mark for mark in (b";", b",", b"\t") if mark in line), b" ")


# the process in which they are tried


class Worker:
    """Calls of a function in a process of its own, which is ended and begun anew when it takes too long or dies.

    ``memory``: bytes that it may take beside what it has once it has loaded the modules.
    """

    def __init__(self, function: Callable[..., Any], seconds: float = 30.0, memory: int = 2 * 2**30) -> None:
        self.function, self.seconds, self.memory = function, seconds, memory
        self.pool: ProcessPoolExecutor | None = None

    def __call__(self, *arguments: Any) -> tuple[str, str]:
        """What the function returns; or the name of what it raises, "killed" or "died", and a message."""
        if self.pool is None:
            started = (self.function, self.memory)
            self.pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _limit, started)
            self.pool.submit(os.getpid).result()
        try:
            return self.pool.submit(_caught, self.function, *arguments).result(self.seconds)
        except TimeoutError:
            outcome = "killed", f"no answer in {self.seconds:g} s"
        except BrokenProcessPool as error:
            outcome = "died", str(error)
        self.close()
        return outcome

    def close(self) -> None:
        """End the process."""
        if self.pool is not None:
            for process in (self.pool._processes or {}).values():
                process.kill()
            self.pool.shutdown()
            self.pool = None


def _limit(_: Any, memory: int) -> None:
    if sys.platform == "linux":
        limit = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE") + memory
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _caught(function: Callable[..., tuple[str, str]], *arguments: Any) -> tuple[str, str]:
    try:
        return function(*arguments)
    except BaseException as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return type(error).__name__, f"{error} ({Path(last.filename).name}:{last.lineno})"
