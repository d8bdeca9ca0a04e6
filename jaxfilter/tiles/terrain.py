"""One terrain model of a collection: tile by tile, without seams, as a Cloud Optimized GeoTIFF."""

from __future__ import annotations

import collections
import dataclasses
import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import GROUND_CLASS, KEPT_CLASSES, PointCloud, Whole
from ..core.errors import InputError, ParameterError
from ..core.filter import Filter
from ..filters import PMF
from ..host.files import Bounds, remove_dead, workplace
from ..host.interpolation import Heights, Linear
from ..host.raster import write_mosaic
from ..terrain import interpolated
from .collection import Collection
from .dask import Cluster
from .ground import layout
from .plan import Plan, plan_with_halo, window_around
from .pool import Executor, Pool, Task, carried_out
from .run import Standing, tile_of
from .setup import filter_for, sampled
from .task import Job, Tile, inside, read_tile

HALOS = (40.0, 80.0, 160.0, 320.0)
"""Metres around a tile whose ground points take part: the first that suffices, by the circles of the triangles."""
_READING = {"returns": "last,only", "ignore_classes": KEPT_CLASSES, "keep_withheld": False, "drop_invalid": False}
_EDGE = 20.0
"""Metres along the edge of the data where triangles at the hull of a tile are let stand."""


@dataclasses.dataclass(frozen=True)
class Model:
    """What all tiles of a terrain model have in common.

    Attributes:
        cell: file units; settings: those of :func:`jaxfilter.dtm` but ``bounds``.
        raster, data: bounds of the whole raster, and of all points; file units.
        ground_classes: classes of ground points; None: the filter finds them.
        lattice, filter_halo: of the filter; file units.
    """

    cell: float
    settings: dict[str, Any]
    raster: Bounds
    data: Bounds
    ground_classes: tuple[int, ...] | None
    lattice: float
    filter_halo: float


@dataclasses.dataclass(frozen=True)
class ModelReport:
    """What became of a tile: ground points of its core, halo in metres, and cells whose triangles reach beyond it."""

    ground: int
    points: int
    halo: float
    uncertain: int
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


def raster_bounds(data: Bounds, cell: float) -> Bounds:
    """The whole cells that hold all points."""
    x0, y0, x1, y1 = data
    return (
        math.floor(x0 / cell) * cell,
        math.floor(y0 / cell) * cell,
        math.ceil(x1 / cell) * cell,
        math.ceil(y1 / cell) * cell,
    )


def model_tile(job: Job, model: Model, tile: Tile) -> ModelReport:
    """Heights of the cells of a core, put into the folder of the job.

    A triangle is that of the whole if the circle through its corners holds no place that has data and was not read. Where
    one does, the halo is doubled.

    Raises: as :func:`jaxfilter.tiles.task.filter_tile`.
    """
    core = _clipped(tile.core, model.raster)
    metre = tile.sources[0].metre
    for halo in HALOS:
        near = window_around(tile.core, halo / metre, model.cell)
        wide = window_around(near, model.filter_halo, model.lattice)
        around = read_tile(job, dataclasses.replace(tile, window=wide))
        cloud = around.cloud
        own = int(around.core.sum())
        if not own:
            return ModelReport(0, 0, halo, 0, around.left_out)
        ground = _ground(job, model, cloud)
        ground_own = int((ground & around.core).sum())
        ground &= inside(cloud, near)
        values, doubtful = _heights(model, cloud, ground, core, near)
        if not doubtful:
            break
    path = _path(job.folder, tile.number)
    part = path.with_suffix(".part")
    with open(part, "wb") as file:
        np.save(file, values)
    os.replace(part, path)
    return ModelReport(ground_own, own, halo, doubtful, around.left_out)


def _ground(job: Job, model: Model, cloud: PointCloud) -> np.ndarray:
    if model.ground_classes is None:
        return job.filter(cloud, workers=1).ground.copy()
    assert cloud.classification is not None
    ground = np.isin(cloud.classification, model.ground_classes)
    return ground if cloud.withheld is None else ground & ~cloud.withheld


