"""Metres per coordinate unit: what is asked for, what coordinate reference systems say, and what cannot be true."""

from __future__ import annotations

import dataclasses
import functools
import math
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pyproj
from pyproj.crs import Datum  # type: ignore[attr-defined]  # a public name by its documentation

from .errors import InputError, warn

METRES_PER_UNIT = (1e-3, 1e4)
"""Least and largest metres per coordinate unit that are believed."""
PROJECTION = "LASF_Projection"
WKT, WKT_2, GEOKEYS, _DOUBLES, _TEXTS = 2112, 4224, 34735, 34736, 34737
"""User and numbers of the records of a LAS file that state its CRS: LAS 1.4 R15 section 3, and the WKT 2 of PDAL."""
CRS_RECORDS = tuple((PROJECTION, number) for number in (WKT, WKT_2, GEOKEYS, _DOUBLES, _TEXTS))
"""Keys of these records."""
ELLIPSOIDAL = "ellipsoidal height"
_MODEL, _GEOGRAPHIC, _PROJECTED, _CONVERSION, _METHOD, _LINEAR = 1024, 2048, 3072, 3074, 3075, 3076
_VERTICAL, _VERTICAL_DATUM, _VERTICAL_UNITS = 4096, 4098, 4099
_GEOCENTRIC = 3  # value of the key _MODEL
_ELLIPSOIDS = range(5001, 5100)  # values of the key _VERTICAL in GeoTIFF 1.0
_SMALL = 0.5  # units: an extent of degrees or kilometres rather than of metres, if heights exceed it
_DENSE = 1e8  # points per square unit: one per 100 m2 in degrees, one per 0.1 mm in metres
_SAMPLE = 5_000  # points that tell the extent
_TAIL = 0.01  # share of points that does not count at each end of it


@dataclasses.dataclass(frozen=True)
class Units:
    """Metres per coordinate unit: ``xy`` for X and Y, ``z`` for Z; ``name`` says where that came from. Raises: InputError if
    one is outside of :data:`METRES_PER_UNIT`."""

    xy: float = 1.0
    z: float = 1.0
    name: str = "metre"

    def __post_init__(self) -> None:
        low, high = METRES_PER_UNIT
        for axis, metres in (("xy", self.xy), ("z", self.z)):
            if not low <= metres <= high:
                wrong = f"units: {axis} = {metres!r} metres per unit ({self.name})"
                raise InputError(f"{wrong}: must be {low:g} to {high:g}")

    @property
    def factor(self) -> np.ndarray:
        """f64[3]: metres per unit of X, Y and Z."""
        return np.array([self.xy, self.xy, self.z])

    def __str__(self) -> str:
        if self.xy == self.z:
            return self.name
        return f"{self.name} (xy x {self.xy:.10g}, z x {self.z:.10g} m)"


