"""Runs of point records that can be read alone, and the area that each covers: how to get at a part of a file.

The runs are the chunks of LAZ, the nodes of COPC (``copc.py``), and :data:`RUN` records of LAS. What area the points of a
run of LAS or LAZ cover is found by one pass over the file, see :func:`measured`, and can be kept.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np

from ..core.errors import InputError
from ..core.forks import need_threads
from .disk import Bounds, new_file
from .header import Header
from .storage import Remote, read_ranges

RUN = 16384
"""Records of LAS in a run."""


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

    def everywhere(self) -> Blocks:
        """The same runs, of which it is not known where they lie."""
        return dataclasses.replace(self, low=np.full_like(self.low, -np.inf), high=np.full_like(self.high, np.inf))

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
    if not header.count:
        points = size = np.zeros(0, np.int64)
        begin = 0
    elif header.compressed:
        file.seek(len(header.head))
        compressor = lazrs.LazVlr(header.decoder)
        table = np.array(lazrs.read_chunk_table(file, compressor), np.int64).reshape(-1, 2)
        points, size = table.T.copy()
        if not compressor.uses_variable_size_chunks():
            points[:] = compressor.chunk_size()
        points = np.diff(np.minimum(np.cumsum(points), header.count), prepend=0)
        begin = len(header.head) + 8
    else:
        points = np.full(-(-header.count // RUN), RUN, np.int64)
        points[-1] = header.count - RUN * (len(points) - 1)
        size = points * header.record_length
        begin = len(header.head)
    unknown = np.zeros((len(points), 2))
    start, first = begin + np.cumsum(size) - size, np.cumsum(points) - points
    return Blocks(start, size, first, points, unknown, unknown, np.full(len(points), -1)).everywhere()


def measured(header: Header) -> Blocks:
    """The runs of a LAS or LAZ file with the areas that their points cover, and checksums: reads all of it. Raises InputError."""
    low, high, sums = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0, np.int64)]
    with header.open() as file:
        found = runs(header, file)
        found = found[found.points > 0]
        for group in found.groups():
            packed = _packed(header, file, group)
            records = _decoded(header, group, packed, lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL)
            sums.append(_checksums(group, packed))
            for areas, edge in zip((low, high), _areas(header, group, records), strict=True):
                areas.append(edge)
    return dataclasses.replace(found, low=np.concatenate(low), high=np.concatenate(high), checksum=np.concatenate(sums))


def summed(header: Header, file: BinaryIO, blocks: Blocks) -> Blocks:
    """The same runs with their checksums: reads all of their bytes. Raises InputError if the file ends before."""
    sums = [_checksums(group, _packed(header, file, group)) for group in blocks.groups()]
    return dataclasses.replace(blocks, checksum=np.concatenate([np.zeros(0, np.int64), *sums]))


def read_blocks(header: Header, file: BinaryIO, blocks: Blocks, wanted: int) -> np.ndarray:
    """The records of some runs, u8[n, record_length]; ``wanted`` are the parts of LAZ to decompress.

    Raises: InputError if they are damaged, Changed if they are not those whose checksums are known.
    """
    packed, known = _packed(header, file, blocks), blocks.checksum >= 0
    if known.any() and (_checksums(blocks, packed) != blocks.checksum)[known].any():
        raise Changed(
            f"{header.path}: the file has changed since its points were first read; open it again, and begin a run anew with "
            "overwrite=True"
        )
    return _decoded(header, blocks, packed, wanted)


def _packed(header: Header, file: BinaryIO, blocks: Blocks) -> np.ndarray:
    """u8: the bytes of some runs, one after the other."""
    if isinstance(header.path, Remote):
        parts = read_ranges(header.path, file, blocks.start.tolist(), blocks.size.tolist())
        return np.frombuffer(bytearray().join(parts), np.uint8)
    packed, at = np.empty(int(blocks.size.sum()), np.uint8), 0
    for start, size in zip(blocks.start.tolist(), blocks.size.tolist(), strict=True):
        file.seek(start)
        if file.readinto(packed[at : at + size].data) < size:  # type: ignore[attr-defined]
            raise InputError(f"{header.path}: the file ends within its points; it is truncated")
        at += size
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


def hold(header: Header, blocks: Blocks, records: np.ndarray) -> bool:
    """Whether the records of some runs, u8[n, record_length], lie in the areas that these are said to cover."""
    low, high = _areas(header, blocks, records)
    return bool(((low >= blocks.low) & (high <= blocks.high)).all())


def _areas(header: Header, blocks: Blocks, records: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[k, 2] each, file coordinates: lowest and highest x and y of the points of each run."""
    ticks, at = records[:, :8].view("<i4"), np.cumsum(blocks.points) - blocks.points
    scale, offset = header.scales[:2], header.offsets[:2]
    low, high = (bound.reduceat(ticks, at) * scale + offset for bound in (np.minimum, np.maximum))
    return low, high
