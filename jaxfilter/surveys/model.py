"""Rasters of a survey, tile by tile and without seams, as Cloud Optimized GeoTIFFs; the terrain model is one."""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import GROUND_CLASS
from ..core.errors import InputError, ParameterError, warn
from ..core.grid import MAX_CELLS
from ..core.inputs import class_numbers
from ..core.reading import Bounds, Reading
from ..files.disk import check_suffix
from ..files.storage import Place, place_of
from ..terrain.contours import Contours, write_contours
from ..terrain.edge import Edge, EdgeRule, Part
from ..terrain.interpolation import Interpolation
from ..terrain.layer import Layer, Site
from ..terrain.levels import BED, water_of
from ..terrain.models import Dtm
from ..terrain.raster import Band, RasterGrid, grid_like, packed, profile_of, write_mosaic
from .area import within
from .collection import Collection, common
from .kept import WaterWanted, kept_water, list_water, remembered
from .options import RunOptions
from .product import KEPT, Cut
from .report import RunReport, Summary
from .small import carry_out
from .surroundings import FIND_GROUND, HALOS, GroundNeeded, GroundSource, source_of_ground
from .survey import Survey, open_files
from .targets import Targets
from .tiles import LOCAL, Tile

_GRIDS, _NEAR, _CIRCLE, _COUNT = (f"{KEPT}{name}" for name in ("grids", "near", "circle", "points"))
"""Names of the arrays of a :class:`Part`: columns and rows of its grids, and the others."""