NAMED_UNITS = {
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
    if not 1 <= len(parts) <= 2 or any(p not in NAMED_UNITS for p in parts):
        known = ", ".join(NAMED_UNITS)
        raise InputError(f"units {text!r} are not known: use one of {known}, or a pair XY,Z such as 'us-ft,m'")
    xy, z = NAMED_UNITS[parts[0]], NAMED_UNITS[parts[-1]]
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


@dataclasses.dataclass(frozen=True)
class Reference:
    """What a file says of its coordinates. ``problem``: why distances cannot be measured, then ``units`` are None and
    ``shown`` is the unit in words. ``units`` are also None where nothing states them."""

    crs: pyproj.CRS | None = None
    units: Units | None = None
    problem: str | None = None
    shown: str = ""


class Stated(NamedTuple):
    """What a user states of coordinates: ``units`` go before those of any CRS, and ``crs`` holds where a file states none."""

    units: Units | None = None
    crs: pyproj.CRS | None = None

    def of(self, reference: Reference, name: str) -> Reference:
        """What is known of a file that says ``reference``. Raises: InputError if it states another CRS."""
        if self.crs is not None:
            asked = f"crs={self.crs.to_string()!r}"
            if reference.crs is None:
                reference = _from_crs(self.crs, asked)
            elif names := difference(self.crs, reference.crs):
                other = f"the file states another CRS, {names[1]}"
                raise InputError(f"{name}: {asked}: {other}: leave out crs=, since nothing is reprojected")
            elif vertical(self.crs) and not vertical(reference.crs):
                reference = _from_crs(self.crs, asked)  # it states heights as well
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
    """Why coordinates cannot be the lengths that they are taken for, or None: X and Y extend over less than half a unit each,
    and Z over more than either; or X and Y are possible as longitude and latitude, and there are more than 10^8 points per
    square unit. Of stray points one per cent at each end is left out. ``xyz``: finite f64[k, 3], file units, some of
    ``count`` points, see :func:`sampled`. ``stated``: the CRS states the unit, or the points are only those within given
    bounds; then the first rule holds for longitudes and latitudes only."""
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
    kind = "degrees" if angles else "a unit far larger than metres"
    found = f"{count} points on {dx:.3g} x {dy:.3g} units, with heights over {dz:.3g}, look like {kind}"
    advice = "reproject them first, for example into their UTM zone, or pass units= if X and Y are lengths"
    return f"{found}, so distances cannot be measured; {advice}"


def reference_of(records: Mapping[int, bytes], name: str, wkt: bool = True) -> Reference:
    """From the data of the records :data:`CRS_RECORDS` by their numbers, as far as they can be understood.

    Where WKT and GeoTIFF keys contradict one another, the WKT is used if ``wkt``, as LAS 1.4 has it for files whose WKT bit is
    set, and else the keys; where they do not, what says more is used. Warns: about contradictions, and about records that
    cannot be understood; ``name`` is that of the file.
    """
    kinds = [(WKT_2, "WKT 2"), (WKT, "WKT")]
    kinds.insert(2 if wkt else 0, (GEOKEYS, "GeoTIFF keys"))
    found: list[tuple[str, Reference]] = []
    for number, kind in kinds:
        data = records.get(number, b"")
        if not data.strip(b"\0 "):
            continue
        try:
            if number == GEOKEYS:
                found.append((kind, _from_geokeys(records, name)))
            else:
                found.append((kind, _from_crs(pyproj.CRS.from_wkt(data.split(b"\0")[0].decode("utf-8")), name)))
        except (pyproj.exceptions.CRSError, ValueError, struct.error) as error:
            reason = str(error).splitlines()[0]
            warn(f"{name}: the {kind} of its CRS cannot be understood and is kept as it is: {reason}")
    if not found:
        return Reference()
    (kind, used), *others = found
    for another, other in others:
        if names := _contradiction(used, other):
            of = f"the CRS of its {kind} is {names[0]}, that of its {another} is {names[1]}"
            warn(f"{name}: {of}: the first is used; correct the file if that is wrong")
        elif (other.crs is not None, bool(vertical(other.crs))) > (used.crs is not None, bool(vertical(used.crs))):
            kind, used = another, other
    return used


def _contradiction(one: Reference, other: Reference) -> tuple[str, str] | None:
    """The names of what differs between two references, as far as both state it."""
    if one.crs is not None and other.crs is not None and (names := difference(one.crs, other.crs)):
        return names
    if one.units is None or other.units is None:
        return None
    ratios = [one.units.xy / other.units.xy]
    if vertical(one.crs) and vertical(other.crs):
        ratios.append(one.units.z / other.units.z)
    return (str(one.units), str(other.units)) if max(abs(ratio - 1) for ratio in ratios) > 1e-7 else None


def _from_crs(crs: pyproj.CRS, name: str) -> Reference:
    """What a CRS says. Warns: about a unit that is not as long as EPSG's of this name."""
    if crs.is_geographic or crs.is_geocentric:
        return _unprojected(crs, bool(crs.is_geocentric))
    if len(crs.axis_info) < 2:
        return Reference(crs)
    xy = _unit_of(crs)
    z = _unit_of(crs, 2) if len(crs.axis_info) > 2 else xy
    for factor, unit in dict.fromkeys((xy, z)):
        if not METRES_PER_UNIT[0] <= factor <= METRES_PER_UNIT[1]:
            wrong = f"{factor:g} metres in a unit named {unit!r}, which cannot be"
            problem = f"its CRS ({crs.name}) has {wrong}; correct it"
            return Reference(crs, problem=problem, shown=f"{unit} of {factor:g} m")
        known = _linear_unit(unit)
        if known is not None and not math.isclose(factor, known[0], rel_tol=1e-3):
            warn(f"{name}: its CRS ({crs.name}) has {factor:g} metres in a {unit}, which has {known[0]:g}: used")
    return Reference(crs, _units(xy, z))


def _unprojected(crs: pyproj.CRS | None, geocentric: bool) -> Reference:
    title = "" if crs is None else f" ({crs.name})"
    unit = crs.axis_info[0].unit_name if crs is not None and crs.axis_info else "metre" if geocentric else "degree"
    wrong = f"not in a projected system{title}, so distances cannot be measured"
    if geocentric:
        wrong, unit = f"counted from the centre of the Earth{title}, so Z is not height", f"{unit}, geocentric"
    problem = f"coordinates are {wrong}; reproject the file first, for example into its UTM zone"
    return Reference(crs, problem=problem, shown=unit)


def _from_geokeys(records: Mapping[int, bytes], name: str) -> Reference:
    """GeoTIFF keys (OGC 19-008r4): EPSG codes, or parameters of a projection. Keys of units take precedence over what codes
    say of units. Warns: where that differs, and about systems that are not understood."""
    data = records[GEOKEYS]
    size = 4 + 4 * struct.unpack_from("<4H", data)[3]
    table = np.frombuffer(data, "<u2", size).reshape(-1, 4).tolist()
    keys = {key: value for key, location, _, value in table[1:] if location == 0}
    geographic, model = keys.get(_GEOGRAPHIC, 0), keys.get(_MODEL)
    unprojected = model in (2, _GEOCENTRIC) or (model is None and _PROJECTED not in keys and _is_epsg(geographic))
    if unprojected and not _is_epsg(keys.get(_PROJECTED, 0)):
        crs = pyproj.CRS.from_epsg(geographic) if _is_epsg(geographic) else None
        return _unprojected(crs, model == _GEOCENTRIC or (crs is not None and bool(crs.is_geocentric)))
    crs, xy = _epsg(keys.get(_PROJECTED, 0)), _linear_unit(keys.get(_LINEAR, 0))
    if crs is not None and not crs.is_projected:
        return _from_crs(crs, name)
    if crs is not None and xy is not None and abs(xy[0] / _unit_of(crs)[0] - 1) > 1e-12:
        warn(f"{name}: its CRS is in {_unit_of(crs)[1]}, but its key of linear units says {xy[1]}: used")
        crs = None
    if crs is None and any(keys.get(key) for key in (_PROJECTED, _CONVERSION, _METHOD)):
        if xy is not None or not _is_epsg(keys.get(_LINEAR, 0)):
            crs = _from_parameters(data[: 2 * size], records.get(_DOUBLES, b""), records.get(_TEXTS, b""))
        if crs is None:
            warn(f"{name}: its GeoTIFF keys state a CRS that is not understood: pass crs= to state it for outputs")
    xy = xy or (None if crs is None else _unit_of(crs))
    if xy is None:
        return Reference()
    heights = _epsg(keys.get(_VERTICAL, 0))
    z = _linear_unit(keys.get(_VERTICAL_UNITS, 0)) or (_unit_of(heights) if heights and heights.is_vertical else xy)
    if crs is None:
        return Reference(units=_units(xy, z))
    if keys.get(_VERTICAL):
        crs = _with_heights(crs, heights, keys, z)
        if vertical(crs) is None:
            warn(f"{name}: its GeoTIFF keys state heights that are not understood: outputs do not state them")
    found = _from_crs(crs, name)
    return found if found.problem else dataclasses.replace(found, units=_units(xy, z))


def _with_heights(
    crs: pyproj.CRS, heights: pyproj.CRS | None, keys: Mapping[int, int], unit: tuple[float, str]
) -> pyproj.CRS:
    """A horizontal CRS with the heights that GeoTIFF keys state, in a unit. ``heights``: what has the code of the key
    ``_VERTICAL``, which may also be that of an ellipsoid or of a datum, as GeoTIFF 1.0 had them."""
    if keys[_VERTICAL] in _ELLIPSOIDS or vertical(heights) == ELLIPSOIDAL:
        return crs.to_3d()
    if heights is None or not heights.is_vertical:
        datum = _epsg(keys.get(_VERTICAL_DATUM) or keys[_VERTICAL], Datum)
        heights = datum and _heights(f"{datum.name} height", datum.name, unit)
    elif abs(unit[0] / _unit_of(heights)[0] - 1) > 1e-7:
        heights = _heights(f"{heights.name} ({unit[1]})", height_datum(heights), unit)
    return crs if heights is None else pyproj.crs.CompoundCRS(f"{crs.name} + {heights.name}", [crs, heights])


@functools.lru_cache(maxsize=256)
def _from_parameters(keys: bytes, doubles: bytes, texts: bytes) -> pyproj.CRS | None:
    """The projected CRS of GeoTIFF keys, by GDAL, which reads them from an image of one pixel; None if they do not define one."""
    import rasterio

    tags = [(33550, 12, struct.pack("<3d", 1, 1, 0)), (33922, 12, bytes(48))]  # a place, or rasterio warns
    tags += [(GEOKEYS, 3, keys), (_DOUBLES, 12, doubles), (_TEXTS, 2, texts)]
    fields, body = [(256, 3, 1, 1), (257, 3, 1, 1), (258, 3, 1, 8), (273, 4, 1, 8), (279, 4, 1, 1)], bytes(8)
    for tag, kind, content in tags:
        if count := len(content) // {2: 1, 3: 2, 12: 8}[kind]:
            fields.append((tag, kind, count, 8 + len(body)))
            body += content.ljust(-len(content) // 8 * -8, b"\0")
    table = struct.pack("<H", len(fields)) + b"".join(struct.pack("<HHII", *field) for field in fields) + bytes(4)
    image = struct.pack("<2sHI", b"II", 42, 8 + len(body)) + body + table
    try:
        with rasterio.MemoryFile(image) as memory, memory.open() as file:
            text = "" if file.crs is None else file.crs.to_wkt(version="WKT2_2019")
    except rasterio.errors.RasterioError as error:
        raise ValueError(error) from error
    known = text.startswith("PROJCRS") and "unretrievable" not in text  # the ellipsoid, which GDAL then guesses
    return pyproj.CRS.from_wkt(text) if known else None


def _parts(crs: pyproj.CRS) -> list[pyproj.CRS]:
    """What a CRS consists of, without shifts to other datums."""
    if crs.is_bound:
        return _parts(crs.source_crs)  # type: ignore[arg-type]
    return [part for each in crs.sub_crs_list for part in _parts(each)] if crs.is_compound else [crs]


def horizontal(crs: pyproj.CRS) -> pyproj.CRS:
    """What a CRS says of X and Y, without heights and shifts to other datums."""
    return _parts(crs)[0].to_2d()


def vertical(crs: pyproj.CRS | None) -> str | None:
    """The name of what a CRS says of heights, :data:`ELLIPSOIDAL` if it has three dimensions; None if it says nothing."""
    parts = [] if crs is None else _parts(crs)
    if any(len(part.axis_info) > 2 for part in parts):
        return ELLIPSOIDAL
    return next((part.name for part in parts if part.is_vertical), None)


def height_datum(crs: pyproj.CRS) -> str | None:
    """What heights count from, by PROJ's name for it; None if the CRS does not say it."""
    heights = _parts(crs)[-1]
    if not heights.is_vertical:
        return vertical(crs)
    name = heights.name if heights.datum is None else heights.datum.name
    try:
        return ELLIPSOIDAL if "ellipsoid" in name.lower() else str(Datum.from_name(name).name)
    except pyproj.exceptions.CRSError:
        return None if name.lower() in ("", "unknown", "unnamed") else name


def difference(one: pyproj.CRS, other: pyproj.CRS) -> tuple[str, str] | None:
    """The names of what differs between two CRS: their horizontal parts, or what heights count from. A CRS that says nothing
    of heights differs from none in this."""
    flat = horizontal(one), horizontal(other)
    if not same_system(*flat):
        alike = flat[0].name == flat[1].name and all(part.axis_info for part in flat)
        names = [f"{part.name} in {part.axis_info[0].unit_name}" if alike else part.name for part in flat]
        return names[0], names[1]
    if len({height_datum(one), height_datum(other)} - {None}) > 1:
        return str(vertical(one)), str(vertical(other))
    return None


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


_code = functools.lru_cache(maxsize=256)(pyproj.CRS.to_authority)


def _numbers(crs: pyproj.CRS) -> dict[str, float]:
    """What matters of a projected CRS, by names: its projection, in radians and metres, and what that is of."""
    operation, ellipsoid, meridian = crs.coordinate_operation, crs.ellipsoid, crs.prime_meridian
    if operation is None or ellipsoid is None or meridian is None:
        return {}
    found = {p.name: float(p.value) * float(p.unit_conversion_factor or 1.0) for p in operation.params}
    found |= {"a": ellipsoid.semi_major_metre, "1/f": ellipsoid.inverse_flattening}
    found |= {f"axis {k}": axis.unit_conversion_factor for k, axis in enumerate(crs.axis_info[:2])}
    return found | {operation.method_name: 0.0, "meridian": meridian.longitude * float(meridian.unit_conversion_factor)}


def for_outputs(crs: pyproj.CRS | None) -> pyproj.CRS | None:
    """What GeoTIFF, GeoPackage and LAS can state of a CRS: its heights only by the code of their datum, since GDAL puts another
    datum and unit into a GeoTIFF otherwise. Warns: if that is not all of it."""
    if crs is None:
        return None
    flat, heights = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d(), _parts(crs)[-1]
    try:
        text = flat.to_wkt("WKT1_GDAL")
        if crs.is_compound:
            coded = _epsg(heights.to_epsg()) or _heights(heights.name, height_datum(crs), _unit_of(heights))
            if coded is not None:  # as text: CompoundCRS leaves out the code of the unit
                return pyproj.CRS.from_wkt(f'COMPD_CS["{crs.name}",{text},{coded.to_wkt("WKT1_GDAL")}]')
    except pyproj.exceptions.CRSError:
        warn(f"CRS {crs.name}: output files cannot state it, so they have no CRS")
        return None
    if (name := vertical(crs)) != vertical(flat):
        warn(f"CRS {crs.name}: output files cannot state its heights ({name}), so they state {flat.name} only")
    return flat


def _heights(name: str, datum: str | None, unit: tuple[float, str]) -> pyproj.CRS | None:
    """A vertical CRS with the codes of its datum and of its unit, metres and name; None if PROJ knows no such datum."""
    lengths = pyproj.database.get_units_map("EPSG", "linear").values()
    try:
        code = Datum.from_name(datum or "unknown").to_json_dict()["id"]["code"]
        of_unit = next(length.code for length in lengths if math.isclose(length.conv_factor, unit[0], rel_tol=1e-7))
        of = f'VERT_DATUM["{datum}",2005,AUTHORITY["EPSG","{code}"]],UNIT["{unit[1]}",{unit[0]},AUTHORITY["EPSG","{of_unit}"]]'
        return pyproj.CRS.from_wkt(f'VERT_CS["{name}",{of},AXIS["Up",UP]]')
    except (pyproj.exceptions.CRSError, KeyError, StopIteration):
        return None


def geokeys(crs: pyproj.CRS) -> bytes | None:
    """The data of a record :data:`GEOKEYS` that states a projected CRS, with or without heights, by EPSG codes; None without."""
    parts = crs.sub_crs_list if crs.is_compound else [crs]
    codes = [part.to_epsg() for part in parts]
    if None in codes or not parts[0].is_projected:
        return None
    keys = [(_MODEL, 1), *zip((_PROJECTED, _VERTICAL), codes, strict=False)]
    entries = [value for key, code in keys for value in (key, 0, 1, code)]
    return struct.pack(f"<{4 + len(entries)}H", 1, 1, 0, len(keys), *entries)


def _epsg(code: int | None, kind: Any = pyproj.CRS) -> Any:
    """The CRS, or the :class:`Datum`, of a code, None if there is none."""
    try:
        return kind.from_epsg(code) if code is not None and _is_epsg(code) else None
    except pyproj.exceptions.CRSError:
        return None


def _unit_of(crs: pyproj.CRS, axis: int = 0) -> tuple[float, str]:
    return crs.axis_info[axis].unit_conversion_factor, crs.axis_info[axis].unit_name


def _is_epsg(code: int) -> bool:
    return 1024 <= code <= 32766


@functools.cache
def _linear_unit(key: int | str) -> tuple[float, str] | None:
    """Metres in EPSG's unit of length with this number or name, and its name."""
    known = pyproj.database.get_units_map("EPSG", "linear").values()
    return next(((u.conv_factor, u.name) for u in known if str(key).lower() in (u.code, u.name.lower())), None)


def _units(xy: tuple[float, str], z: tuple[float, str]) -> Units:
    return Units(xy[0], z[0], xy[1] if xy[0] == z[0] else f"{xy[1]}, Z in {z[1]}")
