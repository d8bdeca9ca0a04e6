"""From labels of tiles to files: each input file is written once all its tiles are done, with nothing but classes changed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, OutputError
from ..files.disk import Identity, Seal
from ..files.handles import Handle
from ..files.reading import open_las
from ..files.sources import Source
from ..files.storage import Place, place_of
from ..files.windows import blocks_of
from ..files.writing import write
from .task import CANDIDATE, GROUND, NOISE, Job, heard, labelled, load_labels

_STORED = 0x80


@dataclasses.dataclass(frozen=True)
class FileTask:
    """A file to be written: its number, the tiles that label it, and where it goes."""

    number: int
    source: Source
    tiles: tuple[int, ...]
    target: Place
    overwrite: bool


@dataclasses.dataclass(frozen=True)
class FileReport:
    """What became of a file: numbers of its points and of those that are ground, what was warned of, and what was written."""

    number: int
    points: int
    ground: int
    remarks: tuple[str, ...]
    seal: Seal


def target_names(uris: list[str]) -> list[str]:
    """The name of the output for each input: the input's, but plain LAZ for COPC.

    Raises: OutputError if two outputs would have one name.
    """
    names = []
    seen: dict[str, str] = {}
    for uri in uris:
        name = place_of(uri).name  # of a signed URL without the signature
        if name.lower().endswith(".copc.laz"):
            name = name[: -len(".copc.laz")] + ".laz"
        if name in seen:
            raise OutputError(f"{seen[name]} and {uri} would both be written as {name}: filter them into two folders")
        seen[name] = uri
        names.append(name)
    return names


def write_file(job: Job, task: FileTask) -> FileReport:
    """Write a file with the labels of its tiles.

    Raises: InputError if a point has no label, or the file has changed; OutputError.
    """
    label, extra = collected(job, task, dict.fromkeys(job.extra, np.float32))
    with heard() as remarks:
        cloud = handle_of(job, task.source, (label & CANDIDATE) > 0)
        ground = (label & GROUND) > 0
        result = labelled(ground, (label & NOISE) > 0, extra)
        write(task.target, cloud, result, overwrite=task.overwrite, extra=job.extra, **job.classes)
    return FileReport(task.number, len(label), int(ground.sum()), tuple(remarks), Seal.of(task.target))


def collected(job: Job, task: FileTask, kinds: Mapping[str, type]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """u8[n]: the labels of all points of a file, from its tiles, and f[n]: quantities of such ``kinds``.

    Raises: InputError if a point has none.
    """
    source = task.source
    label = np.zeros(source.count, np.uint8)
    quantities: dict[str, np.ndarray] = {name: np.full(source.count, np.nan, kind) for name, kind in kinds.items()}
    for number in task.tiles:
        stored = load_labels(job.folder, number, task.number, quantities)
        if stored is None:
            continue
        record, value, *columns = stored
        label[record] = value | _STORED
        for array, values in zip(quantities.values(), columns, strict=True):
            array[record] = values
    missing = int(np.count_nonzero(label == 0))
    if missing:
        raise InputError(
            f"{source.uri}: {missing:,} of {source.count:,} points lie outside of the bounds in its header, so no tile holds "
            "them: correct the header"
        )
    return label, quantities


def handle_of(job: Job, source: Source, candidate: np.ndarray) -> PointCloud:
    """The cloud of a file, without its coordinates, which stay in the file. Raises: InputError if the file has changed."""
    place = source.place
    identity = Identity.of(place)
    if source.identity and open_las(place, tables=False)[0].fingerprint != source.identity:
        raise InputError(f"{source.uri}: the file has changed since the run began; begin anew")
    n = len(candidate)
    handle = Handle(place.absolute(), "las", source.format, n, None, identity, None, blocks_of(source, job.index))
    return PointCloud(
        origin=np.zeros(3),
        xyz=np.broadcast_to(np.zeros(3, np.float32), (n, 3)),
        candidate=candidate,
        units=source.units,
        source=handle,
    )
