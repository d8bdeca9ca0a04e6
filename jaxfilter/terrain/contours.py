"""Contour lines of a terrain model of any size: it is smoothed, lines are made block by block, and joined across blocks."""

from __future__ import annotations

import collections
import dataclasses
import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InputError, ParameterError, check_positive
from ..files.disk import check_suffix
from ..files.storage import Place, place_of
from ..files.vectors import VECTOR_SUFFIXES, write_features
from .layer import Layer, setting
from .models import Dtm
from .raster import STRIP, Raster, Rows, metres_per_unit

if TYPE_CHECKING:
    import geopandas

TOLERANCE, INDEX = 0.1, 5
"""Share of the interval by which smoothing moves a height at most; every so many lines one is an index line."""
_ROUNDS, _SIMPLER = 24, 0.1
"""Times that heights are averaged with their neighbours, and share of a cell by which simpler lines lie beside."""
_STEP = 2.0**-20
"""Of a cell, to which places are rounded: the ends of lines in two blocks are then equal."""
_MOST = 5_000  # elevations of lines in a block


@dataclasses.dataclass(frozen=True)
class Contours(Layer):
    """Contour lines of the terrain model, see :func:`contours`."""

    NAME, TITLE, SUFFIXES, MODEL, OF_RASTER = "contours", "elevation", VECTOR_SUFFIXES, True, True
    interval: float = setting("Difference of elevation between lines, in units of Z.", 1.0)
    shortest: float = setting("Length from which on a line is drawn.", 10.0, metres=True)

    def __post_init__(self) -> None:
        check_positive(", in units of Z", interval=self.interval)
        check_positive(" of metres", shortest=self.shortest)

    @property
    def cells(self) -> Layer:
        return Dtm()

    def from_raster(self, source: Path, target: Place, overwrite: bool) -> None:
        """Write the lines. Raises: InputError if there are none; OutputError."""
        with Rows.of(source) as (_, _, crs):
            system = crs, metres_per_unit(crs)
        if not write_contours(self, source, target, system, overwrite=overwrite):
            raise InputError(f"{source}: {self.none}")

    @property
    def none(self) -> str:
        """What to say if there are none."""
        why = f"no line at multiples of interval={self.interval:g} has {self.shortest:g} m"
        return f"there is no contour line: {why}: pass a smaller interval= or shortest="


