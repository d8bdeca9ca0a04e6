"""Ground filtering of a file, or of a survey of any size: files of points in, as many classified files out."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ..core.compilation import compilations, watch_compilations
from ..core.errors import ParameterError, warn
from ..core.filter import Filter
from ..core.reading import Reading
from ..core.result import FilterResult
from ..files.classes import Classes, Finding, Found, class_changes, findings_of
from ..files.disk import check_suffix
from ..files.text import TEXT_SUFFIXES as TEXT
from ..files.vectors import VECTOR_SUFFIXES
from ..files.writing import Additions, Replacing, check_extra, quantities_of, write_cloud
from ..terrain.levels import water_of
from .collection import Collection
from .kept import WaterWanted, kept_water, list_places, list_water, remember, suspects_in
from .measures import Recipe, recipe_of
from .options import RunOptions
from .product import Cut, FileTask, Product, packed
from .report import RunReport, Summary
from .small import carry_out
from .survey import survey_of_points
from .targets import Targets
from .tiles import LOCAL, Around, Tile, part_of


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundProduct(Product):
    """Files with the classes of their points changed.

    Attributes:
        classes: that are written; extra: quantities that are written along; review: a file for the list of places to look at.
        water: where its outlines go.
        into_text: the output is text, which has classes only if the lines of the input had.
    """

    classes: Classes
    extra: tuple[str, ...]
    review: Path | None
    water: WaterWanted
    into_text: bool

    def cut(self) -> Cut:
        """With a halo for the filter."""
        assert self.filter is not None
        return Cut(self.filter.halo() if self.halo is None else self.halo, self.filter.lattice())

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Label the points of a tile. Raises: InputError, ParameterError."""
        assert self.filter is not None
        summary, local = Summary(), LOCAL.get()
        around = self.read(tile, summary)
        if self.reading.aoi is not None and not around.core.any():
            return {}, summary
        watch_compilations()
        cloud, start, before = around.cloud, time.perf_counter(), compilations()[1]
        result = self.filter(cloud, workers=local.threads, progress=local.progress)
        done, compiled = time.perf_counter(), compilations()[1] - before
        summary.seconds["compile"], summary.seconds["filter"] = compiled, max(done - start - compiled, 0.0)
        bare = self.into_text and (cloud.classification is None or tile.sources[0].format != "text")
        found = findings_of(cloud, result, self.classes)
        summarise(summary, around, result, found, None if bare else self.classes)
        kept = suspects_in(around, result, tile, self.reading)
        kept |= kept_water(cloud, water_of(cloud, result, result.ground), tile)
        summary.seconds["places"] = time.perf_counter() - done
        return packed(around, found, self.columns(around, result)) | kept, summary

    def columns(self, around: Around, result: FilterResult) -> dict[str, np.ndarray]:
        """f32[k]: the quantities ``extra`` of the points of a core, by name. Raises: ParameterError if the method has none."""
        found = quantities_of(result, self.extra)
        for name, values in found.items():
            if around.cloud.candidate.any() and np.isnan(values).all():
                warn(f"extra: {name} is NaN for all points: the method does not compute it")
        return {name: values[around.core] for name, values in found.items()}

    def file(self, task: FileTask) -> None:
        """Write a file with the labels of its tiles. Raises: InputError, OutputError."""
        cloud, found, columns = self.collected(task, dict.fromkeys(self.extra, np.float32))
        write_cloud(task.target, cloud, found, self.classes, Additions(columns=columns), Replacing(**task.how))

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """List the places to look at and the water, and write them. Raises: InputError, OutputError."""
        list_places(self, report, collection, self.review, options.overwrite or options.resume)
        list_water(self, report, collection, self.water, options.overwrite or options.resume)
        remember(report.water, targets, self.classes.water)

    def facts(self) -> dict[str, Any]:
        """Classes and quantities."""
        return {"classes": dataclasses.asdict(self.classes), "extra": self.extra}


