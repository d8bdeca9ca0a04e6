"""The places where a terrain model may be wrong, as a table and as polygons for a GIS."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import as_cloud
from ..core.result import FilterResult
from ..files.vectors import check_suffix, write_features
from .places import SIDE, Place, places_of, suspects

if TYPE_CHECKING:
    import geopandas

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
    square metre of it is off by more than half a metre), ``reason``, ``verdict`` (empty: what a person decides there, for
    :func:`jaxfilter.apply`) and ``geometry``.
    Raises: ParameterError; InputError (labels of another length, too large an extent); OutputError
    (suffix, exists, disk). Warns: if a file is written and the cloud has no CRS.

    >>> places = jf.review(cloud, result, "places.geojson")
    >>> places["rank"].tolist() == list(range(1, len(places) + 1)), bool(places["volume"].is_monotonic_decreasing)
    (True, True)
    """
    target = None if path is None else Path(path)
    if target is not None:
        check_suffix(target)
    cloud = as_cloud(cloud)
    table = table_of(places_of(suspects(cloud, result), cloud.units.xy), cloud.units.xy, cloud.crs)
    if target is not None:
        write_features(target, [table], "review", overwrite=overwrite)
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
    columns: dict[str, list[Any]] = {name: [place.facts()[name] for place in places] for name in COLUMNS}
    columns["verdict"] = [""] * len(places)
    ranks = {"rank": np.arange(1, len(places) + 1)}
    return geopandas.GeoDataFrame(ranks | columns, geometry=shapes, crs=crs)
