"""Shapes in files for a GIS: GeoPackage and GeoJSON."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.errors import InputError, OutputError, warn
from .disk import new_file
from .storage import Place

if TYPE_CHECKING:
    import geopandas

DRIVERS = {".gpkg": "GPKG", ".geojson": "GeoJSON"}
"""Kinds of files by their suffix."""
SUFFIXES = tuple(DRIVERS)
_DATE = "OGR_CURRENT_DATE"  # a GeoPackage says when it was changed; the same shapes shall be the same bytes


def read_shapes(path: str | os.PathLike[str], what: str) -> geopandas.GeoDataFrame:
    """A table of the shapes in a vector file, which are ``what``, in words. Raises: InputError if there are none, or if several
    layers have some."""
    import geopandas
    import pyogrio

    try:
        layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
        table = geopandas.read_file(path, layer=layers[0] if layers else None)
    except Exception as error:  # GDAL has many of its own
        raise InputError(f"{path}: cannot be read as {what}: {error}") from error
    if not isinstance(table, geopandas.GeoDataFrame):
        raise InputError(f"{path}: holds no geometry: pass {what}, as a GeoPackage or GeoJSON")
    if len(layers) > 1:
        raise InputError(
            f"{path}: has the layers {', '.join(layers)}: save the one that is meant, {what}, as a file of its own"
        )
    if table.crs == "EPSG:4326" and max(map(abs, table.total_bounds)) > 360:  # GDAL's guess where GeoJSON states none
        table = table.set_crs(None, allow_override=True)
    return table


def write_features(
    target: Place, tables: Iterable[geopandas.GeoDataFrame], layer: str, *, overwrite: bool = False
) -> None:
    """Write tables of shapes with one CRS, one after the other, of which there is at least one; none is held longer than
    needed. ``layer``: its name in a GeoPackage. Raises: OutputError. Warns: if the tables have no CRS."""
    import pyogrio

    before = pyogrio.get_gdal_config_option(_DATE)
    with new_file(target, overwrite=overwrite) as temporary:
        named = temporary.with_name(f"list{target.suffix.lower()}")  # GDAL takes its kind from the name
        try:
            pyogrio.set_gdal_config_options({_DATE: "1970-01-01T00:00:00Z"})
            for number, table in enumerate(tables):
                _append(table, target, named, layer, first=number == 0)
        finally:
            pyogrio.set_gdal_config_options({_DATE: before})
        os.replace(named, temporary)


def _append(table: geopandas.GeoDataFrame, target: Place, named: Path, layer: str, first: bool) -> None:
    import pyogrio

    kind = DRIVERS[target.suffix.lower()]
    options = {"layer": layer} if kind == "GPKG" else {}
    if first and table.crs is None:
        also = "; programs take its coordinates for degrees" * (kind == "GeoJSON")
        warn(f"{target}: the cloud has no CRS, so the file has none{also}: set the CRS of the layer where it is opened")
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
            table.to_file(named, driver=kind, engine="pyogrio", mode="w" if first else "a", **options)
        lost = first and kind == "GeoJSON" and table.crs is not None and pyogrio.read_info(named)["crs"] == "EPSG:4326"
    except Exception as error:
        raise OutputError(f"{target}: cannot be written: {error}") from error
    if lost:
        warn(
            f"{target}: GeoJSON cannot state the CRS {table.crs.name}, which has no code, so programs take its coordinates for "
            "degrees: write a GeoPackage (.gpkg), or set the CRS of the layer where it is opened"
        )
