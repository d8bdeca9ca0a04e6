"""Contour lines of a terrain model of any size: made block by block, and joined across blocks."""

from __future__ import annotations

import collections
import dataclasses
import math
import os
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import ParameterError, check_positive
from ..files.disk import check_suffix
from ..files.storage import place_of
from ..files.vectors import VECTOR_SUFFIXES, write_features
from .layer import Layer, setting
from .models import Dtm
from .raster import STRIP, Raster

if TYPE_CHECKING:
    import geopandas

_STEP = 2.0**-20
"""Of a cell, to which places are rounded: the ends of lines in two blocks are then equal."""
_MOST = 5_000  # elevations of lines in a block


@dataclasses.dataclass(frozen=True)
class Contours(Layer):
    """Contour lines of the terrain model, see :func:`contours`."""

    NAME, TITLE, SUFFIXES, MODEL = "contours", "elevation", VECTOR_SUFFIXES, True
    interval: float = setting("Difference of elevation between lines, in units of Z.", 1.0)

    def __post_init__(self) -> None:
        check_positive(", in units of Z", interval=self.interval)

    @property
    def cells(self) -> Layer:
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
    Raises: ParameterError for an interval that is not positive, or gives lines of more than 5,000 elevations in 512 x 512 cells;
    OutputError (suffix, exists, disk). Warns: if a file is written and the model has no CRS.

    >>> lines = jf.contours(jf.dtm(cloud, result), interval=2.0)
    >>> bool((lines["elevation"] % 2 == 0).all()), set(lines.geom_type)
    (True, {'LineString'})
    """
    import pandas as pd

    layer, z = Contours(interval), model.values
    target = None if path is None else check_suffix(place_of(path), VECTOR_SUFFIXES)
    strips = (z[top : top + STRIP + 1] for top in range(0, max(1, len(z) - 1), STRIP))
    table = pd.concat(list(contour_tables(strips, interval, model.transform, model.crs)), ignore_index=True)
    if target is not None:
        write_features(target, [table], layer.NAME, overwrite=overwrite)
    return table


def contour_tables(
    strips: Iterable[np.ndarray], interval: float, transform: tuple[float, ...], crs: Any
) -> Iterator[geopandas.GeoDataFrame]:
    """Tables of lines with their ``elevation``, a whole multiple of the interval; at least one table, which may be empty.

    ``strips``: heights f32[r, columns] of some rows after the other, as :func:`jaxfilter.terrain.raster.strips_of` gives them;
    ``transform``, ``crs``: as of a :class:`Raster`.
    """
    import geopandas
    import shapely

    corner, side = np.array([transform[2], transform[5]]), np.array([transform[0], transform[4]])
    waiting: dict[int, list[Any]] = collections.defaultdict(list)  # lines that may go on, by multiples of the interval
    row, some = 0, False

    def table(lines: list[tuple[int, Any]]) -> geopandas.GeoDataFrame:
        elevation = np.array([number * interval for number, _ in lines], np.float64)
        shapes = shapely.transform(np.array([line for _, line in lines], object), lambda at: (at + 0.5) * side + corner)
        return geopandas.GeoDataFrame({"elevation": elevation}, geometry=shapes, crs=crs)

    for z in strips:
        for number, line in _lines(z, interval, row):
            waiting[number].append(line)
        row += len(z) - 1
        done: list[tuple[int, Any]] = []
        for number in sorted(waiting):
            parts = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(waiting.pop(number))))
            ends = shapely.get_y(shapely.get_point(parts, [[0], [-1]]))
            goes_on = (ends == row).any(axis=0) & ~shapely.is_closed(parts)
            if goes_on.any():
                waiting[number] = list(parts[goes_on])
            done += [(number, part) for part in parts[~goes_on]]
        if done:
            some = True
            yield table(done)
    rest = [(number, line) for number, lines in sorted(waiting.items()) for line in lines]
    if rest or not some:
        yield table(rest)


def _lines(z: np.ndarray, interval: float, row: int) -> Iterator[tuple[int, Any]]:
    """Multiples of the interval, and lines in columns and rows of cells; ``row``: the first."""
    import contourpy
    import shapely

    for left in range(0, z.shape[1] - 1, STRIP):
        part = z[:, left : left + STRIP + 1].astype(np.float64)
        if len(part) < 2 or np.isnan(part).all():
            continue
        made = contourpy.contour_generator(z=np.ma.masked_invalid(part), name="serial", line_type="Separate")
        low, high = np.nanmin(part) / interval, np.nanmax(part) / interval
        if not high - low < _MOST:
            many = f"heights over {high - low:.3g} intervals in 512 x 512 cells, more than {_MOST:,}"
            raise ParameterError(f"interval={interval:g}: {many}: pass a larger interval=")
        for number in range(math.ceil(low), math.floor(high) + 1):
            for at in made.lines(number * interval):
                line = np.rint(np.asarray(at) / _STEP) * _STEP + [left, row]
                if np.ptp(line, axis=0).any():
                    yield number, shapely.linestrings(line)
