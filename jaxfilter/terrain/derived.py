"""Contour lines and relief of a raster file of any size, which need no points."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyproj

from ..core.errors import InputError
from ..core.units import vertical
from ..files.storage import Place
from .contours import Contours, write_contours
from .layer import Layer
from .raster import STRIP, Band, RasterGrid, Rows, metres_per_unit, packed, profile_of, write_mosaic
from .rasters import Hillshade


def make_of_raster(layer: Layer, source: Path, target: Place, *, overwrite: bool = False) -> str:
    """Write the contour lines or the hillshade of the heights in a raster file.

    Args:
        layer: Contours or Hillshade. source: first band of a north-up file with square cells.
        target: with a suffix of the layer.

    Returns: what was made, in words. Raises: InputError if there is no such raster; OutputError.
    """
    with Rows.of(source) as (rows, transform, crs):
        metre = metres_per_unit(crs)
        if isinstance(layer, Contours):
            if not write_contours(layer, source, target, (crs, metre), overwrite=overwrite):
                raise InputError(f"{source}: {layer.none}")
            return f"contour lines every {layer.interval:g}"
        assert isinstance(layer, Hillshade)
        grid = RasterGrid(transform[0], 0, 0, rows.columns, rows.number)
        factor = 1.0 if vertical(crs) is None else pyproj.CRS(crs).axis_info[-1].unit_conversion_factor
        z_factor = (metre if vertical(crs) is None else factor) / metre

        def parts() -> Iterator[tuple[RasterGrid, np.ndarray]]:
            for top in range(0, rows.number, STRIP):
                stop, first = min(top + STRIP, rows.number), max(0, top - 1)
                shade = layer.shade(rows.read(first, min(stop + 1, rows.number)), grid.cell, z_factor)[top - first :]
                part = RasterGrid(grid.cell, 0, rows.number - stop, grid.columns, stop - top)
                yield part, packed(shade[: stop - top], layer.KIND, layer.NODATA)

        profile = profile_of(grid.shape, transform, crs, layer.KIND, layer.NODATA)
        known = write_mosaic(target, grid, profile, parts, Band(layer.TITLE, layer.UNITS, crs), overwrite=overwrite)
        return f"{rows.number:,} x {rows.columns:,} cells, {rows.number * rows.columns - known:,} without a value"
