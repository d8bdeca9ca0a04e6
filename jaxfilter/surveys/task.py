"""One tile: its points are read across files, filtered together with their surroundings, and the labels put on disk.

Everything here is a function of paths and numbers, so that it can be run in any process that sees the same files, again
and again, with the same outcome.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import time
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ..core.cloud import QUANTUM, PointCloud, Whole, overlap_counts
from ..core.compilation import cache_warning
from ..core.errors import InputError, JaxfilterWarning
from ..core.filter import Filter
from ..core.inputs import COLUMNS
from ..core.result import Decision, FilterResult, Status
from ..files.disk import Bounds, Seal, told_of
from ..files.sources import Source
from ..files.windows import read_window
from ..files.writing import class_changes
from .border import CutObject, cut_objects

ANCHOR = (0.0, 0.0)
"""File coordinates that all grids of a run are aligned to: the same tile gets the same labels in any collection."""

CANDIDATE, GROUND, NOISE = 1, 2, 4
"""Bits of a stored label."""

_PER_FOLDER = 1000


@dataclasses.dataclass(frozen=True)
class Job:
    """What all tiles of a run have in common.

    Attributes:
        filter: set up for the whole collection.
        reading: ``returns``, ``ignore_classes``, ``ignore_overlap``, ``keep_withheld``, ``drop_invalid`` of
            :func:`jaxfilter.read`.
        classes: ``ground_class``, ``other_class``, ``reset``, ``only_ground``, ``noise_class`` of :func:`jaxfilter.write`.
        extra: quantities of the result that are written along.
        whole: of the collection.
        folder: where labels are kept until a file is complete; all processes see it.
        index: where :func:`jaxfilter.files.windows.read_window` keeps what it finds out about files.
    """

    filter: Filter
    reading: dict[str, Any]
    classes: dict[str, Any]
    extra: tuple[str, ...]
    whole: Whole
    folder: Path
    index: Path


@dataclasses.dataclass(frozen=True)
class Tile:
    """A tile to be filtered.

    Attributes:
        number: in the plan.
        core, window: without and with the halo, file coordinates, half open.
        files: numbers of the files that the window meets; sources: the same files.
        patient: leave out a file that cannot be read, and go on without its points.
    """

    number: int
    core: Bounds
    window: Bounds
    files: tuple[int, ...]
    sources: tuple[Source, ...]
    patient: bool = False


@dataclasses.dataclass(frozen=True)
class TileReport:
    """What became of a tile.

    Attributes:
        points, candidates, ground: of its core.
        read: points of core and halo.
        seconds: that it took.
        classes: points of the core by (old class, new class).
        status: name of the filter's :class:`jaxfilter.Status`.
        remarks: what was warned of.
        left_out: numbers of files that could not be read, with the reason.
        cut_objects: what the border of the data cuts, where the core holds the first place that touches it.
        heights: lowest and highest height above ground in the core, units of Z; uncertain: points of the core whose height may
            be another in the whole.
        seal: of what was kept.
        overlap: see :func:`jaxfilter.core.cloud.overlap_counts`.
    """

    number: int
    points: int
    candidates: int
    ground: int
    read: int
    seconds: float
    classes: dict[tuple[int, int], int]
    status: str
    seal: Seal
    remarks: tuple[str, ...] = ()
    left_out: tuple[tuple[int, str], ...] = ()
    cut_objects: tuple[CutObject, ...] = ()
    heights: tuple[float, float] | None = None
    uncertain: int = 0
    overlap: dict[str, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class Around:
    """The points of a tile and its halo.

    Attributes:
        cloud: n points, files one after the other.
        file: i32[n], the number of the file; record: i64[n], the record in it.
        core: bool[n], points that the tile labels.
        left_out: as in :class:`TileReport`.
    """

    cloud: PointCloud
    file: np.ndarray
    record: np.ndarray
    core: np.ndarray
    left_out: tuple[tuple[int, str], ...]


def filter_tile(job: Job, tile: Tile) -> TileReport:
    """Label the points of the core of a tile and put the labels into the folder of the job.

    Raises: InputError, if a file cannot be read and the tile is not ``patient``; ParameterError.
    """
    start = time.perf_counter()
    with heard() as remarks:
        around = read_tile(job, tile)
        result = job.filter(around.cloud, workers=1)
        own = np.flatnonzero(around.core)
        cloud, labels, noise = part_of(around.cloud, own), result.ground[own], result.low_noise[own]
        quantities = {name: getattr(result, name)[own] for name in job.extra}
        seal = store(job, tile.number, around, result.ground, quantities, result.low_noise)
        changes = class_changes(cloud, labelled(labels, noise), **job.classes)
        cut = cut_at_border(around.cloud, result, tile)
    return TileReport(
        tile.number,
        len(own),
        int(cloud.candidate.sum()),
        int(labels.sum()),
        len(around.cloud),
        time.perf_counter() - start,
        changes,
        Status(result.status).name,
        seal,
        tuple(remarks),
        around.left_out,
        tuple(cut),
        overlap=overlap_counts(cloud, labels),
    )


def cut_at_border(cloud: PointCloud, result: FilterResult, tile: Tile) -> list[CutObject]:
    """Objects of a tile and its halo that the border of the data cuts, as far as they are this tile's to list."""
    footprints = [source.bounds for source in tile.sources if source.count]
    return cut_objects(cloud, result, footprints=footprints, window=tile.window, core=tile.core)


