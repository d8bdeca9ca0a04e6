"""The places of a classification to look at, most expected errors first, as polygons for a GIS."""

from __future__ import annotations

import dataclasses
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import InputError, OutputError, ParameterError, warn
from ..core.grid import grid_over
from ..core.result import Decision, FilterResult
from ..engines.neighbours import groups
from ..files.disk import new_file

if TYPE_CHECKING:
    import geopandas

DRIVERS = {".gpkg": "GPKG", ".geojson": "GeoJSON"}
"""Kinds of files by their suffix."""
AREA, SIDE = 5.0, 10.0
"""Per cent of the area that is listed, and metres of the squares that places are made of, by default."""

_REASONS = {
    Decision.SEED: "ground: lowest point of a cell that is no object",
    Decision.ACCEPTED: "ground: near the triangulation",
    Decision.SURFACE: "not ground: in a cell that is an object",
    Decision.ELEVATION: "not ground: above the triangulation",
    Decision.LOW: "not ground: below the triangulation",
}


def review(
    cloud: Any,
    result: FilterResult,
    path: str | os.PathLike[str] | None = None,
    *,
    area: float = AREA,
    side: float = SIDE,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """The places to look at: squares with most expected errors, those that touch joined, most expected errors first.

    Args:
        cloud: what was classified, n points.
        result: of a filter that states its doubt (OST); its doubt is summed, which is the expected number of errors.
        path: a GeoPackage (.gpkg, layer ``review``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
            Both open in QGIS.
        area: per cent of the area of the squares with judged points that the places cover together, above 0, at most 100.
        side: of a square, metres.
        overwrite: replace an existing file.

    Returns: GeoDataFrame with the CRS of the cloud, coordinates in its units, and the columns ``rank`` (from 1), ``area``
    (m2), ``points`` (judged), ``expected_errors``, ``mean_doubt``, ``reason`` (the decision to which most of the doubt
    belongs) and ``geometry``. No row if no point was judged.
    Raises: ParameterError; InputError (a result without doubt or of another length, too many squares); OutputError (suffix,
    exists, disk). Warns: if a file is written and the cloud has no CRS.

    >>> places = jf.review(cloud, result, "places.geojson", area=10.0)
    >>> places["rank"].tolist() == list(range(1, len(places) + 1))
    True
    """
    target = None if path is None else Path(path)
    check_settings(target, area, side)
    cloud = as_cloud(cloud)
    doubt = doubt_of(result)
    if len(doubt) != len(cloud):
        raise InputError(
            f"result: {len(doubt)} points, but the cloud has {len(cloud)}; pass the cloud that was classified"
        )
    table = list_places(DoubtSquares.of(cloud, result, side), area, cloud.crs, cloud.units.xy)
    if target is not None:
        write_places(table, target, overwrite)
    return table


@dataclasses.dataclass(frozen=True, eq=False)
class DoubtSquares:
    """Sums of doubt over k squares of a lattice.

    Attributes:
        side: metres; anchor: f64[2], file coordinates of a corner of the lattice.
        square: i64[k, 2], columns and rows from there.
        points: i64[k], judged ones; doubt: f64[k, kinds], its sum over the points of each :class:`jaxfilter.Decision`.
    """

    side: float
    anchor: np.ndarray
    square: np.ndarray
    points: np.ndarray
    doubt: np.ndarray

    @classmethod
    def of(cls, cloud: PointCloud, result: FilterResult, side: float, rows: np.ndarray | None = None) -> DoubtSquares:
        """Of a cloud, or of some of its points, bool[n]. Raises: InputError for a result without doubt, or too many squares."""
        doubt, kinds = doubt_of(result), len(Decision)
        judged = np.isfinite(doubt) if rows is None else np.isfinite(doubt) & rows
        judged = np.flatnonzero(judged if cloud.valid is None else judged & cloud.valid)
        if not len(judged):
            return cls(side, cloud.anchor, np.zeros((0, 2), np.int64), np.zeros(0, np.int64), np.zeros((0, kinds)))
        xyz = cloud.xyz[judged]
        grid = grid_over(xyz, side, cloud.grid_offset(side), name="side")
        at, member = np.unique(grid.flat(xyz), return_inverse=True)
        by = np.bincount(member * kinds + result.decision[judged], doubt[judged], len(at) * kinds)
        lag = (cloud.origin[:2] - cloud.anchor) * cloud.units.xy + (grid.x0, grid.y0)
        square = np.stack([at % grid.nx, at // grid.nx], axis=1) + np.rint(lag / side).astype(np.int64)
        return cls(side, cloud.anchor, square, np.bincount(member), by.reshape(-1, kinds))

    @classmethod
    def together(cls, parts: Sequence[DoubtSquares]) -> DoubtSquares:
        """Of several parts of a scene, which may share squares; there is at least one."""
        square, member = np.unique(np.concatenate([part.square for part in parts]), axis=0, return_inverse=True)
        points, doubt = np.zeros(len(square), np.int64), np.zeros((len(square), len(Decision)))
        np.add.at(points, member.reshape(-1), np.concatenate([part.points for part in parts]))
        np.add.at(doubt, member.reshape(-1), np.concatenate([part.doubt for part in parts]))
        return cls(parts[0].side, parts[0].anchor, square, points, doubt)


def list_places(found: DoubtSquares, area: float, crs: Any, metre: float) -> geopandas.GeoDataFrame:
    """The table of :func:`review`. ``area``: per cent; ``metre``: metres per unit of the file."""
    import geopandas
    import shapely

    total = found.doubt.sum(axis=1)
    chosen = np.argsort(-total, kind="stable")[: max(1, round(len(total) * area / 100))]
    square, by, kinds = found.square[chosen], found.doubt[chosen], len(Decision)
    place = _touching(square)
    count = int(place.max()) + 1 if len(place) else 0
    expected, points = np.bincount(place, total[chosen], count), np.bincount(place, found.points[chosen], count)
    share = np.stack([np.bincount(place, by[:, kind], count) for kind in range(kinds)], axis=1)
    reasons = [_REASONS.get(Decision(one), Decision(one).name.lower()) for one in share.argmax(axis=1).tolist()]
    low, high = (found.anchor + (square + step) * found.side / metre for step in (0, 1))
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    order = np.argsort(-expected, kind="stable")
    # The corners of neighbouring squares are equal but for rounding: snapped to a ten thousandth of a side.
    shapes = [shapely.union_all(boxes[place == one], grid_size=found.side / metre / 10_000) for one in order]
    columns = {
        "rank": np.arange(1, count + 1),
        "area": np.bincount(place, minlength=count)[order] * found.side**2,
        "points": points[order].astype(np.int64),
        "expected_errors": expected[order],
        "mean_doubt": expected[order] / np.maximum(points[order], 1),
        "reason": np.array(reasons, object)[order],
    }
    return geopandas.GeoDataFrame(columns, geometry=shapes, crs=crs)


def _touching(square: np.ndarray) -> np.ndarray:
    """i64[k]: for each square, i64[k, 2], the place that it belongs to, from 0 on. Squares that share a side are one place."""
    known = {tuple(one): row for row, one in enumerate(square.tolist())}
    pairs = [
        (row, known[x + dx, y + dy])
        for (x, y), row in known.items()
        for dx, dy in ((1, 0), (0, 1))
        if (x + dx, y + dy) in known
    ]
    one, other = np.array(pairs, np.int64).reshape(-1, 2).T
    return groups(one, other, len(square))


def write_places(table: geopandas.GeoDataFrame, target: Path, overwrite: bool) -> None:
    """Write a table of :func:`review`. Raises: OutputError. Warns: if it has no CRS."""
    if table.crs is None:
        taken = "; programs take its coordinates for degrees" * (DRIVERS[target.suffix.lower()] == "GeoJSON")
        warn(
            f"{target}: the cloud has no CRS, so the file has none{taken}: set the CRS of the layer where it is opened"
        )
    with new_file(target, overwrite=overwrite) as temporary:
        _save(table, target, temporary)


def check_settings(path: Path | None, area: float, side: float) -> None:
    """Raises: ParameterError for numbers that :func:`review` does not take, OutputError for the name of another kind of file."""
    if not 0 < area <= 100:
        raise ParameterError(f"area={area!r}: a percentage above 0 and up to 100 is needed")
    if not 0 < side < np.inf:
        raise ParameterError(f"side={side!r}: must be a finite number of metres > 0")
    if path is not None and path.suffix.lower() not in DRIVERS:
        raise OutputError(f"{path}: the suffix must be one of {', '.join(DRIVERS)}")


def doubt_of(result: FilterResult) -> np.ndarray:
    """f32[n]. Raises InputError for a result without doubt."""
    if result.doubt is None:
        method = "result" if result.run is None else f"result of {type(result.run.filter).__name__}"
        raise InputError(f"{method}: it states no doubt; classify with OST")
    return result.doubt


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
