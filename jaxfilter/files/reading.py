"""Reading point clouds: LAS, LAZ, COPC and text."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from ..core.cloud import GROUND_CLASS, KEPT_CLASSES, PointCloud
from ..core.errors import InputError, warn
from ..core.inputs import COLUMNS, is_laspy
from ..core.points import canonical_points
from ..core.reading import Reading
from ..core.result import Progress, silent
from ..core.units import (
    GEOKEYS,
    PROJECTION,
    WKT,
    Reference,
    Units,
    linear_units,
    not_metric,
    reference_of,
    sampled,
)
from . import records, text
from .disk import CHANGED_IN_READING, Bounds, Identity, Tally, check_bounds
from .handles import Handle
from .header import Header, opened, read_header
from .records import inside, read_records, reading_errors
from .storage import Place, Remote, place_of
from .writing import LAS_SUFFIXES, Classes, class_changes, write

if TYPE_CHECKING:
    import laspy

__all__ = ["Classes", "class_changes", "info", "read", "write"]

_LARGEST_CRS = 2**20  # bytes


def read(
    path: str | Path | Remote | laspy.LasData,
    *,
    bounds: Iterable[float] | None = None,
    units: str | Units | None = None,
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
        returns, ignore_classes, ignore_overlap, keep_withheld: which points are candidates, see :meth:`PointCloud.select`.
        drop_invalid: label points with NaN or infinite coordinates (text only), or far from all others (docs/conventions.md,
            Range), non-ground instead of raising.
        anchor: (x, y) in file units that all grids count from.
        progress: called with the fraction of a LAS file that was read, and "read".

    Raises: InputError naming file and field: damaged or truncated, not a point cloud, angular or geocentric coordinates,
    scales, units or extents that cannot be true.
    Warns: JaxfilterWarning where something was assumed: no CRS, damaged CRS or extra bytes, odd echoes, no points,
    counts that contradict each other.

    >>> west = jf.read("scene.laz", units="m", bounds=(512000, 5403000, 512030, 5403060))
    >>> 0 < len(west) < len(cloud), float(west.xyz[:, 0].max()) < 30
    (True, True)
    """
    cut = None if bounds is None else check_bounds(bounds)
    reading = Reading(returns, ignore_classes, ignore_overlap, keep_withheld, drop_invalid, units, anchor)
    if is_laspy(path):
        return _laspy_cloud(path, reading, cut)
    path = place_of(path)
    suspect = _refuse if reading.units is None else None
    if is_text(path):
        return _text_cloud(path, reading, cut, suspect)
    file = open_las(path)
    chunks = _records(file.header, cut, progress or silent)
    return las_cloud(file, file.reading(reading), chunks, file.header.count, cut, suspect)


def info(path: str | Path | Remote, *, units: str | Units | None = None) -> dict[str, Any]:
    """What is in a file, for people and for JSON; angular, geocentric and far-off coordinates are no error here.

    Returns: ``path``, ``format``, ``points``, ``crs``, ``units``, ``metres_per_unit`` [XY, Z], ``bounds`` and ``z``
    (file units, to 1 mm), ``scales`` and ``offsets`` (LAS), ``extra_bytes`` (names of extra dimensions), ``classes`` and
    ``echoes`` (counts), ``withheld``, ``overlap``, ``candidates``, and of the candidates ``spacing`` (m) and ``density``
    (per m2 of occupied area). None where a file says nothing.

    >>> facts = jf.info("scene.laz", units="m")
    >>> facts["points"] == len(cloud), facts["format"]
    (True, 'LAZ 1.4, point format 6')
    """
    path = place_of(path)
    reading = Reading(drop_invalid=True, units=units)
    header, reference, suspect = None, Reference(), warn if units is None else None
    if is_text(path):
        cloud = _text_cloud(path, reading, None, suspect)
    else:
        file = open_las(path)
        header, reference = file.header, file.reference
        if units is None and reference.problem is not None:
            reading, suspect = dataclasses.replace(reading, units=Units(1.0, 1.0, reference.shown)), None
        cloud = las_cloud(file, file.reading(reading), _records(header), header.count, None, suspect)
    angular = units is None and reference.problem is not None
    low = high = None
    if len(cloud):
        corners = np.stack([cloud.xyz.min(axis=0), cloud.xyz.max(axis=0)])
        low, high = np.round(dataclasses.replace(cloud, xyz=corners).coordinates(), 3).tolist()
    points = canonical_points(cloud)
    spacing = None if angular or len(points) < 2 else points.spacing()
    return {
        "path": str(path),
        "format": cloud.source.format,
        "points": len(cloud),
        "crs": reference.name,
        "units": str(cloud.units),
        "metres_per_unit": None if angular else [cloud.units.xy, cloud.units.z],
        "bounds": None if low is None or high is None else [*low[:2], *high[:2]],
        "z": None if low is None or high is None else [low[2], high[2]],
        "scales": None if header is None else header.scales.tolist(),
        "offsets": None if header is None else header.offsets.tolist(),
        "extra_bytes": _extra_names(header),
        "classes": _counts(cloud.classification),
        "echoes": _echo_counts(cloud),
        "withheld": None if cloud.withheld is None else int(cloud.withheld.sum()),
        "overlap": None if cloud.in_overlap is None else int(cloud.in_overlap.sum()),
        "candidates": int(cloud.candidate.sum()),
        "spacing": spacing,
        "density": None if spacing is None else 1 / spacing**2,
    }


