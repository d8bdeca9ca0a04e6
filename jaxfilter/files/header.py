"""The header of a LAS file as facts, what laspy is shown of it, and what of it an output keeps.

Field offsets follow the ASPRS LAS specification 1.4 R15, tables 3 (public header block), 5 and 6 (variable length records)
and 24 (extra bytes); LAS 1.5 appends two times and an offset.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import functools
import hashlib
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ..core.errors import InputError
from .disk import Identity, opened
from .storage import Place

RECORD_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point record by point format, 0 to 10."""
HEADER_LENGTHS = (227, 227, 227, 235, 375, 393)
"""Bytes of the public header block by minor version, 1.0 to 1.5."""
LASZIP, EXTRA_BYTES, COPC = ("laszip encoded", 22204), ("LASF_Spec", 4), "copc"
"""Records: of compressed points, of descriptions of extra bytes, and the user of those on an octree."""
EXTRA_ENTRY = 192
"""Bytes that describe an extra dimension."""
FLOATS = {9: "<f4", 10: "<f8"}
"""Data types of extra bytes that are floating point, as NumPy names them."""
_EXTRA_SIZES = (1, 1, 2, 2, 4, 4, 8, 8, 4, 8)  # bytes of the data types 1 to 10
_COMPATIBLE = ("lascompatible", 22204)


class Record(NamedTuple):
    """A variable length record: its user and number, where it begins and ends in the file, and where its data begin."""

    key: tuple[str, int]
    start: int
    payload: int
    end: int


class ExtraDimension(NamedTuple):
    """A described part of the extra bytes: ``start`` counts from the first of them."""

    name: str
    data_type: int
    start: int
    size: int


class _Field:
    """A number of the public header block, some bits of it, or several as f64; 0 where its LAS version has none."""

    def __init__(self, at: int, layout: str, version: int = 0, mask: int | None = None) -> None:
        self.at, self.layout, self.version, self.mask = at, f"<{layout}", version, mask

    def __get__(self, header: Header, kind: type[Header]) -> Any:
        if header.version < self.version or header.size < self.at + struct.calcsize(self.layout):
            return 0  # LAS 1.3 may come with the header of LAS 1.2
        found = struct.unpack_from(self.layout, header.head, self.at)
        return np.array(found) if len(found) > 1 else found[0] if self.mask is None else found[0] & self.mask


