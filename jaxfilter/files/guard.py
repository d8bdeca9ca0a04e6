"""A LAS file is held against its own bytes before laspy reads it: header, sizes, counts, records, compressed chunks.

laspy and its decoder believe what a header says. They take memory for points that are not there, read other points than were
written, or end the process. So no number is believed before the length of the file bounds it, and whatever the decoder still
raises becomes an error that names the file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

import laspy
import lazrs
import numpy as np
import psutil

from ..core.errors import InputError, JaxfilterError, warn
from ..core.frame import check_scales
from ..core.process import need_threads
from .disk import Identity
from .header import HEADER_LENGTHS, LASZIP, RECORD_LENGTHS, Header, Record, text_of
from .storage import Place, Remote

_VLR, _EVLR = "<16sHH", "<16sHQ"  # user, number and length of a record, behind two bytes and before 32
_CHUNKED, _LAYERED = 2, 3  # methods of LASzip
_ITEMS, _ITEM = 34, 6  # where a laszip record lists the parts of a point, and bytes for each
_WAVES, _POINT14 = 9, 10  # kinds of parts: wave packets of formats 4 and 5; the first of those that are layered
_POINTS_PER_BYTE = 1000  # more than LAZ reaches for points that are all equal

_FAULTS: tuple[tuple[Any, str], ...] = (
    (FileNotFoundError, "no such file"),
    (IsADirectoryError, "is a folder: name one of its files, or open all of them by jaxfilter.open"),
    (OSError, "cannot be read: {}"),
    (MemoryError, "its points need more memory than there is ({}); read a part of it by bounds, or run it in tiles"),
    ((ValueError, IndexError, OverflowError, RecursionError, struct.error), "cannot be decoded: {}"),
    ((lazrs.LazrsError, laspy.LaspyException), "the points are damaged or truncated: {}"),
)


@contextlib.contextmanager
def reading_errors(path: Place) -> Iterator[None]:
    """Turn whatever the decoders raise on a bad file into an InputError that names it."""
    try:
        yield
    except JaxfilterError:
        raise
    except BaseException as error:
        words = next((words for kinds, words in _FAULTS if isinstance(error, kinds)), None)
        if type(error).__name__ == "PanicException":  # how the LAZ decoder reports some damage; not an Exception
            words = "the compressed points are damaged: {}"
        if words is None:
            raise
        raise InputError(f"{path}: {words.format(getattr(error, 'strerror', None) or error)}") from error


def read_header(path: Place, file: BinaryIO, identity: Identity) -> Header:
    """Read and check what precedes the points, and where extended records lie.

    Raises: InputError naming the file and the field: not LAS, unknown version or point format, sizes, record counts or
    point counts that the file cannot hold, scales that are not positive numbers.
    """
    size = identity.size
    block = file.read(HEADER_LENGTHS[-1])
    if not size:
        raise InputError(f"{path}: the file is empty (0 bytes)")
    if block[:4] != b"LASF":
        raise InputError(f"{path}: not a LAS file: it begins with {block[:4]!r} instead of b'LASF'")
    _refuse(path, len(block) < HEADER_LENGTHS[0], f"{len(block)} bytes are too few for a LAS header")
    major, minor = block[24], block[25]
    if major != 1 or minor >= len(HEADER_LENGTHS):
        raise InputError(f"{path}: LAS version {major}.{minor} is not supported; 1.0 to 1.5 are")
    own, offset, records = struct.unpack_from("<HII", block, 94)
    least = HEADER_LENGTHS[2 if minor == 3 and (block[104] & 0x3F) < 4 else minor]  # LAS 1.3 with the header of 1.2
    _refuse(path, not least <= own <= size, f"header size {own} is impossible in {size} bytes")
    _refuse(path, not own <= offset <= size, f"offset to point data {offset} is not in the file ({size} bytes)")
    announced = f"the header announces {records} variable length records, and has {offset - own} bytes for them"
    _refuse(path, records * 54 > offset - own, announced)
    file.seek(0)
    head = file.read(offset)
    vlrs = _records(path, io.BytesIO(head), own, records, offset, _VLR, "variable length record")
    header = Header(path, head, identity, vlrs)
    number, length, count = header.point_format, header.record_length, header.count
    if number >= len(RECORD_LENGTHS):
        raise InputError(f"{path}: point format {number} is unknown; 0 to 10 are supported")
    short = f"point records of {length} bytes are too short for point format {number} ({RECORD_LENGTHS[number]} bytes)"
    _refuse(path, length < RECORD_LENGTHS[number], short)
    check_scales(header.scales, header.offsets, str(path))
    held = _POINTS_PER_BYTE * size if header.compressed else (size - offset) // length
    _refuse(path, count > held, f"the header announces {count} points, but the file holds {held}")
    start, count = struct.unpack_from("<QI", block, 235) if minor >= 4 else (0, 0)
    if count:
        end = offset if header.compressed else header.points_end
        _refuse(path, start < end, f"extended records begin at byte {start}, before the end of the points ({end})")
        announced = f"the header announces {count} extended records from byte {start}, and has {size} bytes"
        _refuse(path, count * 60 + start > size, announced)
        evlrs = _records(path, file, start, count, size, _EVLR, "extended record")
        header = dataclasses.replace(header, evlrs=evlrs)
    if header.extra_dimensions() is None:
        warn(f"{path}: the description of its extra bytes is damaged; they are kept as they are")
    return header


def _refuse(path: Place, wrong: object, fault: str) -> None:
    if wrong:
        raise InputError(f"{path}: {fault}; the file is damaged or truncated")


def _records(
    path: Place, file: BinaryIO, start: int, count: int, end: int, layout: str, kind: str
) -> tuple[Record, ...]:
    """So many records of a kind from ``start`` on, which end before ``end``."""
    found, own = [], 2 + struct.calcsize(layout) + 32
    for i in range(count):
        file.seek(start)
        block = file.read(own)
        user, number, length = struct.unpack_from(layout, block.ljust(own, b"\0"), 2)
        record = Record((text_of(user), number), start, start + own, start + own + length)
        named = f"{kind} {i + 1} of {count} {record.key}, {length} bytes long, ends behind byte {end}"
        _refuse(path, len(block) < own or record.end > end, named)
        found.append(record)
        start = record.end
    return tuple(found)


def chunk_table(header: Header, file: BinaryIO) -> np.ndarray:
    """i64[3, k]: where the chunks of a LAZ file begin, their bytes, and their points: of chunks of a fixed size, that size."""
    compressor = lazrs.LazVlr(header.laszip)
    file.seek(len(header.head))
    file.read(1)  # lazrs does not say why a store fails
    file.seek(len(header.head))
    points, sizes = np.array(lazrs.read_chunk_table(file, compressor), np.int64).reshape(-1, 2).T
    if not compressor.uses_variable_size_chunks():
        points = np.full_like(points, compressor.chunk_size())
    return np.stack([len(header.head) + 8 + np.cumsum(sizes) - sizes, sizes, points])


def check_chunks(header: Header, file: BinaryIO) -> int:
    """Compare the LAZ chunk table with header and file length, before memory for the points is taken. Returns: number of
    points in the chunks beyond the count of the header, as far as it can be told: chunks of a fixed size do not say how full
    the last one is, unless they are layered. Raises: InputError."""
    if not header.compressed or not (header.count or any(record.key == LASZIP for record in header.vlrs)):
        return 0
    path, length, begin, file_size = header.path, header.record_length, len(header.head) + 8, header.identity.size
    _check_items(header)
    compressor = lazrs.LazVlr(header.laszip)
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
    if not varying and len(sizes):
        # the last one holds anything from one point on, if it is more than the end of a stream
        least += int(sizes[-1] >= length) - int(held[-1])
    _refuse(path, begin + sizes.sum() != start, "the compressed chunks do not end where their table begins")
    largest, memory = min(header.count, int(held.max(initial=0))), psutil.virtual_memory().total
    if largest * length > memory:
        raise InputError(
            f"{path}: a compressed chunk of {largest} points does not fit into the memory of this machine ({memory} bytes); "
            "the file is damaged, or has to be compressed anew in smaller chunks"
        )
    if header.count <= most and not isinstance(path, Remote):  # there each chunk would be a request of its own
        counts = _check_sizes(header, file, table)
        if counts is not None:
            full = len(held) - (not varying)
            other = (counts[:full] != held[:full]).any() or (counts[full:] > held[full:]).any()
            _refuse(path, other, "the compressed chunks hold other numbers of points than their table says")
            most = least = int(counts.sum())
    words = f"but the compressed chunks hold {'' if most == least else 'at most '}{most}"
    other = header.count > most or (header.is_copc and header.count != most)
    _refuse(path, other, f"the header announces {header.count} points, {words}")
    return max(0, least - header.count)


def _check_items(header: Header) -> None:
    """Raises: InputError for a laszip record of other points than those of the header, and for LAZ that laspy cannot read."""
    path, laszip, number, length = header.path, header.laszip, header.point_format, header.record_length
    method = struct.unpack_from("<H", laszip)[0]
    if method not in (_CHUNKED, _LAYERED):
        raise InputError(
            f"{path}: LAZ without chunks (of LASzip 1, before 2011) cannot be read: compress the file anew, such as with laszip "
            "or laszip64 of LAStools"
        )
    items = [(kind, size, 1 if (kind, version) == (_WAVES, 2) else version) for kind, size, version in items_of(laszip)]
    known = list(items_of(laszip_record(number, length - RECORD_LENGTHS[number])))
    if items != known == [(kind, size, 3 if version == 4 else version) for kind, size, version in items]:
        raise InputError(
            f"{path}: LAZ whose items have version 4 (LASzip of 2026) cannot be read yet: compress the file anew with an older "
            "LASzip, or as LAS"
        )
    other = items != known or method != (_CHUNKED if number < 6 else _LAYERED)
    _refuse(path, other, f"the laszip record describes other points than point format {number} of {length} bytes")


def _check_sizes(header: Header, file: BinaryIO, table: np.ndarray) -> np.ndarray | None:
    """Refuse chunks of the wrong length: decoders would read other points from them, and not notice.

    Of formats 6 to 10, a chunk is a first point, the number of points, the sizes of its layers, then the layers, which fill
    it; without points it may have no bytes at all. What an encoder writes, a layer or a chunk of formats 0 to 5, ends in two
    zero bytes.

    Returns: points of each chunk of formats 6 to 10, i64[k].
    """
    counts, there = None, np.flatnonzero(table[1])
    start, size, _ = table[:, there]
    wrong = np.zeros(len(there), bool)
    if header.point_format < 6 and len(there):
        wrong = _wrong_chunks(header, file, table[:, there])
    elif header.point_format >= 6:
        items = items_of(header.laszip)
        layers = sum(width if kind == 14 else {_POINT14: 9, 12: 2}.get(kind, 1) for kind, width, _ in items)
        first, counts = header.record_length + 4 + 4 * layers, np.zeros(table.shape[1], np.int64)
        wrong = size < first
        if not wrong.any():
            stated = pieces(header, file, start + header.record_length, 4 + 4 * layers).view("<u4").astype(np.int64)
            counts[there], lengths = stated[:, 0], stated[:, 1:]
            wrong = first + lengths.sum(axis=1) != size
            if not wrong.any():
                ends, chunk = (start + first - 2)[:, None] + np.cumsum(lengths, axis=1), np.nonzero(lengths)[0]
                wrong[chunk[pieces(header, file, ends[lengths > 0], 2).any(axis=1)]] = True
    number = int(there[wrong.argmax()]) + 1 if wrong.any() else 0
    _refuse(header.path, number, f"compressed chunk {number} of {table.shape[1]} is not as long as its table says")
    return counts


def pieces(header: Header, file: BinaryIO, starts: np.ndarray, size: int) -> np.ndarray:
    """u8[k, size]: bytes of the file from ``starts`` on, i64[k]. Raises: InputError if the file ends before."""
    found = np.empty((len(starts), size), np.uint8)
    for start, piece in zip(starts.tolist(), found, strict=True):
        file.seek(start)
        _refuse(header.path, file.readinto(piece.data) < size, "the file ends within its points")  # type: ignore[attr-defined]
    return found


def _wrong_chunks(header: Header, file: BinaryIO, table: np.ndarray) -> np.ndarray:
    """bool[k]: the chunks of formats 0 to 5 that are not as long as stated. The first is decoded, and each before one whose
    first point lies outside the extent: its points need all its bytes."""
    start, size, held = table
    wrong = np.asarray(pieces(header, file, np.maximum(0, start + size - 2), 2).any(axis=1))
    if len(start) < 2 or wrong.any():
        return wrong
    ticks = pieces(header, file, start[1:], 12).view("<i4")
    with np.errstate(all="ignore"):  # headers may state any extent
        low, high = (np.rint((edge - header.offsets) / header.scales) for edge in header.extent)
    odd = np.flatnonzero(((ticks < low - 1) | (ticks > high + 1)).any(axis=1))
    need_threads()
    for i in np.union1d(odd, 0).tolist():
        most, points = int(size[i]) - 1, np.empty(int(held[i]) * header.record_length, np.uint8)
        packed = pieces(header, file, start[i : i + 1], most)[0]
        everything = lazrs.DecompressionSelection(lazrs.SELECTIVE_DECOMPRESS_ALL)
        with contextlib.suppress(lazrs.LazrsError):  # as it has to be: the last point needs the last byte
            lazrs.decompress_points_with_chunk_table(packed, header.laszip, points, [(int(held[i]), most)], everything)
            wrong[i] = True
    return wrong


def items_of(laszip: bytes) -> Iterator[tuple[Any, ...]]:
    """Kind, bytes and version of the parts of a point that a laszip record lists."""
    end = _ITEMS + _ITEM * struct.unpack_from("<H", laszip, _ITEMS - 2)[0]
    return struct.iter_unpack("<3H", laszip[_ITEMS:end] if end <= len(laszip) else b"")


def laszip_record(point_format: int, extra: int, variable: bool = False) -> bytes:
    """What LAZ of new files states of itself; ``extra``: bytes of a point beyond those of its format; ``variable``: chunks
    differ in their number of points."""
    data = bytearray(lazrs.LazVlr.new_for_compression(point_format, extra, variable).record_data())
    for at in range(_ITEMS, len(data), _ITEM):
        if struct.unpack_from("<H", data, at)[0] == _WAVES:  # the same bytes, of which LASzip knows version 1 only
            struct.pack_into("<H", data, at + 4, 1)
    return bytes(data)
