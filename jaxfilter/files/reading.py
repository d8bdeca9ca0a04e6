"""Reading point clouds: LAS, LAZ, COPC and text."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..core.cloud import GROUND_CLASS, KEPT_CLASSES, PointCloud
from ..core.echoes import Numbering, numbering
from ..core.errors import InputError, warn
from ..core.frame import ends
from ..core.inputs import COLUMNS, is_laspy
from ..core.points import canonical_points
from ..core.reading import Reading
from ..core.result import Progress, silent
from ..core.units import STATED, Reference, Units, linear_units, not_metric, reference_of, sampled
from . import records, text
from .classes import Classes, class_changes
from .disk import CHANGED_IN_READING, Bounds, Identity, Tally
from .handles import Handle
from .header import Header, opened, read_header
from .records import inside, read_records, reading_errors
from .storage import Place, Remote, place_of
from .writing import LAS_SUFFIXES, write

if TYPE_CHECKING:
    import laspy

__all__ = ["Classes", "class_changes", "info", "read", "write"]

_LARGEST_CRS = 2**20  # bytes
_OF_FILES = ("bounds", "aoi", "drop_duplicates")  # fields of Reading that say which points of a file are read


def read(
    path: str | Path | Remote | laspy.LasData,
    *,
    bounds: Iterable[float] | None = None,
    units: str | Units | None = None,
    crs: Any = None,
    returns: str = "last,only",
    ignore_classes: Iterable[int] = KEPT_CLASSES,
    ignore_overlap: bool = False,
    keep_withheld: bool = False,
    drop_invalid: bool = False,
    anchor: Iterable[float] = (0.0, 0.0),
    progress: Progress | None = None,
) -> PointCloud:
    """Read a point cloud: LAS 1.0 to 1.4 and LAZ of every point format, COPC, or text.

    Text has lines of x y z, or x y z label as in the ISPRS samples (0 = ground, 1 = object), separated by white space,
    commas, semicolons or, below a header, tabs; with a header line, columns are found by their names (x, y, z, label,
    classification, return_number, number_of_returns, withheld, overlap) and others are passed over. All lines have the same
    number of cells, quoted where they hold a delimiter, and ``#`` begins lines of comment. The reference of a LAS file is
    its class 2.

    Args:
        path: the file; LAS, LAZ and COPC may also lie where fsspec gets at them (``"s3://..."``, ``"https://..."``). It is
            needed again for lossless writing; the cloud keeps a handle, not a copy. A ``laspy.LasData`` is taken as
            the file it would become. What ``write`` makes of such a cloud is a new file, which holds coordinates, echoes,
            flags (withheld, overlap) and classes only; to keep all else, give the labels to laspy:
            ``las.classification[result.ground] = 2``.
        bounds: (xmin, ymin, xmax, ymax) in file units; points with xmin <= x < xmax and ymin <= y < ymax are kept, so
            that adjoining bounds share no point. COPC reads only the octree nodes concerned.
        units: ``"m"``, ``"ft"``, ``"us-ft"``, or XY and Z apart (``"us-ft,m"``); by default what the CRS says. Where
            it says nothing of Z, Z has the unit of XY. Text is in metres unless told otherwise. Units that are given
            are believed; without them, coordinates that look like degrees are refused.
        crs: that of a file which states none, as ``pyproj.CRS.from_user_input`` takes it (``"EPSG:25832"``). Outputs state it.
            Nothing is reprojected.
        returns, ignore_classes, ignore_overlap, keep_withheld: which points are candidates, see :meth:`PointCloud.select`.
        drop_invalid: label points with NaN or infinite coordinates (text only), or far from all others (docs/conventions.md,
            Range), non-ground instead of raising.
        anchor: (x, y) in file units that all grids count from.
        progress: called with the fraction of a LAS file that was read, and "read".

    Raises: InputError naming file and field: damaged or truncated, not a point cloud, angular or geocentric coordinates,
    scales, units or extents that cannot be true, another CRS than ``crs``.
    Warns: JaxfilterWarning where something was assumed: no CRS, damaged CRS or extra bytes, odd echoes, no points,
    counts that contradict each other.

    >>> west = jf.read("scene.laz", units="m", bounds=(512000, 5403000, 512030, 5403060))
    >>> 0 < len(west) < len(cloud), float(west.xyz[:, 0].max()) < 30
    (True, True)
    """
    box: Any = bounds
    reading = Reading(returns, ignore_classes, ignore_overlap, keep_withheld, drop_invalid, units, anchor, box, crs)
    cut = reading.bounds
    if is_laspy(path):
        las: Any = path
        if cut is not None:
            las = las[inside(np.stack([las.x, las.y], axis=1), cut)]
        return _warn_if_empty("LasData", PointCloud.from_laspy(las, **_fields(reading)), cut)
    place = place_of(path)
    return _warn_if_empty(place, _opened(place, reading).cloud(reading, progress or silent), cut)


def info(path: str | Path | Remote, *, units: str | Units | None = None, crs: Any = None) -> dict[str, Any]:
    """What is in a file, for people and for JSON; angular, geocentric and far-off coordinates are no error here.

    ``units``, ``crs``: as of :func:`read`.

    Returns: ``path``, ``format``, ``points``, ``crs``, ``units``, ``metres_per_unit`` [XY, Z], ``bounds`` and ``z``
    (file units, to 1 mm), ``scales`` and ``offsets`` (LAS), ``extra_bytes`` (names of extra dimensions), ``classes`` and
    ``echoes`` (counts), ``withheld``, ``overlap``, ``candidates``, and of the candidates ``spacing`` (m) and ``density``
    (per m2 of occupied area). None where a file says nothing.

    >>> facts = jf.info("scene.laz", units="m")
    >>> facts["points"] == len(cloud), facts["format"]
    (True, 'LAZ 1.4, point format 6')
    """
    place, reading = place_of(path), Reading(drop_invalid=True, units=units, crs=crs)
    file = _opened(place, reading)
    header, reference = (file.header, file.reference) if isinstance(file, LasFile) else (None, Reference())
    reference = reading.stated.of(reference, str(place))
    if angular := reference.problem is not None:
        reading = dataclasses.replace(reading, units=Units(1.0, 1.0, reference.shown))
    cloud = _warn_if_empty(place, file.cloud(reading, strict=False), None)
    corners = None
    if len(cloud):
        corners = np.round(dataclasses.replace(cloud, xyz=np.stack(ends(cloud.xyz))).coordinates(), 3)
    points = canonical_points(cloud)
    extra = None if header is None else header.extra_dimensions()
    spacing = None if angular or len(points) < 2 else points.spacing()
    return {
        "path": str(place),
        "format": cloud.source.format,
        "points": len(cloud),
        "crs": None if reference.crs is None else reference.crs.name,
        "units": str(cloud.units),
        "metres_per_unit": None if angular else [cloud.units.xy, cloud.units.z],
        "bounds": None if corners is None else corners[:, :2].ravel().tolist(),
        "z": None if corners is None else corners[:, 2].tolist(),
        "scales": None if header is None else header.scales.tolist(),
        "offsets": None if header is None else header.offsets.tolist(),
        "extra_bytes": None if extra is None else [dimension.name for dimension in extra],
        "classes": _counts(cloud.classification),
        "echoes": _echo_counts(cloud),
        "withheld": None if cloud.withheld is None else int(cloud.withheld.sum()),
        "overlap": None if cloud.in_overlap is None else int(cloud.in_overlap.sum()),
        "candidates": int(cloud.candidate.sum()),
        "spacing": spacing,
        "density": None if spacing is None else 1 / spacing**2,
    }


def is_text(path: Place) -> bool:
    """Whether a file is text, not LAS: by suffix, and for other suffixes by the signature of the file. Raises: InputError if
    it is neither, and for text that is not on a local disk."""
    suffix = path.suffix.lower()
    if suffix in LAS_SUFFIXES:
        return False
    if isinstance(path, Remote) and suffix in text.SUFFIXES:
        raise InputError(f"{path}: text is read from local disks only; copy it there, or convert it to LAZ")
    with reading_errors(path), opened(path) as (file, _):
        if file.read(4) == b"LASF":
            return False
    if suffix in text.SUFFIXES:
        return True
    raise InputError(f"{path}: neither LAS nor one of {', '.join(text.SUFFIXES)}; give text one of these suffixes")


@dataclasses.dataclass(frozen=True)
class LasFile:
    """The header of a LAS file, and what it says of its coordinates."""

    header: Header
    reference: Reference

    @functools.cached_property
    def numbering(self) -> Numbering:
        """How the echoes are numbered, by a sample of all records: it is the same for every part of the file."""
        try:
            some = records.sampled_records(self.header)
        except InputError:  # what is damaged is an error where it is needed
            return Numbering.SOUND
        kind = self.header.point_format
        return numbering(records.attributes(some, kind), records.integers(some)[:, 2], records.times(some, kind))

    def cloud(
        self,
        reading: Reading,
        progress: Progress = silent,
        *,
        strict: bool = True,
        chunks: Iterable[np.ndarray] | None = None,
        most: int | None = None,
    ) -> PointCloud:
        """The points inside ``reading.bounds``, in the units asked for, or of the CRS, or in metres with a warning.

        Args:
            strict: coordinates that cannot be lengths are an error, not a warning, where no units are asked for.
            chunks: the records of these points, u8[k, record_length] at a time; by default they are read. ``most``: there are
                as many or fewer.

        Raises: InputError.
        """
        header = self.header
        path, scales, offsets = header.path, header.scales, header.offsets
        reference = reading.stated.of(self.reference, str(path))
        units = linear_units(reference, str(path))
        most = header.count if most is None else most
        if chunks is None:
            chunks = (chunk for chunk, _ in read_records(header, reading.bounds, every_field=False))
        with reading_errors(path):  # memory is taken as arrays fill, so little where bounds leave few points
            ticks, n = np.empty((most, 3), np.int32), 0
            named = [name for name in COLUMNS if header.point_format >= 6 or name != "overlap"]
            columns: dict[str, Any] = {name: np.empty(most, COLUMNS[name]) for name in named}
        identity, tally = cast(Identity, header.identity), Tally()
        with identity.kept(path, CHANGED_IN_READING):
            for number, chunk in enumerate(chunks):
                progress(min(1.0, number * records.CHUNK / max(header.count, 1)), "read")
                rows = slice(n, n + len(chunk))
                ticks[rows] = records.integers(chunk)
                tally.add(ticks[rows])
                for name, values in records.attributes(chunk, header.point_format).items():
                    columns[name][rows] = values
                n = rows.stop
        if n < most:
            ticks, columns = ticks[:n].copy(), {name: column[:n].copy() for name, column in columns.items()}
        stated = reference.units is not None or reading.bounds is not None
        if reading.units is None:
            _check_lengths(path, ticks[sampled(n)] * scales + offsets, n, stated, strict)
        is_ground = columns["classification"] == GROUND_CLASS
        return PointCloud.from_integers(
            ticks,
            scales,
            offsets,
            dataclasses.replace(reading, units=units),
            name=str(path),
            crs=reference.crs,
            source=Handle(path.absolute(), "las", str(header), n, reading.bounds, identity, tally.checksum),
            reference=is_ground if is_ground.any() else None,
            numbering=self.numbering if n else Numbering.SOUND,
            **columns,
        )


def open_las(path: Place, tables: bool = True) -> LasFile:
    """The header of a LAS file, see :func:`read_header`, and its CRS. Raises InputError. Warns: as :func:`read`."""
    with reading_errors(path):
        header = read_header(path, tables)
        stated = {}
        with header.open() as file:
            for record in header.vlrs + header.evlrs:
                size = record.end - record.payload
                if record.key in STATED and size <= _LARGEST_CRS:
                    file.seek(record.payload)
                    stated[record.key[1]] = file.read(size)
        for remark in header.remarks():
            warn(f"{path}: {remark}")
        return LasFile(header, reference_of(stated, str(path)))


@dataclasses.dataclass(frozen=True)
class TextFile:
    """Points of a text file: its layout, n coordinates f64[n, 3] in file units, and columns named as those of a cloud."""

    path: Path
    identity: Identity
    layout: text.Layout
    xyz: np.ndarray
    columns: dict[str, np.ndarray]
    numbering: Numbering

    @property
    def fingerprint(self) -> str:
        """Changes with the file, wherever it is mounted: a hash of its size, the time of its last change and its points."""
        stated = f"{self.identity.size} {self.identity.modified} {zlib.crc32(self.xyz.data)}"
        return hashlib.sha256(stated.encode()).hexdigest()[:32]

    def part(self, rows: np.ndarray) -> TextFile:
        """Some of the points, bool[n]."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return dataclasses.replace(self, xyz=self.xyz[rows], columns=columns)

    def cloud(self, reading: Reading, progress: Progress = silent, *, strict: bool = True) -> PointCloud:
        """The points, which are those inside ``reading.bounds``; ``strict``: as of :class:`LasFile`."""
        xyz, columns, tally = self.xyz, dict(self.columns), Tally()
        is_ground = columns.get("classification", np.zeros(0)) == GROUND_CLASS
        if "reference" not in columns and is_ground.any():
            columns["reference"] = is_ground
        if reading.units is None:
            some = xyz[sampled(len(xyz))]
            some = some[np.isfinite(some).all(axis=1)]
            _check_lengths(self.path, some, len(xyz), reading.bounds is not None, strict)
        tally.add(xyz)
        source = Handle(
            self.path.absolute(), "text", str(self.layout), len(xyz), reading.bounds, self.identity, tally.checksum
        )
        fields: dict[str, Any] = columns | _fields(reading) | {"units": reading.metres, "numbering": self.numbering}
        return PointCloud.from_arrays(xyz, name=str(self.path), source=source, **fields)