def survey_tile(job: Job, tile: Tile) -> float | None:
    """Elevation of the lowest point of the core that the filter lets count (``Filter.lowest``), file units; None without any.

    Raises: as :func:`filter_tile`.
    """
    with heard():
        around = read_tile(job, tile)
        points = job.filter.points_of(around.cloud)
        if len(points) == 0 or not points.has_area():
            return None
        counts = job.filter.lowest(points)
    assert counts is not None
    member = around.core[points.index]
    low = points.xyz[points.member[member & counts[points.member]], 2]
    cloud = around.cloud
    return float(cloud.origin[2] + float(low.min()) / cloud.units.z) if len(low) else None


def read_tile(job: Job, tile: Tile) -> Around:
    """The points of a tile and its halo, out of all its files. Raises: InputError unless the tile is ``patient``.

    What is inside is decided by the quantised coordinates that the filter sees, which are the same in every tile.
    """
    clouds, files, records, cores, left_out = [], [], [], [], []
    for number, source in zip(tile.files, tile.sources, strict=True):
        slack = 4 * QUANTUM / source.metre
        wide = tuple(v + step for v, step in zip(tile.window, (-slack, -slack, slack, slack), strict=True))
        try:
            window = read_window(source, wide, job.index, anchor=ANCHOR, **job.reading)  # type: ignore[arg-type]
        except InputError as error:
            if not tile.patient:
                raise
            left_out.append((number, str(error)))
            continue
        if len(window.cloud) == 0:
            continue
        cloud, record = window.cloud, window.record
        within = inside(cloud, tile.window)
        if not within.all():
            cloud, record = part_of(cloud, within), record[within]
        clouds.append(cloud)
        cores.append(inside(cloud, tile.core))
        files.append(np.full(len(cloud), number, np.int32))
        records.append(record)
    file, record, core = (
        np.concatenate([np.zeros(0, kind), *parts])
        for kind, parts in ((np.int32, files), (np.int64, records), (bool, cores))
    )
    return Around(joined(clouds, job.whole), file, record, core, tuple(left_out))


def inside(cloud: PointCloud, box: Bounds) -> np.ndarray:
    """bool[n]: points in a box in file coordinates, half open, as the quantised coordinates have it. Invalid points lie at
    the corner of the cloud, and are inside where that is."""
    inside = np.ones(len(cloud), bool)
    for axis in range(2):
        metres = np.rint(cloud.origin[axis] * cloud.units.xy) + cloud.xyz[:, axis].astype(np.float64)
        inside &= (metres >= box[axis] * cloud.units.xy) & (metres < box[axis + 2] * cloud.units.xy)
    return inside


def joined(clouds: Sequence[PointCloud], whole: Whole | None = None) -> PointCloud:
    """One cloud of several with one anchor, one after the other; exact, since their origins are whole metres apart."""
    if not clouds:
        return PointCloud.from_arrays(np.zeros((0, 3)), anchor=ANCHOR, whole=whole)
    first = clouds[0]
    if len(clouds) == 1:
        return dataclasses.replace(first, source=None, whole=whole)
    factor = np.array([first.units.xy, first.units.xy, first.units.z])
    origin = np.min([cloud.origin for cloud in clouds], axis=0)
    shifts = [np.rint((cloud.origin - origin) * factor).astype(np.float32) for cloud in clouds]
    columns: dict[str, Any] = {}
    for name, empty in (
        ("return_number", 1), ("number_of_returns", 1), ("classification", 0), ("withheld", False), ("overlap", False),
        ("valid", True),
    ):  # fmt: skip
        parts = [getattr(cloud, name) for cloud in clouds]
        if any(part is not None for part in parts):
            kind = next(part.dtype for part in parts if part is not None)
            filled = [
                np.full(len(cloud), empty, kind) if part is None else part
                for cloud, part in zip(clouds, parts, strict=True)
            ]
            columns[name] = np.concatenate(filled)
    return PointCloud(
        origin=origin,
        xyz=np.concatenate([cloud.xyz + shift for cloud, shift in zip(clouds, shifts, strict=True)]),
        candidate=np.concatenate([cloud.candidate for cloud in clouds]),
        crs=first.crs,
        units=first.units,
        anchor=first.anchor,
        whole=whole,
        **columns,
    )


