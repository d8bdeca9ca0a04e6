"""Which points of a cloud are judged, and how its coordinates are understood: one value, made once and handed on whole."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from .errors import InputError
from .frame import checked_anchor
from .inputs import class_numbers
from .units import Reference, Stated, Units, parse_crs, parse_units

Bounds = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax in file units; half open: xmin <= x < xmax, ymin <= y < ymax."""
ECHOES = ("first", "intermediate", "last", "only")
"""Kinds of echoes that can be judged."""


class _KeptClasses(tuple[int, ...]):
    """Short where signatures show it as a default."""

    def __repr__(self) -> str:
        return "(7, 9, 17, 18, ..., 255)"


KEPT_CLASSES = _KeptClasses((7, 9, *range(17, 256)))
"""ASPRS classes that are set aside by default: noise (7, 18), water (9), bridge decks (17), and all above, which producers give
by rules of their own (ignored ground, snow, artefacts). No ground filter sees what they were given for."""


@dataclasses.dataclass(frozen=True)
class Reading:
    """How points are read: the arguments of :func:`jaxfilter.read` that decide on labels.

    Attributes:
        returns: echoes that are judged: ``all``, or some of ``first``, ``intermediate``, ``last`` and ``only``, with commas.
        ignore_classes: points of these classes are not judged and keep their class.
        ignore_overlap: points of the overlap of flight lines are not judged either.
        keep_withheld: points that carry the withheld flag are judged as well.
        drop_invalid: points with NaN or infinite coordinates, or far from all others, become non-ground instead of an error.
        units: of the coordinates; None = what the CRS says, and metres where it says nothing.
        anchor: (x, y) in file units from which all grids count.
        bounds: (xmin, ymin, xmax, ymax) in file units; points of files with xmin <= x < xmax and ymin <= y < ymax are read.
        crs: that of files which state none, as ``pyproj.CRS.from_user_input`` takes it (``"EPSG:25832"``). Outputs state it.
            Nothing is reprojected.
        aoi: the area of interest, of surveys: a vector file (``"area.gpkg"``), a GeoDataFrame, or a polygon in file coordinates.
            Points in it are written; those around it take part, so that they get the labels that they have in the whole.
        drop_duplicates: of surveys: an echo that lies in several LAS files, as in tiles with a buffer, is written into the first
            of them only, or into the first in which it is not withheld. Echoes are the same if X, Y, Z, GPS time, return number
            and point source are equal. Equal points of one file stay. Rasters count such an echo once in any case.

    Raises: InputError for returns, classes, units, a CRS or an anchor that there are not.

    >>> jf.Reading(returns="all", ignore_classes=[7]).ignore_classes
    (7,)
    """

    returns: str = "last,only"
    ignore_classes: Iterable[int] = KEPT_CLASSES
    ignore_overlap: bool = False
    keep_withheld: bool = False
    drop_invalid: bool = False
    units: str | Units | None = None
    anchor: Iterable[float] = (0.0, 0.0)
    bounds: Bounds | None = None
    crs: Any = None
    aoi: Any = None
    drop_duplicates: bool = False

    def __post_init__(self) -> None:
        words = self.returns.lower().split(",") if isinstance(self.returns, str) else []
        wanted = {word.strip() for word in words} - {""}
        if not wanted or wanted - {*ECHOES, "all"}:
            known = ", ".join(ECHOES)
            raise InputError(f"returns={self.returns!r}: use a text that lists some of {known}, with commas, or 'all'")
        checked: dict[str, Any] = {
            "returns": ",".join(sorted(wanted)),
            "ignore_classes": class_numbers(self.ignore_classes),
            "units": None if self.units is None else parse_units(self.units),
            "anchor": tuple(checked_anchor(self.anchor).tolist()),
        }
        if (crs := parse_crs(self.crs)) is not None:
            checked["crs"] = crs.to_string()
            if (problem := Stated(checked["units"], crs).of(Reference(), "crs").problem) is not None:
                raise InputError(f"crs={checked['crs']!r}: {problem}")
        if self.bounds is not None:
            checked["bounds"] = check_bounds(self.bounds)
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def stated(self) -> Stated:
        """Units and CRS as far as they are given."""
        return Stated(None if self.units is None else parse_units(self.units), parse_crs(self.crs))

    @property
    def metres(self) -> Units:
        """The units, of the given CRS if there is one, and metres where nothing is given."""
        return self.stated.of(Reference(), "points").units or Units()

    def of_points(self) -> dict[str, Any]:
        """The fields that do not choose points of a file, by name: arguments of ``PointCloud.from_arrays``."""
        names = (field.name for field in dataclasses.fields(self))
        return {name: getattr(self, name) for name in names if name not in ("bounds", "aoi", "drop_duplicates")}


def inside(xy: np.ndarray, bounds: Bounds) -> np.ndarray:
    """bool[n]: which f64[n, >=2] lie in the half-open ``bounds``."""
    x, y = xy[:, 0], xy[:, 1]
    return (x >= bounds[0]) & (x < bounds[2]) & (y >= bounds[1]) & (y < bounds[3])


def check_bounds(bounds: object) -> Bounds:
    """Four finite numbers that enclose an area. Raises InputError."""
    try:
        x0, y0, x1, y1 = (float(v) for v in bounds)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"bounds={bounds!r}: four numbers (xmin, ymin, xmax, ymax) are needed") from error
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"bounds={bounds!r}: xmin < xmax and ymin < ymax are needed")
    return x0, y0, x1, y1
