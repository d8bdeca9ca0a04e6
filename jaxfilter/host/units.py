"""Coordinate reference systems of LAS files, and the metres per unit that follow from them."""

from __future__ import annotations

import dataclasses
import struct
import warnings
from typing import Any

import pyproj

from ..core.cloud import Units
from ..core.errors import InputError, JaxfilterWarning
from .header import Header

_PROJECTION = "LASF_Projection"
_WKT, _GEOKEYS = 2112, 34735  # record numbers, LAS 1.4 R15 section 3
_MODEL, _GEOGRAPHIC, _PROJECTED, _LINEAR, _VERTICAL, _VERTICAL_UNITS = 1024, 2048, 3072, 3076, 4096, 4099
_LARGEST_WKT = 2**20


@dataclasses.dataclass(frozen=True)
class Reference:
    """The CRS of a file or None, its units or None where nothing states them, and whether X and Y are angles."""

    crs: pyproj.CRS | None = None
    units: Units | None = None
    angular: bool = False

    @property
    def name(self) -> str | None:
        return None if self.crs is None else self.crs.name


def reference_of(header: Header) -> Reference:
    """From the WKT record if it can be understood, else from the GeoTIFF keys. Warns about records that cannot be."""
    records = {}
    with open(header.path, "rb") as file:
        for record in header.vlrs + header.evlrs:
            size = record.end - record.payload
            if record.user == _PROJECTION and record.number in (_WKT, _GEOKEYS) and size <= _LARGEST_WKT:
                file.seek(record.payload)
                records[record.number] = file.read(size)
    for number, parse in ((_WKT, _from_wkt), (_GEOKEYS, _from_geokeys)):
        if not records.get(number, b"").strip(b"\0 "):
            continue
        try:
            return parse(records[number], str(header.path))
        except (pyproj.exceptions.CRSError, ValueError, struct.error) as error:
            kind = "WKT" if number == _WKT else "GeoTIFF keys"
            reason = str(error).splitlines()[0]
            warnings.warn(
                f"{header.path}: the {kind} of its CRS cannot be understood and is kept as it is: {reason}",
                JaxfilterWarning,
                stacklevel=4,
            )
    return Reference()


def linear_units(reference: Reference, asked: Units | None, name: str) -> Units:
    """The units to read a LAS file with: those asked for, else those of its CRS, else metres with a warning.

    Raises: InputError if X and Y are angles.
    """
    if asked is not None:
        return asked
    if reference.angular:
        raise InputError(
            f"{name}: coordinates are not in a projected system ({reference.name}), so distances cannot be measured; "
            "reproject the file first, for example into its UTM zone, or pass units= if the CRS record is wrong"
        )
    if reference.units is None:
        warnings.warn(
            f"{name}: no CRS states the units, metres are assumed; pass units= if that is wrong",
            JaxfilterWarning,
            stacklevel=4,
        )
        return Units()
    return reference.units


def _from_wkt(data: bytes, name: str) -> Reference:
    return _from_crs(pyproj.CRS.from_wkt(data.split(b"\0")[0].decode("utf-8")))


def _from_crs(crs: pyproj.CRS) -> Reference:
    if crs.is_geographic or crs.is_geocentric:
        return Reference(crs, angular=True)
    axes = crs.axis_info
    if len(axes) < 2:
        return Reference(crs)
    horizontal, vertical = axes[0], axes[2] if len(axes) > 2 else axes[0]
    return Reference(
        crs,
        _units(
            (horizontal.unit_conversion_factor, horizontal.unit_name),
            (vertical.unit_conversion_factor, vertical.unit_name),
        ),
    )


def _from_geokeys(data: bytes, name: str) -> Reference:
    """GeoTIFF keys (OGC 19-008r4): EPSG codes, and the keys of linear units, which take precedence over the EPSG's."""
    count = struct.unpack_from("<4H", data)[3]
    entries = [struct.unpack_from("<4H", data, 8 + 8 * i) for i in range(count)]
    keys = {key: value for key, location, _, value in entries if location == 0}
    projected, geographic = keys.get(_PROJECTED, 0), keys.get(_GEOGRAPHIC, 0)
    found = Reference()
    if _is_epsg(projected):
        found = _from_crs(pyproj.CRS.from_epsg(projected))
    elif keys.get(_MODEL) in (2, 3) or (_MODEL not in keys and _PROJECTED not in keys and _is_epsg(geographic)):
        crs = pyproj.CRS.from_epsg(geographic) if _is_epsg(geographic) else None
        return Reference(crs, angular=True)
    xy = _linear_unit(keys.get(_LINEAR, 0))
    if xy is None and found.units is not None:
        xy = found.units.xy, found.units.name
    z = _linear_unit(keys.get(_VERTICAL_UNITS, 0))
    if z is None and _is_epsg(keys.get(_VERTICAL, 0)):
        vertical = pyproj.CRS.from_epsg(keys[_VERTICAL]).axis_info[0]
        z = (vertical.unit_conversion_factor, vertical.unit_name)
    if xy is None:
        return found
    if found.units is not None and abs(xy[0] / found.units.xy - 1) > 1e-12:
        warnings.warn(
            f"{name}: its CRS is in {found.units.name}, but its key of linear units says {xy[1]}: used",
            JaxfilterWarning,
            stacklevel=5,
        )
    return dataclasses.replace(found, units=_units(xy, z or xy))


def _is_epsg(code: int) -> bool:
    return 1024 <= code <= 32766


def _linear_unit(code: int) -> tuple[float, str] | None:
    units: dict[str, Any] = {u.code: u for u in pyproj.database.get_units_map("EPSG", "linear").values()}
    unit = units.get(str(code))
    return None if unit is None else (unit.conv_factor, unit.name)


def _units(xy: tuple[float, str], z: tuple[float, str]) -> Units:
    return Units(xy[0], z[0], xy[1] if xy[0] == z[0] else f"{xy[1]}, Z in {z[1]}")