@dataclasses.dataclass(frozen=True)
class Header:
    """A header that was checked. ``head`` is the file up to its first point; ``identity`` is that of the file; ``unread`` is the
    number of compressed points, as far as it is known, that are in the file and not in its count."""

    path: Place
    head: bytes
    identity: Identity
    vlrs: tuple[Record, ...]
    evlrs: tuple[Record, ...] = ()
    unread: int = 0

    record_length = _Field(105, "H")
    compressed, point_format = _Field(104, "B", mask=0x80), _Field(104, "B", mask=0x3F)
    scales, offsets, waveform_start = _Field(131, "3d"), _Field(155, "3d"), _Field(227, "Q", 3)
    legacy_count, full_count, evlr_start = _Field(107, "I"), _Field(247, "Q", 4), _Field(235, "Q", 4)

    def open(self) -> contextlib.AbstractContextManager[tuple[BinaryIO, Identity]]:
        """The file that the header is of, see :func:`jaxfilter.files.disk.opened`."""
        return opened(self.path, self.identity)

    @property
    def version(self) -> int:
        """Minor version of LAS."""
        return self.head[25]

    @property
    def size(self) -> int:
        """Bytes of the public header block, what a producer has put behind it included."""
        return int.from_bytes(self.head[94:96], "little")

    @property
    def count(self) -> int:
        """Number of points; writers that leave the 1.4 count at zero are believed in their legacy count."""
        return self.full_count or self.legacy_count

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest x, y, z as the header states them."""
        both = np.array(struct.unpack_from("<6d", self.head, 179)).reshape(3, 2)
        return both[:, 1], both[:, 0]

    @property
    def date(self) -> str | None:
        """Day on which the file was made, ISO 8601; None if the header states none that can be."""
        day, year = struct.unpack_from("<2H", self.head, 90)
        with contextlib.suppress(ValueError):
            return datetime.datetime.strptime(f"{year:04} {day}", "%Y %j").date().isoformat() if year >= 1900 else None
        return None

    @property
    def fingerprint(self) -> str:
        """Changes with the file, wherever it is mounted: a hash of its size, of the time of its last change or its ETag,
        and of all that precedes its points."""
        stated = f"{self.identity.size} {self.identity.modified} {self.identity.tag}\n".encode()
        return hashlib.sha256(stated + self.head).hexdigest()[:32]

    @property
    def is_copc(self) -> bool:
        """Cloud Optimised Point Cloud: LAZ with its octree in an info record, which comes first."""
        return bool(self.vlrs) and self.vlrs[0].key == (COPC, 1)

    @property
    def points_end(self) -> int:
        """Where uncompressed points end."""
        return len(self.head) + self.count * self.record_length

    @property
    def tail(self) -> int:
        """Where that begins which follows the points: extended records, waveforms, or nothing."""
        if not self.compressed:
            return self.points_end
        starts = [self.waveform_start, *(record.start for record in self.evlrs[:1])]
        size = self.identity.size
        return min((start for start in starts if len(self.head) <= start <= size), default=size)

    @property
    def laszip(self) -> bytes:
        """The record that LAZ needs to be compressed and decompressed. Raises InputError if there is none."""
        for record in self.vlrs:
            if record.key == LASZIP and record.end - record.payload >= 34:
                return self.head[record.payload : record.end]
        raise InputError(f"{self.path}: points are compressed, but the laszip record is missing; the file is damaged")

    def remarks(self) -> Iterator[str]:
        """What the header says of the number of points that contradicts itself or the file."""
        full, legacy, said = self.full_count, self.legacy_count, f"the header announces {self.count} points"
        if self.version >= 4 and legacy and full != legacy:
            yield f"the header announces {full} points, and {legacy} in its legacy field: {self.count} are read"
        layout, at = ("<15Q", 255) if full else ("<5I", 111)
        returns = sum(struct.unpack_from(layout, self.head, at))
        after = [s for s in (self.waveform_start, self.evlr_start) if self.points_end <= s <= self.identity.size]
        room = 0 if self.compressed else min(after, default=self.identity.size) - self.points_end
        if self.unread:
            held = f"the compressed chunks hold at least {self.count + self.unread}"
            yield f"{said}, but {held}: the others are not read, and will be in no output"
        elif more := room // self.record_length:
            held = f"{room} bytes follow them, enough for {more} more, so {self.count + more} in all"
            yield f"{said}, but {held}: they are not read; LAS written from this file keeps them as they are"
        elif returns > self.count:
            yield f"{said}, and {returns} in its counts by return: {self.count} are read"

    def __str__(self) -> str:
        name = "COPC" if self.is_copc else "LAZ" if self.compressed else "LAS"
        return f"{name} 1.{self.version}, point format {self.point_format}"

    def extra_dimensions(self) -> list[ExtraDimension] | None:
        """What the extra bytes of a point hold, as far as it is described, which may be in several records; None if the
        description is damaged."""
        at, found = 0, []
        for record in self.vlrs:
            if record.key != EXTRA_BYTES:
                continue
            if (record.end - record.payload) % EXTRA_ENTRY:
                return None
            for entry in range(record.payload, record.end, EXTRA_ENTRY):
                data_type, size, name = struct.unpack_from("<BB32s", self.head, entry + 2)
                if data_type > 30:
                    return None
                if data_type:
                    size = _EXTRA_SIZES[(data_type - 1) % 10] * ((data_type - 1) // 10 + 1)
                found.append(ExtraDimension(text_of(name), data_type, at, size))
                at += size
        return found if at <= self.record_length - RECORD_LENGTHS[self.point_format] else None

    @functools.cached_property
    def upper(self) -> dict[str, int]:
        """Of LAS 1.4 in the compatibility mode of LASzip: which extra byte holds what older point formats have no room for,
        by its name there; nothing of other files."""
        if not any(record.key == _COMPATIBLE for record in self.vlrs) or self.point_format > 5:
            return {}
        found = {one.name.removeprefix("LAS 1.4 "): one.start for one in self.extra_dimensions() or ()}
        return found if {"extended returns", "classification", "flags and channel"} <= found.keys() else {}


def text_of(raw: bytes) -> str:
    """A text that ends with a zero byte."""
    return raw.split(b"\0", 1)[0].decode("latin-1")
