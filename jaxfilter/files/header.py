"""The header of a LAS file, byte by byte: validated before any reader is trusted with it, and rewritten without loss.

Everything before the first point is kept as it stands in the file; only the fields that must change are patched. Field
offsets follow the ASPRS LAS specification 1.4 R15, tables 3 (public header block), 5 and 6 (variable length records)
and 24 (extra bytes).
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import hashlib
import io
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

import lazrs
import numpy as np
import psutil

from ..core.errors import InputError, OutputError, warn
from ..core.frame import check_scales
from ..core.process import need_threads
from ..core.units import PROJECTION, WKT
from .disk import CHANGED_IN_READING, Identity, opened
from .storage import Place, Remote, read_ranges

RECORD_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point record by point format, 0 to 10."""

HEADER_LENGTHS = (227, 227, 227, 235, 375)
"""Least bytes of the public header block by minor version, 1.0 to 1.4."""

_VLR, _EVLR = 54, 60  # bytes of a record's own header
_EXTRA_BYTES = ("LASF_Spec", 4)
_LASZIP = ("laszip encoded", 22204)
_EXTRA_ENTRY = 192
_CHUNKED, _LAYERED = 2, 3  # methods of LASzip
_ITEMS, _ITEM = 34, 6  # where a laszip record lists the parts of a point, and bytes for each
_WAVES, _POINT14 = 9, 10  # kinds of parts: wave packets of formats 4 and 5; the first of those that are layered
_POINTS_PER_BYTE = 1000  # more than LAZ reaches for points that are all equal
_EXTRA_SIZES = (1, 1, 2, 2, 4, 4, 8, 8, 4, 8)  # bytes of the data types 1 to 10
_UINT8, _FLOAT32, _FLOAT64 = 1, 9, 10
FLOATS = {_FLOAT32: "<f4", _FLOAT64: "<f8"}
"""Data types of extra bytes that are floating point, as NumPy names them."""


@dataclasses.dataclass(frozen=True)
class Record:
    """A variable length record: its user and number, where it begins and ends in the file, and where its data begin."""

    key: tuple[str, int]
    start: int
    payload: int
    end: int


@dataclasses.dataclass(frozen=True)
class ExtraDimension:
    """A described part of the extra bytes: ``start`` counts from the beginning of the point record."""

    name: str
    data_type: int
    start: int
    size: int


class _Field:
    """A number of the public header block, some bits of it, or several as f64; 0 where its LAS version has none."""

    def __init__(self, at: int, layout: str, minor: int = 0, mask: int | None = None) -> None:
        self.at, self.layout, self.minor, self.mask = at, layout, minor, mask

    def __get__(self, header: Header, kind: type[Header]) -> Any:
        if header.head[25] < self.minor:
            return 0
        found = struct.unpack_from("<" + self.layout, header.head, self.at)
        return np.array(found) if len(found) > 1 else found[0] if self.mask is None else found[0] & self.mask


