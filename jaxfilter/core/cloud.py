"""PointCloud: what every reader makes, every filter takes and every writer needs."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from .errors import InputError, warn
from .markup import sheet
from .units import (
    GEOKEYS,
    PROJECTION,
    UNITS,
    WKT,
    Units,
    linear_units,
    not_metric,
    parse_crs,
    parse_units,
    reference_of,
    sampled,
)

QUANTUM = 2.0**-10
"""Local coordinates are multiples of this many metres (about 1 mm).

Below 16 km from the origin such values, and all differences between them, are exact in float32. A power of two never
lies half-way between two decimal centimetres or millimetres, so clouds that differ by a shift become equal bit for bit.
"""


class _KeptClasses(tuple[int, ...]):
    """Short where signatures show it as a default."""

    def __repr__(self) -> str:
        return "(7, 9, 17, 18, ..., 255)"


KEPT_CLASSES = _KeptClasses((7, 9, *range(17, 256)))
"""ASPRS classes that are set aside by default: noise (7, 18), water (9), bridge decks (17), and all above, which producers give
by rules of their own (ignored ground, snow, artefacts). No ground filter sees what they were given for."""


GROUND_CLASS = 2
"""ASPRS class ground."""

LARGEST_SPAN = (1e7, 1e7, 1e5)
"""Metres in X, Y and Z that a cloud may extend over; more is a stray point, or a wrong unit or scale."""

SCALES = (1e-12, 100.0)
"""Scale factors of LAS files that are believed: above the first, up to the second."""


@dataclasses.dataclass(frozen=True)
class Whole:
    """What methods ask of the whole scene, for a cloud that is a part of it: all parts are then filtered alike.

    Attributes:
        spacing: mean point spacing of the candidates, metres; None = each part has its own.
        lowest: elevation of the lowest point that a method lets count (``Filter.lowest``), file units; None likewise.
        rounds: of growth on each of STIN's grids, and with the suspected outliers; None likewise.
        width, height: of the largest part, metres: arrays of all parts get the shape that this one needs, so that they share
            compilations; 0 = each has its own.
    """

    spacing: float | None = None
    lowest: float | None = None
    rounds: tuple[int, ...] | None = None
    width: float = 0.0
    height: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class PointCloud:
    """Points in a local metric frame, with what lidar files say about them. All arrays have length n, in input order.

    Attributes:
        origin: f64[3], file units; local metres = (file coordinate - origin) * units, quantised to :data:`QUANTUM`.
        xyz: f32[n, 3], metres in the local frame. Rows of invalid points (see ``valid``) are zero.
        return_number, number_of_returns: u8[n] or None where the format has none.
        classification: u8[n] ASPRS classes as read, or None.
        withheld: bool[n] or None; the LAS flag.
        candidate: bool[n]; the points that a filter may call ground. Others are non-ground and are written unchanged.
        reference: bool[n] or None; True = ground, from a labelled text file or from class 2 of a classified LAS file.
        valid: bool[n] or None; False where a coordinate was NaN, infinite or far off (only with ``drop_invalid=True``).
        crs: pyproj.CRS or None; whatever ``pyproj.CRS.from_user_input`` takes becomes one.
        units: metres per file unit.
        anchor: f64[2] file coordinates that grids are aligned to; None means the cloud's own lower left corner.
        source: a handle to the file (see ``jaxfilter.host.files``), used by lossless writing; None for plain arrays.
        whole: the scene that the cloud is a part of; None = it is a scene of its own.

    >>> cloud.xyz.shape == (len(cloud), 3), cloud.xyz.dtype, cloud.units.name
    (True, dtype('float32'), 'metre')
    >>> round(float(cloud.origin[0]))
    512000
    """

    origin: np.ndarray
    xyz: np.ndarray
    return_number: np.ndarray | None = None
    number_of_returns: np.ndarray | None = None
    classification: np.ndarray | None = None
    withheld: np.ndarray | None = None
    candidate: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, bool))
    reference: np.ndarray | None = None
    valid: np.ndarray | None = None
    crs: Any = None
    units: Units = UNITS["m"]
    anchor: np.ndarray | None = None
    source: Any = None
    whole: Whole | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "crs", parse_crs(self.crs))

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points, {int(self.candidate.sum())} candidates, origin {self.origin.tolist()})"

    def _repr_html_(self) -> str:
        rows: list[tuple[str, Any]] = [("points", len(self)), ("candidates", int(self.candidate.sum()))]
        if len(self):
            ends = np.stack([self.xyz.min(axis=0), self.xyz.max(axis=0)])
            low, high = dataclasses.replace(self, xyz=ends).coordinates()
            rows += [(axis, f"{a:.2f} to {b:.2f}") for axis, a, b in zip("xyz", low, high, strict=True)]
        rows += [("units", str(self.units)), ("CRS", "unknown" if self.crs is None else self.crs.name)]
        if self.classification is not None:
            counts = np.bincount(self.classification)
            rows += [("classes", ", ".join(f"{c}: {int(counts[c]):,}" for c in np.flatnonzero(counts)))]
        if self.reference is not None:
            rows += [("reference ground", int(self.reference.sum()))]
        return sheet("PointCloud", rows)

    @classmethod
    def from_arrays(
        cls,
        xyz: np.ndarray,
        *,
        units: str | Units = "m",
        anchor: Iterable[float] | None = None,
        drop_invalid: bool = False,
        name: str = "xyz",
        returns: str = "last,only",
        ignore_classes: Iterable[int] = KEPT_CLASSES,
        keep_withheld: bool = False,
        **attributes: Any,
    ) -> PointCloud:
        """Make a cloud from coordinates in file units, f64[n, 3], and attribute arrays named as the class's fields.

        ``returns``, ``ignore_classes`` and ``keep_withheld`` choose the candidates, see :meth:`select`; ``name`` stands
        in error messages for where the numbers came from.

        Raises: InputError for a wrong shape or attribute length, and for coordinates so large that float64 does not
        resolve :data:`QUANTUM`; for NaN and infinite coordinates, and for an extent above :data:`LARGEST_SPAN`, unless
        ``drop_invalid``: then points that are not numbers, or lie farther than half of that from the median of a
        coordinate, become non-ground, and a warning gives their number.

        >>> xyz = [[512000.0, 5403000.0, 350.0], [512001.0, 5403002.0, 350.5]]
        >>> made = jf.PointCloud.from_arrays(np.array(xyz), classification=np.array([2, 6], np.uint8))
        >>> made.xyz.tolist()
        [[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]]
        """
        try:
            xyz = np.asarray(xyz)
        except ValueError as error:
            raise InputError(f"{name}: coordinates must be an array of shape (n, 3): {error}") from error
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise InputError(f"{name}: coordinates must have shape (n, 3), not {xyz.shape}")
        if not np.issubdtype(xyz.dtype, np.number) or np.issubdtype(xyz.dtype, np.complexfloating):
            raise InputError(f"{name}: coordinates must be real numbers, not {xyz.dtype}")
        xyz = xyz.astype(np.float64, copy=False)
        scale, grid_anchor = parse_units(units), _checked_anchor(anchor)
        finite = np.isfinite(xyz).all(axis=1)
        valid = None
        if not finite.all():
            bad = int(len(xyz) - finite.sum())
            if not drop_invalid:
                raise InputError(
                    f"{name}: {bad} of {len(xyz)} points have NaN or infinite coordinates; remove them, or pass "
                    "drop_invalid=True to label them non-ground"
                )
            warn(f"{name}: {bad} points with NaN or infinite coordinates are labelled non-ground")
            valid = finite
            xyz = np.where(finite[:, None], xyz, np.nan)
        low, high = _extremes(xyz)
        near = _near(lambda axis: xyz[:, axis], low, high, scale, name, drop_invalid)
        if near is not None:
            valid, xyz = near, np.where(near[:, None], xyz, np.nan)
            low, high = _extremes(xyz)
        _check_resolution(low, high, scale, name)
        origin, local = localise(xyz, scale, grid_anchor)
        chosen = {"returns": returns, "ignore_classes": ignore_classes, "keep_withheld": keep_withheld}
        return cls._assembled(origin, local, scale, grid_anchor, name, chosen, valid=valid, **attributes)

    @classmethod
    def from_integers(
        cls,
        ticks: np.ndarray,
        scales: np.ndarray,
        offsets: np.ndarray,
        *,
        units: str | Units = "m",
        anchor: Iterable[float] | None = None,
        drop_invalid: bool = False,
        name: str = "xyz",
        returns: str = "last,only",
        ignore_classes: Iterable[int] = KEPT_CLASSES,
        keep_withheld: bool = False,
        **attributes: Any,
    ) -> PointCloud:
        """The cloud of ``from_arrays(ticks * scales + offsets)``, bit for bit, without its float64 coordinates.

        ``ticks``, i32[n, 3], is C-contiguous and is **used up**: its memory becomes the cloud's ``xyz``. ``scales``
        (see :func:`check_scales`) and ``offsets`` are f64[3], file units, as in a LAS header. The rest is as in
        :meth:`from_arrays`.

        >>> ticks = np.array([[0, 0, 100], [250, 500, 150]], np.int32)
        >>> made = jf.PointCloud.from_integers(ticks, np.array([0.01, 0.01, 0.01]), np.zeros(3))
        >>> made.coordinates().tolist()
        [[0.0, 0.0, 1.0], [2.5, 5.0, 1.5]]
        """
        scale, grid_anchor = parse_units(units), _checked_anchor(anchor)
        check_scales(scales, offsets, name)
        valid = None
        if len(ticks):
            low, high = (end * scales + offsets for end in (ticks.min(axis=0), ticks.max(axis=0)))
            valid = _near(
                lambda axis: ticks[:, axis] * scales[axis] + offsets[axis], low, high, scale, name, drop_invalid
            )
            if valid is not None and valid.any():
                low, high = (end * scales + offsets for end in (ticks[valid].min(axis=0), ticks[valid].max(axis=0)))
            _check_resolution(low, high, scale, name)
        origin, local = localise_integers(ticks, scales, offsets, scale, grid_anchor, valid)
        chosen = {"returns": returns, "ignore_classes": ignore_classes, "keep_withheld": keep_withheld}
        return cls._assembled(origin, local, scale, grid_anchor, name, chosen, valid=valid, **attributes)

    @classmethod
    def from_laspy(
        cls,
        las: Any,
        *,
        units: str | Units | None = None,
        name: str = "LasData",
        **options: Any,
    ) -> PointCloud:
        """Make a cloud from a ``laspy.LasData`` as from the file it would be written to, see :func:`jaxfilter.read`.

        ``units`` are by default those of its CRS; ``options`` are those of :meth:`from_arrays`. Class 2 becomes the
        reference. To keep all that the points hold, give labels back to laspy: ``las.classification[result.ground] = 2``.

        Raises: InputError as :meth:`from_arrays`, and where X and Y are angles. Warns: as :func:`jaxfilter.read`.

        >>> import laspy
        >>> made = jf.PointCloud.from_laspy(laspy.read("scene.laz"), units="m")
        >>> len(made) == len(cloud), bool((made.reference == truth).all())
        (True, True)
        """
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
        fields = ("return_number", "number_of_returns", "classification")
        columns: dict[str, Any] = {field: np.array(las[field], np.uint8) for field in fields}
        is_ground = columns["classification"] == GROUND_CLASS
        return cls.from_integers(
            ticks,
            scales,
            offsets,
            units=scale,
            name=name,
            crs=reference.crs,
            withheld=np.array(las["withheld"], bool),
            reference=is_ground if is_ground.any() else None,
            **columns,
            **options,
        )

    @classmethod
    def from_structured(
        cls, points: Any, *, units: str | Units = "m", name: str = "array", **options: Any
    ) -> PointCloud:
        """Make a cloud from a structured NumPy array, such as those that the Python package of PDAL gives.

        Fields ``X``, ``Y``, ``Z`` in file units are needed; ``ReturnNumber``, ``NumberOfReturns``, ``Classification`` and
        ``Withheld`` are taken if there are such, others are passed over. Case and underscores in names do not count. Class 2
        becomes the reference. An array has no CRS: state ``units``, and pass ``crs`` for outputs. ``options`` are those of
        :meth:`from_arrays`. Points that are a record, or an object with such attributes, will do as well.

        Raises: InputError as :meth:`from_arrays`, and if a coordinate is missing.

        >>> kind = [("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Classification", "u1")]
        >>> points = np.array([(512000.0, 5403000.0, 350.0, 2), (512001.0, 5403002.0, 355.0, 6)], kind)
        >>> jf.PointCloud.from_structured(points).reference.tolist()
        [True, False]
        """
        named = {_plain(key): key for key in _names_of(points)}
        if missing := [axis for axis in "xyz" if axis not in named]:
            raise InputError(
                f"{name}: there is no field {missing[0].upper()}; X, Y and Z are needed, and it has {', '.join(named.values())}"
            )

        def get(field: str, kind: Any) -> np.ndarray:
            key = named[_plain(field)]
            return np.asarray(getattr(points, key) if hasattr(points, key) else points[key]).astype(kind)

        columns: dict[str, Any] = {name: get(name, kind) for name, kind in _COLUMNS.items() if _plain(name) in named}
        is_ground = columns.get("classification", np.zeros(0, np.uint8)) == GROUND_CLASS
        xyz = np.stack([get(axis, np.float64) for axis in "xyz"], axis=1)
        columns["reference"] = is_ground if is_ground.any() else None
        return cls.from_arrays(xyz, units=units, name=name, **{**columns, **options})

    @classmethod
    def _assembled(
        cls,
        origin: np.ndarray,
        local: np.ndarray,
        units: Units,
        anchor: np.ndarray | None,
        name: str,
        chosen: dict[str, Any],
        **attributes: Any,
    ) -> PointCloud:
        for key, value in attributes.items():
            if key in ("crs", "source", "whole") or value is None:
                continue
            if len(value) != len(local):
                raise InputError(f"{name}: {key} has {len(value)} entries for {len(local)} points")
        cloud = cls(origin=origin, xyz=local, units=units, anchor=anchor, **attributes)
        return cloud.select(name=name, **chosen)

    def select(
        self,
        *,
        returns: str = "last,only",
        ignore_classes: Iterable[int] = KEPT_CLASSES,
        keep_withheld: bool = False,
        name: str = "cloud",
    ) -> PointCloud:
        """A cloud whose candidates are chosen anew; the arrays are shared.

        Args:
            returns: comma-separated list out of ``first``, ``intermediate``, ``last``, ``only``, or ``all``. The default
                takes single echoes and the last of several.
            ignore_classes: points of these classes are set aside: they are no seeds, vertices or ground, and keep their class. By
                default noise, water, bridge decks and all classes from 17 on (:data:`KEPT_CLASSES`).
            keep_withheld: take points that carry the withheld flag as well.

        >>> everything = cloud.select(returns="all", ignore_classes=())
        >>> bool(everything.candidate.all()), bool(cloud.candidate.all())
        (True, False)
        """
        candidate = np.ones(len(self), bool) if self.valid is None else self.valid.copy()
        candidate &= _echo_mask(self.return_number, self.number_of_returns, returns, len(self), name)
        ignored = tuple(ignore_classes)
        if self.classification is not None and ignored:
            candidate &= ~np.isin(self.classification, ignored)
        if self.withheld is not None and not keep_withheld:
            candidate &= ~self.withheld
        return dataclasses.replace(self, candidate=candidate)

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units, rounded to the quantum of the local frame (the file's own integers stay in the file).

        >>> bool(np.allclose(cloud.coordinates(), scene.xyz, atol=0.001))
        True
        """
        factor = np.array([self.units.xy, self.units.xy, self.units.z])
        return self.origin + self.xyz.astype(np.float64) / factor

    def grid_offset(self, cell: float) -> tuple[float, float]:
        """Local x, y in metres (each in (-cell, 0]) of the grid corner for cells of this size.

        Without an anchor it is the cloud's own corner (0, 0); with one, the multiple of ``cell`` counted from the anchor.

        >>> cloud.grid_offset(10.0)
        (0.0, 0.0)
        >>> jf.PointCloud.from_arrays(np.array([[12.0, 7.0, 1.0]]), anchor=(0, 0)).grid_offset(10.0)
        (-2.0, -7.0)
        """
        if self.anchor is None:
            return 0.0, 0.0
        lag = (self.origin[:2] - self.anchor) * self.units.xy
        return tuple(float(-(v - np.floor(v / cell + 1e-9) * cell)) for v in lag)  # type: ignore[return-value]


