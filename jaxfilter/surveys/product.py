"""What is made of every tile, and of every file whose tiles are done; and labels of tiles, on their way into files."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ..core.cloud import PointCloud, Whole
from ..core.errors import InputError
from ..core.filter import Filter, lowest_among
from ..core.points import has_area
from ..core.reading import Reading
from ..files.classes import Found
from ..files.sources import Source, file_cloud
from ..files.storage import Place, place_of
from .collection import Collection
from .options import RunOptions
from .report import RunReport, Summary, collected_warnings
from .targets import Targets
from .tiles import Around, Tile, read_tile

CANDIDATE, GROUND, _STORED, _CODE = 1, 2, 0x80, 2
"""Bits of a label, and the bit at which the number of what was found begins."""
KEPT = "kept_"
"""What arrays begin with that are kept until the run is complete; others go when the files that need them are written."""


@dataclasses.dataclass(frozen=True)
class FileTask:
    """A file to be written: its number, the tiles that label it, and where it goes.

    ``how``: of ``write_cloud``, whether it may replace a file, or what is written first if it takes the place of an input.
    """

    number: int
    source: Source
    tiles: tuple[int, ...]
    target: Place
    how: dict[str, Any]


class Memory:
    """What is found of the one tile of a small file, until its outputs are written.

    Attributes:
        path: a folder for temporary files; None = the system's.
    """

    path: Path | None = None

    def __init__(self) -> None:
        self._arrays: dict[str, np.ndarray] = {}

    def put(self, number: int, arrays: Mapping[str, np.ndarray], summary: Summary) -> None:
        """Keep what was found of a tile. Raises: OutputError."""
        self._arrays = dict(arrays)

    def arrays(self, number: int, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """What was found of the points of a tile; ``names``: those of it that are there. Raises: InputError if it is gone."""
        return self._arrays if names is None else {name: self._arrays[name] for name in names if name in self._arrays}

    def put_seal(self, task: FileTask, remarks: list[str]) -> None:
        """Note that a file is written, and what was warned of. Raises: OutputError."""

    def discard(self) -> None:
        """Remove all that is kept. Raises: OutputError."""
        self._arrays = {}


@dataclasses.dataclass(frozen=True)
class Cut:
    """What decides on tiles, in metres.

    Attributes:
        halo: how far around a tile points are read as well. lattice: tiles and windows end at multiples of it.
        reach: how far around a tile files may be asked for, by default as far as the halo.
        beyond: how far around points something is made.
        boxes: the tiles themselves, f64[t, 2, 4], core and window of each, file units; then nothing else counts.
    """

    halo: float
    lattice: float
    reach: float | None = None
    beyond: float = 0.0
    boxes: np.ndarray | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Product:
    """What is made of every tile. A subclass says how, in ``tile``; ``REPORT`` is what is said in the end.

    Attributes:
        reading: which points count; where it has ``bounds``, points outside are not there.
        halo: metres around each tile that the filter sees as well; None = as the filter says.
        whole, store, filter: measures of the scene, what is kept of tiles, and what finds the ground (None if classes say what it
            is), as the run sets them.
    """

    REPORT: ClassVar[type[RunReport]] = RunReport
    reading: Reading
    halo: float | None
    whole: Whole | None = None
    store: Memory = dataclasses.field(default_factory=Memory)
    filter: Filter | None = None

    def cut(self) -> Cut:
        """The tiles that it is made in."""
        raise NotImplementedError

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Arrays that are kept until the output is written, by name, and a summary. Raises: InputError, ParameterError."""
        raise NotImplementedError

    def file(self, task: FileTask) -> None:
        """Write a file whose tiles are done. Raises: InputError, OutputError."""
        raise NotImplementedError

    def complete(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Complete the report of a run whose tiles are done. Raises: as :meth:`finish`."""
        if self.reading.bounds is not None and collection.count and not report.points and not report.left_out:
            for place in map(place_of, report.files):  # they have no points
                place.unlink() if isinstance(place, Path) else place.remove()
            self.store.discard()
            raise collection.nothing_in(self.reading.bounds)
        report.failed += [{"file": name, "reason": reason} for name, reason in collection.unreadable]
        report.total.classes = Counter(dict(sorted(report.total.classes.items())))
        if self.filter is not None:
            report.method, report.parameters = type(self.filter).__name__, dataclasses.asdict(self.filter)  # type: ignore[call-overload]
        report.measures = None if self.whole is None else dataclasses.asdict(self.whole)
        self.finish(report, collection, targets, options)

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Make the one output of all tiles, and complete the report of the run. Raises: InputError, OutputError."""

    def read(self, tile: Tile, summary: Summary) -> Around:
        """The points of a tile and its halo; how many they are, and the time, goes into the summary. Raises: InputError."""
        start = time.perf_counter()
        around = read_tile(tile, self.reading, self.whole)
        summary.seconds["read"] += time.perf_counter() - start
        summary.points, summary.read, summary.unread = len(around.own), len(around.cloud), around.left_out
        return around

    def kept(self, report: RunReport, names: Sequence[str]) -> Iterator[dict[str, np.ndarray]]:
        """Arrays of such names, of each tile that has kept some of them for the end of the run."""
        done = np.flatnonzero(report.table["ground"] != -1).tolist()
        return filter(None, (self.store.arrays(number, names) for number in done))

    def collected(self, task: FileTask, kinds: Mapping[str, type]) -> tuple[PointCloud, Found, dict[str, np.ndarray]]:
        """What stands for the points of a file, what tiles have found of them, and f[n]: quantities of such ``kinds``.

        Raises: InputError if a point has no label.
        """
        source, reading = task.source, self.reading
        label, quantities, repeated = gathered(self.store, task, kinds)
        rows = label > 0
        missing = int(np.count_nonzero(~rows)) - repeated
        if missing and reading.bounds is None and reading.aoi is None:
            raise InputError(
                f"{source.uri}: {missing:,} of {source.count:,} points lie outside of the bounds in its header, so no tile "
                "holds them: correct the header"
            )
        if not rows.all():
            label, quantities = label[rows], {name: values[rows] for name, values in quantities.items()}
        candidate = (label & CANDIDATE) > 0
        if reading.aoi is None and not repeated:
            cloud = file_cloud(source, candidate, bounds=reading.bounds)
        else:
            cloud = file_cloud(source, candidate, rows=rows)
        return cloud, found_in(label), quantities

    @property
    def writes_files(self) -> bool:
        """Whether there is an output for each input."""
        return type(self).file is not Product.file

    def facts(self) -> dict[str, Any]:
        """What decides on the outcome besides files, filter, reading and tiles."""
        return {}


def do_tile(product: Product, tile: Tile, last: bool = True) -> Summary:
    """Work on a tile, and keep what was found of it: a summary with what was warned of. ``last``: this is not tried again, so
    that a file that cannot be read is left out, if there are others.

    Raises: as ``Product.tile``; OutputError.
    """
    with collected_warnings() as remarks:
        arrays, summary = product.tile(dataclasses.replace(tile, patient=tile.patient and last))
    summary.remarks.update(remarks)
    product.store.put(tile.number, arrays, summary)
    return summary


def write_file(product: Product, task: FileTask, last: bool = True) -> tuple[float, list[str]]:
    """Write a file: seconds, and what was warned of; whether it is tried again changes nothing. Raises: as ``Product.file``."""
    start = time.perf_counter()
    with collected_warnings() as remarks:
        product.file(task)
    product.store.put_seal(task, remarks)
    return time.perf_counter() - start, remarks


def sees_lowest(filter_: Filter | None) -> bool:
    """Whether a filter asks for the elevation of the lowest point of all data."""
    return lowest_among.dispatch(type(filter_)) is not lowest_among.dispatch(object)


def lowest_in_tile(product: Product, tile: Tile, last: bool = True) -> float | None:
    """Elevation of the lowest point of the core that the filter lets count (``lowest_among``), file units; None without any.
    Of a tile that is everything the points are kept. ``last``, raises: as of :func:`do_tile`."""
    assert product.filter is not None
    with collected_warnings():
        tile = dataclasses.replace(tile, patient=tile.patient and last)
        around = read_tile(tile, product.reading, product.whole, keep=tile.core is None)
        points = product.filter.points_of(around.cloud)
        if len(points) == 0 or not has_area(points.xyz):
            return None
        counts = lowest_among(product.filter, points)
    assert counts is not None
    member = around.core[points.index]
    low = points.xyz[points.member[member & counts[points.member]], 2]
    cloud = around.cloud
    return float(cloud.origin[2] + float(low.min()) / cloud.units.z) if len(low) else None


def packed(around: Around, found: Found, quantities: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays of the core of a tile, file after file.

    ``label``: u8[k]; ``record``: i64[r], those of the file, or the first of k in succession; ``part``: i64[f, 4], a row for each
    file: its number, labels, records, and points that are left out since another file has them; and quantities f[k].

    ``found``: of all points of the tile; ``quantities``: f[k], of those of the core.
    """
    own = around.own
    label = around.cloud.candidate[own] * np.uint8(CANDIDATE) | found.ground[own] * np.uint8(GROUND)
    label |= found.code[own] << np.uint8(_CODE)
    file, record = around.file[own], around.record[own]  # files are ascending
    parts, records = [], [np.zeros(0, np.int64)]
    for one in sorted({*file[np.flatnonzero(np.diff(file, prepend=-1))].tolist(), *around.repeated}):
        rows = record[slice(*np.searchsorted(file, (one, one + 1)))]
        in_succession = len(rows) > 0 and rows[-1] - rows[0] == len(rows) - 1
        records.append(rows[:1] if in_succession else rows)
        parts.append((one, len(rows), len(records[-1]), around.repeated.get(one, 0)))
    part = np.array(parts, np.int64).reshape(-1, 4)
    return {"label": label, "record": np.concatenate(records), "part": part, **quantities}


def found_in(label: np.ndarray) -> Found:
    """What labels u8[n] say of points."""
    return Found((label & GROUND) > 0, (label & ~np.uint8(_STORED)) >> np.uint8(_CODE))


def gathered(store: Memory, task: FileTask, kinds: Mapping[str, type]) -> tuple[np.ndarray, dict[str, np.ndarray], int]:
    """u8[n]: the labels of all points of a file, 0 where there is none; f[n]: quantities; and how many points are left out, since
    they are in other files."""
    repeated = 0
    label = np.zeros(task.source.count, np.uint8)
    quantities: dict[str, np.ndarray] = {name: np.full(task.source.count, np.nan, kind) for name, kind in kinds.items()}
    for number in task.tiles:
        stored = store.arrays(number)
        if "part" not in stored:
            continue
        row = int(np.searchsorted(stored["part"][:, 0], task.number))
        if row == len(stored["part"]) or stored["part"][row, 0] != task.number:
            continue
        repeated += int(stored["part"][row, 3])
        ends = stored["part"][: row + 1, 1:3].cumsum(axis=0)
        (start, first), (stop, last) = ends[-1] - stored["part"][row, 1:3], ends[-1]
        record = stored["record"][first:last]
        rows = slice(record[0], record[0] + stop - start) if len(record) == 1 else record
        label[rows] = stored["label"][start:stop] | np.uint8(_STORED)
        for name, values in quantities.items():
            values[rows] = stored[name][start:stop]
    return label, quantities, repeated
