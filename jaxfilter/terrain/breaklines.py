"""Outlines of water bodies, along which a terrain model breaks."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.result import FilterResult
from ..files.storage import Place, place_of
from ..files.vectors import check_suffix, write_features
from .layer import ground_of
from .levels import WaterRuns, levels_in

if TYPE_CHECKING:
    import geopandas


def breaklines(
    cloud: PointCloud,
    result: FilterResult | np.ndarray | None = None,
    path: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """The water bodies of a cloud in memory as polygons: those that the filter found (OST), and those of points of class 9.

    They follow cells of a metre or more, so that voids of water that returns nothing are in them; islands are holes. Corners have
    the height that :func:`jaxfilter.dtm` gives the water: one for all, or, where the two ends differ by more than 0.1 m, heights
    that fall along the course.

    Args:
        cloud: n points.
        result: what is ground, as in :func:`jaxfilter.dtm`.
        path: a GeoPackage (.gpkg, layer ``breaklines``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
        overwrite: replace an existing file.

    Returns: GeoDataFrame of polygons with Z, in the units and with the CRS of the cloud, and with the columns ``elevation``, the
    median; ``fall``, how much higher the upper end is; and ``area``. Raises: InputError for labels that do not fit; OutputError
    (suffix, exists, disk). Warns: if a file is written and the cloud has no CRS.

    >>> wet = jf.scenes.make(jf.scenes.SceneLayout(lake=30.0, water_echoes=0.8), size=(260, 320), density=1, seed=3)
    >>> lakes = jf.breaklines(wet.cloud, jf.OST.for_cloud(wet.cloud)(wet.cloud))
    >>> set(lakes.geom_type), bool((lakes.area >= 100).all()), bool(lakes.has_z.all())
    ({'Polygon'}, True, True)
    """
    cloud = as_cloud(cloud)
    target = None if path is None else place_of(path)
    if target is not None:
        check_suffix(target)
    table = table_of_water(levels_in(cloud, result, ground_of(cloud, result)), cloud.crs)
    if target is not None:
        write_breaklines(target, table, overwrite)
    return table


def table_of_water(levels: WaterRuns | None, crs: object) -> geopandas.GeoDataFrame:
    """What :func:`breaklines` returns, of bodies with their levels."""
    import geopandas

    if levels is not None:
        return levels.table(crs)
    none = np.zeros(0)
    return geopandas.GeoDataFrame({"elevation": none, "fall": none, "area": none}, geometry=[], crs=crs)


def write_breaklines(target: Place, table: geopandas.GeoDataFrame, overwrite: bool) -> None:
    """Write what :func:`breaklines` returns. Raises: OutputError."""
    write_features(target, [table], "breaklines", overwrite=overwrite)