def summarise(summary: Summary, around: Around, result: FilterResult, found: Found, classes: Classes | None) -> None:
    """What is said of the labels of a tile; ``classes``: that are written, None = the output has none."""
    own = around.own
    cloud, ground = part_of(around.cloud, own), result.ground[own]
    summary.candidates, summary.ground = int(cloud.candidate.sum()), int(ground.sum())
    summary.low_noise = int(result.low_noise[own].sum())
    if classes is not None:
        summary.classes.update(class_changes(cloud, Found(ground, found.code[own]), classes))
    marked = np.zeros(len(cloud), bool) if cloud.in_overlap is None else cloud.in_overlap
    for name, which in (("points", marked), ("judged", marked & cloud.candidate), ("ground", marked & ground)):
        summary.overlap[name] += int(which.sum())
    summary.overlap["kept"] += int((ground & (found.code[own] == Finding.KEPT)).sum())
    summary.statuses[result.status.name] = 1


def ground(
    what: Any,
    out: str | Path | None,
    filter_: Filter | Recipe | None = None,
    *,
    reading: Reading = Reading(),
    classes: Classes = Classes(),
    extra: Iterable[str] = (),
    review: str | Path | None = None,
    breaklines: str | Path | None = None,
    run: RunOptions = RunOptions(),
) -> RunReport:
    """Classify the ground points of a file into a file, or of the files of a collection into one file for each in a folder.

    Every file is written as it was, with classes changed, when all its points have labels. If there is water, the file
    ``jaxfilter-water.npz`` beside the outputs tells later models of these files where it is. What is large goes in tiles that see
    their surroundings, across files. A folder beside the output holds what is done of tiles, so that a run that was stopped, in
    whatever way, goes on with ``resume``; the files are those of an undisturbed run.

    Args:
        what: a file, a :class:`Collection`, or what :func:`jaxfilter.open` takes.
        out: a file for one file, else a folder, made if missing; it must be empty, but for ``resume`` and ``overwrite``. May be a
            URL that fsspec can write to (``"s3://bucket/prefix"``); every file appears there whole or not at all. None with
            ``in_place``.
        filter_: by default the default method, set up for the data.
        reading: which points are read and judged, see :class:`Reading`; with ``bounds`` only points within are written.
        classes: that are written, see :class:`Classes`; extra: quantities that are written along, as in :func:`jaxfilter.write`.
        review: a GeoPackage (.gpkg) or GeoJSON (.geojson) to write as well: the places to look at, see :func:`jaxfilter.review`.
        breaklines: the same for the outlines of water bodies, which are joined across tiles, see :func:`jaxfilter.breaklines`.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: RunReport; what could not be done is in it.
    Raises: InputError, ParameterError, OutputError before anything is filtered, JaxfilterError if workers cannot be started;
    OutputError if a disk is full; of a single file what is wrong with it.

    >>> report = jf.ground("survey", "classified", jf.SMRF(), reading=jf.Reading(units="m"))
    >>> len(report.files), report.set_aside, 0 < report.ground < report.candidates
    (2, [], True)
    """
    recipe = recipe_of(filter_)
    recipe.alone()  # what is wrong with parameters is said before anything is read
    if "doubt" in (extra := check_extra(extra)) and recipe.method is not None and not recipe.method.DOUBTS:
        raise ParameterError(f"extra={extra!r}: the method states no doubt; OST does")
    listed, outlined = (None if one is None else Path(one) for one in (review, breaklines))
    for path in (listed, outlined):
        if path is not None:
            check_suffix(path, VECTOR_SUFFIXES)
    if listed is not None and outlined is not None and listed.absolute() == outlined.absolute():
        raise ParameterError(f"breaklines={str(outlined)!r}: is the file of the places (review=): name another")
    survey = survey_of_points(what, out, recipe, reading, run)
    product = GroundProduct(
        reading=survey.reading,
        halo=run.halo,
        classes=classes,
        extra=extra,
        review=listed,
        water=WaterWanted(path=outlined),
        into_text=all(place.suffix.lower() in TEXT for place in survey.targets.places),
    )
    return carry_out(survey, product)
