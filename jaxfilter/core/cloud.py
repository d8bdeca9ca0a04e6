"""PointCloud: what every reader makes, every filter takes and every writer needs."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Iterable
from typing import Any

import numpy as np

from .errors import InputError, JaxfilterWarning

QUANTUM = 2.0**-10
"""Local coordinates are multiples of this many metres (about 1 mm).

Below 16 km from the origin such values, and all differences between them, are exact in float32. A power of two never
lies half-way between two decimal centimetres or millimetres, so clouds that differ by a shift become equal bit for bit.
"""

KEPT_CLASSES = (7, 9, *range(17, 256))
"""ASPRS classes that are set aside by default: noise (7, 18), water (9), bridge decks (17), and all above, which producers give
by rules of their own (ignored ground, snow, artefacts). No ground filter sees what they were given for."""


@dataclasses.dataclass(frozen=True)
class Units:
    """Metres per coordinate unit: ``xy`` for X and Y, ``z`` for Z; ``name`` says where that came from."""

    xy: float = 1.0
    z: float = 1.0
    name: str = "metre"

    def __str__(self) -> str:
        if self.xy == self.z:
            return self.name
        return f"{self.name} (xy x {self.xy:.10g}, z x {self.z:.10g} m)"


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
    parts = [p.strip().lower() for p in text.split(",")]
    if not 1 <= len(parts) <= 2 or any(p not in UNITS for p in parts):
        raise InputError(
            f"units {text!r} are not known: use one of {', '.join(UNITS)}, or a pair XY,Z such as 'us-ft,m'"
        )
    xy, z = UNITS[parts[0]], UNITS[parts[-1]]
    return xy if xy == z else Units(xy.xy, z.z, f"{xy.name}, Z in {z.name}")


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
        valid: bool[n] or None; False where a coordinate was NaN or infinite (only with ``drop_invalid=True``).
        crs: pyproj.CRS or None.
        units: metres per file unit.
        anchor: f64[2] file coordinates that grids are aligned to; None means the cloud's own lower left corner.
        source: a handle to the file (see ``jaxfilter.host.files``), used by lossless writing; None for plain arrays.
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
    units: Units = Units()
    anchor: np.ndarray | None = None
    source: Any = None

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points, {int(self.candidate.sum())} candidates, origin {self.origin.tolist()})"

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

        Raises: InputError for a wrong shape or attribute length, or for NaN and infinite coordinates unless
        ``drop_invalid``, in which case those points become non-ground and a warning gives their number.
        """
        xyz = np.asarray(xyz)
        if xyz.ndim != 2 or xyz.shape[1] != 3:
            raise InputError(f"{name}: coordinates must have shape (n, 3), not {xyz.shape}")
        if not np.issubdtype(xyz.dtype, np.number) or np.issubdtype(xyz.dtype, np.complexfloating):
            raise InputError(f"{name}: coordinates must be real numbers, not {xyz.dtype}")
        xyz = xyz.astype(np.float64, copy=False)
        scale = parse_units(units)
        finite = np.isfinite(xyz).all(axis=1)
        valid = None
        if not finite.all():
            bad = int(len(xyz) - finite.sum())
            if not drop_invalid:
                raise InputError(
                    f"{name}: {bad} of {len(xyz)} points have NaN or infinite coordinates; remove them, or pass "
                    "drop_invalid=True to label them non-ground"
                )
            warnings.warn(
                f"{name}: {bad} points with NaN or infinite coordinates are labelled non-ground",
                JaxfilterWarning,
                stacklevel=2,
            )
            valid = finite
        origin, local = localise(xyz if valid is None else np.where(finite[:, None], xyz, np.nan), scale, anchor)
        chosen = {"returns": returns, "ignore_classes": ignore_classes, "keep_withheld": keep_withheld}
        return cls._assembled(origin, local, scale, anchor, name, chosen, valid=valid, **attributes)

    @classmethod
    def from_integers(
        cls,
        ticks: np.ndarray,
        scales: np.ndarray,
        offsets: np.ndarray,
        *,
        units: str | Units = "m",
        anchor: Iterable[float] | None = None,
        name: str = "xyz",
        returns: str = "last,only",
        ignore_classes: Iterable[int] = KEPT_CLASSES,
        keep_withheld: bool = False,
        **attributes: Any,
    ) -> PointCloud:
        """The cloud of ``from_arrays(ticks * scales + offsets)``, bit for bit, without its float64 coordinates.

        ``ticks``, i32[n, 3], is C-contiguous and is **used up**: its memory becomes the cloud's ``xyz``. ``scales``
        (all positive) and ``offsets`` are f64[3], as in a LAS header. The rest is as in :meth:`from_arrays`.
        """
        scale = parse_units(units)
        origin, local = localise_integers(ticks, scales, offsets, scale, anchor)
        chosen = {"returns": returns, "ignore_classes": ignore_classes, "keep_withheld": keep_withheld}
        return cls._assembled(origin, local, scale, anchor, name, chosen, **attributes)

    @classmethod
    def _assembled(
        cls,
        origin: np.ndarray,
        local: np.ndarray,
        units: Units,
        anchor: Iterable[float] | None,
        name: str,
        chosen: dict[str, Any],
        **attributes: Any,
    ) -> PointCloud:
        for key, value in attributes.items():
            if key in ("crs", "source") or value is None:
                continue
            if len(value) != len(local):
                raise InputError(f"{name}: {key} has {len(value)} entries for {len(local)} points")
        grid_anchor = None if anchor is None else np.asarray(tuple(anchor), np.float64)
        cloud = cls(origin=origin, xyz=local, units=units, anchor=grid_anchor, **attributes)
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
        """f64[n, 3] in file units, rounded to the quantum of the local frame (the file's own integers stay in the file)."""
        factor = np.array([self.units.xy, self.units.xy, self.units.z])
        return self.origin + self.xyz.astype(np.float64) / factor

    def grid_offset(self, cell: float) -> tuple[float, float]:
        """Local x, y in metres (each in (-cell, 0]) of the grid corner for cells of this size.

        Without an anchor it is the cloud's own corner (0, 0); with one, the multiple of ``cell`` counted from the anchor.
        """
        if self.anchor is None:
            return 0.0, 0.0
        lag = (self.origin[:2] - self.anchor) * self.units.xy
        return tuple(float(-(v - np.floor(v / cell + 1e-9) * cell)) for v in lag)  # type: ignore[return-value]


