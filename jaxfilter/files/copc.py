"""The octree of a COPC file: which compressed chunks hold the points of an area.

Hobu Inc., COPC specification 1.0: info record (160 bytes), hierarchy pages of 32-byte entries.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

import lazrs
import numpy as np

from ..core.errors import InputError, warn
from .blocks import Blocks, hold
from .header import Header
from .storage import Remote, read_ranges

_ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")])
"""Level, x, y, z of a node; where its chunk is; number of points, -1: the entry is of another page."""


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
        at_first = np.frombuffer(b"".join(read_ranges(header.path, file, start.tolist(), [12] * len(start))), "<i4")
        first = at_first.reshape(-1, 3) * header.scales + header.offsets
        if not ((first >= low) & (first <= high)).all():
            return _unknown(header, found)
    return found


def sound(header: Header, found: Blocks, group: Blocks, records: np.ndarray) -> Blocks | None:
    """None if the records of a group of nodes lie in their cubes; otherwise all nodes ``found``, to be read without a look
    at the cubes, with a warning: other nodes may hold points of anywhere, too."""
    return None if hold(header, group, records) else _unknown(header, found)


def _unknown(header: Header, found: Blocks) -> Blocks:
    warn(f"{header.path}: points lie outside the cubes of its octree, so all of it is read to find those within bounds")
    return found.everywhere()


def _entries(header: Header, file: BinaryIO, page: int, size: int) -> np.ndarray:
    """The entries of all pages that are of nodes with points."""
    found, pages, seen = [np.zeros(0, _ENTRY)], [(page, size)], set()
    while pages:
        page, size = pages.pop()
        if page in seen or size % _ENTRY.itemsize or page + size > header.file_size:
            raise InputError(f"{header.path}: page of the octree at byte {page}, {size} bytes long, is damaged")
        seen.add(page)
        entries = np.frombuffer(read_ranges(header.path, file, [page], [size])[0], _ENTRY)
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
        file.seek(len(header.head))
        table = np.array(lazrs.read_chunk_table(file, lazrs.LazVlr(header.decoder)), np.int64).reshape(-1, 2)
        begins = len(header.head) + 8 + np.cumsum(table[:, 1]) - table[:, 1]
        chunks, named = np.column_stack([begins, table[:, 1], table[:, 0]]), np.column_stack([start, size, points])
        complete = np.array_equal(chunks[chunks[:, 2] > 0], named)
    if not complete:
        raise InputError(
            f"{header.path}: the octree does not name the chunks that are in the table of chunks; it is damaged: read the "
            "file without bounds"
        )
