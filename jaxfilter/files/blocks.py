"""Runs of point records that can be read alone, and the area that each covers: how to get at a part of a file.

The runs are the chunks of LAZ, the nodes of COPC, and :data:`RUN` records of LAS. What area the points of a run of LAS or LAZ
cover is found by one pass over the file, see :func:`measured`, and can be kept. The octree of COPC says it (Hobu Inc., COPC
specification 1.0: info record of 160 bytes, hierarchy pages of 32-byte entries).
"""

from __future__ import annotations

import dataclasses
import struct
import threading
import zlib
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import lazrs
import numpy as np

from ..core.errors import InputError, warn
from ..core.process import need_threads
from .disk import Bounds, new_file
from .header import Header, chunk_table
from .storage import Remote, read_ranges

RUN = 16384
"""Records of LAS in a run."""
_MOST = 48_000_000
"""Bytes of chunks that a process keeps as they were decoded: small windows beside one another are in the same chunks."""

NEEDED = (  # what LAZ decompresses of point formats 6 to 10 when only the cloud is wanted
    lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
    | lazrs.SELECTIVE_DECOMPRESS_Z
    | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
    | lazrs.SELECTIVE_DECOMPRESS_FLAGS
)
SAMPLED = NEEDED | lazrs.SELECTIVE_DECOMPRESS_GPS_TIME

ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")])
"""Level, x, y, z of a node; where its chunk is; number of points, -1: the entry is of another page."""


class Changed(InputError):
    """Points are not those that were read before."""


@dataclasses.dataclass(frozen=True)
class Blocks:
    """k runs of records of a file, in file order.

    Attributes:
        start, size: i64[k], bytes: where a run begins in the file, and how long it is there.
        first, points: i64[k]: number of its first record in the file, counted from 0, and how many it has.
        low, high: f64[k, 2], file coordinates: all points of a run lie in low <= (x, y) <= high.
        checksum: i64[k], CRC-32 of the bytes of a run in the file, which must still have it when they are read; -1 = unknown.
    """

    start: np.ndarray
    size: np.ndarray
    first: np.ndarray
    points: np.ndarray
    low: np.ndarray
    high: np.ndarray
    checksum: np.ndarray

    def __len__(self) -> int:
        return len(self.start)

    def __getitem__(self, rows: slice | np.ndarray) -> Blocks:
        return Blocks(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))

    def meeting(self, box: Bounds) -> Blocks:
        """Those that may hold points inside a half-open box."""
        low, high = self.low, self.high
        return self[(low[:, 0] < box[2]) & (high[:, 0] >= box[0]) & (low[:, 1] < box[3]) & (high[:, 1] >= box[1])]

    def records(self) -> np.ndarray:
        """i64[n]: the numbers of the records, run after run."""
        ends = np.cumsum(self.points)
        return np.arange(ends[-1] if len(ends) else 0) + np.repeat(self.first - ends + self.points, self.points)

    def groups(self, most: int = 1_000_000) -> Iterator[Blocks]:
        """Runs in succession, about a million points at a time."""
        start = 0
        ends = np.cumsum(self.points)
        while start < len(self):
            before = ends[start] - self.points[start]
            stop = max(start + 1, int(np.searchsorted(ends, before + most, side="right")))
            yield self[start:stop]
            start = stop

    def save(self, path: Path, fingerprint: str) -> None:
        """Keep them for the file that has this fingerprint. Raises OutputError."""
        columns = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        with new_file(path, overwrite=True) as part, open(part, "wb") as file:
            np.savez_compressed(file, fingerprint=np.array(fingerprint), **columns)

    @classmethod
    def load(cls, path: Path, fingerprint: str) -> Blocks | None:
        """What was kept for the file of this fingerprint; None if there is nothing, or nothing for this file."""
        try:
            with np.load(path) as kept:
                if kept["fingerprint"].item() == fingerprint:
                    return cls(*(kept[field.name] for field in dataclasses.fields(cls)))
        except Exception:  # damaged ones, for which NumPy, zipfile and zlib have many errors, are made anew
            pass
        return None


def runs(header: Header, file: BinaryIO) -> Blocks:
    """The runs of a LAS or LAZ file, whose areas are not known yet: they are infinite."""
    if header.count and header.compressed:
        start, size, points = chunk_table(header, file)
        points = np.diff(np.minimum(np.cumsum(points), header.count), prepend=0)
    else:
        first = np.arange(0, header.count, RUN)
        points = np.minimum(header.count - first, RUN)
        start, size = len(header.head) + first * header.record_length, points * header.record_length
    edge, first = np.full((len(points), 2), np.inf), np.cumsum(points) - points
    return Blocks(start, size, first, points, -edge, edge, np.full(len(points), -1))


