"""The area of interest of a survey: points in it are written, and those around it take part.

Shapely is imported where there is one: it takes a while.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..core.errors import InputError, ParameterError, warn
from ..core.reading import Bounds, Reading
from ..files.vectors import in_system, read_shapes
from .collection import Collection

if TYPE_CHECKING:
    import shapely


def area_of(reading: Reading, survey: Collection) -> shapely.Geometry:
    """The area as polygons in file coordinates: of a vector file, a GeoDataFrame or GeoSeries, or a polygon in file coordinates.

    Raises: InputError if it cannot be read, is empty or no area, or lies beside the survey; ParameterError for text, whose points
    are cut by bounds only, and with bounds. Warns: if it is transformed, or repaired.
    """
    import geopandas
    import shapely

    aoi = reading.aoi
    name = os.fspath(aoi) if isinstance(aoi, (str, os.PathLike)) else "aoi"
    if reading.bounds is not None:
        raise ParameterError("aoi= and bounds= cannot both say what is written: leave out one of them")
    if any(source.format == "text" for source in survey):
        raise ParameterError(
            f"{name}: text is cut by bounds only, not by an area: pass bounds=, or convert it to LAZ first"
        )
    shapes: Any = aoi if name == "aoi" else read_shapes(name, "polygons")
    try:
        frame = geopandas.GeoSeries(getattr(shapes, "geometry", [shapes]))
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: cannot be read as polygons: {error}") from error
    if frame.crs is not None and survey.crs is None:
        raise InputError(
            f"{name}: is in {frame.crs.name}, and the CRS of {survey.name} is not known: pass crs= to state it"
        )
    parts = [part for part in in_system(frame, survey.crs, name) if part is not None and not part.is_empty]
    if broken := [part for part in parts if not part.is_valid]:
        warn(f"{name}: {shapely.is_valid_reason(broken[0])}: repaired, please check it")
    area = shapely.union_all([shapely.make_valid(part) for part in parts])
    pieces = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    if not pieces:
        raise InputError(f"{name}: holds no polygon, so there is no area")
    area = shapely.MultiPolygon(pieces)
    if not len(survey.within(cast(Bounds, area.bounds))):
        box = ", ".join(f"{v:.10g}" for v in survey.bounds)
        raise InputError(f"{name}: lies beside the points, which are within {box}: is it in another CRS?")
    return area


def meeting(area: shapely.Geometry | None, boxes: np.ndarray) -> np.ndarray:
    """bool[n]: closed boxes f64[n, 4] that share a place with an area; all, if there is none."""
    if area is None:
        return np.ones(len(boxes), bool)
    import shapely

    return np.asarray(shapely.intersects(area, shapely.box(*boxes.T)))


def within(area: shapely.Geometry | None, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """bool: places in an area or on its border, file coordinates; all, if there is none."""
    if area is None:
        return np.ones(np.shape(x), bool)
    import shapely

    shapely.prepare(area)
    return np.asarray(shapely.intersects_xy(area, x, y))
