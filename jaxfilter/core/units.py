"""Metres per coordinate unit: what is asked for, what coordinate reference systems say, and what cannot be true."""

from __future__ import annotations

import dataclasses
import functools
import math
import struct
from typing import Any, NamedTuple

import numpy as np
import pyproj

from .errors import InputError, warn

METRES_PER_UNIT = (1e-3, 1e4)
"""Least and largest metres per coordinate unit that are believed."""

PROJECTION = "LASF_Projection"
WKT, GEOKEYS = 2112, 34735
"""User and numbers of the records of a LAS file that state its CRS, LAS 1.4 R15 section 3."""

STATED = ((PROJECTION, WKT), (PROJECTION, GEOKEYS))
"""Keys of these records."""

_MODEL, _GEOGRAPHIC, _PROJECTED, _LINEAR, _VERTICAL, _VERTICAL_UNITS = 1024, 2048, 3072, 3076, 4096, 4099
_GEOCENTRIC = 3  # value of the key _MODEL
_SMALL = 0.5  # units: an extent of degrees or kilometres rather than of metres, if heights exceed it
_DENSE = 1e8  # points per square unit: one per 100 m2 in degrees, one per 0.1 mm in metres
_SAMPLE = 5_000  # points that tell the extent
_TAIL = 0.01  # share of points that does not count at each end of it


@dataclasses.dataclass(frozen=True)
class Units:
    """Metres per coordinate unit: ``xy`` for X and Y, ``z`` for Z; ``name`` says where that came from.

    Raises: InputError if one is outside of :data:`METRES_PER_UNIT`.
    """

    xy: float = 1.0
    z: float = 1.0
    name: str = "metre"

    def __post_init__(self) -> None:
        for axis, metres in (("xy", self.xy), ("z", self.z)):
            if not _believed(metres):
                low, high = METRES_PER_UNIT
                raise InputError(
                    f"units: {axis} = {metres!r} metres per unit ({self.name}): must be {low:g} to {high:g}"
                )

    def __str__(self) -> str:
        if self.xy == self.z:
            return self.name
        return f"{self.name} (xy x {self.xy:.10g}, z x {self.z:.10g} m)"


def _believed(metres: float) -> bool:
    return METRES_PER_UNIT[0] <= metres <= METRES_PER_UNIT[1]


UNITS = {
    "m": Units(1.0, 1.0, "metre"),
    "ft": Units(0.3048, 0.3048, "foot"),
    "us-ft": Units(1200 / 3937, 1200 / 3937, "US survey foot"),
}
"""Units that ``read(units=)`` and ``--units`` know; ``"m,ft"`` gives X and Y in metres and Z in feet."""


def parse_units(text: str | Units) -> Units:
    """``"m"``, ``"ft"``, ``"us-ft"``, or a pair such as ``"us-ft,m"`` for XY and Z apart. Raises InputError."""
    if isinstance(text, Units):
        return text
    parts = [p.strip().lower() for p in text.split(",")] if isinstance(text, str) else []
    if not 1 <= len(parts) <= 2 or any(p not in UNITS for p in parts):
        raise InputError(
            f"units {text!r} are not known: use one of {', '.join(UNITS)}, or a pair XY,Z such as 'us-ft,m'"
        )
    xy, z = UNITS[parts[0]], UNITS[parts[-1]]
    return xy if xy == z else Units(xy.xy, z.z, f"{xy.name}, Z in {z.name}")


def parse_crs(value: Any) -> pyproj.CRS | None:
    """What pyproj takes for a CRS (``"EPSG:2154"``, 2154, WKT, a CRS ...) as a pyproj.CRS. Raises InputError."""
    if value is None or isinstance(value, pyproj.CRS):
        return value
    try:
        return pyproj.CRS.from_user_input(value)
    except (pyproj.exceptions.CRSError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"crs={value!r}: no coordinate reference system that PROJ knows: {reason}") from error


def horizontal(crs: pyproj.CRS) -> pyproj.CRS:
    """What a CRS says of X and Y, without heights and shifts to other datums."""
    while crs.is_compound or crs.is_bound:
        crs = crs.sub_crs_list[0] if crs.is_compound else crs.source_crs  # type: ignore[assignment]
    return crs