def measured(header: Header) -> Blocks:
    """The runs of a file with checksums and with the areas that their points cover, which COPC states: reads all of it.
    Raises: InputError."""
    with header.open() as file:
        found = nodes(header, file) if header.is_copc else runs(header, file)
        found = found[found.points > 0]
        groups = [found[:0]]
        small = 2 * header.count * header.record_length <= _MOST  # what is decoded now is kept for windows of the file
        wanted = NEEDED if small else lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        for group in found.groups():
            packed = read_ranges(header.path, file, group.start, group.size)
            group = dataclasses.replace(group, checksum=_checksums(group, packed))
            if not header.is_copc:
                low, high = _areas(header, group, _KEPT.decoded(header, group, packed, wanted))
                group = dataclasses.replace(group, low=low, high=high)
            groups.append(group)
    columns = [[getattr(group, field.name) for group in groups] for field in dataclasses.fields(Blocks)]
    return Blocks(*map(np.concatenate, columns))


def read_blocks(
    header: Header, file: BinaryIO, blocks: Blocks, wanted: int = lazrs.SELECTIVE_DECOMPRESS_ALL
) -> np.ndarray:
    """The records of some runs, u8[n, record_length]; ``wanted`` are the parts of LAZ to decompress. Raises: InputError if
    they are damaged, Changed if they are not those whose checksums are known."""
    return _KEPT.decoded(header, blocks, read_packed(header, file, blocks), wanted)


class _Kept:
    """The chunks that a process has decoded last, known by their place and checksum."""

    def __init__(self) -> None:
        self._chunks: OrderedDict[tuple[Any, ...], np.ndarray] = OrderedDict()
        self._lock = threading.Lock()

    def decoded(self, header: Header, blocks: Blocks, packed: np.ndarray, wanted: int) -> np.ndarray:
        """As :func:`_decoded`; out of what is kept, if there is little of it."""
        large = 2 * int(blocks.points.sum()) * header.record_length > _MOST
        if large or not header.compressed or (blocks.checksum < 0).any():
            return _decoded(header, blocks, packed, wanted)
        columns = (blocks.start, blocks.size, blocks.points, blocks.checksum)
        keys = [(str(header.path), wanted, *key) for key in np.stack(columns, axis=1).tolist()]
        with self._lock:
            found = {key: self._chunks.pop(key) for key in keys if key in self._chunks}
        new = np.array([key not in found for key in keys])
        if new.any():
            some, ends = blocks[new], np.cumsum(blocks[new].points)
            records = _decoded(header, some, packed[np.repeat(new, blocks.size)], wanted)
            parts = (part.copy() for part in np.split(records, ends[:-1]))
            found |= {key: next(parts) for key, unknown in zip(keys, new.tolist(), strict=True) if unknown}
        with self._lock:
            self._chunks |= found
            size = sum(chunk.nbytes for chunk in self._chunks.values())
            while size > _MOST:
                size -= self._chunks.popitem(last=False)[1].nbytes
        return np.concatenate([found[key] for key in keys])


_KEPT = _Kept()


def read_packed(header: Header, file: BinaryIO, blocks: Blocks) -> np.ndarray:
    """The bytes of some runs, u8[bytes], as they are in the file. Raises: Changed as :func:`read_blocks`."""
    packed, known = read_ranges(header.path, file, blocks.start, blocks.size), blocks.checksum >= 0
    if known.any() and (_checksums(blocks, packed) != blocks.checksum)[known].any():
        raise Changed(
            f"{header.path}: the file has changed since its points were first read; open it again, and begin a run anew with "
            "overwrite=True"
        )
    return packed


def _checksums(blocks: Blocks, packed: np.ndarray) -> np.ndarray:
    """i64[k]: of each run, from the bytes of all."""
    ends = np.cumsum(blocks.size)
    sums = [zlib.crc32(packed[start:end].data) for start, end in zip(ends - blocks.size, ends, strict=True)]
    return np.array(sums, np.int64)


def _decoded(header: Header, blocks: Blocks, packed: np.ndarray, wanted: int) -> np.ndarray:
    """The records of some runs, u8[n, record_length], from their bytes."""
    if not header.compressed:
        return packed.reshape(-1, header.record_length)
    records = np.zeros((int(blocks.points.sum()), header.record_length), np.uint8)
    need_threads()
    table = list(zip(blocks.points.tolist(), blocks.size.tolist(), strict=True))
    selection = lazrs.DecompressionSelection(wanted)
    lazrs.decompress_points_with_chunk_table(packed, header.decoder, records.reshape(-1), table, selection)
    return records


