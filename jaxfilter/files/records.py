"""Point records as bytes: read in chunks, looked into, changed and written again, compressed or not."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO

import lazrs
import numpy as np

from ..core.echoes import sample
from ..core.errors import InputError, JaxfilterError
from ..core.inputs import COLUMNS
from ..core.process import need_threads
from .blocks import NEEDED, SAMPLED, Blocks, nodes, read_blocks, read_packed, runs, sound
from .disk import Bounds
from .header import Header
from .storage import Place

CHUNK = 1_000_000
"""Points that are held at a time. LAZ is written in pieces of this size as well."""
_SAME = 1e-5
"""Units, to which coordinates are rounded before they are compared."""

_FAULTS: tuple[tuple[Any, str], ...] = (
    (FileNotFoundError, "no such file"),
    (IsADirectoryError, "is a folder: name one of its files, or open all of them by jaxfilter.open"),
    (OSError, "cannot be read: {}"),
    (MemoryError, "its points need more memory than there is ({}); read a part of it by bounds, or run it in tiles"),
    ((ValueError, IndexError, OverflowError, RecursionError, struct.error), "cannot be decoded: {}"),
    (lazrs.LazrsError, "the compressed points are damaged or truncated: {}"),
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


def read_records(
    header: Header, bounds: Bounds | None = None, every_field: bool = True, blocks: Blocks | None = None
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The point records, u8[k, record_length] with k about a million, in file order, and their numbers in the file, i64[k]; only
    those inside ``bounds`` if given.

    Args:
        every_field: otherwise fields other than coordinates, echoes, class and flags may be zero, which is faster for LAZ.
        blocks: the runs of the file, where their areas are known: only those that may hold some are read. Those that have a
            checksum must still have it. By default the nodes of the octree of COPC with bounds, and else all runs.

    Raises: InputError if the points are damaged.
    """
    wanted = lazrs.SELECTIVE_DECOMPRESS_ALL if every_field else NEEDED
    waiting, again = [], None  # the cubes of an octree are believed when all points read agree with them
    with reading_errors(header.path), header.open() as file:
        if blocks is None:
            blocks = nodes(header, file) if header.is_copc and bounds is not None else runs(header, file)
        for group in (blocks if bounds is None else blocks.meeting(bounds)).groups(CHUNK):
            chunk, numbers = read_blocks(header, file, group, wanted), group.records()
            if bounds is None:
                yield chunk, numbers
                continue
            if header.is_copc and (again := sound(header, blocks, group, chunk)) is not None:
                break
            kept = inside(coordinates(chunk, header, 2), bounds)
            waiting.append((chunk[kept], numbers[kept]))
            if not header.is_copc:
                yield waiting.pop()
    yield from waiting if again is None else read_records(header, bounds, every_field, again)


def sampled_records(header: Header) -> np.ndarray:
    """u8[k, record_length]: the records of :func:`jaxfilter.core.echoes.sample`. Raises: InputError."""
    with reading_errors(header.path), header.open() as file:
        found = runs(header, file)
        points = np.zeros_like(found.points)  # from the beginning of each run
        for part in sample(header.count):
            at = slice(np.searchsorted(found.first, part.start, "right") - 1, np.searchsorted(found.first, part.stop))
            points[at] = np.minimum(found.points[at], part.stop - found.first[at])
        return read_blocks(header, file, dataclasses.replace(found, points=points)[points > 0], SAMPLED)


def times(records: np.ndarray, point_format: int) -> np.ndarray | None:
    """f64[n], GPS times; None where the point format has none."""
    at = 22 if point_format >= 6 else 20
    return None if point_format in (0, 2) else records[:, at : at + 8].copy().view("<f8")[:, 0]


