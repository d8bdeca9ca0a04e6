"""Heights above ground of all points: files in, as many files with heights out."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import GROUND_CLASS
from ..core.errors import InputError, ParameterError
from ..core.reading import Reading
from ..core.result import Status
from ..files.classes import Classes, findings_of
from ..files.writing import HEIGHT, LAS_SUFFIXES, Additions, Replacing, write_cloud
from ..terrain.models import heights_of
from .collection import Collection
from .ground import summarise
from .kept import list_places, suspects_in
from .options import RunOptions
from .product import FileTask, packed
from .report import RunReport, Summary
from .small import carry_out
from .surroundings import FIND_GROUND, HALOS, GroundNeeded, GroundSource, source_of_ground
from .survey import survey_of_points
from .targets import Targets
from .tiles import LOCAL, Tile

_GRAIN = 1.0  # metres


@dataclasses.dataclass(frozen=True, kw_only=True)
class HeightProduct(GroundNeeded):
    """Files with the height of every point; ``replace_z``: in place of Z."""

    replace_z: bool

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Heights of the points of a tile. Raises: InputError if there is no ground within the widest halo."""
        summary, heights, threads = Summary(), None, LOCAL.get().threads
        kept: dict[str, np.ndarray] = {}
        for found in self.surroundings(tile, summary):
            around, start = found.around, time.perf_counter()
            own = around.own
            if not len(own):
                heights = np.zeros(0)
                break
            if found.usable.any():
                heights = heights_of(around.cloud, found.usable, own, workers=threads, look=found.doubt.look)
                summary.seconds["heights"] += time.perf_counter() - start
                if not found.doubt.count:
                    break
        if heights is None:
            around_it = f"the tile {tile.core} and {HALOS[-1]:g} m around it"
            where = tile.sources[0].uri if tile.core is None else around_it
            raise InputError(f"{where}: no point is ground; {FIND_GROUND}")
        cloud, result = around.cloud, found.result
        classed = findings_of(cloud, found.ground)
        if result is not None:
            summarise(summary, around, result, classed, Classes())
            kept = suspects_in(around, result, found.tile, self.reading)
        else:
            summary.candidates, summary.ground = int(cloud.candidate[own].sum()), int(found.ground[own].sum())
            summary.statuses[Status.CONVERGED.name] = 1
        summary.heights = (float(heights.min()), float(heights.max())) if len(heights) else None
        summary.uncertain = found.doubt.count
        return packed(around, classed, {HEIGHT: heights}) | kept, summary

    def file(self, task: FileTask) -> None:
        """Write a file with the heights of its tiles, and classes if a filter found the ground.

        Raises: InputError, OutputError.
        """
        cloud, found, quantities = self.collected(task, {HEIGHT: np.float64})
        result = found if self.classes_of_ground is None else None
        additions = Additions.of_heights(quantities[HEIGHT], self.replace_z)
        write_cloud(task.target, cloud, result, Classes(), additions, Replacing(**task.how))

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """List the places to look at. Raises: InputError."""
        list_places(self, report, collection, None, False)

    def facts(self) -> dict[str, Any]:
        """Classes of ground points, and where heights go."""
        return {"heights": super().facts() | {"replace_z": self.replace_z}}


def heights(
    what: Any,
    out: str | Path | None,
    ground: GroundSource = (GROUND_CLASS,),
    *,
    replace_z: bool = False,
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> RunReport:
    """Write a file, or the files of a collection, with the height of every point above the ground, without seams.

    Heights are those of :func:`jaxfilter.height_above_ground` for all files together, but for points over voids so wide that
    320 m of surroundings do not settle their triangle (``RunReport.uncertain``), and for 20 m along the edge of the data.

    Args:
        what, out, reading: as in :func:`jaxfilter.ground`.
        ground: what is ground: classes of points, less withheld ones, or a filter that finds it, whose classes are then written
            as well. In text it is label 0.
        replace_z: put heights in place of Z instead of into the extra dimension ``HeightAboveGround``.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: RunReport; what could not be done is in it. Tiles without ground within 320 m are set aside.
    Raises: as :func:`jaxfilter.ground`.

    >>> report = jf.heights("survey", "heights", reading=jf.Reading(units="m"))
    >>> len(report.files), report.points == len(cloud), report.heights[0] < 1 < report.heights[1]
    (2, True, True)
    """
    recipe, classes = source_of_ground(ground)
    survey = survey_of_points(what, out, recipe, reading, run)
    if wrong := [place for place in survey.targets.places if place.suffix.lower() not in LAS_SUFFIXES]:
        raise ParameterError(f"{wrong[0]}: heights need .las or .laz")
    product = HeightProduct(
        reading=survey.reading,
        halo=run.halo,
        data=survey.collection.bounds,
        classes_of_ground=classes,
        grain=_GRAIN,
        replace_z=replace_z,
    )
    return carry_out(survey, product)
