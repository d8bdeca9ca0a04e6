"""Tiles: their points are read across files, together with what surrounds them.

Everything here is a function of paths and numbers, so that it can be run in any process that sees the same files, again
and again, with the same outcome.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextvars import ContextVar
from typing import Any

import numpy as np

from ..core.cloud import QUANTUM, PointCloud, Whole
from ..core.errors import InputError
from ..core.inputs import COLUMN_TYPES
from ..core.reading import Bounds, Reading
from ..core.result import Progress, silent
from ..files.sources import Source, read_window
from .area import within
from .collection import common

_LEAST = 1e-9
"""Share of the smaller of two files from which on they overlap."""


@dataclasses.dataclass(frozen=True)
class Local:
    """What the tile that is done now may use: threads (None = one per processor), and a callback for progress."""

    threads: int | None = 1
    progress: Progress = silent


LOCAL: ContextVar[Local] = ContextVar("LOCAL", default=Local())  # noqa: B039


@dataclasses.dataclass(frozen=True)
class Tile:
    """A tile to be worked on.

    Attributes:
        number: in the plan.
        core, window: without and with the halo, file coordinates, half open; None = everything there is.
        files: numbers of the files that the window meets; sources: the same files.
        patient: leave out a file that cannot be read, and go on without its points.
    """

    number: int
    core: Bounds | None
    window: Bounds | None
    files: tuple[int, ...]
    sources: tuple[Source, ...]
    patient: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Around:
    """The points of a tile and its halo.

    Attributes:
        cloud: n points, files one after the other.
        file: i32[n], the number of the file; record: i64[n], the record in it.
        core: bool[n], points that the tile labels.
        left_out: files that could not be read: number, and reason.
        repeated: how many points of the core were left out of each file, since another file has the same echoes.
    """

    cloud: PointCloud
    file: np.ndarray
    record: np.ndarray
    core: np.ndarray
    left_out: dict[int, str]
    repeated: dict[int, int]

    @property
    def own(self) -> np.ndarray:
        """i64[k]: the points of the core."""
        return np.flatnonzero(self.core)


_KEPT: list[tuple[Any, Around]] = []
"""Points of the tile that was read last, if they are to be used once more."""


def read_tile(tile: Tile, reading: Reading, whole: Whole | None, keep: bool = False) -> Around:
    """The points of a tile and its halo, out of all its files. Raises: InputError unless the tile is ``patient``.

    What is inside is decided by the quantised coordinates that the filter sees, which are the same in every tile. With ``keep``
    they are kept for whoever asks next in this process.
    """
    key = (tile.window, tile.sources, reading)
    known, around = _KEPT.pop() if _KEPT else (None, None)
    if around is None or known != key:
        around = None  # let go of them before others are read
        around = _read(tile, reading, whole)
    if keep:
        _KEPT.append((key, around))
    if whole is None and tile.core is None:
        return around  # the same cloud again: what is known of its order and spacing need not be found out anew
    return dataclasses.replace(around, cloud=dataclasses.replace(around.cloud, whole=whole, core=tile.core))


def _read(tile: Tile, reading: Reading, whole: Whole | None) -> Around:
    clouds, numbers, records, cores = [], [], [np.zeros(0, np.int64)], [np.zeros(0, bool)]
    keys, shared = [np.zeros(0, np.uint64)], _overlapping(tile) if reading.drop_duplicates else set()
    left_out: dict[int, str] = {}
    for number, source in zip(tile.files, tile.sources, strict=True):
        box = reading.bounds
        if tile.window is not None:  # a little wider
            (x0, y0, x1, y1), slack = tile.window, 4 * QUANTUM / source.metre
            wide = (x0 - slack, y0 - slack, x1 + slack, y1 + slack)
            box = wide if box is None else common(wide, box)
        if box is not None and not (box[0] < box[2] and box[1] < box[3]):
            continue
        try:
            window = read_window(source, box, reading, number in shared)
        except InputError as error:
            if not tile.patient:
                raise
            left_out[number] = str(error)
            continue
        cloud, record = window.cloud, window.record
        key = np.zeros(len(cloud) if shared else 0, np.uint64) if window.key is None else window.key
        there = inside(cloud, tile.window)
        if not there.all():
            cloud, record, key = part_of(cloud, there), record[there], key[there] if shared else key
        if len(cloud):
            clouds.append(cloud)
            own = inside(cloud, tile.core)
            if reading.aoi is not None:
                own &= within(reading.aoi, *cloud.coordinates()[:, :2].T)
            cores.append(own)
            numbers.append(number)
            records.append(record)
            keys.append(key)
    file = np.repeat(np.array(numbers, np.int32), [len(cloud) for cloud in clouds])
    cloud, record, core = joined(clouds, whole, reading), np.concatenate(records), np.concatenate(cores)
    again, repeated = _again(cloud, file, np.concatenate(keys)) if shared else None, {}
    if again is not None and again.any():
        repeated = dict(zip(*(v.tolist() for v in np.unique(file[again & core], return_counts=True)), strict=True))
        cloud, file, record, core = part_of(cloud, ~again), file[~again], record[~again], core[~again]
    return Around(cloud, file, record, core, left_out, repeated)


def _overlapping(tile: Tile) -> set[int]:
    """The files of a tile that overlap with others. Text is left out, since it has nothing but coordinates to compare."""
    from .findings import Footprints  # late: few files overlap

    rows = [row for row, source in enumerate(tile.sources) if source.format != "text"]
    pairs, _ = Footprints(np.array([tile.sources[row].bounds for row in rows]).reshape(-1, 4)).overlaps(_LEAST)
    return {tile.files[rows[row]] for row in pairs.ravel().tolist()}


def _again(cloud: PointCloud, file: np.ndarray, key: np.ndarray) -> np.ndarray:
    """bool[n]: echoes that another file has as well, but in one file, the first in which they are not withheld.

    ``file``: i32[n]; ``key``: u64[n], 0 = there is none. Points count as the same only if their coordinates are equal, too, so
    different ones are taken for the same in one of 2**64 cases of two at one place.
    """
    ordered = np.sort(key[key > 0])
    rows = np.flatnonzero(np.isin(key, ordered[1:][ordered[1:] == ordered[:-1]]))
    _, start, group = np.unique(key[rows], return_index=True, return_inverse=True)
    rank = file[rows] + (0 if cloud.withheld is None else cloud.withheld[rows]) * np.int64(2**31)
    first = np.full(len(start), 2**62)
    np.minimum.at(first, group, rank)
    equal = (cloud.xyz[rows] == cloud.xyz[rows[start]][group]).all(axis=1)
    again = np.zeros(len(cloud), bool)
    again[rows] = equal & (file[rows] != first[group] % 2**31)
    return again


def inside(cloud: PointCloud, box: Bounds | None) -> np.ndarray:
    """bool[n]: points in a box in file coordinates, half open, as the quantised coordinates have it. Invalid points lie at
    the corner of the cloud, and are inside where that is."""
    inside = np.ones(len(cloud), bool)
    if box is None:
        return inside
    for axis in range(2):
        metres = np.rint(cloud.origin[axis] * cloud.units.xy) + cloud.xyz[:, axis].astype(np.float64)
        inside &= (metres >= box[axis] * cloud.units.xy) & (metres < box[axis + 2] * cloud.units.xy)
    return inside


def joined(clouds: Sequence[PointCloud], whole: Whole | None = None, reading: Reading = Reading()) -> PointCloud:
    """One cloud of several with one anchor, one after the other; exact, since their origins are whole metres apart."""
    if not clouds:
        return PointCloud.from_arrays(np.zeros((0, 3)), anchor=reading.anchor, whole=whole)
    first = clouds[0]
    if len(clouds) == 1:
        return dataclasses.replace(first, whole=whole)
    origin = np.min([cloud.origin for cloud in clouds], axis=0)
    shifts = [np.rint((cloud.origin - origin) * first.units.factor).astype(np.float32) for cloud in clouds]
    columns: dict[str, Any] = {}
    for name in (*COLUMN_TYPES, "reference", "valid"):
        parts = [getattr(cloud, name) for cloud in clouds]
        if kinds := [part.dtype for part in parts if part is not None]:
            empty = np.array(name in ("return_number", "number_of_returns", "valid"), kinds[0])
            filled = zip(clouds, parts, strict=True)
            columns[name] = np.concatenate([np.full(len(c), empty) if part is None else part for c, part in filled])
    xyz = np.concatenate([cloud.xyz + shift for cloud, shift in zip(clouds, shifts, strict=True)])
    candidate = np.concatenate([cloud.candidate for cloud in clouds])
    return dataclasses.replace(
        first, origin=origin, xyz=xyz, candidate=candidate, source=None, whole=whole, core=None, **columns
    )


def part_of(cloud: PointCloud, rows: np.ndarray) -> PointCloud:
    """The points of some rows, i64[k] or bool[n], without their file."""
    if len(rows) == len(cloud) and rows.dtype != bool:
        return dataclasses.replace(cloud, source=None)
    arrays = {name: getattr(cloud, name) for name in ("xyz", *COLUMN_TYPES, "candidate", "reference", "valid")}
    parts: dict[str, Any] = {name: None if array is None else array[rows] for name, array in arrays.items()}
    return dataclasses.replace(cloud, source=None, **parts)