def part_of(cloud: PointCloud, rows: np.ndarray) -> PointCloud:
    """The points of some rows, i64[k] or bool[n], without their file."""
    arrays = {name: getattr(cloud, name) for name in ("xyz", *COLUMNS, "candidate", "reference", "valid")}
    parts: dict[str, Any] = {name: None if array is None else array[rows] for name, array in arrays.items()}
    return dataclasses.replace(cloud, source=None, **parts)


def labelled(
    ground: np.ndarray, noise: np.ndarray, extra: Mapping[str, np.ndarray] = MappingProxyType({})
) -> FilterResult:
    """A result of labels and low outliers, bool[n] each, and of quantities f32[n] by name; others are NaN."""
    n = len(ground)
    empty: Any = np.broadcast_to(np.float32(np.nan), n)
    quantities = {name: extra.get(name, empty) for name in ("height", "slope", "angle", "elevation", "margin")}
    quantities["height"] = np.where(noise & np.isnan(quantities["height"]), np.float32(-np.inf), quantities["height"])
    return FilterResult(
        ground=ground,
        decision=np.broadcast_to(np.uint8(Decision.SET_ASIDE), n),
        barred=noise,
        status=Status.CONVERGED,
        info={},
        trace=[],
        doubt=extra.get("doubt"),
        **quantities,
    )


def labels_path(folder: Path, number: int) -> Path:
    """Where the labels of a tile are."""
    return folder / "labels" / str(number // _PER_FOLDER) / f"{number}.npz"


def load_labels(folder: Path, number: int, file: int, names: Iterable[str]) -> tuple[np.ndarray, ...] | None:
    """Records i64[k] of a file, labels u8[k], and f[k] of every further quantity, as a tile has them; None if it has none."""
    with np.load(labels_path(folder, number)) as stored:
        if f"record_{file}" not in stored:
            return None
        return tuple(stored[f"{name}_{file}"] for name in ("record", "label", *names))


def store(
    job: Job,
    number: int,
    around: Around,
    ground: np.ndarray,
    quantities: dict[str, np.ndarray],
    noise: np.ndarray | None = None,
) -> Seal:
    """Write what was found of a tile, whole or not at all.

    ``ground``, ``noise``: bool[n], of all its points; ``quantities``: f[k], of points of the core.
    """
    arrays: dict[str, np.ndarray] = {}
    own = np.flatnonzero(around.core)
    label = around.cloud.candidate[own] * np.uint8(CANDIDATE) | ground[own] * np.uint8(GROUND)
    if noise is not None:
        label |= noise[own] * np.uint8(NOISE)
    file = around.file[own]
    for one in np.unique(file):
        rows = file == one
        arrays[f"record_{one}"] = around.record[own[rows]]
        arrays[f"label_{one}"] = label[rows]
        arrays |= {f"{name}_{one}": values[rows] for name, values in quantities.items()}
    return keep(labels_path(job.folder, number), lambda file: np.savez(file, **arrays))  # type: ignore[arg-type]


def keep(path: Path, save: Callable[[Any], None]) -> Seal:
    """A file of a run that other processes read: whole or not at all, by ``save`` into an open file. Raises: OutputError."""
    with told_of(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{uuid.uuid4().hex}.part")
        try:
            with open(part, "xb") as stream:
                save(stream)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
        return Seal.of(path)


@contextlib.contextmanager
def heard() -> Iterator[list[str]]:
    """A block whose warnings of this package are listed, each once, instead of being shown."""
    remarks: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", JaxfilterWarning)
        warnings.filterwarnings("always", "Error .* persistent compilation cache entry")
        yield remarks
        texts = [str(w.message) for w in caught]
        others = [text for text in texts if not cache_warning(text)]  # where it is one, it warns in its turn
        remarks += dict.fromkeys(others + [str(w.message) for w in caught[len(texts) :]])
