"""Small LAS files for tests, made by laspy and by struct, so that they do not depend on what they test."""

from __future__ import annotations

import io
import struct
import sys
import tracemalloc
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pyproj

OFFSETS = np.array([440000.0, 4750000.0, 100.0])
SCALES = np.array([0.01, 0.01, 0.001])


class Effort:
    """A block of work, as far as it does not depend on the speed of the machine: ``calls`` of functions, those written in C
    among them, and ``peak``, bytes of memory."""

    calls = peak = 0

    def __enter__(self) -> Effort:
        def count(*_: object) -> None:
            self.calls += 1

        tracemalloc.start()
        sys.setprofile(count)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)
        self.peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()


def make_las(path: Path, point_format: int = 6, version: str | None = None, n: int = 200, *, crs: object = 32632,
             extra: bool = False, seed: int = 0, **fields: np.ndarray) -> laspy.LasData:  # fmt: skip
    """A file in which every dimension of every point has a value of its own; ``fields`` replace some."""
    rng = np.random.default_rng(seed)
    minor = 2 if point_format < 4 else 3 if point_format < 6 else 4
    header = laspy.LasHeader(version=version or f"1.{minor}", point_format=point_format)
    header.scales, header.offsets = SCALES, OFFSETS
    header.generating_software, header.system_identifier = "a scanner", "an aircraft"
    if crs is not None:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    header.vlrs.append(laspy.VLR("someone", 77, "unknown to all", b"\x00\x01\xfe\xff"))
    if extra:
        scaling = {"scales": np.array([0.1]), "offsets": np.array([5.0])}
        header.add_extra_dim(laspy.ExtraBytesParams("amplitude", "u2", "scaled", **scaling))
        header.add_extra_dim(laspy.ExtraBytesParams("echo width", "3f4"))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(n, header=header)
    raw = rng.integers(0, 256, las.points.array.nbytes, dtype=np.uint8)
    las.points.array[:] = raw.view(las.points.array.dtype)  # every bit of every field, flags included
    for axis, high in (("X", 10_000), ("Y", 8_000), ("Z", 30_000)):
        las[axis] = rng.integers(0, high, n)
    total = rng.integers(1, 5, n)
    las.number_of_returns, las.return_number = total, rng.integers(1, total + 1)
    if extra:
        las["echo width"] = rng.normal(size=(n, 3))
    las.classification = rng.integers(0, 19, n)
    las.withheld = rng.integers(0, 10, n) == 0
    if "gps_time" in las.point_format.dimension_names:
        las.gps_time = rng.uniform(0, 1e6, n)
    for name, value in fields.items():
        las[name] = value
    if header.version.minor >= 4:
        las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("someone", 78, "long", bytes(range(256)) * 300)])
    las.write(path)
    return las


def las_of(path: Path | None, xyz: np.ndarray, point_format: int = 6, *, scales: object = 0.01, offsets: object = None,
           crs: object = None, **fields: object) -> laspy.LasData:  # fmt: skip
    """A file of these points, single echoes if ``fields`` do not say otherwise; its offsets are whole numbers."""
    xyz = np.asarray(xyz, float)
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales = np.full(3, scales) if np.ndim(scales) == 0 else np.asarray(scales)
    header.offsets = np.floor(xyz.min(axis=0)) if offsets is None else np.asarray(offsets, float)
    if crs is not None:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    las = laspy.LasData(header)
    las.xyz = xyz
    for name, value in ({"return_number": 1, "number_of_returns": 1} | fields).items():
        las[name] = np.broadcast_to(value, len(xyz))
    if path is not None:
        las.write(path)
    return las


def patch(path: Path, layout: str, at: int, *values: object) -> None:
    """Overwrite bytes of a file."""
    with open(path, "r+b") as file:
        file.seek(at)
        file.write(struct.pack("<" + layout, *values))


def replace_crs(path: Path, record: bytes) -> None:
    """Write another WKT or other GeoTIFF keys, which are not longer, in place of those of a file."""
    content = bytearray(path.read_bytes())
    at = content.index(b"LASF_Projection")
    length = struct.unpack_from("<H", content, at + 18)[0]
    assert len(record) <= length
    content[at + 52 : at + 52 + length] = record.ljust(length, b"\0")
    path.write_bytes(content)