def open_text(path: Path, bounds: Bounds | None = None, drop_invalid: bool = True) -> TextFile:
    """The points of a text file that are inside bounds. Raises: InputError as :func:`text.read_text`."""
    with reading_errors(path), open(path, "rb") as file:  # held, so that no other file gets the same number meanwhile
        identity = Identity.of(file.fileno())
        with identity.kept(path, CHANGED_IN_READING):
            layout = text.layout_of(path)
            parts = list(text.read_text(layout, bounds, drop_invalid))
    xyz = np.concatenate([np.zeros((0, 3)), *(points for points, _ in parts)])
    columns = {key: np.concatenate([part[key] for _, part in parts]) for key in (parts[0][1] if parts else ())}
    if bounds is not None and "return_number" in columns:
        how = kept_text(path).numbering
    else:
        how = numbering(columns, xyz[:, 2])
    return TextFile(path, identity, layout, xyz, columns, how)


def kept_text(path: Path) -> TextFile:
    """All points of a text file. Those of the last file are kept, so that a survey does not parse it for every box."""
    with reading_errors(path):
        return _kept_text(path, Identity.of(path))


@functools.lru_cache(1)
def _kept_text(path: Path, identity: Identity) -> TextFile:
    """``identity`` is that of the file now."""
    return open_text(path)