def same_system(one: pyproj.CRS, other: pyproj.CRS) -> bool:
    """Whether two horizontal CRS are one, in whichever order they are given: PROJ says so, or their codes do, or projection,
    ellipsoid, prime meridian and units agree to a part in 10^9 and the datum, as far as both state one that has a code."""
    if one.equals(other, ignore_axis_order=True) or other.equals(one, ignore_axis_order=True):
        return True
    if _code(one) is not None and _code(one) == _code(other):
        return True
    numbers = _numbers(one), _numbers(other)
    known = (pyproj.CRS.from_authority(*code) if (code := _code(crs)) else crs for crs in (one, other))
    datums = [crs.geodetic_crs and _code(crs.geodetic_crs) for crs in known]
    return (
        bool(numbers[0])
        and numbers[0].keys() == numbers[1].keys()
        and all(math.isclose(value, numbers[1][name], rel_tol=1e-9, abs_tol=1e-9) for name, value in numbers[0].items())
        and (None in datums or datums[0] == datums[1])
    )


@functools.lru_cache(maxsize=256)
def _code(crs: pyproj.CRS) -> tuple[str, str] | None:
    return crs.to_authority()


def _numbers(crs: pyproj.CRS) -> dict[str, float]:
    """What matters of a projected CRS, by names: its projection, in radians and metres, and what that is of."""
    operation, ellipsoid, meridian = crs.coordinate_operation, crs.ellipsoid, crs.prime_meridian
    if operation is None or ellipsoid is None or meridian is None:
        return {}
    found = {p.name: float(p.value) * float(p.unit_conversion_factor or 1.0) for p in operation.params}
    found |= {"a": ellipsoid.semi_major_metre, "1/f": ellipsoid.inverse_flattening}
    found |= {f"axis {k}": axis.unit_conversion_factor for k, axis in enumerate(crs.axis_info[:2])}
    return found | {operation.method_name: 0.0, "meridian": meridian.longitude * float(meridian.unit_conversion_factor)}


@dataclasses.dataclass(frozen=True)
class Reference:
    """What a file says of its coordinates.

    Attributes:
        crs: the CRS, or None.
        units: None where nothing states them, or where there is a ``problem``.
        problem: why distances cannot be measured, or None.
        shown: the unit in words, where there is a ``problem``.
    """

    crs: pyproj.CRS | None = None
    units: Units | None = None
    problem: str | None = None
    shown: str = ""


def reference_of(records: dict[int, bytes], name: str) -> Reference:
    """From the data of the records :data:`WKT` and :data:`GEOKEYS`: the WKT if it can be understood, else the keys. Warns
    about records that cannot be understood; ``name`` is that of the file."""
    for number, parse in ((WKT, _from_wkt), (GEOKEYS, _from_geokeys)):
        if not records.get(number, b"").strip(b"\0 "):
            continue
        try:
            return parse(records[number], name)
        except (pyproj.exceptions.CRSError, ValueError, struct.error) as error:
            kind = "WKT" if number == WKT else "GeoTIFF keys"
            reason = str(error).splitlines()[0]
            warn(f"{name}: the {kind} of its CRS cannot be understood and is kept as it is: {reason}")
    return Reference()


class Stated(NamedTuple):
    """What a user states of coordinates: ``units`` go before those of any CRS, and ``crs`` holds where a file states none."""

    units: Units | None = None
    crs: pyproj.CRS | None = None

    def of(self, reference: Reference, name: str) -> Reference:
        """What is known of a file that says ``reference``. Raises: InputError if it states another CRS."""
        if self.crs is None:
            pass
        elif reference.crs is None:
            reference = _from_crs(self.crs, f"crs={self.crs.to_string()!r}")
        elif not same_system(horizontal(self.crs), horizontal(reference.crs)):
            raise InputError(
                f"{name}: crs={self.crs.to_string()!r}: the file states another CRS, {reference.crs.name}: leave out crs=, since "
                "nothing is reprojected"
            )
        return reference if self.units is None else dataclasses.replace(reference, units=self.units, problem=None)


