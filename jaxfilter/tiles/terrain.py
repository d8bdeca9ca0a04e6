"""One terrain model of a collection: tile by tile, without seams, as a Cloud Optimized GeoTIFF."""

from __future__ import annotations

import collections
import dataclasses
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud, Whole
from ..core.errors import InputError
from ..core.filter import Filter
from ..host.files import Bounds
from ..host.interpolation import Heights, Linear
from ..host.raster import write_mosaic
from ..terrain import interpolated
from .collection import Collection
from .plan import Plan, window_around
from .pool import Executor, Task, carried_out
from .run import Standing, tile_of
from .task import Job, Tile, inside, read_tile

HALOS = (40.0, 80.0, 160.0, 320.0)
"""Metres around a tile whose ground points take part: the first that suffices, by the circles of the triangles."""
_EDGE = 20.0
"""Metres along the edge of the data where triangles at the hull of a tile are let stand."""


@dataclasses.dataclass(frozen=True)
class Model:
    """What all tiles of a terrain model have in common.

    Attributes:
        cell: file units; settings: those of :func:`jaxfilter.dtm` but ``bounds``.
        raster, data: bounds of the whole raster, and of all points; file units.
        ground_classes: classes of ground points, where no filter finds them.
        lattice, filter_halo: of the filter; file units.
    """

    cell: float
    settings: dict[str, Any]
    raster: Bounds
    data: Bounds
    ground_classes: tuple[int, ...]
    lattice: float
    filter_halo: float


@dataclasses.dataclass(frozen=True)
class ModelReport:
    """What became of a tile: ground points of its core, halo in metres, and cells whose triangles reach beyond it."""

    ground: int
    points: int
    halo: float
    uncertain: int


@dataclasses.dataclass
class TerrainReport:
    """What a terrain model is.

    Attributes:
        rows, columns, empty: cells; empty ones have no height. uncertain: those whose triangles reach beyond the widest halo.
        points, ground: of all tiles.
        tiles: number of them; halos: how many needed each halo, metres; set_aside: number, core and reason.
        transform, bounds: of the raster. seconds: of this process.
    """

    rows: int
    columns: int
    empty: int
    uncertain: int
    points: int
    ground: int
    tiles: int
    halos: dict[float, int]
    set_aside: list[dict[str, Any]]
    transform: tuple[float, float, float, float, float, float]
    bounds: Bounds
    seconds: float


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
            return ModelReport(0, 0, halo, 0)
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
    return ModelReport(ground_own, own, halo, doubtful)


def _ground(job: Job, model: Model, cloud: PointCloud) -> np.ndarray:
    if model.filter_halo > 0 or not model.ground_classes:
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
    plan: Plan,
    executor: Executor,
    *,
    cell: float,
    settings: dict[str, Any],
    filter_: Filter | None,
    whole: Whole,
    reading: dict[str, Any],
    ground_classes: tuple[int, ...],
    overwrite: bool,
    progress: Callable[[Standing], None],
) -> TerrainReport:
    """Make the model and write it; see :func:`jaxfilter.cli.terrain.dtm` for the arguments.

    ``plan``: cores on the cells, with a halo of the filter and of the widest of :data:`HALOS`.
    Raises: InputError if no tile has ground; OutputError.
    """
    from ..filters import PMF

    start = time.perf_counter()
    metre = collection.metre
    raster = raster_bounds(collection.bounds, cell)
    shape = (round((raster[3] - raster[1]) / cell), round((raster[2] - raster[0]) / cell))
    model = Model(
        cell, settings, raster, collection.bounds, () if filter_ else ground_classes,
        cell if filter_ is None else filter_.lattice() / metre,
        0.0 if filter_ is None else filter_.tile_halo() / metre,
    )  # fmt: skip
    folder = Path(tempfile.mkdtemp(prefix=".jaxfilter-dtm-", dir=target.absolute().parent))
    report = TerrainReport(
        *shape,
        0,
        0,
        0,
        0,
        len(plan),
        collections.Counter(),
        [],
        (cell, 0.0, raster[0], 0.0, -cell, raster[3]),
        raster,
        0.0,
    )
    try:
        job = Job(filter_ or PMF(), reading, {}, (), whole, folder, folder / "index")
        standing = Standing("tiles", len(plan), 0, 0)

        def tick() -> None:
            standing.seconds = time.perf_counter() - start
            progress(standing)

        def arguments(number: int) -> Callable[[bool], tuple[Any, ...]]:
            return lambda last: (job, model, tile_of(plan, collection, number, patient=last))

        todo = (Task(model_tile, number, arguments(number)) for number in range(len(plan)))
        for task, outcome in carried_out(executor, todo, collections.deque(), tick):
            standing.tiles_done += 1
            if outcome.reason is not None:
                report.set_aside.append({"tile": task.number, "core": plan.core(task.number), "reason": outcome.reason})
                continue
            found: ModelReport = outcome.value
            standing.points += found.points
            report.points, report.ground = report.points + found.points, report.ground + found.ground
            report.uncertain += found.uncertain
            report.halos[found.halo] += 1
        if not report.ground:
            raise InputError(f"{collection!r}: no point is ground; classify it first, or find the ground with --filter")

        def parts() -> Iterator[tuple[int, int, np.ndarray]]:
            for number in range(len(plan)):
                path = _path(folder, number)
                if path.exists():
                    x0, _, _, y1 = _clipped(plan.core(number), raster)
                    yield round((raster[3] - y1) / cell), round((x0 - raster[0]) / cell), np.load(path)

        known = sum(int(np.isfinite(values).sum()) for _, _, values in parts())
        report.empty = shape[0] * shape[1] - known
        write_mosaic(target, shape, report.transform, collection.crs, parts, overwrite=overwrite)
    finally:
        executor.close()
        shutil.rmtree(folder, ignore_errors=True)
    report.seconds = time.perf_counter() - start
    return report
