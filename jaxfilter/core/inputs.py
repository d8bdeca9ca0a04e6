"""Points of other libraries, taken apart: ``laspy.LasData``, structured arrays, and objects with such attributes."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import Any

import numpy as np

from .echoes import numbering
from .errors import InputError
from .units import CRS_RECORDS, Stated, Units, check_lengths, linear_units, reference_of, sampled

GROUND_CLASS = 2
"""ASPRS class ground."""


def is_laspy(points: Any) -> bool:
    """Whether this is a ``laspy.LasData``; laspy is not imported to find out."""
    return any((c.__module__.partition(".")[0], c.__name__) == ("laspy", "LasData") for c in type(points).__mro__)


COLUMN_TYPES = {
    "return_number": np.uint8, "number_of_returns": np.uint8, "classification": np.uint8, "withheld": bool, "overlap": bool
}  # fmt: skip
"""What is known of points beside their coordinates, and how it is held."""
LARGEST = {"return_number": 15, "number_of_returns": 15, "classification": 255}
"""The largest values of it that LAS can hold."""


def numbers(values: Any, what: str) -> np.ndarray:
    """Real numbers as an array, which may be a masked one. Raises: InputError for others, named ``what``."""
    try:
        given = np.ma.asanyarray(values) if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    except ValueError as error:
        raise InputError(f"{what} must be an array: {error}") from error
    if given.dtype.kind not in "iuf":
        raise InputError(f"{what} must be real numbers, not {given.dtype}")
    return given


def as_column(field: str, values: Any, name: str, n: int) -> np.ndarray:
    """One of :data:`COLUMN_TYPES`, or another of bools, [n], as it is held. Raises: InputError for values that it cannot hold."""
    given, kind = np.asanyarray(values), COLUMN_TYPES.get(field, bool)
    if given.ndim == 1 and len(given) != n:
        raise InputError(f"{name}: {field} has {len(given)} entries for {n} points")
    if given.ndim != 1:
        raise InputError(f"{name}: {field} has shape {given.shape}, and a value for each point is needed: shape ({n},)")
    if np.ma.is_masked(given):
        raise InputError(f"{name}: {field} has masked entries; give them values, or leave these points out")
    given = np.asarray(given)
    allowed = "True or False" if kind is bool else f"whole numbers from 0 to {LARGEST[field]}"
    if given.dtype.kind not in "biuf":
        raise InputError(f"{name}: {field} is {given.dtype}: {allowed} are needed")
    with np.errstate(invalid="ignore"):
        held = given.astype(kind, copy=False)
    wrong = (held != given) | (False if kind is bool else held > LARGEST[field])
    if wrong.any():
        at = int(wrong.argmax())
        raise InputError(f"{name}: {field} of point {at} is {given[at].item()!r}: {allowed} are needed")
    return held


def class_numbers(values: Iterable[int]) -> tuple[int, ...]:
    """``ignore_classes`` as numbers from 0 to 255. Raises: InputError."""
    try:
        given = list(values)
        out = tuple(map(operator.index, given))
        if {bool, np.bool_} & set(map(type, given)) or not 0 <= min(out, default=0) <= max(out, default=0) <= 255:
            raise ValueError
    except (TypeError, ValueError) as error:
        wanted = "several whole numbers from 0 to 255 are needed, such as (7, 18), or () for none"
        raise InputError(f"ignore_classes={values!r}: {wanted}") from error
    return out


def _plain(name: str) -> str:
    """A name without case and underscores, so that PDAL's are those of the fields."""
    return name.lower().replace("_", "")


def _names_of(points: Any) -> tuple[str, ...]:
    """Fields of a structured array, columns of a table, or attributes out of x, y, z and the columns."""
    names = getattr(getattr(points, "dtype", None), "names", None) or getattr(points, "columns", None)
    if names is None:
        return tuple(name for name in ("x", "y", "z", *COLUMN_TYPES) if hasattr(points, name))
    return tuple(name for name in names if isinstance(name, str))


def is_structured(points: Any) -> bool:
    """Whether these are named columns: a structured array, or a table or an object with X, Y and Z."""
    names = set(map(_plain, _names_of(points)))
    return bool(getattr(getattr(points, "dtype", None), "names", None)) or set("xyz") <= names


def laspy_parts(
    las: Any, asked: Stated, name: str
) -> tuple[Units, tuple[np.ndarray, np.ndarray, np.ndarray], dict[str, Any]]:
    """Units, then integer coordinates i32[n, 3], scales and offsets f64[3], then what else ``PointCloud.from_integers`` takes."""
    evlrs = las.evlrs if las.header.version.minor >= 4 else None
    stated = {
        vlr.record_id: vlr.record_data_bytes()
        for vlr in [*las.header.vlrs, *(evlrs or ())]
        if (vlr.user_id, vlr.record_id) in CRS_RECORDS
    }
    wkt = las.point_format.id >= 6 or las.header.global_encoding.wkt
    reference = asked.of(reference_of(stated, name, wkt), name)
    scale = linear_units(reference, name)
    ticks = np.stack([np.asarray(las[axis], np.int32) for axis in "XYZ"], axis=1)
    scales, offsets = np.asarray(las.header.scales, np.float64), np.asarray(las.header.offsets, np.float64)
    if asked.units is None:
        some = ticks[sampled(len(ticks))] * scales + offsets
        check_lengths(name, some, len(ticks), reference.units is not None, strict=True)
    there = set(las.point_format.dimension_names)
    columns = {field: np.array(las[field], kind) for field, kind in COLUMN_TYPES.items() if field in there}
    how = numbering(columns, ticks[:, 2], las["gps_time"] if "gps_time" in there else None)
    more = {"crs": reference.crs, "reference": _ground_of(columns), "numbering": how}
    return scale, (ticks, scales, offsets), columns | more


def structured_parts(points: Any, name: str) -> dict[str, Any]:
    """Arguments of ``PointCloud.from_arrays``; see ``PointCloud.from_structured``. Raises InputError without X, Y or Z."""
    named = {_plain(key): key for key in _names_of(points)}
    if missing := [axis for axis in "xyz" if axis not in named]:
        there = ", ".join(named.values())
        raise InputError(f"{name}: there is no field {missing[0].upper()}; X, Y and Z are needed, and it has {there}")

    def get(field: str) -> Any:
        key = named[_plain(field)]
        return points[key] if hasattr(points, "columns") or not hasattr(points, key) else getattr(points, key)

    axes = [numbers(get(axis), f"{name}: {axis.upper()}") for axis in "xyz"]
    if len(shapes := {axis.shape for axis in axes}) > 1 or axes[0].ndim != 1:
        raise InputError(f"{name}: X, Y and Z must have one length and one dimension, not shapes {sorted(shapes)}")
    n = len(axes[0])
    columns = {field: as_column(field, get(field), name, n) for field in COLUMN_TYPES if _plain(field) in named}
    time = numbers(get("gps_time"), f"{name}: gps_time") if "gpstime" in named else None
    how = numbering(columns, axes[2], time)
    return {"xyz": np.ma.stack(axes, axis=1), **columns, "reference": _ground_of(columns), "numbering": how}


def _ground_of(columns: dict[str, np.ndarray]) -> np.ndarray | None:
    """bool[n], the points of class 2; None if there are none."""
    is_ground = columns.get("classification", np.zeros(0, np.uint8)) == GROUND_CLASS
    return is_ground if is_ground.any() else None