NOTHING = Stated()


def linear_units(reference: Reference, name: str) -> Units:
    """The units to read coordinates with: as they are known, else metres with a warning. Raises: InputError if the CRS is
    geographic or geocentric, or has an absurd unit."""
    if reference.problem is not None:
        raise InputError(f"{name}: {reference.problem}, or pass units= if the CRS record is wrong")
    if reference.units is None:
        warn(f"{name}: no CRS states the units, metres are assumed; pass units= if that is wrong, or pass crs=")
        return Units()
    return reference.units


def sampled(n: int) -> slice:
    """Which of n points are enough to tell their extent."""
    return slice(None, None, max(1, n // _SAMPLE))


def check_lengths(name: object, xyz: np.ndarray, count: int, stated: bool, strict: bool) -> None:
    """Raises: InputError if coordinates cannot be lengths, see :func:`not_metric`; unless ``strict``, that is a warning."""
    if reason := not_metric(xyz, count, stated):
        if strict:
            raise InputError(f"{name}: {reason}")
        warn(f"{name}: {reason}")


def not_metric(xyz: np.ndarray, count: int, stated: bool) -> str | None:
    """Why coordinates cannot be the lengths that they are taken for, or None.

    Two rules: X and Y extend over less than half a unit each, and Z over more than either; or X and Y are possible as
    longitude and latitude, and there are more than 10^8 points per square unit. Extents leave out one per cent of the
    points at each end, so that stray points do not hide degrees.

    Args:
        xyz: finite f64[k, 3], file units; some points out of all, see :func:`sampled`.
        count: number of all points.
        stated: the CRS states the unit, or the points are only those within given bounds; then the first rule
            holds for longitudes and latitudes only.
    """
    sample = np.sort(xyz, axis=0)
    cut = int(_TAIL * len(sample))
    if len(sample) < 2:
        return None
    low, high = sample[cut], sample[-1 - cut]
    with np.errstate(over="ignore", invalid="ignore"):
        dx, dy, dz = (high - low).tolist()
    if not (dx > 0 and dy > 0):
        return None
    x, y = np.maximum(abs(low), abs(high))[:2].tolist()
    angles = (x <= 360 and y <= 90) or (x <= 90 and y <= 360)
    small = dx < _SMALL and dy < _SMALL and dz > max(dx, dy) and (angles or not stated)
    if not small and not (angles and count > _DENSE * dx * dy):
        return None
    return (
        f"{count} points on {dx:.3g} x {dy:.3g} units, with heights over {dz:.3g}, look like "
        f"{'degrees' if angles else 'a unit far larger than metres'}, so distances cannot be measured; reproject them "
        "first, for example into their UTM zone, or pass units= if X and Y are lengths"
    )


def _from_wkt(data: bytes, name: str) -> Reference:
    return _from_crs(pyproj.CRS.from_wkt(data.split(b"\0")[0].decode("utf-8")), name)


def _from_crs(crs: pyproj.CRS, name: str) -> Reference:
    axes = crs.axis_info
    if crs.is_geographic or crs.is_geocentric:
        return _unprojected(crs, bool(crs.is_geocentric))
    if len(axes) < 2:
        return Reference(crs)
    horizontal, vertical = axes[0], axes[2] if len(axes) > 2 else axes[0]
    xy = (horizontal.unit_conversion_factor, horizontal.unit_name)
    z = (vertical.unit_conversion_factor, vertical.unit_name)
    for factor, unit in dict.fromkeys((xy, z)):
        if not _believed(factor):
            return Reference(
                crs,
                problem=f"its CRS ({crs.name}) has {factor:g} metres in a unit named {unit!r}, which cannot be; correct it",
                shown=f"{unit} of {factor:g} m",
            )
        known = _linear_unit(unit)
        if known is not None and not math.isclose(factor, known[0], rel_tol=1e-3):
            warn(f"{name}: its CRS ({crs.name}) has {factor:g} metres in a {unit}, which has {known[0]:g}: used")
    return Reference(crs, _units(xy, z))


def _unprojected(crs: pyproj.CRS | None, geocentric: bool) -> Reference:
    title = "" if crs is None else f" ({crs.name})"
    unit = crs.axis_info[0].unit_name if crs is not None and crs.axis_info else "metre" if geocentric else "degree"
    if geocentric:
        problem = f"coordinates are counted from the centre of the Earth{title}, so Z is not height"
    else:
        problem = f"coordinates are not in a projected system{title}, so distances cannot be measured"
    advice = "reproject the file first, for example into its UTM zone"
    return Reference(crs, None, f"{problem}; {advice}", f"{unit}, geocentric" if geocentric else unit)


def _from_geokeys(data: bytes, name: str) -> Reference:
    """GeoTIFF keys (OGC 19-008r4): EPSG codes, and the keys of linear units, which take precedence over the EPSG's."""
    count = struct.unpack_from("<4H", data)[3]
    entries = [struct.unpack_from("<4H", data, 8 + 8 * i) for i in range(count)]
    keys = {key: value for key, location, _, value in entries if location == 0}
    projected, geographic, model = keys.get(_PROJECTED, 0), keys.get(_GEOGRAPHIC, 0), keys.get(_MODEL)
    found = Reference()
    if _is_epsg(projected):
        found = _from_crs(pyproj.CRS.from_epsg(projected), name)
    elif model in (2, _GEOCENTRIC) or (model is None and _PROJECTED not in keys and _is_epsg(geographic)):
        crs = pyproj.CRS.from_epsg(geographic) if _is_epsg(geographic) else None
        return _unprojected(crs, model == _GEOCENTRIC or (crs is not None and bool(crs.is_geocentric)))
    if found.problem is not None:
        return found
    stated = None if found.units is None else (found.units.xy, found.units.name)
    xy = _linear_unit(keys.get(_LINEAR, 0)) or stated
    if xy is None:
        return found
    z = _linear_unit(keys.get(_VERTICAL_UNITS, 0)) or _vertical_unit(keys.get(_VERTICAL, 0))
    if found.units is not None and abs(xy[0] / found.units.xy - 1) > 1e-12:
        warn(f"{name}: its CRS is in {found.units.name}, but its key of linear units says {xy[1]}: used")
    return dataclasses.replace(found, units=_units(xy, z or xy))


def geokeys(crs: pyproj.CRS) -> bytes | None:
    """The data of a record :data:`GEOKEYS` that states a projected CRS, with or without heights, by EPSG codes; None without."""
    parts = crs.sub_crs_list if crs.is_compound else [crs]
    codes = [part.to_epsg() for part in parts]
    if None in codes or not parts[0].is_projected:
        return None
    keys = [(_MODEL, 1), *zip((_PROJECTED, _VERTICAL), codes, strict=False)]
    entries = [value for key, code in keys for value in (key, 0, 1, code)]
    return struct.pack(f"<{4 + len(entries)}H", 1, 1, 0, len(keys), *entries)


def _vertical_unit(code: int) -> tuple[float, str] | None:
    """Unit of a vertical CRS. Writers also put the code of a vertical datum there (5103), or of an ellipsoid (5030), as
    GeoTIFF had them once: these state no unit."""
    try:
        crs = pyproj.CRS.from_epsg(code)
    except pyproj.exceptions.CRSError:
        return None
    return (crs.axis_info[0].unit_conversion_factor, crs.axis_info[0].unit_name) if crs.is_vertical else None


def _is_epsg(code: int) -> bool:
    return 1024 <= code <= 32766


@functools.cache
def _linear_unit(key: int | str) -> tuple[float, str] | None:
    """Metres in EPSG's unit of length with this number or name, and its name."""
    known = pyproj.database.get_units_map("EPSG", "linear").values()
    return next(((u.conv_factor, u.name) for u in known if str(key).lower() in (u.code, u.name.lower())), None)


def _units(xy: tuple[float, str], z: tuple[float, str]) -> Units:
    return Units(xy[0], z[0], xy[1] if xy[0] == z[0] else f"{xy[1]}, Z in {z[1]}")
