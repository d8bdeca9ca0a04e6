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

from ..core.errors import InputError
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
    """The nodes whose cubes meet ``bounds``, in file order. Raises InputError if the hierarchy is damaged."""
    at = header.vlrs[0].payload
    x0, y0, _, half, _, page, size = struct.unpack_from("<5d2Q", header.head.ljust(at + 160, b"\0"), at)
    x0, y0 = x0 - half, y0 - half
    margin_x, margin_y = header.scales[:2]  # cubes are rounded by some writers
    nodes: list[Node] = []
    chunks, start = set(), len(header.head) + 8
    file.seek(len(header.head))
    for points, length in lazrs.read_chunk_table(file, lazrs.LazVlr(header.decoder)):
        chunks.add(Node(start, length, points))
        start += length
    pages, seen = [(page, size)], set()
    while pages:
        page, size = pages.pop()
        if page in seen or size % _ENTRY.size or page + size > header.file_size:
            raise InputError(f"{header.path}: page of the octree at byte {page}, {size} bytes long, is damaged")
        seen.add(page)
        file.seek(page)
        for level, x, y, _, offset, length, points in _ENTRY.iter_unpack(file.read(size)):
            if not 0 <= level < 64 or length < 0 or points < -1 or offset + length > header.file_size:
                raise InputError(f"{header.path}: entry of the octree's page at byte {page} is damaged")
            edge = 2 * half / 2**level
            low_x, low_y = x0 + x * edge - margin_x, y0 + y * edge - margin_y
            if not (low_x < bounds[2] and low_x + edge + 2 * margin_x >= bounds[0]
                    and low_y < bounds[3] and low_y + edge + 2 * margin_y >= bounds[1]):  # fmt: skip
                continue
            if points == -1:
                pages.append((offset, length))
            elif points:
                nodes.append(Node(offset, length, points))
    if len(set(nodes)) < len(nodes) or not chunks.issuperset(nodes):
        raise InputError(f"{header.path}: the octree names chunks that are not in the table of chunks; it is damaged")
    return sorted(nodes)


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
