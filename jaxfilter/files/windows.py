"""The points of a box out of a file, without reading the rest of it."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, warn
from ..core.units import Reference
from . import copc
from .blocks import Blocks, measured, summed
from .disk import Bounds, Identity, check_bounds
from .header import Header
from .reading import las_cloud, open_las
from .records import reading, within
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


def read_window(source: Source, box: Bounds, index: Path | None = None, **chosen: Any) -> Window:
    """The points with xmin <= x < xmax and ymin <= y < ymax, as ``jaxfilter.read(..., bounds=box)`` gives them.

    Boxes that adjoin share no point and lose none. Of COPC the octree and the nodes concerned are read, of LAS and LAZ the
    runs of records or chunks concerned; where these lie is found in one pass over the file, the first time, and kept.

    Args:
        source: the file. If it has an ``identity``, the file must still be the same.
        box: (xmin, ymin, xmax, ymax), file coordinates.
        index: folder in which the areas of runs and chunks are kept, one small file for each file, for other processes and
            later runs. It is made if missing. By default only this process keeps them. Checksums are kept along, of COPC
            only here and for files on a disk: the points of a file that is changed meanwhile are refused, even if its size
            and time are what they were.
        chosen: ``returns``, ``ignore_classes``, ``ignore_overlap``, ``keep_withheld``, ``drop_invalid`` and ``anchor`` of
            :func:`jaxfilter.read`; ``units`` are those of the source.

    Returns: Window; a cloud of no points where there are none.
    Raises: InputError naming the file, if it is gone, damaged, or has changed since ``source`` was made.
    """
    cut, place = check_bounds(box), source.place
    with reading(place):
        identity = Identity.of(place)
        opened = _opened(place, identity)
        if source.identity and opened.header.fingerprint != source.identity:
            raise InputError(f"{source.uri}: the file has changed since the collection was opened; open it again")
        blocks = _blocks(place, identity, index)
    return _window(opened, blocks, cut, source, chosen)


def blocks_of(source: Source, index: Path | None = None) -> Blocks:
    """The runs of records of a file and the area that each covers; see :func:`read_window` for ``index``.

    Raises: InputError if the file is damaged.
    """
    with reading(source.place):
        return _blocks(source.place, Identity.of(source.place), index)


@dataclasses.dataclass(frozen=True)
class _Opened:
    header: Header
    reference: Reference


@functools.lru_cache(_FILES)
def _opened(place: Place, identity: Identity) -> _Opened:
    """``identity`` is that of the file now, so that what is kept is not of another."""
    return _Opened(*open_las(place, tables=False))


def _blocks(place: Place, identity: Identity, index: Path | None) -> Blocks:
    header = _opened(place, identity).header
    if index is None or (header.is_copc and isinstance(place, Remote)):
        return _unchecked(place, identity)
    name = hashlib.sha256(str(place.absolute()).encode()).hexdigest()[:24]
    path = Path(index) / name[:2] / f"{name[2:]}.npz"  # folders of some thousand files for a million
    kept = None
    with contextlib.suppress(OSError):  # there is none yet
        kept = _loaded(path, Identity.of(path), header.fingerprint)
    if kept is None:
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
            return copc.nodes(header, file)
    found = _measured(place)
    return dataclasses.replace(found, checksum=np.full_like(found.checksum, -1))


def _measured(place: Place) -> Blocks:
    """By a pass over the file; warns of points that its header denies, since surveys are planned by headers."""
    header = open_las(place)[0]
    if header.is_copc:
        with header.open(sequential=True) as file:
            return summed(header, file, copc.nodes(header, file))
    found = measured(header)
    if len(found):
        (low, high), slack = header.extent, header.scales[:2]
        beyond = ((found.low < low[:2] - slack) | (found.high > high[:2] + slack)).any(axis=1)
        if beyond.any():
            warn(f"{place}: points lie outside the extent that its header states; write the file anew to correct that")
    return found


def _window(opened: _Opened, blocks: Blocks, box: Bounds, source: Source, chosen: dict[str, Any]) -> Window:
    blocks = blocks.meeting(box)
    numbers = [np.zeros(0, np.int64)]

    def chunks() -> Iterator[np.ndarray]:
        for records, record in within(opened.header, blocks, box):
            numbers.append(record)
            yield records

    most = int(blocks.points.sum())
    cloud = las_cloud(opened.header, opened.reference, source.units, box, chosen, None, chunks(), most)
    return Window(cloud, np.concatenate(numbers))
