"""The points of a box out of a file, without reading the rest of it."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, warn
from ..core.reading import Reading
from .blocks import Blocks, measured, nodes
from .disk import Bounds, Identity
from .handles import Handle
from .header import Header
from .reading import LasFile, TextFile, kept_text, open_las, open_text
from .records import coordinates, inside, read_records, reading_errors
from .sources import Source
from .storage import Place, Remote

_FILES = 64  # whose headers and blocks a process keeps


@dataclasses.dataclass(frozen=True)
class Window:
    """The points of a file that lie in a box.

    Attributes:
        cloud: n points, in the order of the file.
        record: i64[n], their record numbers in the file, counted from 0; the row that each has in ``jaxfilter.read`` of
            the whole file.
    """

    cloud: PointCloud
    record: np.ndarray


def read_window(
    source: Source,
    box: Bounds | None = None,
    index: Path | None = None,
    reading: Reading = Reading(),  # noqa: B008
) -> Window:
    """The points with xmin <= x < xmax and ymin <= y < ymax, as ``jaxfilter.read(..., bounds=box)`` gives them.

    Boxes that adjoin share no point and lose none. A box that holds the whole file is read in one pass, unless the index has
    the file already. Else, of COPC the octree and the nodes concerned are read, of LAS and LAZ the runs of records or chunks
    concerned; where these lie is found in one pass over the file, the first time, and kept. Text is read whole, and a process
    keeps the last text file that it read.

    Args:
        source: the file. If it has an ``identity``, the file must still be the same.
        box: (xmin, ymin, xmax, ymax), file coordinates; None = all points.
        index: folder in which the areas of runs and chunks are kept, one small file for each file, for other processes and
            later runs. It is made if missing. By default only this process keeps them. Checksums are kept along, of COPC
            only here and for files on a disk: the points of a file that is changed meanwhile are refused, even if its size
            and time are what they were.
        reading: which points are candidates, and the anchor of grids; the units are those of the source.

    Returns: Window; a cloud of no points where there are none.
    Raises: InputError naming the file, if it is gone, damaged, or has changed since ``source`` was made.
    """
    reading, place = dataclasses.replace(reading, bounds=box, units=source.units), source.place
    cut = reading.bounds
    if source.format == "text":
        return _text_window(source, reading)
    with reading_errors(place):
        identity = Identity.of(place)
        file = _opened(place, identity)
        _check_identity(source, file.header)
        x0, y0, x1, y1 = source.bounds
        whole = cut is None or not source.count or (cut[0] <= x0 and cut[1] <= y0 and x1 < cut[2] and y1 < cut[3])
        blocks = blocks_of(place, identity, index, make=not whole)
        if blocks is None:
            file = open_las(place)
    numbers = [np.zeros(0, np.int64)]

    def chunks() -> Iterator[np.ndarray]:
        for records, record in _numbered(file.header, cut, blocks):
            numbers.append(record)
            yield records

    most = None  # also of COPC, whose octree is not believed if points lie outside of it
    if blocks is not None and cut is not None and not file.header.is_copc:
        most = int(blocks.meeting(cut).points.sum())
    cloud = file.cloud(reading, chunks=chunks(), most=most)
    return Window(cloud, np.concatenate(numbers))


def file_cloud(
    source: Source, candidate: np.ndarray, *, bounds: Bounds | None = None, rows: np.ndarray | None = None
) -> PointCloud:
    """A cloud that stands for the points of a file when they are written, and whose coordinates stay in the file.

    Args:
        candidate: bool[n], of the points of the file inside ``bounds``, or of its ``rows``, in its order.
        bounds: points outside are not written; None = all are. rows: bool of all points of a LAS file; others are not written.

    Raises: InputError if the file has changed since the source was made.
    """
    place, kind = source.place, "text" if source.format == "text" else "las"
    with reading_errors(place):
        identity = Identity.of(place)
        file = kept_text(cast(Path, place)) if kind == "text" else _opened(place, identity).header
        _check_identity(source, file)
    handle = Handle(place.absolute(), kind, source.format, len(candidate), bounds, identity, None, None, rows)
    corner = np.floor([*source.bounds[:2], source.z[0]]) if source.count else np.zeros(3)
    xyz = np.broadcast_to(np.zeros(3, np.float32), (len(candidate), 3))
    return PointCloud(corner, xyz, candidate=candidate, crs=source.crs, units=source.units, source=handle)


def _check_identity(source: Source, file: Header | TextFile) -> None:
    """Raises: InputError if a file has changed, or has another number of points than a .vpc says, which knows no more of it."""
    if source.identity and file.fingerprint != source.identity:
        raise InputError(f"{source.uri}: the file has changed since the collection was opened; open it again")
    if not source.identity and isinstance(file, Header) and file.count != source.count:
        said = f"holds {file.count:,} points, and the .vpc that names it says {source.count:,}"
        raise InputError(f"{source.uri}: {said}: make the .vpc anew, such as with jaxfilter info --vpc")


def _text_window(source: Source, reading: Reading) -> Window:
    file, cut = kept_text(cast(Path, source.place)), reading.bounds
    _check_identity(source, file)
    if not reading.drop_invalid and not np.isfinite(file.xyz).all():
        open_text(file.path, cut, drop_invalid=False)  # which names the line
    rows = np.ones(len(file.xyz), bool) if cut is None else inside(file.xyz, cut)
    return Window(file.part(rows).cloud(reading), np.flatnonzero(rows))


def _numbered(header: Header, cut: Bounds | None, blocks: Blocks | None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Records inside a cut, u8[k, record_length], and their numbers in the file, i64[k]: out of some runs, or of all the file."""
    if blocks is not None:
        yield from read_records(header, cut, False, blocks)
        return
    ends = np.zeros((0, 2))
    for chunk, record in read_records(header, every_field=False):
        xy = coordinates(chunk, header, 2)
        ends = np.concatenate([ends, [xy.min(axis=0), xy.max(axis=0)]])
        kept = np.ones(len(chunk), bool) if cut is None else inside(xy, cut)
        yield (chunk, record) if kept.all() else (chunk[kept], record[kept])
    _tell_beyond(header, ends)