def _extra_names(header: Header | None) -> list[str] | None:
    found = None if header is None else header.extra_dimensions()
    return None if found is None else [one.name for one in found]


def is_text(path: Place) -> bool:
    """Whether a file is text, not LAS: by suffix, and for other suffixes by the signature of the file.

    Raises: InputError if it is neither, and for text that is not on a local disk.
    """
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

    def reading(self, asked: Reading) -> Reading:
        """How its points are read, with units: those asked for, or of its CRS, or metres with a warning. Raises InputError."""
        units = linear_units(self.reference, cast("Units | None", asked.units), str(self.header.path))
        return dataclasses.replace(asked, units=units)


def open_las(path: Place, tables: bool = True) -> LasFile:
    """The header of a LAS file, see :func:`read_header`, and its CRS. Raises InputError. Warns: as :func:`read`."""
    with reading_errors(path):
        header = read_header(path, tables)
        stated = {}
        with header.open() as file:
            for record in header.vlrs + header.evlrs:
                size = record.end - record.payload
                if record.user == PROJECTION and record.number in (WKT, GEOKEYS) and size <= _LARGEST_CRS:
                    file.seek(record.payload)
                    stated[record.number] = file.read(size)
        for remark in header.remarks():
            warn(f"{path}: {remark}")
        return LasFile(header, reference_of(stated, str(path)))


def _records(header: Header, cut: Bounds | None = None, progress: Progress = silent) -> Iterable[np.ndarray]:
    """The records inside a cut; warns if there are none."""
    found = False
    for number, chunk in enumerate(read_records(header, cut, every_field=False)):
        progress(min(1.0, number * records.CHUNK / max(header.count, 1)), "read")
        found |= len(chunk) > 0
        yield chunk
    if not found:
        _warn_empty(str(header.path), cut)


def _refuse(message: str) -> None:
    raise InputError(message)


def _laspy_cloud(las: Any, reading: Reading, cut: Bounds | None) -> PointCloud:
    if cut is not None:
        las = las[inside(np.stack([las.x, las.y], axis=1), cut)]
    cloud = PointCloud.from_laspy(las, **_fields(reading))
    if not len(cloud):
        _warn_empty("LasData", cut)
    return cloud


def _fields(reading: Reading) -> dict[str, Any]:
    return {field.name: getattr(reading, field.name) for field in dataclasses.fields(reading) if field.name != "bounds"}


def las_cloud(
    file: LasFile,
    reading: Reading,
    chunks: Iterable[np.ndarray],
    most: int,
    cut: Bounds | None = None,
    suspect: Callable[[str], None] | None = None,
) -> PointCloud:
    """The cloud of some records of a file, u8[k, record_length] at a time, ``most`` of them or fewer; ``cut`` says which
    they are. ``suspect`` is told why coordinates cannot be lengths, if so."""
    header, reference = file.header, file.reference
    name, number = str(header.path), header.point_format
    # np.empty takes memory only as it is filled, so little of it where bounds leave few points
    with reading_errors(header.path):
        ticks, n = np.empty((most, 3), np.int32), 0
        columns: dict[str, Any] = {key: np.empty(most, kind) for key, kind in COLUMNS.items()}
    if number < 6:
        del columns["overlap"]
    identity, tally = cast(Identity, header.identity), Tally()
    with identity.kept(header.path, CHANGED_IN_READING):
        for chunk in chunks:
            rows = slice(n, n + len(chunk))
            ticks[rows] = records.integers(chunk)
            tally.add(ticks[rows])
            columns["return_number"][rows], columns["number_of_returns"][rows] = records.echoes(chunk, number)
            columns["classification"][rows] = records.classes(chunk, number)
            columns["withheld"][rows] = records.withheld(chunk, number)
            if number >= 6:
                columns["overlap"][rows] = records.overlap(chunk)
            n = rows.stop
    if n < most:
        ticks, columns = ticks[:n].copy(), {key: column[:n].copy() for key, column in columns.items()}
    if suspect is not None:
        some = ticks[sampled(n)] * header.scales + header.offsets
        if reason := not_metric(some, n, reference.units is not None or cut is not None):
            suspect(f"{name}: {reason}")
    is_ground = columns["classification"] == GROUND_CLASS
    source = Handle(header.path.absolute(), "las", str(header), n, cut, identity, tally.checksum)
    return PointCloud.from_integers(
        ticks,
        header.scales,
        header.offsets,
        reading,
        name=name,
        crs=reference.crs,
        source=source,
        reference=is_ground if is_ground.any() else None,
        **columns,
    )