def localise(xyz: np.ndarray, units: Units, anchor: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Remove a float64 origin and quantise: the only place where raw coordinates become local ones.

    The origin is the lower corner in x, y, z. With an anchor it is whole metres from the anchor, so that clouds with one
    anchor share one lattice of quantised coordinates. Returns origin f64[3] and local f32[n, 3]; NaN rows become zero.
    """
    if len(xyz) == 0 or not np.isfinite(xyz).any():
        return np.zeros(3), np.zeros((len(xyz), 3), np.float32)
    factor = np.array([units.xy, units.xy, units.z])
    origin = _origin(np.nanmin(xyz, axis=0), factor, anchor)
    local = np.empty(xyz.shape, np.float32)
    for axis in range(3):  # by axis: bounds the float64 temporaries on large clouds
        local[:, axis] = np.nan_to_num(_quantised(xyz[:, axis], origin[axis], factor[axis]), nan=0.0)
    return origin, local


def localise_integers(
    ticks: np.ndarray,
    scales: np.ndarray,
    offsets: np.ndarray,
    units: Units,
    anchor: np.ndarray | None,
    valid: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`localise` of ``ticks * scales + offsets``, bit for bit, in the memory of the i32[n, 3] ticks.

    Rows that are not ``valid`` (bool[n]; by default all are) become zero.
    """
    if len(ticks) == 0 or (valid is not None and not valid.any()):
        return np.zeros(3), np.zeros((len(ticks), 3), np.float32)
    factor = np.array([units.xy, units.xy, units.z])
    low = ticks.min(axis=0) if valid is None else ticks[valid].min(axis=0)
    origin = _origin(low * scales + offsets, factor, anchor)
    local = ticks.view(np.float32)
    for start in range(0, len(ticks), _ROWS):
        rows = slice(start, start + _ROWS)
        for axis in range(3):
            column = ticks[rows, axis] * scales[axis] + offsets[axis]
            local[rows, axis] = _quantised(column, origin[axis], factor[axis])
    if valid is not None:
        local[~valid] = 0
    return origin, local


_ROWS = 1_000_000  # points of a large cloud that are converted at a time


def _origin(low: np.ndarray, factor: np.ndarray, anchor: np.ndarray | None) -> np.ndarray:
    if anchor is None:
        return low
    base = np.append(anchor, 0.0)
    return base + np.floor((low - base) * factor) / factor


def _checked_anchor(anchor: Iterable[float] | None) -> np.ndarray | None:
    """f64[2], or None for none. Raises InputError."""
    if anchor is None:
        return None
    try:
        x, y = (float(v) for v in anchor)
    except (TypeError, ValueError) as error:
        raise InputError(f"anchor={anchor!r}: two numbers (x, y) in file units are needed") from error
    if not max(abs(x), abs(y)) < _RESOLVED:
        raise InputError(f"anchor={anchor!r}: must be two finite numbers below {_RESOLVED:g}")
    return np.array([x, y])


_RESOLVED = QUANTUM * 2.0**53
"""Below this many metres float64 resolves the quantum."""


def _extremes(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[3] least and f64[3] largest coordinates; NaN where there are none."""
    known = xyz[~np.isnan(xyz[:, 0])] if np.isnan(xyz[:, 0]).any() else xyz
    return (known.min(axis=0), known.max(axis=0)) if len(known) else (np.full(3, np.nan), np.full(3, np.nan))


def _near(
    column: Callable[[int], np.ndarray], low: np.ndarray, high: np.ndarray, units: Units, name: str, drop: bool
) -> np.ndarray | None:
    """None if a cloud from ``low`` to ``high`` is of possible size; else bool[n], the points that are left of it.

    ``column(axis)`` gives f64[n] file coordinates, NaN for points that do not count. Medians are taken only of clouds
    that are too large. Raises: InputError unless points may be dropped (``drop``).
    """
    factor = np.array([units.xy, units.xy, units.z])
    with np.errstate(over="ignore", invalid="ignore"):
        spans = (high - low) * factor
    near = None
    for axis in np.flatnonzero(spans > LARGEST_SPAN).tolist():
        limit, letter = LARGEST_SPAN[axis], "XYZ"[axis]
        values = column(axis)
        known = values[~np.isnan(values)]
        median = np.partition(known, len(known) // 2)[len(known) // 2]
        with np.errstate(over="ignore"):
            distance = abs(values - median) * factor[axis]
        if not drop:
            worst = int(np.nanargmax(distance))
            place = ", ".join(f"{column(i)[worst]:.10g}" for i in range(3))
            raise InputError(
                f"{name}: {letter} spans {spans[axis]:.4g} m, more than the {limit:g} m that are possible; farthest from "
                f"the median is point {worst} of {len(values)} (counted from 0) at ({place}): remove stray points or pass "
                f"drop_invalid=True to label them non-ground, or, if it is not stray, correct scale and offset or pass units="
            )
        far = distance > limit / 2
        warn(
            f"{name}: {int(far.sum())} points more than {limit / 2:g} m from the median of {letter} are labelled non-ground"
        )
        near = distance <= limit / 2 if near is None else near & (distance <= limit / 2)
    return near


def _check_resolution(low: np.ndarray, high: np.ndarray, units: Units, name: str) -> None:
    """Raises: InputError for coordinates that float64 holds less exactly than local ones are."""
    factor = np.array([units.xy, units.xy, units.z])
    largest = np.fmax(abs(low), abs(high)) * factor
    if (largest >= _RESOLVED).any():
        axis = int(np.argmax(largest >= _RESOLVED))
        value = low[axis] if abs(low[axis]) > abs(high[axis]) else high[axis]
        raise InputError(
            f"{name}: {'XYZ'[axis]} reaches {value:.10g} units, where float64 does not resolve {QUANTUM:.2g} m: correct "
            "scale and offset, or subtract a constant from the coordinates"
        )


def check_scales(scales: np.ndarray, offsets: np.ndarray, name: str) -> None:
    """Scales and offsets of integer coordinates, f64[3] each. Raises InputError naming the field."""
    low, high = SCALES
    for axis, scale, offset in zip("XYZ", scales, offsets, strict=True):
        if not low < scale <= high:
            raise InputError(
                f"{name}: {axis} scale factor is {scale:g}; it must be above {low:g} and not above {high:g}, the header is "
                "damaged"
            )
        if not math.isfinite(offset):
            raise InputError(f"{name}: {axis} offset is {offset:g}; the header is damaged")


def _quantised(column: np.ndarray, origin: float, factor: float) -> np.ndarray:
    return np.rint((column - origin) * (factor / QUANTUM)) * QUANTUM


_ECHOES = ("first", "intermediate", "last", "only")


def _echo_mask(number: np.ndarray | None, total: np.ndarray | None, returns: str, n: int, name: str) -> np.ndarray:
    """bool[n]: which points are among the wanted echoes. Damaged echo numbers are treated as last, with a warning."""
    wanted = {r.strip().lower() for r in returns.split(",") if r.strip()}
    if not wanted or wanted - {*_ECHOES, "all"}:
        raise InputError(f"returns={returns!r}: use a comma-separated list of {', '.join(_ECHOES)}, or all")
    if "all" in wanted or number is None or total is None or n == 0:
        return np.ones(n, bool)
    empty = (number == 0) & (total == 0)
    if empty.all():
        warn(f"{name}: return number and number of returns are 0 throughout, so all points are candidates")
        return np.ones(n, bool)
    odd = (number == 0) | (total == 0) | (number > total)
    if odd.any():
        warn(f"{name}: {int(odd.sum())} points have impossible return numbers and are treated as last returns")
    mask = np.zeros(n, bool)
    several = (total > 1) & ~odd
    if "only" in wanted:
        mask |= (total == 1) & ~odd
    if "last" in wanted:
        mask |= (several & (number == total)) | odd
    if "first" in wanted:
        mask |= several & (number == 1)
    if "intermediate" in wanted:
        mask |= several & (number > 1) & (number < total)
    return mask


def is_laspy(points: Any) -> bool:
    """Whether this is a ``laspy.LasData``; laspy is not imported to find out."""
    return any((c.__module__.partition(".")[0], c.__name__) == ("laspy", "LasData") for c in type(points).__mro__)


_COLUMNS = {"return_number": np.uint8, "number_of_returns": np.uint8, "classification": np.uint8, "withheld": bool}


def _plain(name: str) -> str:
    """A name without case and underscores, so that PDAL's are those of the fields."""
    return name.lower().replace("_", "")


def _names_of(points: Any) -> tuple[str, ...]:
    """Fields of a structured array, or attributes out of x, y, z and the columns."""
    names = getattr(getattr(points, "dtype", None), "names", None)
    return tuple(names) if names else tuple(name for name in ("x", "y", "z", *_COLUMNS) if hasattr(points, name))


def is_structured(points: Any) -> bool:
    """Whether these are named columns: a structured array, or an object with attributes ``x``, ``y`` and ``z``."""
    return bool(getattr(getattr(points, "dtype", None), "names", None)) or {"x", "y", "z"} <= set(_names_of(points))


def as_cloud(points: Any) -> PointCloud:
    """A PointCloud as it is; a ``laspy.LasData`` as its file; a structured array, or what has attributes x, y and z, by its
    names; anything else as coordinates f64[n, 3]. Arrays are in metres."""
    if isinstance(points, PointCloud):
        return points
    if is_laspy(points):
        return PointCloud.from_laspy(points)
    if isinstance(points, (str, os.PathLike)):
        raise InputError(
            f"{os.fspath(points)}: is a name, and points are needed: read the file first, by jaxfilter.read"
        )
    return PointCloud.from_structured(points) if is_structured(points) else PointCloud.from_arrays(points)
