"""Outlines of water bodies, along which a terrain model breaks."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import InputError
from ..core.result import FilterResult
from ..files.storage import place_of
from ..files.vectors import check_suffix, write_features

if TYPE_CHECKING:
    import geopandas


def breaklines(
    cloud: PointCloud, result: FilterResult, path: str | os.PathLike[str] | None = None, *, overwrite: bool = False
) -> geopandas.GeoDataFrame:
    """The water bodies of a cloud in memory as polygons with one elevation each, after a filter that looks for water (OST).

    They follow the cells of the filter, so that voids of water that returns nothing are in them; islands are holes. Of a cloud
    that is a part of a survey, those of the part.

    Args:
        cloud: n points, those that ``result`` is of.
        result: what the filter returned.
        path: a GeoPackage (.gpkg, layer ``breaklines``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
        overwrite: replace an existing file.

    Returns: GeoDataFrame of polygons with the columns ``elevation``, the median of the surface, and ``area``, in the units and
    with the CRS of the cloud. Raises: InputError for a result of another method or another cloud; OutputError (suffix, exists,
    disk). Warns: if a file is written and the cloud has no CRS.

    >>> wet = jf.scenes.make(jf.scenes.SceneLayout(lake=30.0, water_echoes=0.8), size=(260, 320), density=1, seed=3)
    >>> lakes = jf.breaklines(wet.cloud, jf.OST.for_cloud(wet.cloud)(wet.cloud))
    >>> set(lakes.geom_type), bool((lakes.area > 200).all())
    ({'Polygon'}, True)
    """
    import geopandas
    import rasterio.features
    import shapely

    from ..methods import OST  # imports JAX

    cloud, run = as_cloud(cloud), result.run
    if run is None or not isinstance(run.filter, OST) or run.cloud is not cloud:
        raise InputError("breaklines(cloud, result): result must be what an OST filter returned for this very cloud")
    target = None if path is None else place_of(path)
    if target is not None:
        check_suffix(target)
    body, level, (x0, y0, cell) = run.filter.waters(cloud)
    factor = cloud.units.xy
    corner = cloud.origin[:2] + np.array([x0, y0]) / factor
    transform = rasterio.Affine(cell / factor, 0, corner[0], 0, cell / factor, corner[1])
    shapes = list(rasterio.features.shapes(body, mask=body > 0, connectivity=4, transform=transform))
    rows: dict[str, list[Any]] = {"elevation": [], "geometry": []}
    for shape, number in shapes:
        median = float(np.median(level[body == int(number)]))
        rows["elevation"].append(cloud.origin[2] + median / cloud.units.z)
        rows["geometry"].append(shapely.geometry.shape(shape))
    table = geopandas.GeoDataFrame(rows, geometry="geometry", crs=cloud.crs)
    table.insert(1, "area", table.area)
    if target is not None:
        write_features(target, [table], "breaklines", overwrite=overwrite)
    return table
