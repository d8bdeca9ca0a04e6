"""One terrain model of a collection: tile by tile, without seams, as a Cloud Optimized GeoTIFF."""

from __future__ import annotations

import dataclasses
import math
import shutil
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from ..core.cloud import GROUND_CLASS, PointCloud
from ..core.errors import InputError, OutputError
from ..core.filter import Filter
from ..files.disk import Bounds, Seal, check_bounds, is_there, remove
from ..files.storage import Place, Remote, check_writable, place_of
from ..terrain.models import check_settings, interpolated
from ..terrain.raster import check_target, write_mosaic
from .folder import executor_of, facts_of, work_of
from .journal import NAME, Journal, discard
from .options import RunOptions, begun
from .run import Run, Step
from .surroundings import Doubt, GroundJob, ground_job, surroundings
from .task import Tile, keep

_PER_FOLDER = 1000


@dataclasses.dataclass(frozen=True)
class ModelJob(GroundJob):
    """What all tiles of a terrain model have in common.

    Attributes:
        cell: file units; settings: those of :func:`jaxfilter.dtm` but ``bounds``.
        raster: bounds of the whole raster, file units.
    """

    cell: float
    settings: dict[str, Any]
    raster: Bounds


@dataclasses.dataclass(frozen=True)
class ModelReport:
    """What became of a tile: ground points and points of its core, points that were read, halo in metres, cells whose
    triangles reach beyond it, and the seal of what was kept."""

    number: int
    ground: int
    points: int
    read: int
    halo: float
    uncertain: int
    seal: Seal
    left_out: tuple[tuple[int, str], ...] = ()


