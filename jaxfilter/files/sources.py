"""A file of points as it is described before they are read, small, picklable, and enough to plan with; and the points of a box
out of it, without reading the rest."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import struct
from collections.abc import Iterable
from typing import Any, cast

import numpy as np
import pyproj

from ..core.cloud import PointCloud
from ..core.errors import InputError
from ..core.frame import ends
from ..core.reading import Bounds, Reading
from ..core.units import NAMED_UNITS, NOTHING, Reference, Stated, Units, not_metric, sampled
from .disk import opened
from .header import HEADER_LENGTHS
from .points import ALL, CLOUD, Handle, Points, coordinates, echo_keys, first_points, read_points
from .reading import FARTHEST, LasFile, kept_file
from .storage import Place, Remote, place_of
from .text import TextFile, open_text

NO_BOUNDS: Bounds = (math.nan,) * 4  # type: ignore[assignment]
"""The bounds of a file without points."""
WHOLE = 8_000_000
"""Points that are held in memory at once: data of so many or fewer are one tile."""
SQUARE = 64.0
"""Metres: side of the squares that tell where the points of a file lie."""
_WIDE, _FEW, _FILLED = 1000.0, 16, 0.6
"""Metres, about, of the side of a file whose points are looked at; samples that say too little; and the share of equal parts of
the extent that have a sample if the points fill it."""
SCATTERED = 4.0
"""Points are scattered over an extent that is so many times as large as the squares that hold them."""
Squares = tuple[np.ndarray, np.ndarray]
"""i64[m, 2], column and row of squares that hold points, counted from zero of the coordinates; i64[m], how many points."""


@dataclasses.dataclass(frozen=True, slots=True)
class Source:
    """A LAS, LAZ or COPC file as its header states it, or a text file.

    Attributes:
        uri: absolute path, or URI.
        format: ``"las"``, ``"laz"``, ``"copc"`` or ``"text"``.
        bounds: xmin, ymin, xmax, ymax, file coordinates, **closed** on all sides; NaN for a file without points.
        z: lowest and highest Z, file coordinates.
        count: number of points.
        wkt: its CRS as WKT, or None; see ``crs``.
        units: metres per file unit.
        point_format: as in the header; None for text, and for a member of a ``.vpc`` whose header was not read.
        date: day on which the file was made, ISO 8601, as the header states it, or None.
        identity: changes with the file (size, time of the last change or ETag, header), see ``Header.fingerprint``; ``""``
            where the header was not read.
    """

    uri: str
    format: str
    bounds: Bounds
    count: int
    z: tuple[float, float] = (math.nan, math.nan)
    wkt: str | None = None
    units: Units = NAMED_UNITS["m"]
    point_format: int | None = None
    date: str | None = None
    identity: str = ""

    @property
    def place(self) -> Place:
        """Where its bytes are."""
        return place_of(self.uri)

    @property
    def crs(self) -> pyproj.CRS | None:
        """The CRS, or None."""
        return None if self.wkt is None else _crs_of(self.wkt)

    @property
    def metre(self) -> float:
        """Metres per unit of X and Y."""
        return self.units.xy


_crs_of = functools.lru_cache(256)(pyproj.CRS.from_wkt)


def fingerprint(place: Place) -> str:
    """What :attr:`Source.identity` of this file is now. Raises: InputError."""
    return kept_file(place, False).fingerprint


def describe_file(place: Place, stated: Stated = NOTHING, points: bool = False) -> Source:
    """What can be known of a file before its points are read, from its header or, of text, from all of its lines.

    ``points``: look at some points as well, see :func:`with_true_extent`. An impossible extent is replaced in any case.

    Raises: InputError if it cannot be read, if its coordinates cannot be lengths, unless units are ``stated``, or if it
    states another CRS. Warns: of a wrong extent.
    """
    facts: dict[str, Any]
    file = kept_file(place, points)
    if isinstance(file, TextFile):
        xyz, count, reference = file.xyz[np.isfinite(file.xyz).all(axis=1)], file.points, Reference()
        extent, some = np.stack(ends(xyz)) if len(xyz) else np.full((2, 3), math.nan), xyz[sampled(len(xyz))]
        facts = {"format": "text"}
    else:
        header, reference, count = file.header, file.reference, file.header.count
        extent = some = file.extent
        kind = "copc" if header.is_copc else "laz" if header.compressed else "las"
        facts = {"format": kind, "point_format": header.point_format, "date": header.date}
    reference = stated.of(reference, str(place))
    if reference.problem is not None:
        raise InputError(f"{place}: {reference.problem}, or pass units= if the CRS record is wrong")
    if stated.units is None and count and (problem := not_metric(some, count, reference.units is not None)):
        raise InputError(f"{place}: {problem}")
    (x0, y0, z0), (x1, y1, z1) = (extent if count else np.full((2, 3), math.nan)).tolist()
    facts |= {"bounds": (x0, y0, x1, y1), "z": (z0, z1), "units": reference.units or Units()}
    facts["wkt"] = None if reference.crs is None else reference.crs.to_wkt()
    return Source(str(place), count=count, identity=file.fingerprint, **facts)


def stated_bounds(place: Place) -> Bounds:
    """The bounds in the header of a LAS file of which nothing else may be readable; NaN where it states none."""
    with contextlib.suppress(InputError, OSError, struct.error), opened(place) as (file, _):
        head = file.read(HEADER_LENGTHS[0])
        x1, x0, y1, y0 = struct.unpack_from("<4d", head, 179)
        if head.startswith(b"LASF") and x0 <= x1 and y0 <= y1 and max(map(abs, (x0, x1, y0, y1))) < FARTHEST:
            return x0, y0, x1, y1
    return NO_BOUNDS


def with_true_extent(source: Source) -> Source:
    """A source whose extent is that of its points, if some of them show that its header states another: the first of each chunk
    of LAZ, some of LAS, all of a small file. Remote files, and those that only a .vpc describes, are not looked at. Warns."""
    if source.format == "text" or not source.identity or not source.count or isinstance(source.place, Remote):
        return source
    with contextlib.suppress(InputError):  # a damaged file is named when its points are read
        (x0, y0, z0), (x1, y1, z1) = cast(LasFile, kept_file(source.place)).extent.tolist()
        return dataclasses.replace(source, bounds=(x0, y0, x1, y1), z=(z0, z1))
    return source


def squares_of(source: Source) -> Squares | None:
    """Squares of :data:`SQUARE` metres that hold the points of a file, where these leave much of its extent empty, as in a
    corridor that runs across. None if they fill it, as far as some of them show; and if it is small, remote or damaged."""
    x0, y0, x1, y1 = source.bounds
    if not source.count or max(x1 - x0, y1 - y0) * source.metre <= _WIDE:
        return None
    if not source.identity or isinstance(source.place, Remote):
        return None
    with contextlib.suppress(InputError):
        file, side = _file_of(source), SQUARE / source.metre
        if isinstance(file, TextFile):
            return _scattered(counted_squares([file.xyz[:, :2]], side))
        some = first_points(file.header)
        parts = min(16, math.isqrt(len(some) // 4))
        if len(some) > _FEW:
            extent = np.maximum([x1 - x0, y1 - y0], 1.0)
            part = np.clip((some - [x0, y0]) * parts / extent, 0, parts - 1).astype(int)
            if len(np.unique(part @ [1, parts])) >= _FILLED * parts**2:
                return None
        every = (coordinates(points, file.header, 2) for points, _ in read_points(file.header, fields=CLOUD))
        return _scattered(counted_squares(every, side))
    return None


def _scattered(found: Squares) -> Squares | None:
    """Squares that are a small part of their extent, also those of them with four points or more, which are no stray points; None
    for others."""
    square, count = found
    for some in (square, square[count > 3]):
        area = math.prod((np.ptp(some, axis=0) + 1).tolist()) if len(some) else 0
        if area <= SCATTERED * len(some):
            return None
    return found


def counted_squares(parts: Iterable[np.ndarray], side: float) -> Squares:
    """The squares of points f64[n, 2], and how many each holds. Raises: InputError for an extent that is too large."""
    squares, counts = [np.zeros((0, 2), np.int64)], [np.zeros(0, np.int64)]
    for xy in parts:
        square = np.floor(xy[np.isfinite(xy).all(axis=1)] / side).astype(np.int64)
        _, first, count = np.unique(square_keys(square), return_index=True, return_counts=True)
        squares.append(square[first])
        counts.append(count)
    square = np.concatenate(squares)
    _, first, member = np.unique(square_keys(square), return_index=True, return_inverse=True)
    return square[first], np.bincount(member, np.concatenate(counts), len(first)).astype(np.int64)


def square_keys(square: np.ndarray) -> np.ndarray:
    """i64[m], row by row: tells squares from others, i64[m, 2]. Raises: InputError for an extent that is too large."""
    if not len(square):
        return np.zeros(0, np.int64)
    low = square.min(axis=0)
    wide, tall = (square.max(axis=0) - low + 1).tolist()
    if wide * tall >= 2**62:
        raise InputError("points are too far from each other: remove stray points far from the rest")
    return (square - low) @ np.array([1, wide])


@dataclasses.dataclass(frozen=True)
class Window:
    """The points of a file that lie in a box.

    Attributes:
        cloud: n points, in the order of the file.
        record: i64[n], their record numbers in the file, counted from 0; the row that each has in ``jaxfilter.read`` of
            the whole file.
        key: u64[n], see :func:`echo_keys`, if it was asked for.
    """

    cloud: PointCloud
    record: np.ndarray
    key: np.ndarray | None = None


def read_window(
    source: Source,
    box: Bounds | None = None,
    reading: Reading = Reading(),  # noqa: B008
    keys: bool = False,
) -> Window:
    """The points with xmin <= x < xmax and ymin <= y < ymax, as ``jaxfilter.read(..., bounds=box)`` gives them.

    Boxes that adjoin share no point and lose none. A box that holds the whole file is read in one pass. Else, of COPC the octree
    and the nodes concerned are read, of LAS and LAZ the runs of records or chunks concerned; where these lie is found in
    one pass over the file, the first time in a process. Text is read whole, and a process keeps the last text file that it
    read.

    Args:
        source: the file. If it has an ``identity``, the file must still be the same.
        box: (xmin, ymin, xmax, ymax), file coordinates; None = all points.
        reading: which points are candidates, and the anchor of grids; the units are those of the source.
        keys: read what tells echoes from one another as well.

    Returns: Window; a cloud of no points where there are none.
    Raises: InputError naming the file, if it is gone, damaged, or has changed since ``source`` was made.
    """
    reading = dataclasses.replace(reading, bounds=box, units=source.units)
    file, cut = _file_of(source), reading.bounds
    if isinstance(file, TextFile):
        if not reading.drop_invalid and not np.isfinite(file.xyz).all():
            open_text(file.path, cut, drop_invalid=False)  # which names the line
        part = file.within(cut)
        return Window(part.cloud(reading), np.flatnonzero(part.rows))
    x0, y0, x1, y1 = source.bounds
    whole = cut is None or not source.count or (cut[0] <= x0 and cut[1] <= y0 and x1 < cut[2] and y1 < cut[3])
    header, record, key = file.header, [np.zeros(0, np.int64)], [np.zeros(0, np.uint64)]

    def note(points: Points, numbers: np.ndarray) -> None:
        record.append(numbers)
        if keys:
            key.append(echo_keys(points, header))

    cloud = file.cloud(reading, runs=None if whole else file.runs, fields=ALL if keys else CLOUD, note=note)
    return Window(cloud, np.concatenate(record), np.concatenate(key) if keys else None)


def file_cloud(
    source: Source, candidate: np.ndarray, *, bounds: Bounds | None = None, rows: np.ndarray | None = None
) -> PointCloud:
    """A cloud that stands for the points of a file when they are written, and whose coordinates stay in the file.

    Args:
        candidate: bool[n], of the points of the file inside ``bounds``, or of its ``rows``, in its order.
        bounds: points outside are not written; None = all are. rows: bool of all points of a LAS file; others are not written.

    Raises: InputError if the file has changed since the source was made.
    """
    file = _file_of(source)
    handle = file.within(bounds) if isinstance(file, TextFile) else Handle(file.header, len(candidate), bounds, rows)
    corner = np.floor([*source.bounds[:2], source.z[0]]) if source.count else np.zeros(3)
    xyz = np.broadcast_to(np.zeros(3, np.float32), (len(candidate), 3))
    return PointCloud(corner, xyz, candidate=candidate, crs=source.crs, units=source.units, source=handle)


def _file_of(source: Source) -> LasFile | TextFile:
    """Raises: InputError if the file has changed, or has another number of points than a .vpc says, which knows no more of it."""
    file = kept_file(source.place)
    if source.identity and file.fingerprint != source.identity:
        raise InputError(f"{source.uri}: the file has changed since the collection was opened; open it again")
    if not source.identity and isinstance(file, LasFile) and file.header.count != source.count:
        said = f"holds {file.header.count:,} points, and the .vpc that names it says {source.count:,}"
        raise InputError(f"{source.uri}: {said}: make the .vpc anew, such as with jaxfilter info --vpc")
    return file
