"""The places where a terrain model may be wrong, as a table and as polygons for a GIS."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import as_cloud
from ..core.errors import OutputError, warn
from ..core.result import FilterResult
from ..files.disk import new_file
from .places import SIDE, Place, places_of, suspects

if TYPE_CHECKING:
    import geopandas

DRIVERS = {".gpkg": "GPKG", ".geojson": "GeoJSON"}
"""Kinds of files by their suffix."""
COLUMNS = ("x", "y", "area", "volume", "chance", "reason")
"""Of the table, after the rank."""


def review(
    cloud: Any,
    result: FilterResult | np.ndarray,
    path: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """Places where the terrain model may be off by more than half a metre, the largest expected error volume first.

    Cells of 2 m whose chance of such an error is 6 % or more are named; those that touch are one place, from 40 m2 on. The
    chance follows from the mean doubt of the points, the share of ground among them, the density of ground points, and the
    slope of the terrain. Objects that are labelled ground and that the outline of the data cuts are named as well
    (docs/doubt.md).

    Args:
        cloud: what was classified, n points, a PointCloud or a ``laspy.LasData``.
        result: of any filter, or bool[n] with True = ground. Places are found better where doubt is stated (OST).
        path: a GeoPackage (.gpkg, layer ``review``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
            Both open in QGIS.
        overwrite: replace an existing file.

    Returns: GeoDataFrame with the CRS of the cloud, coordinates in its units, and the columns ``rank`` (from 1), ``x`` and
    ``y`` (in a cell that holds points), ``area`` (m2), ``volume`` (m3: expected error, area times height), ``chance`` (that a
    square metre of it is off by more than half a metre), ``reason`` and ``geometry``.
    Raises: ParameterError; InputError (labels of another length, too large an extent); OutputError
    (suffix, exists, disk). Warns: if a file is written and the cloud has no CRS.

    >>> places = jf.review(cloud, result, "places.geojson")
    >>> places["rank"].tolist() == list(range(1, len(places) + 1)), bool(places["volume"].is_monotonic_decreasing)
    (True, True)
    """
    target = None if path is None else Path(path)
    check_suffix(target)
    cloud = as_cloud(cloud)
    table = table_of(places_of(suspects(cloud, result), cloud.units.xy), cloud.units.xy, cloud.crs)
    if target is not None:
        write_places(table, target, overwrite)
    return table


def table_of(places: Sequence[Place], metre: float, crs: Any) -> geopandas.GeoDataFrame:
    """The table of :func:`review`. ``metre``: metres per unit of the file."""
    import geopandas
    import shapely

    side, shapes = SIDE / metre, []
    for place in places:
        low = place.cells * side
        boxes = shapely.box(low[:, 0], low[:, 1], low[:, 0] + side, low[:, 1] + side)
        # The corners of neighbouring cells are equal but for rounding: snapped to a ten thousandth of a side.
        shapes.append(shapely.union_all(boxes, grid_size=side / 10_000))
    columns = {name: [place.facts()[name] for place in places] for name in COLUMNS}
    ranks = {"rank": np.arange(1, len(places) + 1)}
    return geopandas.GeoDataFrame(ranks | columns, geometry=shapes, crs=crs)


def write_places(table: geopandas.GeoDataFrame, target: Path, overwrite: bool) -> None:
    """Write a table of :func:`review`. Raises: OutputError. Warns: if it has no CRS."""
    if table.crs is None:
        taken = "; programs take its coordinates for degrees" * (DRIVERS[target.suffix.lower()] == "GeoJSON")
        warn(
            f"{target}: the cloud has no CRS, so the file has none{taken}: set the CRS of the layer where it is opened"
        )
    with new_file(target, overwrite=overwrite) as temporary:
        _save(table, target, temporary)


def check_suffix(path: Path | None) -> None:
    """Raises: OutputError for the name of another kind of file than :func:`review` writes."""
    if path is not None and path.suffix.lower() not in DRIVERS:
        raise OutputError(f"{path}: the suffix must be one of {', '.join(DRIVERS)}")


def _save(table: geopandas.GeoDataFrame, target: Path, temporary: Path) -> None:
    """Write the file; GDAL takes its kind from the name, so it is made under one with the suffix of ``target``."""
    import pyogrio

    named = temporary.with_name(f"list{target.suffix.lower()}")
    options = {"layer": "review"} if DRIVERS[target.suffix.lower()] == "GPKG" else {}
    date = "OGR_CURRENT_DATE"  # a GeoPackage says when it was changed; the same places shall be the same bytes
    before = pyogrio.get_gdal_config_option(date)
    try:
        pyogrio.set_gdal_config_options({date: "1970-01-01T00:00:00Z"})
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
            table.to_file(named, driver=DRIVERS[target.suffix.lower()], engine="pyogrio", **options)
    except Exception as error:
        raise OutputError(f"{target}: cannot be written: {error}") from error
    finally:
        pyogrio.set_gdal_config_options({date: before})
    os.replace(named, temporary)
