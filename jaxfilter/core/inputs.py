"""Points of other libraries, taken apart: ``laspy.LasData``, structured arrays, and objects with such attributes."""

from __future__ import annotations

from typing import Any

import numpy as np

from .errors import InputError
from .units import GEOKEYS, PROJECTION, WKT, Units, linear_units, not_metric, parse_units, reference_of, sampled

GROUND_CLASS = 2
"""ASPRS class ground."""


def is_laspy(points: Any) -> bool:
    """Whether this is a ``laspy.LasData``; laspy is not imported to find out."""
    return any((c.__module__.partition(".")[0], c.__name__) == ("laspy", "LasData") for c in type(points).__mro__)


COLUMNS = {
    "return_number": np.uint8, "number_of_returns": np.uint8, "classification": np.uint8, "withheld": bool, "overlap": bool
}  # fmt: skip
"""What is known of points beside their coordinates, and how it is held."""


def as_column(field: str, values: Any, name: str) -> np.ndarray:
    """One of :data:`COLUMNS`, [n], as it is held. Raises: InputError for values that it cannot hold."""
    given, kind = np.asarray(values), COLUMNS[field]
    with np.errstate(invalid="ignore"):
        held = given.astype(kind)
    if given.dtype != kind and len(wrong := np.flatnonzero(held != given)):
        allowed = "True or False" if kind is bool else "whole numbers from 0 to 255"
        raise InputError(f"{name}: {field} of point {wrong[0]} is {given[wrong[0]]!r}: {allowed} are needed")
    return held if given.dtype != kind else given


def _plain(name: str) -> str:
    """A name without case and underscores, so that PDAL's are those of the fields."""
    return name.lower().replace("_", "")


def _names_of(points: Any) -> tuple[str, ...]:
    """Fields of a structured array, or attributes out of x, y, z and the columns."""
    names = getattr(getattr(points, "dtype", None), "names", None)
    return tuple(names) if names else tuple(name for name in ("x", "y", "z", *COLUMNS) if hasattr(points, name))


def is_structured(points: Any) -> bool:
    """Whether these are named columns: a structured array, or an object with attributes ``x``, ``y`` and ``z``."""
    return bool(getattr(getattr(points, "dtype", None), "names", None)) or {"x", "y", "z"} <= set(_names_of(points))


def laspy_parts(las: Any, units: str | Units | None, name: str) -> dict[str, Any]:
    """Arguments of ``PointCloud.from_integers``; see ``PointCloud.from_laspy``."""
    evlrs = las.evlrs if las.header.version.minor >= 4 else None
    stated = {
        vlr.record_id: vlr.record_data_bytes()
        for vlr in [*las.header.vlrs, *(evlrs or ())]
        if vlr.user_id == PROJECTION and vlr.record_id in (WKT, GEOKEYS)
    }
    reference, asked = reference_of(stated, name), None if units is None else parse_units(units)
    scale = linear_units(reference, asked, name)
    ticks = np.stack([np.asarray(las[axis], np.int32) for axis in "XYZ"], axis=1)
    scales, offsets = np.asarray(las.header.scales, np.float64), np.asarray(las.header.offsets, np.float64)
    if asked is None:
        some = ticks[sampled(len(ticks))] * scales + offsets
        if reason := not_metric(some, len(ticks), reference.units is not None):
            raise InputError(f"{name}: {reason}")
    there = set(las.point_format.dimension_names)
    columns = {field: np.array(las[field], kind) for field, kind in COLUMNS.items() if field in there}
    placed = {"ticks": ticks, "scales": scales, "offsets": offsets, "units": scale, "crs": reference.crs}
    return placed | columns | {"reference": _ground_of(columns)}


def structured_parts(points: Any, name: str) -> dict[str, Any]:
    """Arguments of ``PointCloud.from_arrays``; see ``PointCloud.from_structured``. Raises InputError without X, Y or Z."""
    named = {_plain(key): key for key in _names_of(points)}
    if missing := [axis for axis in "xyz" if axis not in named]:
        raise InputError(
            f"{name}: there is no field {missing[0].upper()}; X, Y and Z are needed, and it has {', '.join(named.values())}"
        )

    def get(field: str) -> np.ndarray:
        key = named[_plain(field)]
        return np.asarray(getattr(points, key) if hasattr(points, key) else points[key])

    columns = {field: as_column(field, get(field), name) for field in COLUMNS if _plain(field) in named}
    xyz = np.stack([get(axis).astype(np.float64) for axis in "xyz"], axis=1)
    return {"xyz": xyz, **columns, "reference": _ground_of(columns)}


def _ground_of(columns: dict[str, np.ndarray]) -> np.ndarray | None:
    """bool[n], the points of class 2; None if there are none."""
    is_ground = columns.get("classification", np.zeros(0, np.uint8)) == GROUND_CLASS
    return is_ground if is_ground.any() else None