@functools.lru_cache(_FILES)
def _opened(place: Place, identity: Identity) -> LasFile:
    """``identity`` is that of the file now, so that what is kept is not of another."""
    return open_las(place, tables=False)


def blocks_of(place: Place, identity: Identity, index: Path | None = None, make: bool = True) -> Blocks | None:
    """The runs of records of a file, which has this identity now, and the area that each covers; see :func:`read_window` for
    ``index``. None if they are not known and not to be made. Raises: InputError if the file is damaged."""
    header = _opened(place, identity).header
    if index is None or (header.is_copc and isinstance(place, Remote)):
        return _unchecked(place, identity) if make else None
    name = hashlib.sha256(str(place.absolute()).encode()).hexdigest()[:24]
    path = Path(index) / name[:2] / f"{name[2:]}.npz"  # folders of some thousand files for a million
    kept = None
    with contextlib.suppress(OSError):  # there is none yet
        kept = _loaded(path, Identity.of(path), header.fingerprint)
    if kept is None and make:
        kept = _measured(place)
        path.parent.mkdir(parents=True, exist_ok=True)
        kept.save(path, header.fingerprint)
    return kept


@functools.lru_cache(_FILES)
def _loaded(path: Path, identity: Identity, fingerprint: str) -> Blocks | None:
    """``identity`` is that of the index now: a run that is begun anew makes another."""
    return Blocks.load(path, fingerprint)


@functools.lru_cache(_FILES)
def _unchecked(place: Place, identity: Identity) -> Blocks:
    """Without checksums: only this process knows of them, and has no other way to begin anew."""
    header = _opened(place, identity).header
    if header.is_copc:
        with header.open() as file:
            return nodes(header, file)
    found = _measured(place)
    return dataclasses.replace(found, checksum=np.full_like(found.checksum, -1))


def _measured(place: Place) -> Blocks:
    """By a pass over the file; warns of points that its header denies."""
    header = open_las(place).header
    found = measured(header)
    if not header.is_copc:
        _tell_beyond(header, np.concatenate([found.low, found.high]))
    return found


def _tell_beyond(header: Header, xy: np.ndarray) -> None:
    """Warn of places f64[k, 2] that the header denies, since surveys are planned by headers."""
    (low, high), slack = header.extent, header.scales[:2]
    if ((xy < low[:2] - slack) | (xy > high[:2] + slack)).any():
        warn(f"{header.path}: points lie outside the extent that its header states; write it anew to correct that")
