"""A file of point clouds as its header describes it: small, picklable, and enough to plan with."""

from __future__ import annotations

import dataclasses
import functools
import math

import pyproj

from ..core.units import UNITS, Reference, Units
from .disk import Bounds
from .header import Header
from .storage import Place, place_of

NO_BOUNDS: Bounds = (math.nan,) * 4  # type: ignore[assignment]
"""The bounds of a file without points."""


@dataclasses.dataclass(frozen=True, slots=True)
class Source:
    """A LAS, LAZ or COPC file.

    Attributes:
        uri: absolute path, or URI.
        format: ``"las"``, ``"laz"`` or ``"copc"``.
        bounds: xmin, ymin, xmax, ymax that the header states, file coordinates, **closed** on all sides; NaN for a file
            without points.
        z: lowest and highest Z that the header states, file coordinates.
        count: number of points.
        wkt: its CRS as WKT, or None; see ``crs``.
        units: metres per file unit.
        point_format, scales, offsets: as in the header; None for a member of a ``.vpc`` whose header was not read.
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


def described(uri: str, header: Header, reference: Reference, units: Units) -> Source:
    """The source of a header that was read."""
    low, high = (v.tolist() for v in header.extent)
    kind = "copc" if header.is_copc else "laz" if header.compressed else "las"
    scales, offsets = (tuple(v.tolist()) for v in (header.scales, header.offsets))
    return Source(
        uri,
        kind,
        (low[0], low[1], high[0], high[1]) if header.count else NO_BOUNDS,
        header.count,
        (low[2], high[2]) if header.count else (math.nan, math.nan),
        None if reference.crs is None else reference.crs.to_wkt(),
        units,
        header.point_format,
        scales,
        offsets,
        header.date,
        header.fingerprint,
    )