def echo_keys(records: np.ndarray, header: Header) -> np.ndarray:
    """u64[n], a hash of X, Y, Z (to 0.01 mm of a unit in metres), GPS time, return number and point source of each point, whose
    scales and offsets do not count. Different echoes have one hash in a case of 2**64."""
    point_format = header.point_format
    time = times(records, point_format)
    at = 20 if point_format >= 6 else 18
    source = records[:, at : at + 2].copy().view("<u2")[:, 0]
    columns = list(np.rint(coordinates(records, header) / _SAME).astype(np.int64).T)
    columns += [] if time is None else [time.view(np.int64)]
    columns += [get(records, point_format, "return_number").astype(np.int64) << 16 | source]
    key = np.zeros(len(records), np.uint64)
    for column in columns:
        key = (key ^ column.view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(32)
    return key


def read_chunks(header: Header, blocks: Blocks, packed: np.ndarray) -> Iterator[np.ndarray]:
    """Runs of records, one after the other: where ``packed``, bool[k], their bytes in the file, u8[size], and else the records,
    u8[points, record_length]. Raises: InputError if they are damaged or others than before."""
    with reading_errors(header.path), header.open() as file:
        for number, whole in enumerate(packed.tolist()):
            one = blocks[number : number + 1]
            yield read_packed(header, file, one) if whole else read_blocks(header, file, one)


def inside(xy: np.ndarray, bounds: Bounds) -> np.ndarray:
    """bool[n]: which f64[n, >=2] lie in the half-open ``bounds``."""
    x, y = xy[:, 0], xy[:, 1]
    return (x >= bounds[0]) & (x < bounds[2]) & (y >= bounds[1]) & (y < bounds[3])


def integers(records: np.ndarray) -> np.ndarray:
    """i32[n, 3] view of X, Y, Z."""
    return records[:, :12].view("<i4")


def coordinates(records: np.ndarray, header: Header, axes: int = 3) -> np.ndarray:
    """f64[n, axes], file units."""
    return integers(records)[:, :axes] * header.scales[:axes] + header.offsets[:axes]


_FIELDS: tuple[dict[str, tuple[int, int, int]], ...] = (
    {"return_number": (14, 0, 7), "number_of_returns": (14, 3, 7), "classification": (15, 0, 31), "withheld": (15, 7, 1)},
    {"return_number": (14, 0, 15), "number_of_returns": (14, 4, 15), "classification": (16, 0, 255),
     "withheld": (15, 2, 1), "overlap": (15, 3, 1), "channel": (15, 4, 3)},
)  # fmt: skip
"""Byte of a record, first bit and mask of fields, in point formats 0 to 5 and 6 to 10."""


def get(records: np.ndarray, point_format: int, name: str) -> np.ndarray:
    """u8[n], a field of the points."""
    byte, bit, mask = _FIELDS[point_format >= 6][name]
    return (records[:, byte] >> bit) & mask


def put(records: np.ndarray, point_format: int, name: str, values: np.ndarray | int) -> None:
    """Put in new values of a field, u8[n] or one for all; fields that share its byte stay."""
    byte, bit, mask = _FIELDS[point_format >= 6][name]
    records[:, byte] &= 0xFF ^ (mask << bit)
    records[:, byte] |= (np.asarray(values, np.uint8) & mask) << bit


def attributes(records: np.ndarray, point_format: int) -> dict[str, np.ndarray]:
    """The columns of a cloud, u8[n] each, as far as the point format has them."""
    return {name: get(records, point_format, name) for name in COLUMNS if name in _FIELDS[point_format >= 6]}


class _Recording:
    """A file that keeps what was raised when the LAZ encoder used it, of which the encoder passes on only a few words."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.error: BaseException | None = None

    def __getattr__(self, name: str) -> Any:
        method = getattr(self.file, name)

        def call(*arguments: Any) -> Any:
            try:
                return method(*arguments)
            except BaseException as error:  # a full disk, or a signal
                self.error = error
                raise

        return call

    @contextlib.contextmanager
    def heard(self) -> Iterator[None]:
        """A block that encodes: raises what the file raised."""
        try:
            yield
        except lazrs.LazrsError as error:
            raise self.error or OSError(str(error)) from error


def in_one_chunk(records: np.ndarray, laszip: bytes) -> bytes:
    """A chunk of LAZ of u8[k, record_length], no more than the record ``laszip`` says that a chunk has."""
    points = np.ascontiguousarray(records).reshape(-1)
    packed = bytes(lazrs.compress_points(lazrs.LazVlr(laszip), points, parallel=False))
    return packed[8 : int.from_bytes(packed[:8], "little")]  # before the table


class Writer:
    """Writes a header, then point records in chunks, then the tail of a source file.

    Args:
        file: binary, empty.
        header: as the output shall have it, see ``Header.rewritten``.
        recount: bring the counts and the extent in the header up to date with what was written; otherwise they stay.
        rescale: bring the extent of Z up to date in any case.
        chunks: the points of LAZ are written to ``file`` by others, in whole chunks.
    """

    def __init__(
        self, file: BinaryIO, header: Header, recount: bool, rescale: bool = False, chunks: bool = False
    ) -> None:
        self.file, self.header, self.recount, self.rescale = file, header, recount, rescale
        self.head = bytearray(header.head)
        self.count, self.by_return = 0, np.zeros(16, np.int64)
        self.low, self.high = np.full(3, 2**31, np.int64), np.full(3, -(2**31), np.int64)
        file.write(header.head)
        self.encoded = _Recording(file)
        self.encoder = None
        if header.compressed and not chunks:
            need_threads()
            with self.encoded.heard():
                self.encoder = lazrs.ParLasZipCompressor(self.encoded, lazrs.LazVlr(header.laszip))

    def write(self, records: np.ndarray) -> None:
        """Append u8[k, record_length]."""
        records = np.ascontiguousarray(records)
        if not len(records):
            return
        self.count += len(records)
        if self.recount:
            self.by_return += np.bincount(get(records, self.header.point_format, "return_number"), minlength=16)
        if self.recount or self.rescale:
            ticks = integers(records)
            self.low, self.high = np.minimum(self.low, ticks.min(axis=0)), np.maximum(self.high, ticks.max(axis=0))
        if self.encoder is not None:
            with self.encoded.heard():
                self.encoder.compress_many(records.reshape(-1))
        else:
            self.file.write(records.data)

    def finish(self, source: Header | None = None) -> None:
        """Complete the points, append the tail of ``source`` without an octree, patch the header."""
        if self.encoder is not None:
            with self.encoded.heard():
                self.encoder.done()
        self.file.seek(0, 2)
        if source is not None:
            self._copy_tail(source)
        if self.recount:
            self._recount()
        if self.count and (self.recount or self.rescale):
            scales, offsets = self.header.scales, self.header.offsets
            extent = np.stack([self.high, self.low], axis=1) * scales[:, None] + offsets[:, None]
            renewed = extent[0 if self.recount else 2 :].reshape(-1)
            struct.pack_into(f"<{len(renewed)}d", self.head, 227 - 8 * len(renewed), *renewed)
        self.file.seek(0)
        self.file.write(self.head)

    def _copy_tail(self, source: Header) -> None:
        at, kept = self.file.tell(), source.without_octree(source.evlrs)
        with source.open() as file:
            if len(kept) == len(source.evlrs):
                file.seek(source.tail)
                shutil.copyfileobj(file, self.file, 2**20)
                shift = at - source.tail
                for field, start in ((227, source.waveform_start), (235, source.evlr_start)):
                    if source.tail <= start <= source.file_size and start:
                        struct.pack_into("<Q", self.head, field, start + shift)
            else:
                struct.pack_into("<QI", self.head, 235, at if kept else 0, len(kept))
                for record in kept:
                    file.seek(record.start)
                    self.file.write(file.read(record.end - record.start))

    def _recount(self) -> None:
        header = self.header
        if header.minor >= 4:
            struct.pack_into("<16Q", self.head, 247, self.count, *self.by_return[1:])
        old = header.minor < 4 or header.point_format < 6  # point formats from 6 have no legacy counts in LAS 1.4
        legacy = [self.count, *self.by_return[1:6]] if old and self.count < 2**32 else [0] * 6
        struct.pack_into("<6I", self.head, 107, *(int(v) for v in legacy))
        struct.pack_into("<6d", self.head, 179, *[0.0] * 6)  # of no points
