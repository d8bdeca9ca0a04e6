"""Reading point clouds: LAS, LAZ, COPC and text."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from laspy import DecompressionSelection

from ..core.cloud import GROUND_CLASS, KEPT_CLASSES, PointCloud
from ..core.echoes import Numbering, numbering, sample
from ..core.errors import InputError, warn
from ..core.inputs import COLUMN_TYPES, is_laspy
from ..core.reading import Bounds, Reading, inside
from ..core.result import Progress, silent
from ..core.units import CRS_RECORDS, Reference, Units, check_lengths, linear_units, reference_of, sampled
from .classes import Classes, class_changes
from .disk import identify, opened
from .guard import check_chunks, read_header, reading_errors
from .header import Header
from .points import (
    ALL,
    CLOUD,
    POINTS_AT_ONCE,
    Handle,
    Points,
    Runs,
    attributes,
    integers,
    measure,
    nodes,
    read_points,
    sample_points,
)
from .storage import Place, Remote, place_of
from .text import TEXT_SUFFIXES, TextFile, open_text
from .writing import LAS_SUFFIXES, write

if TYPE_CHECKING:
    import laspy

__all__ = ["Classes", "class_changes", "read", "write"]

_LARGEST_CRS = 2**20  # bytes
FARTHEST = 1e12
"""Units from zero that no coordinate reaches: the Earth in millimetres is smaller."""


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
    """Read a point cloud: LAS 1.0 to 1.5 and LAZ of every point format, COPC, or text.

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
        return warn_if_empty("LasData", PointCloud.from_laspy(las, **reading.of_points()), cut)
    place = place_of(path)
    file = open_points(place, reading)
    cloud = file.cloud(reading) if isinstance(file, TextFile) else file.cloud(reading, progress or silent)
    return warn_if_empty(place, cloud, cut)


def is_text(path: Place) -> bool:
    """Whether a file is text, not LAS: by suffix, and for other suffixes by the signature of the file. Raises: InputError if
    it is neither, and for text that is not on a local disk."""
    suffix = path.suffix.lower()
    if suffix in LAS_SUFFIXES:
        return False
    if isinstance(path, Remote) and suffix in TEXT_SUFFIXES:
        raise InputError(f"{path}: text is read from local disks only; copy it there, or convert it to LAZ")
    with reading_errors(path), opened(path) as (file, _):
        if file.read(4) == b"LASF":
            return False
    if suffix in TEXT_SUFFIXES:
        return True
    raise InputError(f"{path}: neither LAS nor one of {', '.join(TEXT_SUFFIXES)}; give text one of these suffixes")


