"""The octree of a COPC file: which compressed chunks hold the points of an area.

Hobu Inc., COPC specification 1.0: info record (160 bytes), hierarchy pages of 32-byte entries.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from typing import BinaryIO

import lazrs
import numpy as np

from ..core.errors import InputError, warn
from ..core.forks import need_threads
from .files import Bounds
from .header import Header

_ENTRY = struct.Struct("<4iQ2i")  # level, x, y, z of the node; offset, bytes, points (-1: another page)


@dataclasses.dataclass(frozen=True, order=True)
class Node:
    """A chunk of compressed points; nodes sort in the order of the file."""

    offset: int
    size: int
    points: int


def nodes_within(header: Header, file: BinaryIO, bounds: Bounds) -> list[Node]:
    """The nodes whose cubes meet ``bounds``, in file order.

    The whole octree is read and compared with the table of chunks, and the first point of each chunk, which is not
    compressed, with the cube of its node: a damaged cube would lose points. If they do not agree, all nodes are returned,
    with a warning.

    Raises: InputError if the octree is damaged.
    """
    at = header.vlrs[0].payload
    *centre, half, _, page, size = struct.unpack_from("<5d2Q", header.head.ljust(at + 160, b"\0"), at)
    low = np.array(centre) - half
    chunks, start = set(), len(header.head) + 8
    file.seek(len(header.head))
    for points, length in lazrs.read_chunk_table(file, lazrs.LazVlr(header.decoder)):
        chunks.add(Node(start, length, points))
        start += length
    keys, nodes = [], []
    pages, seen = [(page, size)], set()
    while pages:
        page, size = pages.pop()
        if page in seen or size % _ENTRY.size or page + size > header.file_size:
            raise InputError(f"{header.path}: page of the octree at byte {page}, {size} bytes long, is damaged")
        seen.add(page)
        file.seek(page)
        for *key, offset, length, points in _ENTRY.iter_unpack(file.read(size)):
            if not 0 <= key[0] < 64 or length < 0 or points < -1 or offset + length > header.file_size:
                raise InputError(f"{header.path}: entry of the octree's page at byte {page} is damaged")
            if points == -1:
                pages.append((offset, length))
            elif points:
                keys.append(key)
                nodes.append(Node(offset, length, points))
    if len(set(nodes)) < len(nodes) or chunks != set(nodes):
        raise InputError(
            f"{header.path}: the octree does not name the chunks that are in the table of chunks; it is damaged: read the "
            "file without bounds"
        )
    if not nodes:
        return []
    level, corner = np.array(keys)[:, :1], np.array(keys)[:, 1:]
    with np.errstate(over="ignore", invalid="ignore"):
        edge = 2 * half / 2.0**level
        first = low + corner * edge - header.scales  # cubes are rounded by some writers
        last = low + (corner + 1) * edge + header.scales
    points = _first_points(header, file, nodes)
    if not ((points >= first) & (points <= last)).all():
        warn(
            f"{header.path}: points lie outside the cubes of its octree, so all of it is read to find those within bounds"
        )
        return sorted(nodes)
    met = (first[:, 0] < bounds[2]) & (last[:, 0] >= bounds[0]) & (first[:, 1] < bounds[3]) & (last[:, 1] >= bounds[1])
    return sorted(node for node, meets in zip(nodes, met.tolist(), strict=True) if meets)


def _first_points(header: Header, file: BinaryIO, nodes: list[Node]) -> np.ndarray:
    """f64[n, 3], file units: the first point of each node."""
    ticks = bytearray()
    for node in nodes:
        file.seek(node.offset)
        ticks += file.read(12)
    return np.frombuffer(ticks, "<i4").reshape(-1, 3) * header.scales + header.offsets


def node_chunks(header: Header, file: BinaryIO, nodes: list[Node], selection: int, chunk: int) -> Iterator[np.ndarray]:
    """Records of the nodes, u8[k, record_length], about ``chunk`` points at a time."""
    start = 0
    while start < len(nodes):
        end, points = start, 0
        while end < len(nodes) and (end == start or points + nodes[end].points <= chunk):
            points += nodes[end].points
            end += 1
        part = nodes[start:end]
        packed = bytearray()
        for node in part:
            file.seek(node.offset)
            packed += file.read(node.size)
        records = np.zeros((points, header.record_length), np.uint8)
        need_threads()
        lazrs.decompress_points_with_chunk_table(
            packed, header.decoder, records.reshape(-1), [(n.points, n.size) for n in part],
            lazrs.DecompressionSelection(selection),
        )  # fmt: skip
        yield records
        start = end