def _areas(header: Header, blocks: Blocks, records: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[k, 2] each, file coordinates: lowest and highest x and y of the points of each run."""
    ticks, at = records[:, :8].view("<i4"), np.cumsum(blocks.points) - blocks.points
    scale, offset = header.scales[:2], header.offsets[:2]
    low, high = (bound.reduceat(ticks, at) * scale + offset for bound in (np.minimum, np.maximum))
    return low, high


def nodes(header: Header, file: BinaryIO) -> Blocks:
    """The nodes with points, in file order, with the squares that their cubes cover.

    The whole octree is read. Of files on a disk it is compared with the table of chunks, and the first point of each
    chunk, which is not compressed, with the cube of its node: a damaged cube would lose points. If these do not agree, all
    nodes cover everything, with a warning.

    Raises: InputError if the octree is damaged.
    """
    at = header.vlrs[0].payload
    *centre, half, _, page, size = struct.unpack_from("<5d2Q", header.head.ljust(at + 160, b"\0"), at)
    entries = _entries(header, file, page, size)
    entries = np.sort(entries, order=("offset", "size", "points"))
    start, length, points = (entries[name].astype(np.int64) for name in ("offset", "size", "points"))
    _check_chunks(header, file, start, length, points)
    key = entries["key"]
    with np.errstate(over="ignore", invalid="ignore"):
        edge = 2 * half / 2.0 ** key[:, :1]
        low = np.array(centre) - half + key[:, 1:] * edge - header.scales  # cubes are rounded by some writers
        high = np.array(centre) - half + (key[:, 1:] + 1) * edge + header.scales
    found = Blocks(start, length, np.cumsum(points) - points, points, low[:, :2], high[:, :2], np.full(len(points), -1))
    if not isinstance(header.path, Remote):
        ticks = read_ranges(header.path, file, start, np.full_like(start, 12)).view("<i4")
        first = ticks.reshape(-1, 3) * header.scales + header.offsets
        if not ((first >= low) & (first <= high)).all():
            return _unknown(header, found)
    return found


def sound(header: Header, found: Blocks, group: Blocks, records: np.ndarray) -> Blocks | None:
    """None if the records of a group of nodes lie in their cubes; otherwise all nodes ``found``, to be read without a look
    at the cubes, with a warning: other nodes may hold points of anywhere, too."""
    low, high = _areas(header, group, records)
    return None if ((low >= group.low) & (high <= group.high)).all() else _unknown(header, found)


def _unknown(header: Header, found: Blocks) -> Blocks:
    warn(f"{header.path}: points lie outside the cubes of its octree, so all of it is read to find those within bounds")
    edge = np.full_like(found.low, np.inf)
    return dataclasses.replace(found, low=-edge, high=edge)


def _entries(header: Header, file: BinaryIO, page: int, size: int) -> np.ndarray:
    """The entries of all pages that are of nodes with points."""
    found, pages, seen = [np.zeros(0, ENTRY)], [(page, size)], set()
    while pages:
        page, size = pages.pop()
        if page in seen or size % ENTRY.itemsize or page + size > header.file_size:
            raise InputError(f"{header.path}: page of the octree at byte {page}, {size} bytes long, is damaged")
        seen.add(page)
        entries = read_ranges(header.path, file, np.array([page]), np.array([size])).view(ENTRY)
        level, points, length = entries["key"][:, 0], entries["points"], entries["size"]
        end = entries["offset"].astype(np.float64) + length
        if not ((level >= 0) & (level < 64) & (length >= 0) & (points >= -1) & (end <= header.file_size)).all():
            raise InputError(f"{header.path}: entry of the octree's page at byte {page} is damaged")
        pages += entries[points == -1][["offset", "size"]].tolist()
        found.append(entries[points > 0])
    return np.concatenate(found)


def _check_chunks(header: Header, file: BinaryIO, start: np.ndarray, size: np.ndarray, points: np.ndarray) -> None:
    """Raises InputError unless the nodes are the chunks of the file; of remote files only their total is known."""
    if isinstance(header.path, Remote):
        complete = points.sum() == header.count and (start[1:] >= start[:-1] + size[:-1]).all()
    else:
        chunks, nodes = chunk_table(header, file), np.stack([start, size, points])
        complete = np.array_equal(chunks[:, chunks[2] > 0], nodes)
    if not complete:
        raise InputError(
            f"{header.path}: the octree does not name the chunks that are in the table of chunks; it is damaged: read the "
            "file without bounds"
        )
