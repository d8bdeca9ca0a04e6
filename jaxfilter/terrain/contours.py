"""Contour lines of a terrain model."""

from __future__ import annotations

import dataclasses
import math
import os
from typing import TYPE_CHECKING

from ..core.errors import ParameterError
from ..files.storage import place_of
from ..files.vectors import check_suffix, write_features
from .layer import Layer
from .lines import contour_tables
from .models import Dtm
from .raster import STRIP, Raster

if TYPE_CHECKING:
    import geopandas


@dataclasses.dataclass(frozen=True)
class Contours(Layer):
    """Make contour lines of the terrain model, a GeoPackage or GeoJSON of lines with their elevation."""

    NAME, TITLE, SUFFIX = "contours", "elevation", ".gpkg"
    interval: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.interval < math.inf:
            raise ParameterError(f"interval={self.interval!r} must be a positive number, in units of Z")

    @property
    def cells(self) -> Layer:
        """The terrain model."""
        return Dtm()


def contours(
    model: Raster,
    interval: float = 1.0,
    path: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """Contour lines of a terrain model, by contourpy: linear between the centres of cells.

    Args:
        model: heights, for instance of :func:`dtm`.
        interval: difference of elevation between lines, in units of Z; their elevations are whole multiples of it.
        path: a GeoPackage (.gpkg, layer ``contours``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
        overwrite: replace an existing file.

    Returns: GeoDataFrame of lines with the column ``elevation``, in the coordinates and with the CRS of the model.
    Raises: ParameterError for an interval that is not positive; OutputError (suffix, exists, disk). Warns: if a file is written
    and the model has no CRS.

    >>> lines = jf.contours(jf.dtm(cloud, result), interval=2.0)
    >>> bool((lines["elevation"] % 2 == 0).all()), set(lines.geom_type)
    (True, {'LineString'})
    """
    import pandas as pd

    layer, z = Contours(interval), model.values
    target = None if path is None else place_of(path)
    if target is not None:
        check_suffix(target)
    strips = (z[top : top + STRIP + 1] for top in range(0, max(1, len(z) - 1), STRIP))
    table = pd.concat(list(contour_tables(strips, interval, model.transform, model.crs)), ignore_index=True)
    if target is not None:
        write_features(target, [table], layer.NAME, overwrite=overwrite)
    return table