@dataclasses.dataclass(frozen=True)
class TextFile:
    """Points of a text file: its layout, n coordinates f64[n, 3] in file units, and columns named as those of a cloud."""

    path: Path
    identity: Identity
    layout: text.Layout
    xyz: np.ndarray
    columns: dict[str, np.ndarray]

    @property
    def fingerprint(self) -> str:
        """Changes with the file, wherever it is mounted: a hash of its size, the time of its last change and its points."""
        stated = f"{self.identity.size} {self.identity.modified} {zlib.crc32(self.xyz.data)}"
        return hashlib.sha256(stated.encode()).hexdigest()[:32]

    def part(self, rows: np.ndarray) -> TextFile:
        """Some of the points, bool[n]."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return dataclasses.replace(self, xyz=self.xyz[rows], columns=columns)


def open_text(path: Path, cut: Bounds | None = None, drop_invalid: bool = True) -> TextFile:
    """The points of a text file that are inside a cut. Raises: InputError as :func:`text.read_text`."""
    with reading_errors(path), open(path, "rb") as file:  # held, so that no other file gets the same number meanwhile
        identity = Identity.of(file.fileno())
        with identity.kept(path, CHANGED_IN_READING):
            layout = text.layout_of(path)
            parts = list(text.read_text(path, layout, cut, drop_invalid))
    xyz = np.concatenate([np.zeros((0, 3)), *(points for points, _ in parts)])
    keys = parts[0][1] if parts else ()
    return TextFile(
        path, identity, layout, xyz, {key: np.concatenate([part[key] for _, part in parts]) for key in keys}
    )


def kept_text(path: Path) -> TextFile:
    """All points of a text file. Those of the last file are kept, so that a survey does not parse it for every box."""
    with reading_errors(path):
        return _kept_text(path, Identity.of(path))


@functools.lru_cache(1)
def _kept_text(path: Path, identity: Identity) -> TextFile:
    """``identity`` is that of the file now."""
    return open_text(path)


def text_cloud(
    file: TextFile, reading: Reading, cut: Bounds | None = None, suspect: Callable[[str], None] | None = None
) -> PointCloud:
    """The cloud of a text file; ``cut`` says which points these are. ``suspect``: as in :func:`las_cloud`."""
    xyz, columns, tally = file.xyz, dict(file.columns), Tally()
    if "reference" not in columns and (columns.get("classification", np.zeros(0)) == GROUND_CLASS).any():
        columns["reference"] = columns["classification"] == GROUND_CLASS
    if suspect is not None:
        some = xyz[sampled(len(xyz))]
        some = some[np.isfinite(some).all(axis=1)]
        if reason := not_metric(some, len(xyz), cut is not None):
            suspect(f"{file.path}: {reason}")
    tally.add(xyz)
    source = Handle(file.path.absolute(), "text", str(file.layout), len(xyz), cut, file.identity, tally.checksum)
    if reading.units is None:
        reading = dataclasses.replace(reading, units=Units())
    fields: dict[str, Any] = columns | _fields(reading)
    return PointCloud.from_arrays(xyz, name=str(file.path), source=source, **fields)


def _text_cloud(path: Place, reading: Reading, cut: Bounds | None, suspect: Callable[[str], None] | None) -> PointCloud:
    cloud = text_cloud(open_text(cast(Path, path), cut, reading.drop_invalid), reading, cut, suspect)
    if not len(cloud):
        _warn_empty(str(path), cut)
    return cloud


def _warn_empty(name: str, cut: Bounds | None) -> None:
    where = "" if cut is None else f" within bounds {cut}"
    warn(f"{name}: holds no points{where}")


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