def make_copc(path: Path, n: int = 400, seed: int = 0) -> np.ndarray:
    """A COPC 1.0 file of random points in a root and eight children; returns its records in file order, u8[n, 30]."""
    rng = np.random.default_rng(seed)
    xyz = rng.integers(0, 10_000, (n, 3)).astype("<i4")
    inner = rng.random(n) < 0.2
    child = np.where(inner, -1, (xyz[:, 0] >= 5000) + 2 * (xyz[:, 1] >= 5000) + 4 * (xyz[:, 2] >= 5000))
    parts = []
    for number in np.unique(child):
        key = (0, 0, 0, 0) if number < 0 else (1, number & 1, number >> 1 & 1, number >> 2 & 1)
        parts.append((key, xyz[child == number]))
    return write_copc(path, parts)


def make_deep_copc(path: Path, levels: int, per_node: int, seed: int = 0) -> np.ndarray:
    """A COPC 1.0 file of flat ground, as surveys have it: ``per_node`` points in each of the 4^l nodes of every level l;
    returns its records in file order. Nodes are in no order of place."""
    rng = np.random.default_rng(seed)
    parts = []
    for level in range(levels):
        edge = 10_000 / 2**level
        for x, y in rng.permutation([(x, y) for x in range(2**level) for y in range(2**level)]).tolist():
            corner = np.array([x, y, 0]) * edge
            size = np.array([edge, edge, min(edge, 10_000 / 2**levels)])
            parts.append(((level, x, y, 0), (corner + rng.random((per_node, 3)) * size).astype("<i4")))
    order = rng.permutation(len(parts))
    return write_copc(path, [parts[i] for i in order])


def write_copc(path: Path, parts: list[tuple[tuple[int, ...], np.ndarray]]) -> np.ndarray:
    """A COPC 1.0 file (copc.io specification) of point format 6 with the ticks i32[k, 3] of each node, by its key (level,
    x, y, z) in the cube of 100 m at OFFSETS; returns its records in file order, u8[n, 30]."""
    records = np.zeros((sum(len(xyz) for _, xyz in parts), 30), np.uint8)
    n = len(records)
    records[:, :12] = np.concatenate([xyz for _, xyz in parts]).view(np.uint8)
    rng = np.random.default_rng(n)
    records[:, 12:14], records[:, 22:30] = rng.integers(0, 256, (n, 2)), rng.random((n, 1)).view(np.uint8)  # time
    records[:, 14], records[:, 16] = 0x11, 1
    laszip = lazrs.LazVlr.new_for_compression(6, 0, True)

    def vlr(user: bytes, number: int, payload: bytes) -> bytes:
        return struct.pack("<H16sHH32s", 0, user, number, len(payload), b"") + payload

    wkt = b'LOCAL_CS["metres",UNIT["metre",1]]\0'
    tail = vlr(b"laszip encoded", 22204, laszip.record_data()) + vlr(b"LASF_Projection", 2112, wkt)
    offset = 375 + 54 + 160 + len(tail)
    body = io.BytesIO(b"\0" * offset)
    body.seek(offset)
    compressor = lazrs.LasZipCompressor(body, laszip)
    start = 0
    for i, (_, xyz) in enumerate(parts):
        if i:
            compressor.finish_current_chunk()
        compressor.compress_many(records[start : start + len(xyz)].reshape(-1))
        start += len(xyz)
    compressor.done()
    end = body.seek(0, 2)
    body.seek(offset)
    first, second, at = b"", b"", offset + 8
    for (key, xyz), (_, size) in zip(parts, lazrs.read_chunk_table(body, laszip), strict=True):
        entry = struct.pack("<4iQ2i", *key, at, size, len(xyz))
        first, second = (first + entry, second) if key[0] < 2 else (first, second + entry)
        at += size
    if second:  # deep nodes have a page of their own
        first += struct.pack("<4iQ2i", 2, 0, 0, 0, end + 60 + len(first) + 32, len(second), -1)
    entries = first + second
    info = struct.pack("<5d2Q2d", *(OFFSETS + 50), 50.0, 1.0, end + 60, len(first), 0.0, 0.0).ljust(160, b"\0")
    head = bytearray(375)
    struct.pack_into("<4sHH", head, 0, b"LASF", 0, 16)
    struct.pack_into("<BB32s32sHHHIIBH", head, 24, 1, 4, b"", b"", 1, 2024, 375, offset, 3, 6 | 0x80, 30)
    high, low = OFFSETS + 100.0, OFFSETS
    struct.pack_into("<6d", head, 131, 0.01, 0.01, 0.01, *OFFSETS)
    struct.pack_into("<6d", head, 179, *np.stack([high, low], axis=1).reshape(-1))
    struct.pack_into("<QIQQ", head, 235, end, 1, n, n)
    content = bytes(head) + vlr(b"copc", 1, info) + tail + body.getvalue()[offset:]
    content += struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(entries), b"") + entries
    path.write_bytes(content)
    return records