@dataclasses.dataclass
class TerrainReport(RunReport):
    """What rasters of a survey are. To what :class:`RunReport` has:

    Attributes:
        rows, columns: of cells; empty: cells of the first raster that have no value.
        transform, bounds: of the rasters, as of :class:`jaxfilter.Raster`.
    """

    rows: int = 0
    columns: int = 0
    empty: int = 0
    transform: tuple[float, float, float, float, float, float] = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
    bounds: Bounds = (0.0, 0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RasterProduct(GroundNeeded):
    """Layers of the whole survey, of which every tile makes the cells of its core.

    Attributes:
        grid: of all rasters; layers: what they show; interpolation: of heights between ground points.
        water: how tiles come to know of it. lost: files that are not among those of the ground, since they cannot be read.
        nodata: what stands for no value in float32, instead of the layers' own.
    """

    REPORT = TerrainReport
    grid: RasterGrid
    layers: tuple[Layer, ...]
    interpolation: Interpolation
    water: WaterWanted
    lost: tuple[str, ...] = ()
    nodata: float | None = None

    def cut(self) -> Cut:
        """Tiles that cover what is near ground as well."""
        return dataclasses.replace(super().cut(), beyond=HALOS[-1])

    @property
    def reach(self) -> float:
        """As far as the layers look, and the disc that finds the edge."""
        looks = (layer.reach(self.grain) for layer in self._bases)
        return max(*looks, 2 * (self._edge.limit + self.grain) - HALOS[0] if self.interpolation.ends else 0.0, 0.0)

    @property
    def _bases(self) -> list[Layer]:
        """The layers out of whose cells all others are made, each once."""
        cells = (layer.cells for layer in self.layers)
        return list(dict.fromkeys(part for layer in cells for part in layer.parts or (layer,)))

    @property
    def _edge(self) -> EdgeRule:
        return EdgeRule(self.grid, self.grain / self.grid.cell, self.data, self.interpolation.max_edge)

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Values of the cells of a tile, and of a ring around them. Raises: InputError."""
        summary, whole, arrays = Summary(), self.grid, dict[str, np.ndarray]()
        grid = wide = whole
        if tile.core is not None:
            ring = np.array([-whole.cell, -whole.cell, whole.cell, whole.cell])  # hillshade looks at it
            grid, wide = whole.part(tile.core), whole.part(tuple((tile.core + ring).tolist()))
        if wide.rows * wide.columns > MAX_CELLS:
            cells = f"{wide.rows:,} x {wide.columns:,} cells, more than {MAX_CELLS:,}"
            raise InputError(f"cell={whole.cell:g}: a tile has {cells}: pass a larger cell=, or pass a smaller tile=")
        for found in self.surroundings(tile, summary):
            around, doubt, start, doubtful = found.around, found.doubt, time.perf_counter(), 0
            own = around.own
            if min(grid.shape) < 1:  # points on the edge of the raster have no cell beyond
                break
            noise = None if found.result is None else found.result.low_noise
            threads, usable = LOCAL.get().threads, found.usable
            # A triangle is that of the whole if the circle through its corners holds no place that has data and was not read.
            strict = found.near is None and bool(usable.any())
            how = self.interpolation
            site = Site(around.cloud, usable, wide, noise, how, threads, doubt.look, strict, ends=False)
            arrays = {KEPT + layer.NAME: site.of(layer) for layer in self._bases}
            summary.seconds["interpolate"] += time.perf_counter() - start
            unknown = doubt.reaches and not doubt.looked and any(layer.SURFACE for layer in self.layers)
            doubtful = grid.rows * grid.columns if unknown else doubt.count
            if not doubtful:
                break
        if arrays:
            part = site.part_of(self._edge, grid, wide)
            arrays |= {_GRIDS: np.array([dataclasses.astuple(one)[1:] for one in part[:3]])}
            if self.interpolation.ends:
                arrays |= {_NEAR: part.near, _COUNT: np.array(part.points)}
                arrays |= {} if part.circle is None else {_CIRCLE: part.circle}
            water = water_of(around.cloud, found.result, found.ground) if self.water.seeks else None
            arrays |= kept_water(around.cloud, water, tile)
        summary.ground, summary.uncertain = int(found.ground[own].sum()), doubtful if len(own) else 0
        return arrays, summary

    def facts(self) -> dict[str, Any]:
        """What ground is, the cells, the layers, and the interpolation."""
        layers = {layer.NAME: dataclasses.asdict(layer) for layer in self.layers}
        facts = super().facts() | {"grid": dataclasses.asdict(self.grid), "layers": layers, "nodata": self.nodata}
        return {"rasters": facts, "interpolation": dataclasses.asdict(self.interpolation)}

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Write the rasters, and lines. Raises: InputError if no point is ground, or if one has no value; OutputError."""
        assert isinstance(report, TerrainReport)
        if not report.ground:
            more = f"; {report.set_aside[0]['reason']}" if report.set_aside else ""
            raise self._nothing(f"{collection.name}: no point is ground; {FIND_GROUND}{more}")
        reason = "it could not be read before, and what it covers has no value"
        report.left_out += [{"file": name, "reason": reason} for name in self.lost]
        grid, start, replace = self.grid, time.perf_counter(), options.overwrite or options.resume
        list_water(self, report, collection, self.water, replace)
        levels, edge = report.water if self.interpolation.level_water else None, None
        if self.interpolation.ends:
            edge = self._edge.find(lambda: self._parts(report), levels)
        report.rows, report.columns, report.transform = *grid.shape, grid.transform
        report.bounds = grid.bounds
        places: dict[Layer, Place] = dict(zip(self.layers, targets.places, strict=True))
        rasters = {layer: place for layer, place in places.items() if layer.cells == layer}
        known = [self._write(layer, place, report, collection, edge, replace) for layer, place in rasters.items()]
        for layer in self.layers:
            if isinstance(layer, Contours):
                with tempfile.TemporaryDirectory(prefix="jaxfilter-", dir=self.store.path) as folder:
                    model = rasters.get(layer.cells)
                    if not isinstance(model, Path):
                        model = Path(folder) / "model.tif"
                        known.append(self._write(layer.cells, model, report, collection, edge, True))
                    how, alone = (collection.crs, collection.metre), len(self.layers) == 1
                    if not write_contours(layer, model, places[layer], how, overwrite=replace, empty=not alone):
                        said = f"{collection.name}: {layer.none}"
                        if alone:
                            raise self._nothing(said)
                        warn(said)
        report.empty = grid.rows * grid.columns - known[0]
        report.files = [str(place) for place in targets.places]
        report.total.seconds["write"] += time.perf_counter() - start

    def _parts(self, report: RunReport) -> Iterator[Part]:
        """What the tiles say of the edge."""
        for stored in self.kept(report, (_GRIDS, _NEAR, _COUNT, _CIRCLE)):
            own, wide, around = self._grids(stored)
            yield Part(own, wide, around, stored[_NEAR], int(stored[_COUNT]), stored.get(_CIRCLE))

    def _grids(self, stored: Mapping[str, np.ndarray]) -> Iterator[RasterGrid]:
        return (RasterGrid(self.grid.cell, *cells) for cells in stored[_GRIDS].tolist())

    def _write(
        self, layer: Layer, place: Place, report: RunReport, collection: Collection, edge: Edge | None, replace: bool
    ) -> int:
        """Write a raster out of tiles; the number of its cells that have a value. Raises: OutputError."""
        levels, units = report.water if self.interpolation.level_water else None, collection.units
        bases = layer.parts or (layer,)
        nodata = layer.NODATA if self.nodata is None or layer.KIND != "float32" else self.nodata
        lost = collection.uncovered(one["file"] for one in (*report.failed, *report.left_out))

        def parts() -> Iterator[tuple[RasterGrid, np.ndarray]]:
            for stored in self.kept(report, (_GRIDS, *(KEPT + base.NAME for base in bases))):
                if _GRIDS in stored:
                    own, wide, _ = self._grids(stored)
                    known = {base: base.bounded(stored[KEPT + base.NAME], wide, edge, levels) for base in bases}
                    values, centres = layer.made_of(known, wide, units)[wide.slices(own)], np.meshgrid(*own.centres())
                    wanted = within(self.reading.aoi, *centres)
                    if lost is not None:
                        wanted = wanted & ~within(lost, *centres)
                    yield own, packed(np.where(wanted, values, np.float32(np.nan)), layer.KIND, nodata)

        def check(known: int) -> None:
            if known:
                return
            gap = "gap=" if hasattr(layer, "gap") else "max_gap="
            why = f"too few points are near the middle of one: pass a larger {gap}, or pass a smaller cell="
            if report.set_aside:
                why = report.set_aside[0]["reason"]
            box, data = (", ".join(f"{v:.10g}" for v in one) for one in (self.grid.bounds, self.data))
            where = f"in bounds {box}, of data within {data},"
            raise self._nothing(f"{collection.name}: no cell of the {layer.NAME} {where} has a value: {why}")

        band = Band(layer.TITLE, layer.UNITS, collection.crs)
        profile = profile_of(self.grid.shape, self.grid.transform, collection.crs, layer.KIND, nodata)
        return write_mosaic(place, self.grid, profile, parts, band, overwrite=replace, check=check)

    def _nothing(self, why: str) -> InputError:
        """The error of a product without values, which leaves nothing to go on with."""
        self.store.discard()
        return InputError(why)


def terrain_model(
    what: Any,
    target: str | Path,
    ground: GroundSource = (GROUND_CLASS,),
    *,
    cell: float | str | Path = 1.0,
    interpolation: Interpolation = Interpolation(),
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> TerrainReport:
    """Make one terrain model of a file or of a collection, and write it as a Cloud Optimized GeoTIFF.

    Tiles of large data lie in a hidden folder beside ``target`` until the model is complete, so that a run that was stopped, in
    whatever way, goes on with ``resume``.

    Args:
        what: as in :func:`jaxfilter.ground`.
        target: .tif or .tiff; may be a URL that fsspec can write to (``"s3://bucket/dtm.tif"``), where the file appears whole or
            not at all; then the hidden folder lies in ``run.work``.
        ground: what is ground, as in :func:`jaxfilter.heights`. With class 40, the bed of waters, no water is level.
        cell: side of a cell; its edges are whole multiples of it, all in file units. Or a raster file whose cells the model has.
        interpolation: as in :func:`jaxfilter.dtm`, see :class:`Interpolation`.
        reading: as in :func:`jaxfilter.ground`; its ``bounds`` are those of the raster, and points around them take part.
        run: how it is carried out, see :class:`RunOptions`: tiles, memory, workers or a cluster, going on after a stop.

    Returns: TerrainReport; tiles that could not be done are in it.
    Raises: InputError if no point is ground; ParameterError; OutputError; JaxfilterError if workers cannot be started.

    >>> report = jf.terrain_model("survey", "dtm.tif", cell=2.0, reading=jf.Reading(units="m"))
    >>> report.rows, report.columns, jf.Raster.read("dtm.tif").values.shape
    (30, 30, (30, 30))
    """
    rasters = Rasters({Dtm(): place_of(target)}, cell, interpolation)
    return make_rasters(what, rasters, ground, reading=reading, run=run)


@dataclasses.dataclass(frozen=True)
class Rasters:
    """Layers to be made: ``places`` says where each goes, several of them in one folder. ``water``: how they come to know of it;
    ``lost``: files that could not be read before, whose places have no value; ``nodata``: what stands for no value in float32, by
    default -9999; the others are those of :func:`terrain_model`."""

    places: Mapping[Layer, Place]
    cell: float | str | Path = 1.0
    interpolation: Interpolation = Interpolation()
    water: WaterWanted = WaterWanted()
    lost: tuple[str, ...] = ()
    nodata: float | None = None


def make_rasters(
    what: Any, rasters: Rasters, ground: GroundSource, *, reading: Reading, run: RunOptions
) -> TerrainReport:
    """Make layers of a file or of a collection in one go, each into a file. Arguments, and what is raised: as of
    :func:`terrain_model`."""
    layers, places, cell = tuple(rasters.places), list(rasters.places.values()), rasters.cell
    interpolation, water = rasters.interpolation, rasters.water
    for layer, place in rasters.places.items():
        check_suffix(place, layer.SUFFIXES)
    recipe, classes = source_of_ground(ground)
    if BED in (classes or ()):
        interpolation = dataclasses.replace(interpolation, level_water=False)
    collection, reading = open_files(what, reading, clip=False)
    if classes is not None and interpolation.level_water:
        water = remembered(water, collection.uris)
        classes = class_numbers({*classes, *water.classes})
    bounds = reading.bounds if reading.aoi is None else reading.aoi.bounds
    if not collection.count:
        raise InputError(f"{collection.name}: holds no points, so that no cell has a value: name files with points")
    if rasters.nodata is not None and not (
        abs(rasters.nodata) < 1e38 and rasters.nodata == float(np.float32(rasters.nodata))
    ):
        raise ParameterError(f"nodata={rasters.nodata!r}: must be a number that float32 can hold, such as -999999")
    if bounds is not None and not interpolation.fill:
        x0, y0, x1, y1 = common(bounds, collection.bounds)
        if x0 > x1 or y0 > y1:
            raise collection.nothing_in(bounds)
    if isinstance(cell, (str, Path)):
        grid = grid_like(cell, collection.crs)
    else:
        grid = RasterGrid.over(collection.bounds if bounds is None else bounds, cell, collection.metre, math.inf)
    targets = Targets(places, called="products" if len(places) > 1 else "")
    survey = Survey(collection, targets, recipe, dataclasses.replace(reading, bounds=None, drop_duplicates=True), run)
    product = RasterProduct(
        reading=survey.reading,
        halo=run.halo,
        data=collection.bounds,
        classes_of_ground=classes,
        grain=grid.cell * collection.metre,
        grid=grid,
        layers=layers,
        interpolation=interpolation,
        lost=rasters.lost,
        nodata=rasters.nodata,
        water=water if interpolation.level_water or water.path is not None else WaterWanted(False),
    )
    return carry_out(survey, product)
