"""A file of points as it is described before they are read: small, picklable, and enough to plan with."""

from __future__ import annotations

import dataclasses
import functools
import math
from pathlib import Path
from typing import cast

import numpy as np
import pyproj

from ..core.errors import InputError
from ..core.units import UNITS, Units, not_metric, sampled
from .disk import Bounds
from .reading import is_text, kept_text, open_las
from .storage import Place, place_of

NO_BOUNDS: Bounds = (math.nan,) * 4  # type: ignore[assignment]
"""The bounds of a file without points."""


@dataclasses.dataclass(frozen=True, slots=True)
class Source:
    """A LAS, LAZ or COPC file as its header states it, or a text file.

    Attributes:
        uri: absolute path, or URI.
        format: ``"las"``, ``"laz"``, ``"copc"`` or ``"text"``.
        bounds: xmin, ymin, xmax, ymax, file coordinates, **closed** on all sides; NaN for a file without points.
        z: lowest and highest Z, file coordinates.
        count: number of points.
        wkt: its CRS as WKT, or None; see ``crs``.
        units: metres per file unit.
        point_format, scales, offsets: as in the header; None for text, and for a member of a ``.vpc`` whose header was not read.
        date: day on which the file was made, ISO 8601, as the header states it, or None.
        identity: changes with the file (size, time of the last change or ETag, header), see ``Header.fingerprint``; ``""``
            where the header was not read.
    """

    uri: str
    format: str
    bounds: Bounds
    count: int
    z: tuple[float, float] = (math.nan, math.nan)
    wkt: str | None = None
    units: Units = UNITS["m"]
    point_format: int | None = None
    scales: tuple[float, float, float] | None = None
    offsets: tuple[float, float, float] | None = None
    date: str | None = None
    identity: str = ""

    @property
    def place(self) -> Place:
        """Where its bytes are."""
        return place_of(self.uri)

    @property
    def crs(self) -> pyproj.CRS | None:
        """The CRS, or None."""
        return None if self.wkt is None else _crs_of(self.wkt)

    @property
    def metre(self) -> float:
        """Metres per unit of X and Y."""
        return self.units.xy


@functools.lru_cache(maxsize=256)
def _crs_of(wkt: str) -> pyproj.CRS:
    return pyproj.CRS.from_wkt(wkt)


def describe_file(place: Place, units: Units | None = None) -> Source:
    """What can be known of a file before its points are read, from its header or, of text, from all of its lines.

    Raises: InputError if it cannot be read, or if its coordinates cannot be lengths, unless ``units`` are given.
    """
    return _text_source(cast(Path, place), units) if is_text(place) else _las_source(place, units)


def _las_source(place: Place, units: Units | None) -> Source:
    file = open_las(place, tables=False)
    header, reference = file.header, file.reference
    low, high = header.extent
    if header.count and not (np.isfinite(low) & np.isfinite(high) & (low <= high)).all():
        extent = f"{low.tolist()} to {high.tolist()}"
        raise InputError(f"{place}: the extent in its header is damaged: {extent}; write the file anew to correct it")
    problem = None
    if units is None and reference.problem is not None:
        problem = f"{reference.problem}, or pass units= if the CRS record is wrong"
    if units is None and problem is None and header.count:
        problem = not_metric(np.stack(header.extent), header.count, reference.units is not None)
    if problem is not None:
        raise InputError(f"{place}: {problem}")
    return dataclasses.replace(
        _extended(place, header.count, np.stack([low, high])),
        format="copc" if header.is_copc else "laz" if header.compressed else "las",
        wkt=None if reference.crs is None else reference.crs.to_wkt(),
        units=units or reference.units or Units(),
        point_format=header.point_format,
        scales=tuple(header.scales.tolist()),
        offsets=tuple(header.offsets.tolist()),
        date=header.date,
        identity=header.fingerprint,
    )


def _text_source(place: Path, units: Units | None) -> Source:
    file = kept_text(place)
    xyz = file.xyz[np.isfinite(file.xyz).all(axis=1)]
    if units is None and (problem := not_metric(xyz[sampled(len(xyz))], len(xyz), False)):
        raise InputError(f"{place}: {problem}")
    extent = np.stack([xyz.min(axis=0), xyz.max(axis=0)]) if len(xyz) else np.full((2, 3), math.nan)
    source = _extended(place, len(file.xyz), extent)
    return dataclasses.replace(source, units=units or Units(), identity=file.fingerprint)


def _extended(place: Place, count: int, extent: np.ndarray) -> Source:
    """A source of so many points, of the lowest and highest x, y and z, f64[2, 3]."""
    if not count:
        return Source(str(place), "text", NO_BOUNDS, 0)
    (x0, y0, z0), (x1, y1, z1) = extent.tolist()
    return Source(str(place), "text", (x0, y0, x1, y1), count, (z0, z1))