def _opened(place: Place, reading: Reading) -> LasFile | TextFile:
    return open_text(cast(Path, place), reading.bounds, reading.drop_invalid) if is_text(place) else open_las(place)


def _fields(reading: Reading) -> dict[str, Any]:
    names = (field.name for field in dataclasses.fields(reading))
    return {name: getattr(reading, name) for name in names if name not in _OF_FILES}


def _check_lengths(path: Place, some: np.ndarray, n: int, stated: bool, strict: bool) -> None:
    """Raises: InputError if some coordinates out of n cannot be lengths; unless ``strict``, that is a warning."""
    if reason := not_metric(some, n, stated):
        if strict:
            raise InputError(f"{path}: {reason}")
        warn(f"{path}: {reason}")


def _warn_if_empty(name: object, cloud: PointCloud, bounds: Bounds | None) -> PointCloud:
    """The cloud, with a warning if it has no points."""
    if not len(cloud):
        warn(f"{name}: holds no points" + ("" if bounds is None else f" within bounds {bounds}"))
    return cloud


def _counts(values: np.ndarray | None) -> dict[int, int] | None:
    if values is None:
        return None
    counts = np.bincount(values, minlength=1)
    return {int(value): int(counts[value]) for value in np.flatnonzero(counts)}


def _echo_counts(cloud: PointCloud) -> dict[str, int] | None:
    number, total = cloud.return_number, cloud.number_of_returns
    if number is None or total is None:
        return None
    several = total > 1
    kinds = {
        "only": (total == 1) & (number == 1),
        "first": several & (number == 1),
        "intermediate": several & (number > 1) & (number < total),
        "last": several & (number == total),
    }
    counts = {name: int(mask.sum()) for name, mask in kinds.items()}
    return {**counts, "odd": len(cloud) - sum(counts.values())}
