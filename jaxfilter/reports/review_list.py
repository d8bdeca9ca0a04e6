"""The places of a classification to look at, most expected errors first, as polygons for a GIS."""

from __future__ import annotations

import itertools
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import ndimage

from ..core.cloud import as_cloud
from ..core.errors import InputError, OutputError, ParameterError, warn
from ..core.result import Decision, FilterResult
from ..files.disk import new_file
from .places import Squares, squares

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
    if not 0 < area <= 100:
        raise ParameterError(f"area={area!r}: a percentage above 0 and up to 100 is needed")
    if not 0 < side < np.inf:
        raise ParameterError(f"side={side!r}: must be a finite number of metres > 0")
    target = None if path is None else Path(path)
    if target is not None:
        check_suffix(target)
    import geopandas

    cloud = as_cloud(cloud)
    doubt = doubt_of(result)
    if len(doubt) != len(cloud):
        raise InputError(
            f"result: {len(doubt)} points, but the cloud has {len(cloud)}; pass the cloud that was classified"
        )
    columns: dict[str, Any] = {"area": [], "points": [], "expected_errors": [], "mean_doubt": [], "reason": []}
    shapes: list[Any] = []
    if np.isfinite(doubt).any():
        found = squares(cloud, doubt, side)
        label = joined(found, found.first[: max(1, round(len(found.at) * area / 100))])
        columns, shapes = _described(found, label, doubt, result.decision), _shapes(cloud, found, label)
    order = np.argsort(-np.asarray(columns["expected_errors"], np.float64), kind="stable")
    rows = {name: np.asarray(values)[order] for name, values in columns.items()}
    geometry = [shapes[i] for i in order]
    table = geopandas.GeoDataFrame({"rank": np.arange(1, len(order) + 1), **rows}, geometry=geometry, crs=cloud.crs)
    if target is not None:
        if cloud.crs is None:
            taken = "; programs take its coordinates for degrees" * (DRIVERS[target.suffix.lower()] == "GeoJSON")
            warn(
                f"{target}: the cloud has no CRS, so the file has none{taken}: set the CRS of the layer where it is opened"
            )
        with new_file(target, overwrite=overwrite) as temporary:
            _save(table, target, temporary)
    return table


def check_suffix(path: Path) -> None:
    """Raises OutputError if a list of places cannot be written to a file of this name."""
    if path.suffix.lower() not in DRIVERS:
        raise OutputError(f"{path}: the suffix must be one of {', '.join(DRIVERS)}")


def doubt_of(result: FilterResult) -> np.ndarray:
    """f32[n]. Raises InputError for a result without doubt."""
    if result.doubt is None:
        method = "result" if result.run is None else f"result of {type(result.run.filter).__name__}"
        raise InputError(f"{method}: it states no doubt; classify with OST")
    return result.doubt


def joined(found: Squares, chosen: np.ndarray) -> np.ndarray:
    """i64[k]: for each square with points the place that it belongs to, from 0 on; -1 if it is not among ``chosen``.

    Squares that touch along a side belong together.
    """
    mask = np.zeros(found.grid.shape, bool)
    mask.ravel()[found.at[chosen]] = True
    return ndimage.label(mask)[0].ravel()[found.at].astype(np.int64) - 1


def _described(found: Squares, label: np.ndarray, doubt: np.ndarray, decision: np.ndarray) -> dict[str, np.ndarray]:
    """The columns of the places, by ``label``."""
    count, inside = int(label.max()) + 1, label >= 0
    points = np.bincount(label[inside], found.points[inside], count)
    expected = np.bincount(label[inside], found.total[inside], count)
    rows = np.flatnonzero(found.of >= 0)
    place = label[found.of[rows]]
    rows, place = rows[place >= 0], place[place >= 0]
    kinds = len(Decision)
    by = np.bincount(place * kinds + decision[rows], doubt[rows], count * kinds).reshape(count, kinds).argmax(axis=1)
    return {
        "area": np.bincount(label[inside], minlength=count) * found.grid.cell**2,
        "points": points.astype(np.int64),
        "expected_errors": expected,
        "mean_doubt": expected / points,
        "reason": np.array([_REASONS.get(Decision(one), Decision(one).name.lower()) for one in by], object),
    }


def _shapes(cloud: Any, found: Squares, label: np.ndarray) -> list[Any]:
    """A polygon for each place, in the coordinates of the cloud."""
    import shapely

    rows = np.flatnonzero(label >= 0)
    rows = rows[np.argsort(label[rows], kind="stable")]
    centre, half = found.centres(rows), found.grid.cell / 2
    low, high = (cloud.origin[:2] + (centre + sign * half) / cloud.units.xy for sign in (-1, 1))
    boxes = shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])
    ends = np.searchsorted(label[rows], np.arange(int(label.max()) + 2))
    # The corners of neighbouring squares are equal but for rounding: snapped to a ten thousandth of a side.
    snap = found.grid.cell / cloud.units.xy / 10_000
    return [shapely.union_all(boxes[a:b], grid_size=snap) for a, b in itertools.pairwise(ends)]


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
