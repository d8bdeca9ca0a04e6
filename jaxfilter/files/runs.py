"""Runs of point records, and the area that each covers: which part of a file has to be read for a box.

The runs are the chunks of LAZ, the nodes of COPC, and :data:`RUN_LENGTH` records of LAS. What area the points of a run of LAS or
LAZ cover is found by one pass over the file. The octree of COPC says it (Hobu Inc., COPC specification 1.0: info record of 160
bytes, hierarchy pages of 32-byte entries).
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from ..core.errors import InputError, warn
from .disk import Bounds
from .guard import chunk_table, pieces
from .header import Header
from .storage import Remote

RUN_LENGTH = 16384
"""Records of LAS in a run."""

ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")])
"""Level, x, y, z of a node of COPC; where its chunk is; number of points, -1: the entry is of another page."""


@dataclasses.dataclass(frozen=True)
class Runs:
    """k runs of records of a file, in file order.

    Attributes:
        start, size: i64[k]: where a run begins in the file, and its bytes there.
        first, points: i64[k]: number of its first record in the file, counted from 0, and how many it has.
        low, high: f64[k, 2], file coordinates: all points of a run lie in low <= (x, y) <= high.
    """

    start: np.ndarray
    size: np.ndarray
    first: np.ndarray
    points: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def __getitem__(self, rows: np.ndarray | slice) -> Runs:
        return Runs(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))

    @classmethod
    def of_chunks(cls, start: np.ndarray, size: np.ndarray, points: np.ndarray) -> Runs:
        """Runs of so many points, i64[k], one after the other, whose areas are not known yet: they are infinite."""
        edge = np.full((len(points), 2), np.inf)
        return cls(start, size, np.cumsum(points) - points, points, -edge, edge)[points > 0]

    @classmethod
    def of_file(cls, header: Header, file: BinaryIO) -> Runs:
        """The chunks of LAZ; :data:`RUN_LENGTH` records each of LAS."""
        if header.count and header.compressed:
            start, size, points = chunk_table(header, file)
            return cls.of_chunks(start, size, np.diff(np.minimum(np.cumsum(points), header.count), prepend=0))
        first = np.arange(0, header.count, RUN_LENGTH)
        points, length = np.minimum(header.count - first, RUN_LENGTH), header.record_length
        return cls.of_chunks(len(header.head) + first * length, points * length, points)

    def meeting(self, box: Bounds) -> Runs:
        """Those that may hold points inside a half-open box."""
        low, high = self.low, self.high
        return self[(low[:, 0] < box[2]) & (high[:, 0] >= box[0]) & (low[:, 1] < box[3]) & (high[:, 1] >= box[1])]

    def groups(self, most: int) -> Iterator[Runs]:
        """Runs in succession, about ``most`` points at a time."""
        ends, at = np.cumsum(self.points), 0
        while at < len(ends):
            end = max(at + 1, int(np.searchsorted(ends, ends[at] - self.points[at] + most, side="right")))
            yield self[at:end]
            at = end

    @property
    def records(self) -> np.ndarray:
        """i64[n]: the numbers of the records, run after run."""
        ends = np.cumsum(self.points)
        return np.arange(int(self.points.sum())) + np.repeat(self.first - ends + self.points, self.points)


def nodes(header: Header, file: BinaryIO) -> Runs:
    """The nodes of COPC with points, in file order, with the squares that their cubes cover.

    Of files on a disk the octree is held against the table of chunks, and the first point of each chunk, which is not compressed,
    against the cube of its node: a damaged cube would lose points. If a point lies outside, all nodes cover everything,
    with a warning. Raises: InputError if the octree is damaged.
    """
    at = header.vlrs[0].payload
    *centre, half, _, page, size = struct.unpack_from("<5d2Q", header.head.ljust(at + 160, b"\0"), at)
    entries = np.sort(_entries(header, file, page, size), order=("offset", "size", "points"))
    start, length, points = (entries[name].astype(np.int64) for name in ("offset", "size", "points"))
    if isinstance(header.path, Remote):  # where a look at each chunk is a request of its own
        complete = points.sum() == header.count and (start[1:] >= start[:-1] + length[:-1]).all()
    else:
        chunks = chunk_table(header, file)
        complete = np.array_equal(chunks[:, chunks[2] > 0], np.stack([start, length, points]))
    if not complete:
        raise InputError(
            f"{header.path}: the octree does not name the chunks that are in the table of chunks; it is damaged: read the "
            "file without bounds"
        )
    found, key = Runs.of_chunks(start, length, points), entries["key"]
    with np.errstate(over="ignore", invalid="ignore"):
        edge = 2 * half / 2.0 ** key[:, :1]
        low = np.array(centre) - half + key[:, 1:] * edge - header.scales  # cubes are rounded by some writers
        high = np.array(centre) - half + (key[:, 1:] + 1) * edge + header.scales
    if not isinstance(header.path, Remote):
        first = pieces(header, file, start, 12).view("<i4") * header.scales + header.offsets
        if not ((first >= low) & (first <= high)).all():
            warn(
                f"{header.path}: points lie outside the cubes of its octree, so all of it is read to find those within bounds"
            )
            return found
    return dataclasses.replace(found, low=low[:, :2], high=high[:, :2])


def _entries(header: Header, file: BinaryIO, page: int, size: int) -> np.ndarray:
    """The entries of all pages that are of nodes with points."""
    found, pages, seen = [np.zeros(0, ENTRY)], [(page, size)], set()
    while pages:
        page, size = pages.pop()
        if page in seen or size % ENTRY.itemsize or page + size > header.identity.size:
            raise InputError(f"{header.path}: page of the octree at byte {page}, {size} bytes long, is damaged")
        seen.add(page)
        file.seek(page)
        entries = np.frombuffer(file.read(size), ENTRY)
        level, points, length = entries["key"][:, 0], entries["points"], entries["size"]
        end = entries["offset"].astype(np.float64) + length
        if not ((level >= 0) & (level < 64) & (length >= 0) & (points >= -1) & (end <= header.identity.size)).all():
            raise InputError(f"{header.path}: entry of the octree's page at byte {page} is damaged")
        pages += entries[points == -1][["offset", "size"]].tolist()
        found.append(entries[points > 0])
    return np.concatenate(found)
