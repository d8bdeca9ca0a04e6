"""PointCloud: what every reader makes, every filter takes and every writer needs."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from .echoes import echo_mask, numbering, renumbered
from .errors import InputError, warn
from .frame import QUANTUM as QUANTUM
from .frame import Coordinates, check_scales
from .inputs import COLUMN_TYPES, as_column, is_laspy, is_structured, laspy_parts, numbers, structured_parts
from .inputs import GROUND_CLASS as GROUND_CLASS
from .reading import KEPT_CLASSES as KEPT_CLASSES
from .reading import Reading
from .units import NAMED_UNITS, Units, parse_crs

OVERLAP_CLASS = 12
"""ASPRS class of points in the overlap of flight lines, up to LAS 1.3."""


@dataclasses.dataclass(frozen=True)
class Whole:
    """What methods ask of the whole scene, for a cloud that is a part of it: all parts are then filtered alike.

    Attributes:
        spacing: mean point spacing of the candidates, metres; None = each part has its own.
        lowest: elevation of the lowest point that a method lets count (CSF), file units; None likewise.
        rounds: of growth on each of STIN's grids, and with the suspected outliers; None likewise.
        scatter: metres, standard deviation of the vertices of OST from the plane of their neighbours; None likewise.
    """

    spacing: float | None = None
    lowest: float | None = None
    rounds: tuple[int, ...] | None = None
    scatter: float | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class PointCloud:
    """Points in a local metric frame, with what lidar files say about them. All arrays have length n, in input order.

    Attributes:
        origin: f64[3], file units; local metres = (file coordinate - origin) * units, quantised to :data:`QUANTUM`.
        xyz: f32[n, 3], metres in the local frame. Rows of invalid points (see ``valid``) are zero.
        return_number, number_of_returns: u8[n] or None where the format has none. Numbers that count from 0 are one more here,
            and they are None where they are not filled in, or count from the last echo.
        classification: u8[n] ASPRS classes as read, or None.
        withheld, overlap: bool[n] or None; the LAS flags. Point formats below 6 have class 12 instead of the second.
        candidate: bool[n]; the points that a filter may call ground. Others are non-ground and are written unchanged.
        reference: bool[n] or None; True = ground, from a labelled text file or from class 2 of a classified LAS file.
        valid: bool[n] or None; False where a coordinate was NaN, infinite or far off (only with ``drop_invalid=True``).
        crs: pyproj.CRS or None; whatever ``pyproj.CRS.from_user_input`` takes becomes one.
        units: metres per file unit.
        anchor: f64[2], file coordinates that all grids count from; zero by default, so that clouds of one CRS share grids.
        source: a handle to the file (see ``jaxfilter.files.points``), used by lossless writing; None for plain arrays.
        whole: the scene that the cloud is a part of; None = it is a scene of its own.
        core: (xmin, ymin, xmax, ymax), file coordinates, of a part of a scene: labels are asked for inside only, and methods may
            leave out work that does not reach there. None = everywhere.

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
    overlap: np.ndarray | None = None
    candidate: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, bool))
    reference: np.ndarray | None = None
    valid: np.ndarray | None = None
    crs: Any = None
    units: Units = NAMED_UNITS["m"]
    anchor: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(2))
    source: Any = None
    whole: Whole | None = None
    core: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "crs", parse_crs(self.crs))

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"PointCloud({len(self)} points, {int(self.candidate.sum())} candidates, origin {self.origin.tolist()})"

    @classmethod
    def from_arrays(
        cls,
        xyz: np.ndarray,
        *,
        units: str | Units | None = "m",
        anchor: Iterable[float] = (0.0, 0.0),
        drop_invalid: bool = False,
        name: str = "xyz",
        returns: str = "last,only",
        ignore_classes: Iterable[int] = KEPT_CLASSES,
        ignore_overlap: bool = False,
        keep_withheld: bool = False,
        **attributes: Any,
    ) -> PointCloud:
        """Make a cloud from coordinates in file units, f64[n, 3].

        ``attributes``, named as the class's fields, are arrays of length n: ``return_number``, ``number_of_returns``,
        ``classification``, ``withheld``, ``overlap``, ``reference`` and ``candidate``; and ``crs``. The other arguments are the
        fields of :class:`jaxfilter.Reading`; those that choose the candidates do not count if ``candidate`` is given. ``name``
        stands in error messages for where the numbers came from.

        Raises: InputError for a wrong shape, attribute or attribute length, and for coordinates so large that float64 does
        not resolve :data:`QUANTUM`; for NaN, infinite and masked coordinates, and for an extent above :data:`LARGEST_SPAN`,
        unless ``drop_invalid``: then points that are not numbers, or lie farther than half of that from the median of a
        coordinate, become non-ground, and a warning gives their number. Warns: of coordinates in float32 that are too
        large for it.

        >>> xyz = [[512000.0, 5403000.0, 350.0], [512001.0, 5403002.0, 350.5]]
        >>> made = jf.PointCloud.from_arrays(np.array(xyz), classification=np.array([2, 6], np.uint8))
        >>> made.xyz.tolist()
        [[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]]
        """
        reading = Reading(returns, ignore_classes, ignore_overlap, keep_withheld, drop_invalid, units, anchor)
        given = numbers(xyz, f"{name}: coordinates")
        if given.ndim != 2 or given.shape[1] != 3:
            raise InputError(f"{name}: coordinates must have shape (n, 3), not {given.shape}")
        xyz = np.ma.filled(given.astype(np.float64, copy=False), np.nan)
        finite, valid = np.isfinite(xyz).all(axis=1), None
        if not finite.all():
            bad = int(len(xyz) - finite.sum())
            odd = "NaN, infinite or masked" if np.ma.is_masked(given) else "NaN or infinite"
            if not drop_invalid:
                advice = "remove them, or pass drop_invalid=True to label them non-ground"
                raise InputError(f"{name}: {bad} of {len(xyz)} points have {odd} coordinates; {advice}")
            warn(f"{name}: {bad} points with {odd} coordinates are labelled non-ground")
            valid = finite
            xyz = np.where(finite[:, None], xyz, np.nan)
        places = Coordinates(xyz, np.empty(xyz.shape, np.float32), kind=given.dtype)
        return cls._assembled(places, valid, reading, name, attributes)

    @classmethod
    def from_integers(
        cls,
        ticks: np.ndarray,
        scales: np.ndarray,
        offsets: np.ndarray,
        reading: Reading = Reading(),  # noqa: B008
        *,
        name: str = "xyz",
        **columns: Any,
    ) -> PointCloud:
        """The cloud of ``from_arrays(ticks * scales + offsets)``, bit for bit, without its float64 coordinates. ``ticks``,
        i32[n, 3], is C-contiguous and is **used up**: its memory becomes the cloud's ``xyz``. ``scales`` (see
        :func:`check_scales`) and ``offsets`` are f64[3], file units, as in a LAS header. ``columns`` are the attributes of
        :meth:`from_arrays`. Raises: InputError likewise."""
        check_scales(scales, offsets, name)
        if ticks.dtype != np.int32 or ticks.shape[1:] != (3,) or not ticks.flags.c_contiguous:
            raise InputError(f"{name}: ticks must be int32[n, 3], C-contiguous, not {ticks.dtype}{list(ticks.shape)}")
        return cls._assembled(Coordinates(ticks, ticks.view(np.float32), scales, offsets), None, reading, name, columns)

    @classmethod
    def from_laspy(
        cls, las: Any, *, units: str | Units | None = None, name: str = "LasData", **options: Any
    ) -> PointCloud:
        """Make a cloud from a ``laspy.LasData`` as from the file it would be written to, see :func:`jaxfilter.read`.

        ``units`` are by default those of its CRS; ``options`` are the other fields of :class:`jaxfilter.Reading`. Class 2
        becomes the reference. To keep all that the points hold, give labels back to laspy:
        ``las.classification[result.ground] = 2``.

        Raises: InputError as :meth:`from_arrays`, and where X and Y are angles. Warns: as :func:`jaxfilter.read`.

        >>> import laspy
        >>> made = jf.PointCloud.from_laspy(laspy.read("scene.laz"), units="m")
        >>> len(made) == len(cloud), bool((made.reference == truth).all())
        (True, True)
        """
        reading = Reading(units=units, **options)
        scale, placed, columns = laspy_parts(las, reading.stated, name)
        return cls.from_integers(*placed, dataclasses.replace(reading, units=scale), name=name, **columns)

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
        return cls.from_arrays(**{"units": units, "name": name, **structured_parts(points, name), **options})

    @classmethod
    def _assembled(
        cls, places: Coordinates, valid: np.ndarray | None, reading: Reading, name: str, attributes: dict[str, Any]
    ) -> PointCloud:
        units, local = reading.metres, places.local
        origin, valid = places.place(valid, units, reading.anchor, name, reading.drop_invalid)
        arrays, numbered = (*COLUMN_TYPES, "reference", "candidate"), attributes.pop("numbering", None)
        for key, value in attributes.items():
            if key in arrays and value is not None:
                attributes[key] = as_column(key, value, name, len(local))
            elif key not in (*arrays, "crs", "source", "whole"):
                raise InputError(f"{name}: {key}= is no attribute of points; there are {', '.join(arrays)} and crs")
        how = numbering(attributes, local[:, 2]) if numbered is None else numbered
        attributes["return_number"] = renumbered(attributes, how, name)
        candidate = attributes.pop("candidate", None)
        cloud = cls(origin, local, units=units, anchor=np.array(reading.anchor), valid=valid, **attributes)
        if candidate is None:
            candidate = cloud._candidates(reading, name)
        elif valid is not None:
            candidate = candidate & valid
        return dataclasses.replace(cloud, candidate=candidate)

    def select(
        self,
        *,
        returns: str = "last,only",
        ignore_classes: Iterable[int] = KEPT_CLASSES,
        ignore_overlap: bool = False,
        keep_withheld: bool = False,
    ) -> PointCloud:
        """A cloud whose candidates are chosen anew, by fields of :class:`jaxfilter.Reading`; the arrays are shared. Raises:
        InputError for returns and classes that there are not.

        >>> everything = cloud.select(returns="all", ignore_classes=())
        >>> bool(everything.candidate.all()), bool(cloud.candidate.all())
        (True, False)
        """
        reading = Reading(returns, ignore_classes, ignore_overlap, keep_withheld)
        return dataclasses.replace(self, candidate=self._candidates(reading, "cloud"))

    def _candidates(self, reading: Reading, name: str) -> np.ndarray:
        """bool[n]: the points that are judged."""
        candidate = echo_mask(self.return_number, self.number_of_returns, reading.returns, len(self), name)
        if self.valid is not None:
            candidate &= self.valid
        if self.classification is not None and reading.ignore_classes:
            candidate &= ~np.isin(self.classification, tuple(reading.ignore_classes))
        if reading.ignore_overlap and self.in_overlap is not None:
            candidate &= ~self.in_overlap
        if self.withheld is not None and not reading.keep_withheld:
            candidate &= ~self.withheld
        return candidate

    @property
    def in_overlap(self) -> np.ndarray | None:
        """bool[n]: points that the producer has marked as overlap of flight lines, by the flag or by class 12, which stood for
        it before LAS 1.4; None if the cloud has neither flag nor class."""
        marks = [] if self.overlap is None else [self.overlap]
        marks += [] if self.classification is None else [self.classification == OVERLAP_CLASS]
        return np.logical_or.reduce(marks) if marks else None

    def digest(self, *more: np.ndarray) -> str:
        """32 hexadecimal digits by which the cloud is known again: a hash of all that filters read of it, and of ``more`` arrays.

        That is coordinates, units, anchor, candidates and numbers of returns; reference, classes and file do not count. Points in
        another order have another digest, since results are in the order of their cloud. It is computed at each call.

        >>> same = jf.PointCloud.from_arrays(cloud.coordinates(), candidate=cloud.candidate)
        >>> same.digest() == jf.PointCloud.from_arrays(cloud.coordinates(), candidate=cloud.candidate).digest()
        True
        >>> same.digest() == same.select(returns="all").digest()
        False
        """
        found = hashlib.blake2b(repr((self.units, self.whole, self.core)).encode(), digest_size=16)
        own = self.origin, self.anchor, self.xyz, self.candidate, self.valid, self.number_of_returns
        for array in (*own, *more):
            found.update(b"" if array is None else np.ascontiguousarray(array).data)
            found.update(b"|")
        return found.hexdigest()

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units, rounded to the quantum of the local frame (the file's own integers stay in the file)."""
        return self.origin + self.xyz.astype(np.float64) / self.units.factor

    def grid_offset(self, cell: float) -> tuple[float, float]:
        """Local x, y in metres (each in (-cell, 0]) of the grid corner for cells of this size, which count from the anchor."""
        lag = (self.origin[:2] - self.anchor) * self.units.xy
        return tuple(float(-(v - np.floor(v / cell + 1e-9) * cell)) for v in lag)  # type: ignore[return-value]


def as_cloud(points: Any) -> PointCloud:
    """A PointCloud as it is; a ``laspy.LasData`` as its file; a structured array, or what has attributes x, y and z, by its
    names; anything else as coordinates f64[n, 3]. Arrays are in metres."""
    if isinstance(points, PointCloud):
        return points
    if is_laspy(points):
        return PointCloud.from_laspy(points)
    if isinstance(points, (str, os.PathLike)):
        name = os.fspath(points)
        raise InputError(f"{name}: is the name of a file, and points are needed: pass jaxfilter.read({name!r})")
    return PointCloud.from_structured(points) if is_structured(points) else PointCloud.from_arrays(points)