def localise(xyz: np.ndarray, units: Units, anchor: Iterable[float] | None) -> tuple[np.ndarray, np.ndarray]:
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
    ticks: np.ndarray, scales: np.ndarray, offsets: np.ndarray, units: Units, anchor: Iterable[float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`localise` of ``ticks * scales + offsets``, bit for bit, in the memory of the i32[n, 3] ticks."""
    if len(ticks) == 0:
        return np.zeros(3), np.zeros((0, 3), np.float32)
    factor = np.array([units.xy, units.xy, units.z])
    origin = _origin(ticks.min(axis=0) * scales + offsets, factor, anchor)
    local = ticks.view(np.float32)
    for start in range(0, len(ticks), _ROWS):
        rows = slice(start, start + _ROWS)
        for axis in range(3):
            column = ticks[rows, axis] * scales[axis] + offsets[axis]
            local[rows, axis] = _quantised(column, origin[axis], factor[axis])
    return origin, local


_ROWS = 1_000_000  # points of a large cloud that are converted at a time


def _origin(low: np.ndarray, factor: np.ndarray, anchor: Iterable[float] | None) -> np.ndarray:
    if anchor is None:
        return low
    base = np.append(np.asarray(tuple(anchor), np.float64), 0.0)
    return base + np.floor((low - base) * factor) / factor


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
        warnings.warn(
            f"{name}: return number and number of returns are 0 throughout, so all points are candidates",
            JaxfilterWarning,
            stacklevel=3,
        )
        return np.ones(n, bool)
    odd = (number == 0) | (total == 0) | (number > total)
    if odd.any():
        warnings.warn(
            f"{name}: {int(odd.sum())} points have impossible return numbers and are treated as last returns",
            JaxfilterWarning,
            stacklevel=3,
        )
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


def as_cloud(points: Any) -> PointCloud:
    """A PointCloud as it is; anything else is taken as coordinates f64[n, 3] in metres."""
    return points if isinstance(points, PointCloud) else PointCloud.from_arrays(points)
