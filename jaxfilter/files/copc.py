"""Cloud Optimised Point Clouds (COPC 1.0, copc.io): the points of a LAS file as an octree, each node a chunk of LAZ."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np

from ..core.errors import OutputError, warn
from ..core.process import need_threads
from .disk import opened
from .guard import laszip_record, read_header
from .header import HEADER_LENGTHS, LASZIP, RECORD_LENGTHS, Header
from .points import ENTRY, vlr
from .storage import Place

SUFFIX = ".copc.laz"
FORMATS = {0: 6, 1: 6, 2: 7, 3: 7, 6: 6, 7: 7, 8: 8}
"""Point formats that can be written, and what they become: COPC holds 6 to 8. The others have waveforms."""
NODE_CELLS, LEAF_POINTS, DEEPEST_LEVEL = 128, 2048, 10
"""Cells along the side of a node, of which each gives it one point; number of points that stay together; last level."""
_TOGETHER = 1 << 20  # points that are compressed at a time


def is_copc(path: Place) -> bool:
    """Whether a name asks for this kind of file."""
    return path.name.lower().endswith(SUFFIX)


def check_format(path: Place, number: int) -> None:
    """Raises OutputError for points that COPC cannot hold; warns of those that are converted."""
    if number not in FORMATS:
        raise OutputError(f"{path}: COPC has no room for the waveforms of point format {number}: write .laz or .las")
    if FORMATS[number] != number:
        warn(f"{path}: COPC holds point formats 6 to 8: the points are converted from {number} to {FORMATS[number]}")


def write_octree(plain: Path, target: Path) -> None:
    """Make a COPC file of uncompressed LAS, of a point format that :func:`check_format` lets pass.

    Records stay as they are, but for another point format. A node has one point of each of ``NODE_CELLS`` cells a side, in
    file order, and its children have the rest, so that a level shows the whole at its spacing. Raises: OSError.
    """
    with opened(plain) as (file, identity):
        header = read_header(plain, file, identity)
    if FORMATS[header.point_format] != header.point_format:
        write_octree(_converted(plain, header), target)
        return
    n, length, number = header.count, header.record_length, header.point_format
    points = np.memmap(plain, np.uint8, "r", len(header.head), (n, length)) if n else np.zeros((0, length), np.uint8)
    corner, side, order, keys, counts = _octree(header, points[:, :12].view("<i4"))
    compressor = laszip_record(number, length - RECORD_LENGTHS[number], variable=True)
    head, size = header.head, HEADER_LENGTHS[4]
    blocks = [vlr("copc", 1, bytes(160), "COPC info"), *(head[record.start : record.end] for record in header.vlrs)]
    front = bytearray(head[:size] + b"".join(blocks) + vlr(*LASZIP, compressor))
    front[25] = 4  # COPC is LAS 1.4
    struct.pack_into("<HIIB", front, 94, size, len(front), len(blocks) + 1, 0x80 | number)
    need_threads()
    with open(target, "x+b") as file:
        file.write(front)
        coder = lazrs.ParLasZipCompressor(file, lazrs.LazVlr(compressor))
        ends, first = np.cumsum(counts), 0
        while first < len(counts):
            last = max(first + 1, int(np.searchsorted(ends, ends[first] - counts[first] + _TOGETHER, "right")))
            parts = [points[order[ends[k] - counts[k] : ends[k]]].reshape(-1) for k in range(first, last)]
            coder.compress_chunks(parts)
            first = last
        coder.done()
        file.seek(len(front))
        sizes = np.array(lazrs.read_chunk_table(file, lazrs.LazVlr(compressor)), np.int64).reshape(-1, 2)[:, 1]
        entries = np.zeros(max(len(keys), 1), ENTRY)  # without points the root alone, which has none
        entries["key"][: len(keys)], entries["points"][: len(keys)], entries["size"][: len(keys)] = keys, counts, sizes
        entries["offset"][: len(keys)] = len(front) + 8 + np.cumsum(sizes) - sizes
        evlrs = file.seek(0, 2)
        file.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, entries.nbytes, b"COPC hierarchy") + entries.tobytes())
        hierarchy = file.tell() - entries.nbytes
        with header.open() as (source, _):
            for record in header.evlrs:
                source.seek(record.start)
                file.write(source.read(record.end - record.start))
        times = points[:, 22:30].copy().view("<f8") if n else np.zeros(1)
        info = (*(corner + side / 2), side / 2, side / NODE_CELLS, hierarchy, entries.nbytes, times.min(), times.max())
        struct.pack_into("<5d2Q2d", front, size + 54, *info)
        struct.pack_into("<6I", front, 107, *[0] * 6)  # legacy counts
        struct.pack_into("<2QIQ", front, 227, 0, evlrs, 1 + len(header.evlrs), n)
        file.seek(0)
        file.write(front)


def _octree(header: Header, ticks: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray, np.ndarray]:
    """Corner f64[3] and side of the cube, the order i64[n] of points i32[n, 3], and level, x, y, z i64[k, 4] and number of
    points i64[k] of nodes. No face of a node goes through a place that a point can have."""
    scales, finest = header.scales, float(header.scales.min())
    low = ticks.min(axis=0).astype(np.int64) if len(ticks) else np.zeros(3, np.int64)
    metres = (ticks - low) * scales + finest / 2
    step = 2**DEEPEST_LEVEL * float(scales.max())
    side = step * max(1, math.ceil((metres.max(initial=0.0) + finest / 2) / step))
    level, node, rest = np.zeros(len(ticks), np.int8), np.zeros(len(ticks), np.int64), np.arange(len(ticks))
    for depth in range(DEEPEST_LEVEL + 1):
        cell = (metres[rest] * (NODE_CELLS * 2**depth / side)).astype(np.int64)
        own = _packed(cell // NODE_CELLS)
        _, which, count = np.unique(own, return_inverse=True, return_counts=True)
        taken = (count[which] <= LEAF_POINTS) | (depth == DEEPEST_LEVEL)
        taken[np.unique(_packed(cell), return_index=True)[1]] = True
        level[rest[taken]], node[rest[taken]] = depth, own[taken]
        rest = rest[~taken]
    order = np.lexsort((node, level))
    level, node = level[order].astype(np.int64), node[order]
    starts = np.flatnonzero(np.r_[len(order) > 0, (np.diff(level) != 0) | (np.diff(node) != 0)][: len(order)])
    axes = [(node[starts] >> shift) & (2**21 - 1) for shift in (0, 21, 42)]
    counts = np.diff(np.append(starts, len(order)))
    corner = header.offsets + low * scales - finest / 2
    return corner, side, order, np.stack([level[starts], *axes], axis=1), counts


def _packed(cell: np.ndarray) -> np.ndarray:
    return np.asarray(cell[:, 0] | cell[:, 1] << 21 | cell[:, 2] << 42)


def _converted(plain: Path, header: Header) -> Path:
    """The same points in the format that COPC has for them, by laspy; its CRS as WKT, which such formats need."""
    old = laspy.read(plain)
    new = laspy.convert(old, point_format_id=FORMATS[header.point_format])
    new.scan_angle = np.rint(np.asarray(old.scan_angle_rank) / 0.006)  # in units of 0.006 degrees
    if header.upper:  # the rules by which LASzip makes LAS 1.4 of it
        echoes, flags = np.asarray(old["LAS 1.4 extended returns"]), np.asarray(old["LAS 1.4 flags and channel"])
        new.return_number = np.asarray(old.return_number) + (echoes >> 4)
        new.number_of_returns = np.asarray(old.number_of_returns) + (echoes & 15)
        new.classification = np.asarray(old.classification) + np.asarray(old["LAS 1.4 classification"])
        new.overlap, new.scanner_channel = flags & 1, flags >> 1 & 3
    if (crs := old.header.parse_crs()) is not None:
        new.header.add_crs(crs)
    new.write(made := plain.with_name("converted.las"))
    return made