@dataclasses.dataclass(frozen=True)
class LasFile:
    """The header of a LAS file, what it says of its coordinates, and what some points show: the lowest and highest x, y, z of
    them, f64[2, 3], None where no point was looked at, and how the echoes of all are numbered."""

    header: Header
    reference: Reference
    seen: np.ndarray | None = None
    numbering: Numbering = Numbering.SOUND

    @property
    def fingerprint(self) -> str:
        """Changes with the file, see ``Header.fingerprint``."""
        return self.header.fingerprint

    @functools.cached_property
    def runs(self) -> Runs:
        """The runs of its records with the areas that they cover: of LAS and LAZ, by a pass over the file. Raises: InputError."""
        return nodes(self.header) if self.header.is_copc else measure(self.header)[0]

    @functools.cached_property
    def extent(self) -> np.ndarray:
        """Lowest and highest x, y, z, f64[2, 3]: as the header states them, unless all points are known, or some of them show
        that this cannot be; then those of the points. Raises: InputError if these are too far away. Warns: if the header is
        wrong."""
        header, (low, high) = self.header, self.header.extent
        stated = np.stack([low, high])
        sane = (abs(stated) < FARTHEST).all() and (low <= high).all() and ((low < high)[:2].any() or header.count == 1)
        if not header.count or (sane and self.seen is None):
            return stated
        seen = self.seen if self.seen is not None else open_las(header.path).seen
        assert seen is not None
        slack, small = 2 * header.scales, len(sample(header.count)) == 1
        if sane and not small:
            reached = (high - low <= 2 * (seen[1] - seen[0]) + slack)[:2].all()  # some points do not reach the edges
            if reached and (low <= seen[0] + slack).all() and (seen[1] <= high + slack).all():
                return stated
        found = seen if small else measure(header)[1]
        if (far := abs(found) >= FARTHEST).any():
            axis = int(far.any(axis=0).argmax())
            words = f"{'XYZ'[axis]} reaches {found[:, axis][far[:, axis]][0]:g}, which no coordinate does"
            raise InputError(f"{header.path}: {words}: correct scale and offset in its header")
        margin = 0.02 * (found[1] - found[0]) + slack  # some producers state the edges of the tile
        if not ((abs(stated - found) <= margin).all() and (low <= found[0] + slack).all()):
            words, true = (f"{one[0].tolist()} to {one[1].tolist()}" for one in (stated, np.round(found, 3)))
            warn(
                f"{header.path}: its header states the extent {words}, but its points lie in {true}: their extent is used"
            )
        return found

    def cloud(
        self,
        reading: Reading,
        progress: Progress = silent,
        *,
        strict: bool = True,
        runs: Runs | None = None,
        fields: DecompressionSelection = CLOUD,
        note: Callable[[Points, np.ndarray], None] = lambda points, record: None,
    ) -> PointCloud:
        """The points inside ``reading.bounds``, in the units asked for, or of the CRS, or in metres with a warning.

        Args:
            strict: coordinates that cannot be lengths are an error, not a warning, where no units are asked for.
            runs, fields: as of :func:`read_points`.
            note: is called with points, as they are read, and their numbers in the file, i64[k].

        Raises: InputError.
        """
        header, cut = self.header, reading.bounds
        path, scales, offsets = header.path, header.scales, header.offsets
        reference = reading.stated.of(self.reference, str(path))
        units = linear_units(reference, str(path))
        most = header.count if runs is None or cut is None else int(runs.meeting(cut).points.sum())
        named = [name for name in COLUMN_TYPES if header.point_format >= 6 or name != "overlap" or header.upper]
        with reading_errors(path):  # memory is taken as arrays fill, so little where bounds leave few points
            ticks, n = np.empty((most, 3), np.int32), 0
            columns: dict[str, Any] = {name: np.empty(most, COLUMN_TYPES[name]) for name in named}
        for number, (points, record) in enumerate(read_points(header, cut, ALL if header.upper else fields, runs)):
            progress(min(1.0, number * POINTS_AT_ONCE / max(header.count, 1)), "read")
            rows = slice(n, n + len(points))
            ticks[rows] = integers(points)
            for name, values in attributes(points, header).items():
                columns[name][rows] = values
            note(points, record)
            n = rows.stop
        if n < most:
            ticks, columns = ticks[:n].copy(), {name: column[:n].copy() for name, column in columns.items()}
        stated = reference.units is not None or cut is not None
        if reading.units is None:
            check_lengths(path, ticks[sampled(n)] * scales + offsets, n, stated, strict)
        is_ground = columns["classification"] == GROUND_CLASS
        return PointCloud.from_integers(
            ticks,
            scales,
            offsets,
            dataclasses.replace(reading, units=units),
            name=str(path),
            crs=reference.crs,
            source=Handle(header, n, cut),
            reference=is_ground if is_ground.any() else None,
            numbering=self.numbering if n else Numbering.SOUND,
            **columns,
        )


def open_las(path: Place, tables: bool = True) -> LasFile:
    """The header of a LAS file and its CRS, both checked.

    ``tables=False`` does not look among the points: whether chunks of LAZ hold as many as announced is then not checked.
    Raises InputError. Warns: as :func:`read`.
    """
    with reading_errors(path):
        with opened(path) as (file, identity):
            header, seen, how = read_header(path, file, identity), None, Numbering.SOUND
            if tables:
                header = dataclasses.replace(header, unread=check_chunks(header, file))
                if header.count:
                    some, seen = sample_points(header, file)
                    time = some.gps_time if "gps_time" in some.array.dtype.names else None
                    how = numbering(attributes(some, header), some.Z, time)
            stated = {}
            for record in header.vlrs + header.evlrs:
                size = record.end - record.payload
                if record.key in CRS_RECORDS and size <= _LARGEST_CRS:
                    file.seek(record.payload)
                    stated[record.key[1]] = file.read(size)
        for remark in header.remarks():
            warn(f"{path}: {remark}")
        wkt = header.point_format >= 6 or bool(header.head[6] & 16)  # of the global encoding
        return LasFile(header, reference_of(stated, str(path), wkt), seen, how)


def open_points(place: Place, reading: Reading) -> LasFile | TextFile:
    """A file of any kind; of text, the points inside ``reading.bounds``. Raises: InputError."""
    return open_text(cast(Path, place), reading.bounds, reading.drop_invalid) if is_text(place) else open_las(place)


def kept_file(place: Place, tables: bool = True) -> LasFile | TextFile:
    """A file of any kind, see :func:`open_las`. Those of the last files are kept as long as the files stay the same, since every
    tile asks for them. Raises: InputError."""
    with reading_errors(place):
        identity = identify(place)
        return _kept_text(place, identity) if is_text(place) else _kept_las(place, identity, tables)


_kept_text = functools.lru_cache(1)(lambda place, identity: open_text(place))
_kept_las = functools.lru_cache(64)(lambda place, identity, tables: open_las(place, tables))


def warn_if_empty(name: object, cloud: PointCloud, bounds: Bounds | None) -> PointCloud:
    """The cloud, with a warning if it has no points."""
    if not len(cloud):
        warn(f"{name}: holds no points" + ("" if bounds is None else f" within bounds {bounds}"))
    return cloud