@dataclasses.dataclass
class TerrainReport:
    """What a terrain model is.

    Attributes:
        rows, columns, empty: cells; empty ones have no height. uncertain: those whose triangles reach beyond the widest halo.
        points, ground: of all tiles.
        tiles: number of them; halos: how many needed each halo, metres; set_aside: number, core and reason; left_out: URI
            and reason of files that could not be read.
        transform, bounds: of the raster. seconds: of this process.
    """

    rows: int
    columns: int
    tiles: int
    transform: tuple[float, float, float, float, float, float]
    bounds: Bounds
    empty: int = 0
    uncertain: int = 0
    points: int = 0
    ground: int = 0
    halos: dict[float, int] = dataclasses.field(default_factory=dict)
    set_aside: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    left_out: list[dict[str, str]] = dataclasses.field(default_factory=list)
    seconds: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether no tile was set aside and no file left out."""
        return not (self.set_aside or self.left_out)


def raster_bounds(data: Bounds, cell: float) -> Bounds:
    """The whole cells that hold all points."""
    x0, y0, x1, y1 = data
    return (
        math.floor(x0 / cell) * cell,
        math.floor(y0 / cell) * cell,
        math.ceil(x1 / cell) * cell,
        math.ceil(y1 / cell) * cell,
    )


def model_tile(job: ModelJob, tile: Tile) -> ModelReport:
    """Heights of the cells of a core, put into the folder of the job.

    A triangle is that of the whole if the circle through its corners holds no place that has data and was not read. Where
    one does, the halo is doubled.

    Raises: as :func:`jaxfilter.surveys.task.filter_tile`.
    """
    core = _clipped(tile.core, job.raster)
    for found in surroundings(job, tile):
        around = found.around
        own = int(around.core.sum())
        if (
            not own or core[0] >= core[2] or core[1] >= core[3]
        ):  # points on the very edge of the raster have no cell beyond it
            values, doubtful = np.zeros((0, 0), np.float32), 0
            break
        values, doubtful = _heights(job, around.cloud, found.usable, core, found.near)
        if not doubtful:
            break
    seal = keep(values_path(job.folder, tile.number), lambda file: np.save(file, values))
    ground = int((found.ground & around.core).sum())
    return ModelReport(tile.number, ground, own, len(around.cloud), found.halo, doubtful, seal, around.left_out)


def values_path(folder: Path, number: int) -> Path:
    """Where the heights of a tile are."""
    return folder / "values" / str(number // _PER_FOLDER) / f"{number}.npy"


MODEL = Step(model_tile, values_path, None)


def _heights(
    job: ModelJob, cloud: PointCloud, ground: np.ndarray, core: Bounds, near: Bounds
) -> tuple[np.ndarray, int]:
    """f32[rows, columns] of a core, and the number of cells whose triangles might be others in the whole."""
    doubt = Doubt(cloud, job.data, near)
    method, settings = job.settings["method"], {k: v for k, v in job.settings.items() if k != "method"}
    try:
        raster = interpolated(cloud, ground, job.cell, method, core, workers=1, look=doubt.look, **settings)
    except InputError:
        if int(ground.sum()) > 100:
            raise
        size = (round((core[3] - core[1]) / job.cell), round((core[2] - core[0]) / job.cell))
        return np.full(size, np.nan, np.float32), size[0] * size[1] if doubt.reaches else 0
    return raster.values, doubt.count


def _clipped(box: Bounds, limits: Bounds) -> Bounds:
    low = (max(v, limit) for v, limit in zip(box[:2], limits[:2], strict=True))
    high = (min(v, limit) for v, limit in zip(box[2:], limits[2:], strict=True))
    return (*low, *high)  # type: ignore[return-value]


def terrain_model(
    what: Any,
    target: str | Path,
    finder: type[Filter] | None = None,
    changes: dict[str, Any] | None = None,
    *,
    cell: float = 1.0,
    method: str = "tin",
    max_gap: float | None = None,
    fill: bool = False,
    bounds: Iterable[float] | None = None,
    neighbours: int = 12,
    power: float = 2.0,
    units: str | None = None,
    largest_building: float | None = None,
    ground_classes: Iterable[int] = (GROUND_CLASS,),
    **run: Unpack[RunOptions],
) -> TerrainReport:
    """Make one terrain model of a collection and write it as a Cloud Optimized GeoTIFF.

    Tiles and a journal lie in a hidden folder beside ``target`` until the model is complete, so that a run that was stopped, in
    whatever way, goes on with ``resume``.

    Args:
        what, units: as in :func:`jaxfilter.ground`.
        target: .tif or .tiff; may be a URL that fsspec can write to (``"s3://bucket/dtm.tif"``), where the file appears whole or
            not at all; then the hidden folder lies in ``work``.
        finder: the method that finds the ground; by default the points of ``ground_classes`` are it, less withheld ones.
        changes: its fields. largest_building: metres, as in ``Filter.for_cloud``.
        cell, method, max_gap, fill, bounds, neighbours, power: as in :func:`jaxfilter.dtm`, in file units.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: TerrainReport; tiles that could not be done are in it.
    Raises: InputError if no tile has ground; ParameterError; OutputError; JaxfilterError if workers cannot be started.

    >>> report = jf.terrain_model("survey", "dtm.tif", cell=2.0, units="m", workers=1)
    >>> report.rows, report.columns, jf.Raster.read("dtm.tif").values.shape
    (30, 30, (30, 30))
    """
    check_settings(cell, method, max_gap, neighbours, power)
    settings = {"method": method, "max_gap": max_gap, "fill": fill, "neighbours": neighbours, "power": power}
    place = place_of(target)
    check_target(place)
    collection = begun("terrain_model", what, units, run)
    metre, start = collection.metre, time.perf_counter()
    raster = raster_bounds(collection.bounds if bounds is None else check_bounds(bounds), cell)
    shape = (round((raster[3] - raster[1]) / cell), round((raster[2] - raster[0]) / cell))
    work = _prepared(place, run)
    with Journal(work / NAME) as journal:
        try:
            job, cut, plan = ground_job(
                ModelJob,
                collection,
                finder,
                changes or {},
                largest_building=largest_building,
                ground_classes=ground_classes,
                grain=cell * metre,
                run=run,
                most_points=(journal.fact("tiles") or {}).get("most_points"),
                classes={},
                scratch=work,
                cell=cell,
                settings=settings,
                raster=raster,
            )
            executor = executor_of(run, cut)
            try:
                if isinstance(place, Remote):
                    check_writable(place)
                model = {"ground_classes": job.ground_classes, "cell": cell, "raster": raster, **settings}
                journal.begin(facts_of(collection, job, cut, plan) | {"model": model})
            except BaseException:
                executor.close()
                raise
        except BaseException:
            if journal.fact("version") is None:
                journal.close()
                shutil.rmtree(work, ignore_errors=True)
            raise
        this = Run(job, plan, collection, [], journal, executor, step=MODEL, progress=run.get("progress"))
        this()
        report = TerrainReport(
            rows=shape[0], columns=shape[1], tiles=len(plan), transform=(cell, 0.0, raster[0], 0.0, -cell, raster[3]),
            bounds=raster,
        )  # fmt: skip
        _add(report, this)

    def parts() -> Iterator[tuple[int, int, np.ndarray]]:
        for number in range(len(plan)):
            path = values_path(work, number)
            values = np.load(path) if path.exists() else np.zeros((0, 0))
            if values.size:
                x0, _, _, y1 = _clipped(plan.core(number), raster)
                yield round((raster[3] - y1) / cell), round((x0 - raster[0]) / cell), values

    if not report.ground:
        more = f"; {report.set_aside[0]['reason']}" if report.set_aside else ""
        shutil.rmtree(work, ignore_errors=True)
        raise InputError(
            f"{collection!r}: no point is ground; classify it first, or find the ground with a filter{more}"
        )
    report.empty = shape[0] * shape[1] - sum(int(np.isfinite(values).sum()) for _, _, values in parts())
    replace = run.get("overwrite", False) or run.get("resume", False)
    write_mosaic(place, shape, report.transform, collection.crs, parts, overwrite=replace)
    if report.complete:
        shutil.rmtree(work, ignore_errors=True)
    report.seconds = time.perf_counter() - start
    return report


def _prepared(target: Place, run: RunOptions) -> Path:
    """The folder of a run for ``target``, made. Raises: OutputError if something is there that would be lost; ParameterError."""
    target = target.absolute()
    parent = work_of(run, target, target if isinstance(target, Remote) else target.parent)
    work = parent / f".{target.name}.jaxfilter-run"
    begun = (work / NAME).exists()
    resume, overwrite = run.get("resume", False), run.get("overwrite", False)
    if is_there(target) and not overwrite and not (resume and begun):
        raise OutputError(f"{target}: the file exists; pass overwrite=True to replace it")
    if begun and not resume:
        if not overwrite:
            raise OutputError(
                f"{target}: a run for it was begun and is not complete: pass resume=True to go on with it, or pass "
                "overwrite=True to begin anew"
            )
        discard(work / NAME)
    if not (begun and resume):
        remove(work)
    try:
        work.mkdir(exist_ok=True, parents=run.get("work") is not None)
    except OSError as error:
        raise OutputError(f"{work}: cannot be made: {error.strerror}") from error
    return work


def _add(report: TerrainReport, run: Run) -> None:
    """What the journal knows."""
    left_out: dict[str, str] = dict(run.sources.unreadable)
    for number, done, facts in run.journal.reports("tiles"):
        if not done:
            report.set_aside.append({"tile": number, "core": run.plan.core(number), "reason": facts["reason"]})
            continue
        for name in ("points", "ground", "uncertain"):
            setattr(report, name, getattr(report, name) + facts[name])
        report.halos[facts["halo"]] = report.halos.get(facts["halo"], 0) + 1
        left_out |= {run.sources[file].uri: reason for file, reason in facts["left_out"]}
    report.left_out = [{"file": uri, "reason": reason} for uri, reason in left_out.items()]
