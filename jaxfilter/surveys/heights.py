"""Heights above ground of all points of a survey: the files of a collection in, as many files with heights out."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ..core.cloud import GROUND_CLASS
from ..core.errors import InputError
from ..core.filter import Filter
from ..core.result import Status
from ..files.disk import Seal
from ..files.writing import HEIGHT, class_changes, write
from ..terrain.models import heights_of
from .capacity import Layout
from .folder import Folder, run_in
from .options import RunOptions, begun
from .outputs import FileReport, FileTask, collected, handle_of
from .plan import Plan
from .run import RunReport, Step
from .surroundings import HALOS, Doubt, GroundJob, ground_job, surroundings
from .task import CANDIDATE, GROUND, Job, Tile, TileReport, cut_at_border, heard, labels_path, part_of, store

_GRAIN = 1.0  # metres
_CLASSES = {"ground_class": GROUND_CLASS, "other_class": 1, "reset": "ground", "only_ground": False}


@dataclasses.dataclass(frozen=True)
class HeightJob(GroundJob):
    """``replace_z``: heights take the place of Z."""

    replace_z: bool


def height_tile(job: HeightJob, tile: Tile) -> TileReport:
    """Heights of the points of a core above the ground in and around it, put into the folder of the job.

    Raises: InputError if there is no ground within the widest halo; as :func:`jaxfilter.surveys.task.filter_tile`.
    """
    start, heights, doubt = time.perf_counter(), None, None
    with heard() as remarks:
        for found in surroundings(job, tile):
            around, usable = found.around, found.usable
            own = np.flatnonzero(around.core)
            if not len(own):
                heights = np.zeros(0)
                break
            if usable.any():
                doubt = Doubt(around.cloud, job.data, found.near)
                heights = heights_of(around.cloud, usable, own, workers=1, look=doubt.look)
                if not doubt.count:
                    break
        if heights is None:
            raise InputError(
                f"no point within {HALOS[-1]:g} m of the tile {tile.core} is ground: classify the files first, or find the "
                "ground with a filter"
            )
        result = found.result
        seal = store(job, tile.number, around, found.ground, {HEIGHT: heights})
        cloud = part_of(around.cloud, own)
        changes = {} if result is None else class_changes(cloud, found.ground[own], **job.classes)
        cut = [] if result is None else cut_at_border(around.cloud, result, found.tile)
    return TileReport(
        tile.number,
        len(own),
        int(cloud.candidate.sum()),
        int(found.ground[own].sum()),
        len(around.cloud),
        time.perf_counter() - start,
        changes,
        Status.CONVERGED.name if result is None else Status(result.status).name,
        seal,
        tuple(remarks),
        around.left_out,
        tuple(cut),
        (float(heights.min()), float(heights.max())) if len(heights) else None,
        0 if doubt is None else doubt.count,
    )


def write_heights(job: HeightJob, task: FileTask) -> FileReport:
    """Write a file with the heights of its tiles, and classes if a filter found the ground.

    Raises: InputError if a point has none, or the file has changed; OutputError.
    """
    label, quantities = collected(job, task, {HEIGHT: np.float64})
    ground = (label & GROUND) > 0
    with heard() as remarks:
        cloud = handle_of(job, task.source, (label & CANDIDATE) > 0)
        result = ground if job.ground_classes is None else None
        write(
            task.target,
            cloud,
            result,
            overwrite=task.overwrite,
            heights=quantities[HEIGHT],
            replace_z=job.replace_z,
            **job.classes,
        )
    return FileReport(task.number, len(label), int(ground.sum()), tuple(remarks), Seal.of(task.target))


HEIGHTS = Step(height_tile, labels_path, write_heights)


def heights(
    what: Any,
    out: str | Path,
    finder: type[Filter] | None = None,
    changes: dict[str, Any] | None = None,
    *,
    replace_z: bool = False,
    units: str | None = None,
    largest_building: float | None = None,
    ground_classes: Iterable[int] = (GROUND_CLASS,),
    **run: Unpack[RunOptions],
) -> RunReport:
    """Write the files of a collection with the height of every point above the ground, tile by tile and without seams.

    Heights are those of :func:`jaxfilter.height_above_ground` for all files together, but for points over voids so wide that
    320 m of surroundings do not settle their triangle (``RunReport.uncertain``), and for 20 m along the edge of the data.

    Args:
        finder: the method that finds the ground, whose classes are then written as well; by default the points of
            ``ground_classes`` are it, less withheld ones.
        changes: its fields. largest_building: metres, as in ``Filter.for_cloud``.
        replace_z: put heights in place of Z instead of into the extra dimension ``HeightAboveGround``.
        what, out, units: as in :func:`jaxfilter.ground`.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: RunReport; what could not be done is in it. Tiles without ground within 320 m are set aside.
    Raises: InputError, ParameterError, OutputError before anything is done, JaxfilterError if workers cannot be started;
    OutputError if the journal cannot be written.

    >>> report = jf.heights("survey", "heights", units="m", workers=1)
    >>> len(report.files), report.points == len(cloud), report.heights[0] < 1 < report.heights[1]
    (2, True, True)
    """
    collection = begun("heights", what, units, run)
    folder = Folder.prepared(out, collection, run)

    def prepared(most: float | None) -> tuple[Job, Layout, Plan, dict[str, Any]]:
        job, cut, plan = ground_job(
            HeightJob,
            collection,
            finder,
            changes or {},
            largest_building=largest_building,
            ground_classes=ground_classes,
            grain=_GRAIN,
            run=run,
            most_points=most,
            classes=_CLASSES,
            scratch=folder.scratch,
            replace_z=replace_z,
        )
        return job, cut, plan, {"heights": {"ground_classes": job.ground_classes, "replace_z": replace_z}}

    return run_in(folder, collection, HEIGHTS, prepared, run)
