"""One raster of a survey, tile by tile and without seams, as a Cloud Optimized GeoTIFF; the terrain model is one."""

from __future__ import annotations

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import GROUND_CLASS
from ..core.errors import InputError
from ..core.filter import Filter
from ..core.reading import Reading
from ..files.disk import Bounds
from ..files.storage import place_of
from ..terrain.interpolation import Interpolation
from ..terrain.models import interpolated
from ..terrain.raster import RasterGrid, check_target, write_mosaic
from .collection import Collection
from .executors import LOCAL
from .options import RunOptions
from .report import RunReport, Summary
from .store import KEPT
from .surroundings import DoubtfulTriangles, GroundNeeded, GroundSource, Surroundings, cut_around, source_of_ground
from .survey import FIND_GROUND, Survey, open_files
from .targets import Targets, target_of
from .tiles import Tile, TileReader

_VALUES, _CORNER = f"{KEPT}values", f"{KEPT}corner"


@dataclasses.dataclass
class TerrainReport(RunReport):
    """What a raster of a survey is. To what :class:`RunReport` has:

    Attributes:
        rows, columns, empty: cells; empty ones have no height.
        transform, bounds: of the raster, as of :class:`jaxfilter.Raster`.
    """

    rows: int = 0
    columns: int = 0
    empty: int = 0
    transform: tuple[float, float, float, float, float, float] = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
    bounds: Bounds = (0.0, 0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class RasterProduct(GroundNeeded):
    """A raster of the whole survey, of which every tile makes the cells of its core; ``grid``: of the raster."""

    REPORT = TerrainReport
    grid: RasterGrid

    def cells(self, found: Surroundings, grid: RasterGrid) -> tuple[np.ndarray, int]:
        """f32[rows, columns], from north: values of some cells, and how many may be others in the whole. Raises: InputError."""
        raise NotImplementedError

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Values of the cells of a tile. Raises: InputError."""
        summary, grid = Summary(), self.grid if tile.core is None else self.grid.part(tile.core)
        for found in self.surroundings(tile, summary):
            around, start = found.around, time.perf_counter()
            own = around.own
            if not len(own) or min(grid.shape) < 1:  # points on the edge of the raster have no cell beyond
                values, doubtful = np.zeros((0, 0), np.float32), 0
                break
            values, doubtful = self.cells(found, grid)
            summary.seconds["interpolate"] += time.perf_counter() - start
            if not doubtful:
                break
        summary.points, summary.read, summary.unread = len(own), len(around.cloud), around.left_out
        summary.ground, summary.uncertain = int(found.ground[own].sum()), doubtful
        summary.halos[found.halo] = 1
        whole = self.grid
        corner = (whole.bottom + whole.rows - grid.bottom - grid.rows, grid.left - whole.left)
        return {_VALUES: values, _CORNER: np.array(corner)}, summary

    def facts(self) -> dict[str, Any]:
        """What ground is, and the cells."""
        return {self.NAME: super().facts() | {"grid": dataclasses.asdict(self.grid)}}

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Write the raster. Raises: OutputError."""
        assert isinstance(report, TerrainReport)
        target, grid, start = targets.places[0], self.grid, time.perf_counter()
        report.rows, report.columns, report.transform = *grid.shape, grid.transform
        report.bounds = grid.bounds

        def parts() -> Iterator[tuple[int, int, np.ndarray]]:
            for number in np.flatnonzero(report.state != -1).tolist():
                stored = self.store.arrays(number)
                if stored[_VALUES].size:
                    yield *stored[_CORNER].tolist(), stored[_VALUES]

        report.empty = grid.rows * grid.columns - sum(int(np.isfinite(values).sum()) for _, _, values in parts())
        replace = options.overwrite or options.resume
        write_mosaic(target, grid.shape, grid.transform, collection.crs, parts, overwrite=replace)
        report.files = [str(target)]
        report.seconds["write"] += time.perf_counter() - start


@dataclasses.dataclass(frozen=True)
class TerrainProduct(RasterProduct):
    """A terrain model: heights at the centres of cells, see :func:`jaxfilter.dtm`."""

    NAME = "model"
    interpolation: Interpolation = Interpolation()

    def cells(self, found: Surroundings, grid: RasterGrid) -> tuple[np.ndarray, int]:
        """Heights. A triangle is that of the whole if the circle through its corners holds no place that has data and was not
        read."""
        cloud, ground = found.around.cloud, found.usable
        doubt = DoubtfulTriangles(cloud, self.data, found.near)
        try:
            threads = LOCAL.get().threads
            raster = interpolated(cloud, ground, grid, self.interpolation, workers=threads, look=doubt.look)
        except InputError:
            if ground.any() and (found.near is None or int(ground.sum()) > 100):
                raise
            return np.full(grid.shape, np.nan, np.float32), grid.rows * grid.columns if doubt.reaches else 0
        return raster.values, doubt.count

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Write the raster. Raises: InputError if no point is ground; OutputError."""
        if collection.count and not report.ground:
            more = f"; {report.set_aside[0]['reason']}" if report.set_aside else ""
            self.store.discard()
            raise InputError(f"{collection.name}: no point is ground; {FIND_GROUND}{more}")
        super().finish(report, collection, targets, options)

    def facts(self) -> dict[str, Any]:
        """What rasters have, and the interpolation."""
        return super().facts() | {"interpolation": dataclasses.asdict(self.interpolation)}


def terrain_model(
    what: Any,
    target: str | Path,
    ground: GroundSource = (GROUND_CLASS,),
    *,
    cell: float = 1.0,
    interpolation: Interpolation = Interpolation(),
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> TerrainReport:
    """Make one terrain model of a file or of a collection, and write it as a Cloud Optimized GeoTIFF.

    Tiles lie in a hidden folder beside ``target`` until the model is complete, so that a run that was stopped, in whatever way,
    goes on with ``resume``.

    Args:
        what: as in :func:`jaxfilter.ground`.
        target: .tif or .tiff; may be a URL that fsspec can write to (``"s3://bucket/dtm.tif"``), where the file appears whole or
            not at all; then the hidden folder lies in ``run.work``.
        ground: what is ground, as in :func:`jaxfilter.heights`.
        cell: side of a cell; its edges are whole multiples of it, all in file units.
        interpolation: as in :func:`jaxfilter.dtm`, see :class:`Interpolation`.
        reading: as in :func:`jaxfilter.ground`; its ``bounds`` are those of the raster, and points around them take part.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: TerrainReport; tiles that could not be done are in it.
    Raises: InputError if no point is ground; ParameterError; OutputError; JaxfilterError if workers cannot be started.

    >>> report = jf.terrain_model("survey", "dtm.tif", cell=2.0, reading=jf.Reading(units="m"))
    >>> report.rows, report.columns, jf.Raster.read("dtm.tif").values.shape
    (30, 30, (30, 30))
    """
    kind = functools.partial(TerrainProduct, interpolation=interpolation)
    return make_raster(kind, what, target, ground, cell=cell, reading=reading, run=run)


def make_raster(
    kind: Callable[..., RasterProduct],
    what: Any,
    target: str | Path,
    ground: GroundSource = (),
    *,
    cell: float = 1.0,
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> TerrainReport:
    """Make one raster of a file or of a collection; ``kind``: makes the product from the fields of :class:`RasterProduct`.

    The other arguments, and what is raised, are those of :func:`terrain_model`.
    """
    place = place_of(target)
    check_target(place)
    recipe, classes = source_of_ground(ground)
    bounds, reading = reading.bounds, dataclasses.replace(reading, bounds=None)
    collection = open_files(what, None, reading, dataclasses.replace(run, in_place=True))
    if bounds is None and not collection.count:
        raise InputError(f"{collection.name}: holds no points, which would say where the raster lies: pass bounds=")
    grid = RasterGrid.over(collection.bounds if bounds is None else bounds, cell, collection.metre, math.inf)
    targets, grain = target_of(place, len(collection) == 1, run), cell * collection.metre

    def product_for(reader: TileReader, filter_: Filter | None) -> RasterProduct:
        return kind(reader, targets.store.path, filter_, collection.bounds, classes, grain, run.halo, grid)

    survey = Survey(collection, targets, recipe, reading, run)
    return survey.run(lambda filter_, halo: cut_around(filter_, grain, halo), product_for)
