"""The points of a box out of a file, without reading the rest of it."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import cast

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError
from ..core.reading import Reading
from .disk import Bounds, Identity
from .guard import reading_errors
from .handles import Handle
from .header import Header
from .points import ALL, CLOUD, Points, echo_keys, measured
from .reading import kept_las
from .runs import Runs, nodes
from .sources import Source
from .storage import Place
from .text import TextFile, kept_text, open_text

_FILES = 64  # whose runs a process keeps


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
    reading, place = dataclasses.replace(reading, bounds=box, units=source.units), source.place
    cut = reading.bounds
    if source.format == "text":
        return _text_window(source, reading)
    file = kept_las(place, tables=True)
    _check_identity(source, file.header)
    x0, y0, x1, y1 = source.bounds
    whole = cut is None or not source.count or (cut[0] <= x0 and cut[1] <= y0 and x1 < cut[2] and y1 < cut[3])
    runs = None if whole else _runs(place, file.header.identity)
    record, key = [np.zeros(0, np.int64)], [np.zeros(0, np.uint64)]

    def note(points: Points, numbers: np.ndarray) -> None:
        record.append(numbers)
        if keys:
            key.append(echo_keys(points, file.header))

    cloud = file.cloud(reading, runs=runs, fields=ALL if keys else CLOUD, note=note)
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
    handle: Handle | TextFile
    if source.format == "text":
        handle = kept_text(cast(Path, source.place)).within(bounds)
        _check_identity(source, handle)
    else:
        header = kept_las(source.place, tables=True).header
        _check_identity(source, header)
        handle = Handle(header, len(candidate), bounds, rows)
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
    part = file.within(cut)
    return Window(part.cloud(reading), np.flatnonzero(part.rows))


@functools.lru_cache(_FILES)
def _runs(place: Place, identity: Identity) -> Runs:
    """``identity`` is that of the file now."""
    header = kept_las(place, tables=True).header
    with reading_errors(place), header.open() as file:
        return nodes(header, file) if header.is_copc else measured(header)[0]
