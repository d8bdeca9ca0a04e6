"""Lines of equal height through rasters of any size: made block by block, and joined across blocks."""

from __future__ import annotations

import collections
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from .raster import STRIP

if TYPE_CHECKING:
    import geopandas

_STEP = 2.0**-20
"""Of a cell, to which places are rounded: the ends of lines in two blocks are then equal."""


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
        shapes = [shapely.transform(line, lambda at: (at + 0.5) * side + corner) for _, line in lines]
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
        for number in range(math.ceil(low), math.floor(high) + 1):
            for at in made.lines(number * interval):
                line = np.rint(np.asarray(at) / _STEP) * _STEP + [left, row]
                if np.ptp(line, axis=0).any():
                    yield number, shapely.linestrings(line)
