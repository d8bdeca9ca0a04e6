"""From a survey to its products in one go: classified files, rasters and lines, and a page that shows them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import InputError, OutputError, ParameterError
from ..core.filter import Filter
from ..core.output import output_errors
from ..core.reading import Reading
from ..files.classes import Classes
from ..files.disk import check_suffix, is_there
from ..files.storage import Place, place_of
from ..files.vectors import VECTOR_SUFFIXES
from ..terrain.interpolation import Interpolation
from ..terrain.layer import Layer
from ..terrain.layers import LAYERS
from .collection import Collection
from .collection import open as open_collection
from .ground import ground as classify
from .kept import WaterWanted
from .measures import Recipe
from .model import Rasters, TerrainReport, make_rasters
from .options import RunOptions
from .report import RunReport
from .surroundings import GroundSource

CLASSIFIED = "classified"


class Products(NamedTuple):
    """What :func:`products` has made.

    ``ground``: of the classified files; None if there are none. ``rasters``: of rasters and lines, whose ``files`` are named.
    ``page``: where the page is.
    """

    ground: RunReport | None
    rasters: TerrainReport
    page: Place

    @property
    def complete(self) -> bool:
        """Whether nothing was set aside, and no file was left out."""
        return self.rasters.complete and (self.ground is None or self.ground.complete)


def products(
    what: Any,
    out: str | Path,
    ground: GroundSource | None = None,
    *,
    only: Iterable[str | Layer] | None = None,
    cell: float | str | Path = 1.0,
    nodata: float | None = None,
    interpolation: Interpolation = Interpolation(),
    reading: Reading = Reading(),
    classes: Classes = Classes(),
    review: str | Path | None = None,
    breaklines: str | Path | None = None,
    run: RunOptions = RunOptions(),
) -> Products:
    """Classify a survey, and make rasters and contours of its ground, each as one file, and a page that shows them.

    In the folder ``out`` are then ``classified/`` with what :func:`jaxfilter.ground` writes, one Cloud Optimized GeoTIFF for the
    whole survey of each raster, such as ``dtm.tif``, the lines ``contours.gpkg``, and ``survey.html``. A run that was stopped
    goes on with ``resume``: files that are whole are kept, and rasters that were complete are made again.

    Args:
        what, reading, run: as in :func:`jaxfilter.ground`, but for ``in_place``.
        out: a folder, made if missing; a URL needs ``run.work``.
        ground: the filter, by default the default method, set up for the data; or classes of points that are ground already,
            as in :func:`jaxfilter.heights`, and then no files are classified.
        only: names of what is made, such as ``["dtm", "contours"]``; by default everything (docs/products.md). Or layers with
            other settings, such as ``jf.dsm.replace(gap=5.0)``.
        cell: side of the cells of rasters, in file units, or a raster file whose cells they have.
        nodata: what stands for no value in rasters of float32, by default -9999.
        interpolation: of heights between ground points, see :class:`Interpolation`.
        classes: of the classified files. Points of water are ground of the rasters, whatever class they get.
        review: a GeoPackage (.gpkg) or GeoJSON (.geojson) to write as well: the places to look at, as in
            :func:`jaxfilter.ground`; only if files are classified.
        breaklines: a GeoPackage (.gpkg) or GeoJSON (.geojson) to write as well: the outlines of water bodies, on which the
            terrain is level, see :func:`jaxfilter.breaklines`.

    Returns: Products; what could not be done is in its reports.
    Raises: as :func:`jaxfilter.ground` and :func:`jaxfilter.terrain_model`.

    >>> made = jf.products("survey", "made", (2,), only=["dtm", "hillshade"], reading=jf.Reading(units="m"))
    >>> [file.rpartition("/")[2] for file in made.rasters.files]
    ['dtm.tif', 'hillshade.tif']
    """
    from .page import PAGE, write_survey_page  # late: it brings Matplotlib

    asked, folder = list(LAYERS if only is None else only), place_of(out)
    given = {layer.NAME: layer for layer in asked if isinstance(layer, Layer)}
    names = [layer.NAME if isinstance(layer, Layer) else layer for layer in asked]
    if wrong := [name for name in names if name not in LAYERS] or ([] if names else ["nothing"]):
        raise ParameterError(f"only={wrong[0]!r}: choose from {', '.join(LAYERS)}")
    if run.in_place:
        raise ParameterError("products are written into a folder and cannot take the place of the input: name a folder")
    if isinstance(folder, Path) and folder.is_file():
        raise OutputError(f"{folder}: is a file, and products are written into a folder: name a folder")
    layers = [given.get(name) or entry.kind() for name, entry in LAYERS.items() if name in names]
    outputs = {layer: folder / f"{layer.NAME}{layer.SUFFIXES[0]}" for layer in layers}
    taken = {place.absolute(): layer.NAME for layer, place in outputs.items() if isinstance(place, Path)}
    for name, shapes in (("review", review), ("breaklines", breaklines)):
        if shapes is None:
            continue
        check_suffix(path := Path(shapes), VECTOR_SUFFIXES)
        if (other := taken.setdefault(path.absolute(), name)) != name:
            raise ParameterError(f"{name}={str(shapes)!r}: is the file of the {other}: name another")
    source: GroundSource = Recipe() if ground is None else ground
    if review is not None and not isinstance(source, Filter | Recipe):
        raise ParameterError(
            f"review={str(review)!r}: places come from a filter, and classes say here what is ground: leave it out, and list "
            "places with review_survey (jaxfilter review)"
        )
    for place in (*outputs.values(), folder / PAGE):
        if is_there(place) and not (run.overwrite or run.resume):
            raise OutputError(
                f"{place}: the file exists; pass overwrite=True to replace it, or pass resume=True to go on"
            )
    collection = what if isinstance(what, Collection) else open_collection(what, units=reading.units, crs=reading.crs)
    if isinstance(folder, Path) and not run.dry_run:
        with output_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
    classified: RunReport | None = None
    water = WaterWanted(path=None if breaklines is None else Path(breaklines))
    anew = dataclasses.replace(run, overwrite=run.overwrite or run.resume)
    if isinstance(source, Filter | Recipe):
        how: dict[str, Any] = {"reading": reading, "classes": classes, "review": review}
        classified = classify(collection, f"{folder / CLASSIFIED}/", source, run=run, **how)
        if classified.was_complete:
            classified = classified.recalled(folder / CLASSIFIED)
    if run.dry_run:
        known = reading.aoi is None and classified is not None  # around an area the rasters look for the ground again
        wanted = Rasters(outputs, cell, interpolation)
        tried = make_rasters(collection, wanted, (2,) if known else source, reading=reading, run=run)
        if classified is not None and classified.forecast is not None and tried.forecast is not None:
            seconds = classified.forecast.seconds + tried.forecast.seconds
            tried.forecast = tried.forecast._replace(seconds=seconds)
        return Products(classified, tried, folder / PAGE)
    if classified is not None and not classified.files:
        reasons = [one["reason"] for one in (*classified.set_aside, *classified.failed)]
        raise InputError(f"{folder / CLASSIFIED}: no file could be classified: {'; '.join(reasons[:1])}")
    lost = [] if classified is None else [*classified.failed, *classified.left_out]
    left_out: tuple[str, ...] = ()
    what = collection
    if classified is not None and reading.aoi is None:  # around an area there is ground that is in no classified file
        what, left_out = classified.files, tuple(dict.fromkeys(one["file"] for one in lost))
        source = (classes.ground_class,)
        reading = Reading(units=reading.units, crs=reading.crs, bounds=reading.bounds)
    wanted = Rasters(outputs, cell, interpolation, water, left_out, nodata)
    rasters = make_rasters(what, wanted, source, reading=reading, run=anew)
    if classified is not None:  # what was warned of inputs comes again from the classified files
        said = {remark.partition(": ")[2] for remark in classified.remarks}
        for remark in [one for one in rasters.remarks if one.partition(": ")[2] in said]:
            del rasters.remarks[remark]
    write_survey_page(folder, wanted, (classified or rasters, rasters), collection, overwrite=anew.overwrite)
    return Products(classified, rasters, folder / PAGE)