def contours(
    model: Raster,
    interval: float = 1.0,
    path: str | os.PathLike[str] | None = None,
    *,
    shortest: float = 10.0,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """Contour lines of a terrain model, smooth, by contourpy: linear between the centres of cells.

    Heights are averaged with their neighbours, but stay within a tenth of the interval of the model. Lines lose corners that lie
    less than a tenth of a cell beside them.

    Args:
        model: heights, for instance of :func:`dtm`.
        interval: difference of elevation between lines, in units of Z; their elevations are whole multiples of it.
        path: a GeoPackage (.gpkg, layer ``contours``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
        shortest: metres: shorter lines, such as rings around a bush, are left out.
        overwrite: replace an existing file.

    Returns: GeoDataFrame of lines in the coordinates and with the CRS of the model. Columns: ``elevation``; ``index_line``, every
    fifth elevation.
    Raises: ParameterError for an interval that is not positive, or gives lines of more than 5,000 elevations in 512 x 512 cells;
    OutputError (suffix, exists, disk). Warns: if a file is written and the model has no CRS.

    >>> lines = jf.contours(jf.dtm(cloud, result), interval=2.0)
    >>> bool((lines["elevation"] % 2 == 0).all()), set(lines.geom_type)
    (True, {'LineString'})
    """
    import pandas as pd

    layer = Contours(interval, shortest)
    target = None if path is None else check_suffix(place_of(path), VECTOR_SUFFIXES)
    number, columns = model.values.shape
    rows = Rows(number, columns, lambda top, stop: model.values[top:stop])
    table = pd.concat(list(contour_tables(rows, layer, model.transform, model.crs)), ignore_index=True)
    if target is not None:
        write_features(target, [table], layer.NAME, overwrite=overwrite)
    return table


def write_contours(
    layer: Contours, source: Path, target: Place, system: tuple[Any, float], *, overwrite: bool, empty: bool = False
) -> bool:
    """Write the contour lines of a raster file. ``system``: the CRS, and metres per unit. Returns: whether there are any; without
    them a file is written only if it may be ``empty``. Raises: InputError, OutputError."""
    with Rows.of(source) as (rows, transform, _):
        tables = contour_tables(rows, layer, transform, *system)
        some = bool(len(first := next(tables)))
        if some or empty:
            write_features(target, itertools.chain([first], tables), layer.NAME, overwrite=overwrite)
    return some


def contour_tables(
    rows: Rows, layer: Contours, transform: tuple[float, ...], crs: Any, metre: float | None = None
) -> Iterator[geopandas.GeoDataFrame]:
    """Tables of lines as of :func:`contours`; at least one table, which may be empty.

    ``rows``: of heights; ``transform``, ``crs``: as of a :class:`Raster`; ``metre``: metres per unit, by default by the CRS.
    """
    import geopandas
    import shapely

    interval, shortest = layer.interval, layer.shortest / (metre or metres_per_unit(crs)) / transform[0]  # cells
    corner, side = np.array([transform[2], transform[5]]), np.array([transform[0], transform[4]])
    waiting: dict[int, list[Any]] = collections.defaultdict(list)  # lines that may go on, by multiples of the interval
    row, some = 0, False

    def table(lines: list[tuple[int, Any]]) -> geopandas.GeoDataFrame:
        number = np.array([number for number, _ in lines], np.int64)
        shapes = shapely.simplify(np.array([line for _, line in lines], object), _SIMPLER)
        shapes = shapely.transform(shapes, lambda at: (at + 0.5) * side + corner)
        columns = {"elevation": number * interval, "index_line": number % INDEX == 0}
        return geopandas.GeoDataFrame(columns, geometry=shapes, crs=crs)

    for top in range(0, max(1, rows.number - 1), STRIP):
        first, stop = max(0, top - _ROUNDS), min(top + STRIP + 1, rows.number)
        z = _smoothed(rows.read(first, min(rows.number, stop + _ROUNDS)), TOLERANCE * interval)[
            top - first : stop - first
        ]
        for number, line in _lines(z, interval, row):
            waiting[number].append(line)
        row += len(z) - 1
        done: list[tuple[int, Any]] = []
        for number in sorted(waiting):
            parts = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(waiting.pop(number))))
            ends = shapely.get_y(shapely.get_point(parts, [[0], [-1]]))
            goes_on = (ends == row).any(axis=0) & ~shapely.is_closed(parts) & (stop < rows.number)
            if goes_on.any():
                waiting[number] = list(parts[goes_on])
            long = ~goes_on & (shapely.length(parts) >= shortest)
            done += [(number, part) for part in parts[long]]
        if done:
            some = True
            yield table(done)
    if not some:
        yield table([])


def _smoothed(z: np.ndarray, most: float) -> np.ndarray:
    """f64[r, columns]: heights f32[r, columns] after rounds of averages, none moved by more than ``most``."""
    known = np.isfinite(z)
    given = np.where(known, z, 0.0)
    weight = np.maximum(_spread(known.astype(np.float64)), 1.0 / 16)
    out = given
    for _ in range(_ROUNDS):
        out = np.where(known, np.clip(_spread(out) / weight, given - most, given + most), 0.0)
    return np.where(known, out, np.nan)


def _spread(z: np.ndarray) -> np.ndarray:
    """f64[r, columns]: sums of values and their neighbours, with weights of 1/4, 1/8 and 1/16."""
    for axis in (0, 1):
        wide = np.pad(z, [(1, 1) if one == axis else (0, 0) for one in (0, 1)])
        low, high = (np.take(wide, range(k, k + z.shape[axis]), axis) for k in (0, 2))
        z = z / 2 + (low + high) / 4
    return z


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