@dataclasses.dataclass(frozen=True)
class Header:
    """A validated header. ``head`` is the file up to its first point, ``file_size`` its length in bytes; ``identity`` is
    that of the file it was read from, None for the header of a new file; ``unread`` is the number of compressed points, as
    far as it is known, that are in the file and not in its count."""

    path: Place
    head: bytes
    file_size: int
    vlrs: tuple[Record, ...]
    evlrs: tuple[Record, ...] = ()
    evlr_start: int = 0
    identity: Identity | None = None
    unread: int = 0

    @contextlib.contextmanager
    def open(self) -> Iterator[BinaryIO]:
        """The file that the header is of. Raises: InputError if the name is another file's by now, OSError."""
        with opened(self.path) as (file, identity):
            if identity != self.identity:
                raise InputError(f"{self.path}: {CHANGED_IN_READING}")
            yield file

    @property
    def fingerprint(self) -> str:
        """Changes with the file, wherever it is mounted: a hash of its size, of the time of its last change or its ETag,
        and of all that precedes its points."""
        assert self.identity is not None
        stated = f"{self.identity.size} {self.identity.modified} {self.identity.tag}\n".encode()
        return hashlib.sha256(stated + self.head).hexdigest()[:32]

    minor, size, record_length = _Field(25, "B"), _Field(94, "H"), _Field(105, "H")
    compressed, point_format = _Field(104, "B", mask=0x80), _Field(104, "B", mask=0x3F)
    scales, offsets, waveform_start = _Field(131, "3d"), _Field(155, "3d"), _Field(227, "Q", 3)
    _legacy_count, _count = _Field(107, "I"), _Field(247, "Q", 4)

    @property
    def count(self) -> int:
        """Number of points; writers that leave the 1.4 count at zero are believed in their legacy count."""
        return self._count or self._legacy_count

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest x, y, z as the header states them."""
        both = np.array(struct.unpack_from("<6d", self.head, 179)).reshape(3, 2)
        return both[:, 1], both[:, 0]

    @property
    def date(self) -> str | None:
        """Day on which the file was made, ISO 8601; None if the header states none that can be."""
        day, year = struct.unpack_from("<2H", self.head, 90)
        if not (1 <= day <= 366 and 1900 <= year <= 2999):
            return None
        return (datetime.date(year, 1, 1) + datetime.timedelta(day - 1)).isoformat()

    @property
    def is_copc(self) -> bool:
        """Cloud Optimised Point Cloud: LAZ with its octree in an info record, which comes first."""
        return bool(self.vlrs) and self.vlrs[0].key == ("copc", 1)

    def without_octree(self, records: Sequence[Record]) -> list[Record]:
        """Those of some records that are not on the octree of COPC."""
        return [record for record in records if not self.is_copc or record.key[0] != "copc"]

    def remarks(self) -> Iterator[str]:
        """What the header says of the number of points that contradicts itself or the file."""
        full, legacy, said = self._count, self._legacy_count, f"the header announces {self.count} points"
        if self.minor >= 4 and legacy and full != legacy:
            yield f"the header announces {full} points, and {legacy} in its legacy field: {self.count} are read"
        room = 0 if self.compressed else self._next(self.points_end) - self.points_end
        returns = sum(struct.unpack_from("<15Q", self.head, 255) if full else struct.unpack_from("<5I", self.head, 111))
        if self.unread:
            held = f"the compressed chunks hold at least {self.count + self.unread}"
            yield f"{said}, but {held}: the others are not read, and will be in no output"
        elif more := room // self.record_length:
            held = f"{room} bytes follow them, enough for {more} more, so {self.count + more} in all"
            yield f"{said}, but {held}: they are not read; LAS written from this file keeps them as they are"
        elif returns > self.count:
            yield f"{said}, and {returns} in its counts by return: {self.count} are read"

    @property
    def points_end(self) -> int:
        """Where uncompressed points end."""
        return len(self.head) + self.count * self.record_length

    @property
    def tail(self) -> int:
        """Where that begins which follows the points (EVLRs, waveforms) and is copied as it stands."""
        return self._next(len(self.head)) if self.compressed else self.points_end

    def _next(self, start: int) -> int:
        """Where after ``start`` something else than points begins; else the end of the file."""
        starts = [s for s in (self.waveform_start, self.evlr_start) if start <= s <= self.file_size]
        return min(starts, default=self.file_size)

    @property
    def laszip(self) -> bytes:
        """The record that LAZ needs to be compressed and decompressed. Raises InputError if there is none."""
        for record in self.vlrs:
            if record.key == _LASZIP and record.end - record.payload >= 16:
                return self.head[record.payload : record.end]
        raise InputError(f"{self.path}: points are compressed, but the laszip record is missing; the file is damaged")

    @property
    def decoder(self) -> bytes:
        """``laszip`` with chunks not larger than all the points: a decoder takes memory for a whole chunk."""
        data = self.laszip
        chunk = struct.unpack_from("<I", data, 12)[0]
        if self.count < chunk < 2**32 - 1:  # the largest number stands for chunks of varying size
            data = data[:12] + struct.pack("<I", max(self.count, 1)) + data[16:]
        return data

    def __str__(self) -> str:
        name = "COPC" if self.is_copc else "LAZ" if self.compressed else "LAS"
        return f"{name} 1.{self.minor}, point format {self.point_format}"

    def extra_dimensions(self) -> list[ExtraDimension] | None:
        """What the extra bytes of a point hold, as far as it is described; None if the description is damaged."""
        at, found = RECORD_LENGTHS[self.point_format], []
        for record in self.vlrs:
            if record.key != _EXTRA_BYTES:
                continue
            if (record.end - record.payload) % _EXTRA_ENTRY:
                return None
            for entry in range(record.payload, record.end, _EXTRA_ENTRY):
                data_type, size, name = struct.unpack_from("<BB32s", self.head, entry + 2)
                if data_type > 30:
                    return None
                if data_type:
                    size = _EXTRA_SIZES[(data_type - 1) % 10] * ((data_type - 1) // 10 + 1)
                found.append(ExtraDimension(_text(name), data_type, at, size))
                at += size
        return found if at <= self.record_length else None

    def rewritten(
        self,
        compressor: bytes | None,
        extra: Mapping[str, str] | None = None,
        crs: tuple[int, bytes] | None = None,
        drop: str = "",
    ) -> Header:
        """The header of an output: compressed by ``compressor`` (a laszip record's data) or not at all, with further
        float32 dimensions ``extra`` (names and descriptions), and without an octree; ``crs``: number and data of a record that
        is added; ``drop``: user whose records are left out."""
        kept = self.without_octree([r for r in self.vlrs if r.key != _LASZIP and r.key[0] != (drop or None)])
        blocks = [self.head[r.start : r.end] for r in kept]
        length = self.record_length
        if extra:
            described = self.extra_dimensions()
            if described is None:
                raise OutputError(f"{self.path}: the description of its extra bytes is damaged, so none can be added")
            end = max((d.start + d.size for d in described), default=RECORD_LENGTHS[self.point_format])
            entries = [(f"undescribed {i + 1}", _UINT8, "") for i in range(length - end)]  # they precede the new ones
            entries += [(name, _FLOAT32, words) for name, words in extra.items()]
            payload = b"".join(
                struct.pack("<HBB32s124x32s", 0, kind, 0, name.encode(), words.encode())
                for name, kind, words in entries
            )
            old = [i for i, r in enumerate(kept) if r.key == _EXTRA_BYTES]
            if old:
                block = blocks[old[-1]]
                size = struct.pack("<H", len(block) - _VLR + len(payload))
                blocks[old[-1]] = block[:20] + size + block[22:] + payload
            else:
                blocks.append(vlr(*_EXTRA_BYTES, payload))
            length += 4 * len(extra)
        if crs is not None:
            blocks.append(vlr(PROJECTION, *crs))
        if compressor is not None:
            blocks.append(vlr(*_LASZIP, compressor))
        gap = self.head[self.vlrs[-1].end if self.vlrs else self.size :]
        head = bytearray(self.head[: self.size] + b"".join(blocks) + gap)
        kind = self.point_format | (0x80 if compressor is not None else self.head[104] & 0x40)  # LASzip's bits
        struct.pack_into("<IIBH", head, 96, len(head), len(blocks), kind, length)
        if crs is not None and crs[0] == WKT:
            head[6] |= 16
        return _parse(self.path, bytes(head), len(head))


def read_header(path: Place, tables: bool = True) -> Header:
    """Read and validate. No field is trusted before it is bounded by the length of the file.

    ``tables=False`` does not look among the points: whether chunks of LAZ hold as many as announced is then not checked.

    Raises: InputError naming the file and the field: not LAS, unknown version or point format, sizes, record counts or
    point counts that the file cannot hold, scales that are not positive numbers.
    """
    with opened(path) as (file, identity):
        size = identity.size
        block = file.read(HEADER_LENGTHS[4])
        if not size:
            raise InputError(f"{path}: the file is empty (0 bytes)")
        if block[:4] != b"LASF":
            raise InputError(f"{path}: not a LAS file: it begins with {block[:4]!r} instead of b'LASF'")
        _refuse(path, len(block) < HEADER_LENGTHS[0], f"{len(block)} bytes are too few for a LAS header")
        major, minor = block[24], block[25]
        if major != 1 or minor >= len(HEADER_LENGTHS):
            raise InputError(f"{path}: LAS version {major}.{minor} is not supported; 1.0 to 1.4 are")
        own, offset, records = struct.unpack_from("<HII", block, 94)
        _refuse(path, not HEADER_LENGTHS[minor] <= own <= size, f"header size {own} is impossible in {size} bytes")
        _refuse(path, not own <= offset <= size, f"offset to point data {offset} is not in the file ({size} bytes)")
        announced = f"the header announces {records} variable length records, and has {offset - own} bytes for them"
        _refuse(path, records * _VLR > offset - own, announced)
        file.seek(0)
        header = dataclasses.replace(_parse(path, file.read(offset), size), identity=identity)
        _check_points(header)
        if tables and header.compressed and (header.count or any(record.key == _LASZIP for record in header.vlrs)):
            header = dataclasses.replace(header, unread=_check_chunk_table(header, file))
        start, count = struct.unpack_from("<QI", block, 235) if minor >= 4 else (0, 0)
        if count:
            end = len(header.head) if header.compressed else header.points_end
            _refuse(path, start < end, f"extended records begin at byte {start}, before the end of the points ({end})")
            announced = f"the header announces {count} extended records from byte {start}, and has {size} bytes"
            _refuse(path, count * _EVLR + start > size, announced)
            evlrs = _records(path, file, start, count, size, "<16sHQ", "extended record")
            header = dataclasses.replace(header, evlrs=evlrs, evlr_start=start)
    if header.extra_dimensions() is None:
        warn(f"{path}: the description of its extra bytes is damaged; they are kept as they are")
    return header


def _refuse(path: Place, wrong: object, fault: str) -> None:
    if wrong:
        raise InputError(f"{path}: {fault}; the file is damaged or truncated")


def _parse(path: Place, head: bytes, file_size: int) -> Header:
    start, _, count = struct.unpack_from("<HII", head, 94)
    vlrs = _records(path, io.BytesIO(head), start, count, len(head), "<16sHH", "variable length record")
    return Header(path, head, file_size, vlrs)


def _records(
    path: Place, file: BinaryIO, start: int, count: int, end: int, layout: str, kind: str
) -> tuple[Record, ...]:
    """So many records of a kind from ``start`` on, which end before ``end``."""
    found, own = [], 2 + struct.calcsize(layout) + 32
    for i in range(count):
        file.seek(start)
        block = file.read(own)
        user, number, length = struct.unpack_from(layout, block.ljust(own, b"\0"), 2)
        record = Record((_text(user), number), start, start + own, start + own + length)
        named = f"{kind} {i + 1} of {count} {record.key}, {length} bytes long, ends behind byte {end}"
        _refuse(path, len(block) < own or record.end > end, named)
        found.append(record)
        start = record.end
    return tuple(found)


def _check_points(header: Header) -> None:
    path, number, length, count = header.path, header.point_format, header.record_length, header.count
    if number >= len(RECORD_LENGTHS):
        raise InputError(f"{path}: point format {number} is unknown; 0 to 10 are supported")
    short = f"point records of {length} bytes are too short for point format {number} ({RECORD_LENGTHS[number]} bytes)"
    _refuse(path, length < RECORD_LENGTHS[number], short)
    check_scales(header.scales, header.offsets, str(path))
    held = count if header.compressed else (header.file_size - len(header.head)) // length
    _refuse(path, count > held, f"the header announces {count} points, but the file holds {held}")


def chunk_table(header: Header, file: BinaryIO) -> np.ndarray:
    """i64[3, k]: where the chunks of a LAZ file begin, their bytes, and their points: of chunks of a fixed size, that size."""
    compressor = lazrs.LazVlr(header.laszip)
    file.seek(len(header.head))
    points, sizes = np.array(lazrs.read_chunk_table(file, compressor), np.int64).reshape(-1, 2).T
    if not compressor.uses_variable_size_chunks():
        points = np.full_like(points, compressor.chunk_size())
    return np.stack([len(header.head) + 8 + np.cumsum(sizes) - sizes, sizes, points])


def _check_chunk_table(header: Header, file: BinaryIO) -> int:
    """Compare the LAZ chunk table with header and file length, before memory for the points is taken. Returns: number of
    points in the chunks beyond the count of the header, as far as it can be told: chunks of a fixed size do not say how full
    the last one is, unless they are layered."""
    path, laszip, length, number = header.path, header.laszip, header.record_length, header.point_format
    compressor, begin, file_size = lazrs.LazVlr(header.decoder), len(header.head) + 8, header.file_size
    described = f"the laszip record describes points of {compressor.item_size()} bytes, the header of {length}"
    _refuse(path, compressor.item_size() != length, described)
    items, method = _items(laszip), struct.unpack_from("<H", laszip)[0]
    known = _items(laszip_record(number, length - RECORD_LENGTHS[number]))
    versions = {kind: (1, 2) if kind == _WAVES else (2,) if kind < _POINT14 else (3, 4) for kind, _, _ in known}
    same = [item[:2] for item in items] == [item[:2] for item in known]
    same = same and all(version in versions[kind] for kind, _, version in items)
    other = not same or method == (_LAYERED if number < 6 else _CHUNKED)
    _refuse(path, other, f"the laszip record describes other points than point format {number}")
    if method not in (_CHUNKED, _LAYERED):
        raise InputError(f"{path}: LAZ without chunks (before LASzip 2.0) is not supported; compress the file anew")
    announced = f"the header announces {header.count} points"
    _refuse(path, header.count > _POINTS_PER_BYTE * file_size, f"{announced}, too many for {file_size} bytes")
    file.seek(begin - 8)
    start = int.from_bytes(file.read(8), "little", signed=True)
    if start == -1:  # written by a compressor that could not seek
        file.seek(-8, 2)
        start = int.from_bytes(file.read(8), "little", signed=True)
    inside = begin <= start <= file_size - 8
    if not inside and not header.count:  # some writers leave out the table where there is nothing in it
        return 0
    _refuse(path, not inside, f"the table of compressed chunks (byte {start}) is not in the file")
    file.seek(start)
    chunks = struct.unpack("<II", file.read(8))[1]  # each begins with one uncompressed point
    _refuse(path, chunks * length > file_size, f"{chunks} compressed chunks cannot fit into {file_size} bytes")
    varying, (_, sizes, held) = compressor.uses_variable_size_chunks(), (table := chunk_table(header, file))
    most = least = int(held.sum())
    # the last chunk holds anything from one point on, if it is more than the end of a stream
    if not varying and len(sizes):
        least += int(sizes[-1] >= length) - int(held[-1])
    _refuse(path, begin + sizes.sum() != start, "the compressed chunks do not end where their table begins")
    largest, memory = min(header.count, int(held.max(initial=0))), psutil.virtual_memory().total
    if largest * length > memory:
        raise InputError(
            f"{path}: a compressed chunk of {largest} points does not fit into the memory of this machine ({memory} bytes); "
            "the file is damaged, or has to be compressed anew in smaller chunks"
        )
    if header.count <= most:
        counts = _check_chunks(header, file, table)
        if counts is not None:
            full = len(held) - (not varying)
            other = (counts[:full] != held[:full]).any() or (counts[full:] > held[full:]).any()
            _refuse(path, other, "the compressed chunks hold other numbers of points than their table says")
            most = least = int(counts.sum())
    other = header.count > most or (header.is_copc and header.count != most)
    _refuse(path, other, f"{announced}, but the compressed chunks hold {'' if most == least else 'at most '}{most}")
    return max(0, least - header.count)


def _check_chunks(header: Header, file: BinaryIO, table: np.ndarray) -> np.ndarray | None:
    """Refuse chunks of the wrong length: decoders would read other points from them, and not notice.

    Of formats 6 to 10, a chunk is a first point, the number of points, the sizes of its layers, then the layers, which fill
    it; without points it may have no bytes at all. Of files on a disk more is looked at: what an encoder writes, a layer or a
    chunk of formats 0 to 5, ends in two zero bytes.

    Returns: points of each chunk of formats 6 to 10, i64[k].
    """
    path, local, counts = header.path, not isinstance(header.path, Remote), None
    there = np.flatnonzero(table[1])
    start, size, _ = table[:, there]
    wrong = np.zeros(len(there), bool)
    if header.point_format < 6 and local and len(there):
        wrong = _wrong_chunks(header, file, table[:, there])
    elif header.point_format >= 6:
        items = _items(header.laszip)
        layers = sum(width if kind == 14 else {_POINT14: 9, 12: 2}.get(kind, 1) for kind, width, _ in items)
        first, counts = header.record_length + 4 + 4 * layers, np.zeros(table.shape[1], np.int64)
        wrong = size < first
        if not wrong.any():
            stated = read_ranges(path, file, start + header.record_length, np.full_like(start, 4 + 4 * layers))
            stated = stated.view("<u4").reshape(-1, 1 + layers).astype(np.int64)
            counts[there], lengths = stated[:, 0], stated[:, 1:]
            wrong = first + lengths.sum(axis=1) != size
            if local and not wrong.any():
                ends, of = (start + first - 2)[:, None] + np.cumsum(lengths, axis=1), np.nonzero(lengths)[0]
                wrong[of[_unended(path, file, ends[lengths > 0])]] = True
    number = int(there[wrong.argmax()]) + 1 if wrong.any() else 0
    _refuse(path, number, f"compressed chunk {number} of {table.shape[1]} is not as long as its table says")
    return counts


def _unended(path: Place, file: BinaryIO, starts: np.ndarray) -> np.ndarray:
    """bool[k]: which pairs of bytes are not zero."""
    return read_ranges(path, file, starts, np.full_like(starts, 2)).view("<u2") != 0


def _wrong_chunks(header: Header, file: BinaryIO, table: np.ndarray) -> np.ndarray:
    """bool[k]: the chunks of formats 0 to 5 that are not as long as stated. The first is decoded, and each before one whose
    first point lies outside the extent: its points need all its bytes."""
    path, (start, size, held) = header.path, table
    wrong = _unended(path, file, np.maximum(0, start + size - 2))
    if len(start) < 2 or wrong.any():
        return wrong
    ticks = read_ranges(path, file, start[1:], np.full_like(start[1:], 12)).view("<i4").reshape(-1, 3)
    with np.errstate(all="ignore"):  # headers may state any extent
        low, high = (np.rint((edge - header.offsets) / header.scales) for edge in header.extent)
    odd = np.flatnonzero(((ticks < low - 1) | (ticks > high + 1)).any(axis=1))
    need_threads()
    for i in np.union1d(odd, 0).tolist():
        most, points = int(size[i]) - 1, np.empty(int(held[i]) * header.record_length, np.uint8)
        packed = read_ranges(path, file, start[i : i + 1], size[i : i + 1] - 1)
        everything = lazrs.DecompressionSelection(lazrs.SELECTIVE_DECOMPRESS_ALL)
        with contextlib.suppress(lazrs.LazrsError):  # as it has to be: the last point needs the last byte
            lazrs.decompress_points_with_chunk_table(packed, header.laszip, points, [(int(held[i]), most)], everything)
            wrong[i] = True
    return wrong


def _items(record: bytes) -> list[tuple[int, int, int]]:
    """Kind, bytes and version of the parts of a point that a laszip record lists."""
    return list(struct.iter_unpack("<3H", record[_ITEMS:]))


def laszip_record(point_format: int, extra: int, variable: bool = False) -> bytes:
    """What LAZ of new files states of itself; ``extra``: bytes of a point beyond those of its format; ``variable``: chunks
    differ in their number of points."""
    data = bytearray(lazrs.LazVlr.new_for_compression(point_format, extra, variable).record_data())
    for at in range(_ITEMS, len(data), _ITEM):
        if struct.unpack_from("<H", data, at)[0] == _WAVES:  # the same bytes, of which LASzip knows version 1 only
            struct.pack_into("<H", data, at + 4, 1)
    return bytes(data)


def vlr(user: str, number: int, payload: bytes, description: str = "") -> bytes:
    """A variable length record in bytes."""
    return struct.pack("<H16sHH32s", 0, user.encode(), number, len(payload), description.encode()) + payload


def new_header(
    path: Place, scales: np.ndarray, offsets: np.ndarray, wkt: str | None, created: tuple[int, int]
) -> Header:
    """A header of LAS 1.4, point format 6, without points yet; ``created`` is day of the year and year."""
    record = b"" if wkt is None else vlr(PROJECTION, WKT, wkt.encode() + b"\0", "OGC WKT")
    block = bytearray(HEADER_LENGTHS[4])
    struct.pack_into("<4sHH", block, 0, b"LASF", 0, 1 | 16)  # global encoding: adjusted GPS time, CRS as WKT
    struct.pack_into("<BB32s32sHH", block, 24, 1, 4, b"OTHER", b"jaxfilter", *created)
    struct.pack_into("<HIIBH", block, 94, len(block), len(block) + len(record), bool(record), 6, RECORD_LENGTHS[6])
    struct.pack_into("<6d", block, 131, *scales, *offsets)
    return _parse(path, bytes(block) + record, len(block) + len(record))


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("latin-1")