def _heights(model: Model, cloud: PointCloud, ground: np.ndarray, core: Bounds, near: Bounds) -> tuple[np.ndarray, int]:
    """f32[rows, columns] of a core, and the number of cells whose triangles might be others in the whole."""
    strips = _unread(model, cloud, near)
    doubtful = 0

    def look(rows: slice, at: np.ndarray, surface: Heights) -> None:
        nonlocal doubtful
        if not isinstance(surface, Linear) or not strips:
            return
        centre, radius = surface.circles(at)
        meets = np.zeros(len(at), bool)
        for low, high in strips:
            away = np.maximum(np.maximum(low - centre, centre - high), 0.0)
            meets |= np.hypot(away[:, 0], away[:, 1]) < radius
        doubtful += int(meets.sum())

    method, settings = model.settings["method"], {k: v for k, v in model.settings.items() if k != "method"}
    try:
        raster = interpolated(cloud, ground, model.cell, method, core, workers=1, look=look, **settings)
    except InputError:
        if int(ground.sum()) > 100:
            raise
        size = (round((core[3] - core[1]) / model.cell), round((core[2] - core[0]) / model.cell))
        return np.full(size, np.nan, np.float32), size[0] * size[1] if strips else 0
    return raster.values, doubtful


def _unread(model: Model, cloud: PointCloud, near: Bounds) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rectangles, low and high f64[2] in local metres, that have data and were not read; without the edge of the data."""
    factor, edge = cloud.units.xy, _EDGE / cloud.units.xy
    x0, y0, x1, y1 = model.data
    x0, y0, x1, y1 = x0 + edge, y0 + edge, x1 - edge, y1 - edge
    boxes = ((x0, y0, near[0], y1), (near[2], y0, x1, y1), (x0, y0, x1, near[1]), (x0, near[3], x1, y1))
    origin = cloud.origin[:2]
    return [
        ((np.array(box[:2]) - origin) * factor, (np.array(box[2:]) - origin) * factor)
        for box in boxes
        if box[0] < box[2] and box[1] < box[3]
    ]


def _clipped(box: Bounds, limits: Bounds) -> Bounds:
    low = (max(v, limit) for v, limit in zip(box[:2], limits[:2], strict=True))
    high = (min(v, limit) for v, limit in zip(box[2:], limits[2:], strict=True))
    return (*low, *high)  # type: ignore[return-value]


def _path(folder: Path, number: int) -> Path:
    return folder / f"{number}.npy"


def terrain_model(
    collection: Collection,
    target: Path,
    finder: type[Filter] | None = None,
    changes: dict[str, Any] | None = None,
    *,
    cell: float = 1.0,
    largest_building: float | None = None,
    ground_classes: tuple[int, ...] = (GROUND_CLASS,),
    tile: float | None = None,
    memory: float | None = None,
    workers: int | None = None,
    client: Any = None,
    executor: Executor | None = None,
    bounds: Bounds | None = None,
    overwrite: bool = False,
    progress: Callable[[Standing], None] = lambda standing: None,
    **settings: Any,
) -> TerrainReport:
    """Make one terrain model of a collection and write it as a Cloud Optimized GeoTIFF.

    Args:
        finder: the method that finds the ground; by default the points of ``ground_classes`` are it, less withheld ones.
        changes: its fields. largest_building: as in ``Filter.for_cloud``.
        cell, bounds, settings: as in :func:`jaxfilter.dtm`, in file units.
        tile, memory, workers, client, executor, progress: as in :func:`jaxfilter.tiles.ground.ground`.

    Raises: InputError if no tile has ground; ParameterError; OutputError.

    >>> from pathlib import Path
    >>> report = jf.terrain_model(jf.open("survey", units="m"), Path("dtm.tif"), cell=2.0, workers=1)
    >>> report.rows, report.columns, jf.Raster.read("dtm.tif").values.shape
    (30, 30, (30, 30))
    """
    settings = {"method": "tin", "max_gap": None, "fill": False, "neighbours": 12, "power": 2.0} | settings
    metre, start = collection.metre, time.perf_counter()
    data = collection.bounds
    raster = raster_bounds(data if bounds is None else bounds, cell)
    shape = (round((raster[3] - raster[1]) / cell), round((raster[2] - raster[0]) / cell))
    parent = target.absolute().parent
    remove_dead(parent)
    with workplace(parent) as folder:
        filter_, whole, filter_halo = None, Whole(), 0.0
        if finder is not None:
            sample = sampled(collection, _READING, folder / "index")
            filter_ = filter_for(sample, finder, changes or {}, largest_building=largest_building)
            whole, filter_halo = sample.whole, filter_.tile_halo()
            if type(filter_).lowest is not Filter.lowest:
                raise ParameterError(
                    f"{finder.__name__} looks at the whole survey first: run jaxfilter ground, then dtm"
                )
        lattice = cell * metre if filter_ is None else filter_.lattice()
        cut = layout(
            collection, lattice=cell * metre, halo=HALOS[0] + filter_halo, tile=tile, memory=memory, workers=workers
        )
        plan = plan_with_halo(cut.plan, collection, HALOS[-1] + filter_halo + lattice)
        model = Model(
            cell,
            settings,
            raster,
            data,
            None if filter_ is not None else ground_classes,
            lattice / metre,
            filter_halo / metre,
        )
        job = Job(filter_ or PMF(), _READING, {}, (), whole, folder, folder / "index")
        report = TerrainReport(
            rows=shape[0], columns=shape[1], tiles=len(plan), transform=(cell, 0.0, raster[0], 0.0, -cell, raster[3]),
            bounds=raster,
        )  # fmt: skip
        if executor is None:
            executor = Pool(cut.workers) if client is None else Cluster(client)
        try:
            _carry_out(job, model, plan, collection, executor, report, progress)
        finally:
            executor.close()

        def parts() -> Iterator[tuple[int, int, np.ndarray]]:
            for number in range(len(plan)):
                path = _path(folder, number)
                if path.exists():
                    x0, _, _, y1 = _clipped(plan.core(number), raster)
                    yield round((raster[3] - y1) / cell), round((x0 - raster[0]) / cell), np.load(path)

        report.empty = shape[0] * shape[1] - sum(int(np.isfinite(values).sum()) for _, _, values in parts())
        write_mosaic(target, shape, report.transform, collection.crs, parts, overwrite=overwrite)
    report.seconds = time.perf_counter() - start
    return report


def _carry_out(
    job: Job,
    model: Model,
    plan: Plan,
    collection: Collection,
    executor: Executor,
    report: TerrainReport,
    progress: Callable[[Standing], None],
) -> None:
    """All tiles; what becomes of them goes into the report. Raises: InputError if none has ground."""
    start, standing = time.perf_counter(), Standing("tiles", len(plan), 0, 0)

    def tick() -> None:
        standing.seconds = time.perf_counter() - start
        progress(standing)

    def arguments(number: int) -> Callable[[bool], tuple[Any, ...]]:
        return lambda last: (job, model, tile_of(plan, collection, number, patient=last))

    todo = (Task(model_tile, number, arguments(number)) for number in range(len(plan)))
    left_out = dict(collection.unreadable)
    for task, outcome in carried_out(executor, todo, collections.deque(), tick):
        standing.tiles_done += 1
        if outcome.reason is not None:
            report.set_aside.append({"tile": task.number, "core": plan.core(task.number), "reason": outcome.reason})
            continue
        found: ModelReport = outcome.value
        standing.points += found.points
        report.points, report.ground = report.points + found.points, report.ground + found.ground
        report.uncertain += found.uncertain
        report.halos[found.halo] = report.halos.get(found.halo, 0) + 1
        left_out |= {collection[number].uri: reason for number, reason in found.left_out}
    report.left_out = [{"file": uri, "reason": reason} for uri, reason in left_out.items()]
    if not report.ground:
        more = f"; {report.set_aside[0]['reason']}" if report.set_aside else ""
        raise InputError(
            f"{collection!r}: no point is ground; classify it first, or pass filter= to find the ground{more}"
        )
