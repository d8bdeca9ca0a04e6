"""Shapes in files for a GIS: GeoPackage and GeoJSON."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..core.errors import InputError, OutputError, warn
from ..core.units import for_outputs, horizontal, same_system
from .disk import new_file
from .reading import FARTHEST
from .storage import Place

if TYPE_CHECKING:
    import geopandas

DRIVERS = {".gpkg": "GPKG", ".geojson": "GeoJSON"}
"""Kinds of files by their suffix."""
VECTOR_SUFFIXES = tuple(DRIVERS)
_MOST = 1 << 28  # bytes of a file of shapes
_COMPUTED = """SELECT m.name FROM sqlite_master m JOIN pragma_table_xinfo(m.name) c WHERE m.type = 'view'
    OR (m.type = 'table' AND m.sql NOT LIKE 'CREATE VIRTUAL%' AND c.hidden > 1)"""  # what is in no file, and may have no end
_DATE = "OGR_CURRENT_DATE"  # a GeoPackage says when it was changed; the same shapes shall be the same bytes


def read_shapes(path: str | os.PathLike[str], what: str) -> geopandas.GeoDataFrame:
    """A table of the shapes in a vector file, which are ``what``, in words. Raises: InputError if there are none, if several
    layers have some, or if they are those of a view or of another file, or have more than 256 MB."""
    import geopandas
    import pyogrio

    try:
        _check_source(Path(path))
        layers = [str(name) for name, kind in pyogrio.list_layers(path) if kind is not None]
        if len(layers) != 1:
            found = ", ".join(layers) or "none"
            raise ValueError(f"one layer of shapes is needed, in a file of its own; it has {found}")
        table = geopandas.read_file(path, layer=layers[0])
    except Exception as error:  # GDAL has many of its own
        raise InputError(f"{path}: cannot be read as {what}: {error}") from error
    if table.crs == "EPSG:4326" and max(map(abs, table.total_bounds)) > 360:  # GDAL's guess where GeoJSON states none
        table = table.set_crs(None, allow_override=True)
    return table


def _check_source(place: Path) -> None:
    """Raises, before GDAL opens it: ValueError for what holds no shapes of its own, or has no bound; OSError, sqlite3.Error."""
    parts = (place, *place.rglob("*"), *place.parent.glob(f"{place.name}-wal"))
    if sum(part.stat().st_size for part in parts) > _MOST:
        raise ValueError(f"it has more than {_MOST >> 20} MB: save what is needed as a file of its own")
    head = b""
    if place.is_file():
        with place.open("rb") as file:
            head = file.read(1 << 16)
    if head.startswith(b"PK\3\4") or b"<OGR" in head or b"gdal_streamed_alg" in head:
        raise ValueError("it packs or names other files, and these are not followed: pass the file itself")
    if head.startswith(b"SQLite format 3"):
        address = f"{place.absolute().as_uri()}?mode=ro{'' if os.access(place.parent, os.W_OK) else '&immutable=1'}"
        with contextlib.closing(sqlite3.connect(address, uri=True)) as base:
            if made := base.execute(_COMPUTED).fetchone():
                raise ValueError(f"{made[0]} is a view, or has computed columns: save the layer as a file of its own")


def in_system(table: Any, crs: Any, name: str) -> Any:
    """A table or series of shapes, in a CRS if both state one. Raises: InputError if it cannot be transformed, and for
    coordinates that are NaN, infinite or beyond the Earth. Warns: if it is transformed."""
    crs = crs and horizontal(crs)
    if crs is not None and table.crs is not None and not same_system(horizontal(table.crs), crs):
        warn(f"{name}: transformed from {table.crs.name} to {crs.name}")
        try:
            table = table.to_crs(crs)
        except RuntimeError as error:  # those of PROJ are
            raise InputError(f"{name}: there is no way from {table.crs.name} to {crs.name}: save it in that") from error
    at = table.geometry.reset_index(drop=True).get_coordinates()
    if len(wrong := at.index[~(abs(at) < FARTHEST).all(axis=1)]):
        raise InputError(f"{name}: feature {wrong[0] + 1} has NaN, infinite or far coordinates: correct or remove it")
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
                table = table.set_crs(for_outputs(table.crs), allow_override=True)
                _append(table, target, named, layer, first=number == 0)
        finally:
            pyogrio.set_gdal_config_options({_DATE: before})
        os.replace(named, temporary)


def _append(table: geopandas.GeoDataFrame, target: Place, named: Path, layer: str, first: bool) -> None:
    import pyogrio

    kind, crs = DRIVERS[target.suffix.lower()], table.crs
    options = {"layer": layer} if kind == "GPKG" else {}
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
            table.to_file(named, driver=kind, engine="pyogrio", mode="w" if first else "a", **options)
    except Exception as error:
        raise OutputError(f"{target}: cannot be written: {error}") from error
    degrees = kind == "GeoJSON" and (crs is None or pyogrio.read_info(named)["crs"] == "EPSG:4326")
    if first and (crs is None or degrees):
        why = "the cloud has no CRS" if crs is None else f"GeoJSON cannot state the CRS {crs.name}, which has no code"
        also = ", and programs take its coordinates for degrees" * degrees
        warn(f"{target}: {why}, so the file has none{also}: set the CRS of the layer where it is opened")
