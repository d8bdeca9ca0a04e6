"""Writing classified clouds. What is not asked to change is copied from the file the cloud came from: LAS byte for byte."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import BinaryIO, cast

import laspy
import numpy as np

from ..core.cloud import GROUND_CLASS, OVERLAP_CLASS, PointCloud
from ..core.errors import InputError, OutputError, ParameterError, warn
from ..core.inputs import COLUMN_TYPES
from ..core.result import FilterResult
from ..core.units import CRS_RECORDS, GEOKEYS, WKT, for_outputs, geokeys, reference_of, vertical
from . import copc
from .classes import Classes, Found, asked, findings_of, table_of
from .disk import Identity, new_file
from .guard import read_header
from .header import FLOATS, Header
from .points import Handle, Points, Writer, attributes, put_classes
from .storage import Place, Remote, place_of
from .text import TEXT_SUFFIXES, TextFile

HEIGHT = "HeightAboveGround"
"""The extra dimension of heights above ground, by the name that PDAL gives it."""

_DESCRIPTIONS = {  # at most 32 bytes each
    "height": "metres above the final surface",
    "slope": "of that surface, degrees",
    "angle": "last tested to a facet, degrees",
    "elevation": "last tested, metres",
    "margin": "tested value less its threshold",
    "doubt": "probability that label is wrong",
    HEIGHT: "in the units of Z",
}

EXTRAS = tuple(name for name in _DESCRIPTIONS if name != HEIGHT)
"""Quantities of a FilterResult that can be written along with the points."""

LAS_SUFFIXES = (".las", ".laz")
CLOUD_SUFFIXES = LAS_SUFFIXES + TEXT_SUFFIXES


@dataclasses.dataclass(frozen=True, eq=False)
class Additions:
    """What is written along with the points: ``columns``, f[n] by name, become float32 extra bytes; ``z``, f[n], takes the place
    of Z."""

    columns: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    z: np.ndarray | None = None

    @classmethod
    def of_heights(cls, heights: np.ndarray | None, replace_z: bool) -> Additions:
        """Heights above ground f[n], in place of Z or as a column. Raises: ParameterError if they are to replace Z and there are
        none; InputError for others than finite numbers."""
        if heights is None:
            if replace_z:
                raise ParameterError("replace_z=True: there are no heights to put there; pass heights=")
            return cls()
        if not np.isfinite(heights := np.asarray(heights)).all():
            raise InputError(f"heights: {heights.size} finite numbers are needed")
        return cls(z=heights) if replace_z else cls({HEIGHT: heights})


@dataclasses.dataclass(frozen=True)
class Replacing:
    """What an output may replace, as of :func:`jaxfilter.files.disk.new_file`."""

    overwrite: bool = False
    in_place: bool = False
    into: Path | None = None


def write(
    path: str | Path | Remote,
    cloud: PointCloud,
    result: FilterResult | np.ndarray | None,
    *,
    overwrite: bool = False,
    in_place: bool = False,
    ground_class: int = GROUND_CLASS,
    other_class: int = 1,
    reset: str = "ground",
    only_ground: bool = False,
    noise_class: int | None = None,
    classes: Classes | None = None,
    extra: Iterable[str] = (),
    heights: np.ndarray | None = None,
    replace_z: bool = False,
) -> Path | Remote:
    """Write the points of a cloud with their classes: .las and .laz, or .txt, .xyz and .csv with a label (0 = ground).

    A cloud from a LAS file is streamed from that file again: only the classes of candidates change, everything else is
    kept (dates, scales, records, extra bytes, flags, integer coordinates, waveforms). Counts and extent in the header become
    those of the points. Clouds from text keep their other cells when written as text. Clouds without a LAS file become LAS
    1.4, point format 6, to 0.001 units (0.0001 if the text has more than three decimals).

    A name that ends in .copc.laz makes a COPC file: the same records in the order of an octree. Point formats 0 to 3 become 6 and
    7 then, which is said; those with waveforms (4, 5, 9, 10) are refused. COPC that is written as .laz loses its octree.

    Args:
        path: the output; it appears whole or not at all. May be a URL that fsspec can write to (``"s3://..."``).
        result: what a filter returned, or bool[n], True = ground; None keeps all classes.
        overwrite: replace an existing file.
        in_place: allow the output to be the file that the cloud came from.
        ground_class, other_class, reset, only_ground, noise_class: which classes points get, see :class:`Classes`; or all of it
            as ``classes``, such as ``jf.Classes.preset("usgs")``.
        extra: quantities of the result to add as float32 extra bytes, out of height, slope, angle, elevation, margin,
            and doubt of methods that state it.
        heights: f[n], units of Z: what :func:`jaxfilter.height_above_ground` returns, to be added as extra bytes
            ``HeightAboveGround``.
        replace_z: put ``heights`` in place of Z instead, rounded to the scale of the file; only Z and its extent change.

    Returns: the path.
    Raises: OutputError (exists, is the input, cannot hold a class or a coordinate, disk), ParameterError, InputError
    (result of another length, source file changed).

    >>> jf.write("ground.laz", cloud, result).name
    'ground.laz'
    >>> back = jf.read("ground.laz", units="m")
    >>> bool((back.reference == result.ground).all())
    True
    """
    named = Classes(ground_class, other_class, reset, only_ground, noise_class)
    if classes is not None and named != Classes():
        raise ParameterError(f"classes={classes!r}: holds the other settings of classes as well; name them there only")
    added = Additions.of_heights(heights, replace_z)
    added = dataclasses.replace(added, columns={**quantities_of(result, check_extra(extra)), **added.columns})
    return write_cloud(place_of(path), cloud, result, classes or named, added, Replacing(overwrite, in_place))


def check_extra(names: Iterable[str]) -> tuple[str, ...]:
    """Names of quantities of a result. Raises: ParameterError for those that there are not, or twice."""
    names = tuple(names)
    if set(names) - set(EXTRAS) or len(set(names)) < len(names):
        raise ParameterError(f"extra={names!r}: distinct names out of {', '.join(EXTRAS)} are needed")
    return names


def quantities_of(result: FilterResult | np.ndarray | None, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """f32[n] by name. Raises: ParameterError for what the method does not state. Warns: of doubt that is little worth."""
    if names and not isinstance(result, FilterResult):
        raise ParameterError(f"extra={names!r}: labels alone hold no such quantities; pass the FilterResult")
    found = {name: getattr(result, name) for name in names}
    if absent := [name for name, values in found.items() if values is None]:
        raise ParameterError(f"extra={names!r}: the method states no {absent[0]}; OST does")
    if "doubt" in found and isinstance(result, FilterResult) and "doubt" in result.info:
        warn(result.info["doubt"])
    return found


def write_cloud(
    path: Place,
    cloud: PointCloud,
    result: FilterResult | np.ndarray | Found | None,
    classes: Classes = Classes(),  # noqa: B008
    additions: Additions = Additions(),
    replacing: Replacing = Replacing(),
) -> Place:
    """:func:`write`, with what it takes as values."""
    kind = path.suffix.lower()
    if kind not in CLOUD_SUFFIXES:
        known = ", ".join((*LAS_SUFFIXES, copc.SUFFIX, *TEXT_SUFFIXES))
        raise OutputError(f"{path}: the suffix must be one of {known}")
    labels = _Labels(cloud, result, classes, additions)
    source: Handle | TextFile | None = cloud.source
    if source is not None and source.points != len(cloud):
        raise InputError(f"{source.path}: {source.points} points were read, but the cloud has {len(cloud)}")
    if kind in TEXT_SUFFIXES:
        if result is None:
            raise OutputError(f"{path}: text holds labels, and there are none; pass result=, or write .las or .laz")
        named = [*additions.columns, *(["heights"] if additions.z is not None else [])]
        named += [] if isinstance(source, TextFile) and "classification" in source.columns else asked(classes)
        if named:
            raise OutputError(f"{path}: this text holds labels only; {', '.join(named)} needs .las or .laz")
    if (octree := copc.is_copc(path)) and isinstance(source, Handle):
        copc.check_format(path, source.header.point_format)
    origin = None if source is None else source.path
    with new_file(path, source=origin, **dataclasses.asdict(replacing)) as temporary:
        if kind in TEXT_SUFFIXES:
            _write_text(path, temporary, cloud, labels)
            return path
        plain = temporary.with_name("plain.las") if octree else temporary
        again = source.again() if isinstance(source, Handle) else contextlib.nullcontext()
        with again as opened, open(plain, "x+b") as file:
            _write_las(path, file, cloud, labels, opened)
        if octree:
            copc.write_octree(plain, temporary)
    return path


class _Labels:
    """The outcome of a run as new classes and extra values, for any run of points."""

    def __init__(
        self, cloud: PointCloud, result: FilterResult | np.ndarray | Found | None, rule: Classes, additions: Additions
    ) -> None:
        self.table, self.rule, self.extra, self.z = table_of(rule), rule, additions.columns, additions.z
        if result is None:
            nothing = np.zeros(len(cloud), np.uint8)
            self.table, result = np.arange(256, dtype=np.uint8)[None], Found(nothing.astype(bool), nothing)
        found = result if isinstance(result, Found) else findings_of(cloud, result, rule)
        self.ground, self.code = found.ground, found.code
        for name, values in [*self.extra.items(), *([] if self.z is None else [("heights", self.z)])]:
            if values.shape != self.ground.shape:
                raise InputError(f"{name}: {len(cloud)} numbers are needed for this cloud, not {list(values.shape)}")

    def classes(self, old: np.ndarray, rows: slice) -> np.ndarray:
        """u8[k]: the classes of the points ``rows``, whose classes were ``old``."""
        return np.asarray(self.table[self.code[rows], old])

    def put(self, points: Points, rows: slice, header: Header) -> None:
        """Put classes into the points ``rows``."""
        old = attributes(points, header)["classification"]
        new = self.classes(old, rows)
        if self.rule.overlap_flag and header.point_format >= 6:
            points.overlap = np.asarray(points.overlap) | ((old == OVERLAP_CLASS) & (new != old))
        put_classes(points, header, new)


def _write_las(path: Place, file: BinaryIO, cloud: PointCloud, labels: _Labels, opened: BinaryIO | None) -> None:
    """``opened``: the file that the cloud is of."""
    las = cloud.source if isinstance(cloud.source, Handle) else None
    header = _fresh_header(path, cloud) if las is None else las.header
    chunks = [_fresh_points(path, header, cloud)] if las is None else las.records(cast(BinaryIO, opened))
    number, most = header.point_format, int(labels.table.max(initial=0, where=labels.table != np.arange(256)))
    if number < 6 and most > 31 and not header.upper:
        raise OutputError(
            f"{path}: class {most} does not fit into point format {number}, which holds 0 to 31; upgrade the "
            "input to point format 6 or above first (laspy.convert(las, point_format_id=6)), or choose another class"
        )
    existing = {d.name: d for d in header.extra_dimensions() or () if d.name in labels.extra}
    if wrong := [name for name, dimension in existing.items() if dimension.data_type not in FLOATS]:
        raise OutputError(
            f"{path}: the input has extra bytes named {wrong[0]!r} that are not float32 or float64: rename them first"
        )
    added = {name: _DESCRIPTIONS.get(name, "") for name in labels.extra if name not in existing}
    compressed = path.suffix.lower() == ".laz" and not copc.is_copc(path)
    if header.is_copc and not copc.is_copc(path):
        warn(f"{path}: the input is COPC, the output is plain {'LAZ' if compressed else 'LAS'}, without an octree")
    crs_record = None if las is None else _crs_record(path, header, cloud, cast(BinaryIO, opened))
    writer = Writer(file, header, compressed, added, crs_record)
    packed_waves = number in (9, 10) and (compressed or header.compressed)
    channels, done = set(), 0
    for points in chunks:
        rows = slice(done, done := done + len(points))
        if packed_waves:
            channels |= set(np.unique(points.scanner_channel).tolist())
            if len(channels) > 1:  # lazrs 0.8 mixes up the wave packets of different channels
                raise OutputError(
                    f"{path}: LAZ does not keep the waveform references of several scanner channels apart; use "
                    ".las for input and output"
                )
        labels.put(points, rows, header)
        for name, dimension in existing.items():
            values = labels.extra[name][rows].astype(FLOATS[dimension.data_type]).view(np.uint8)
            at = slice(dimension.start, dimension.start + dimension.size)
            points.array["ExtraBytes"][:, at] = values.reshape(len(points), dimension.size)
        if labels.z is not None:
            points.array["Z"] = _ticks(path, header, labels.z[rows, None].astype(np.float64), slice(2, 3))[:, 0]
        writer.write(points, {name: labels.extra[name][rows] for name in added})
    writer.finish(opened)


def _ticks(path: Place, header: Header, xyz: np.ndarray, axes: slice = slice(3)) -> np.ndarray:
    """f64[k, axes]: the integers that stand for coordinates in units of the file. Raises OutputError if they do not fit."""
    ticks = np.rint((xyz - header.offsets[axes]) / header.scales[axes])
    bad = ~(np.abs(ticks) < 2**31)
    if bad.any():
        raise OutputError(
            f"{path}: coordinate {xyz[bad.any(axis=1).argmax()].tolist()} does not fit into 32 bits at a scale of "
            f"{header.scales[2]:g}; LAS cannot hold this extent (or NaN): remove stray points, or write heights as extra bytes"
        )
    return ticks


def _crs_record(path: Place, header: Header, cloud: PointCloud, opened: BinaryIO) -> tuple[int, bytes] | None:
    """Number and data of the record that states the CRS of a cloud whose file, ``opened``, states none, or no heights: WKT where
    LAS knows it, and else the EPSG codes as GeoTIFF keys."""
    crs, stated, here = cloud.crs, {}, opened.tell()
    for record in [one for one in header.vlrs + header.evlrs if one.key in CRS_RECORDS]:
        opened.seek(record.payload)
        stated[record.key[1]] = opened.read(record.end - record.payload)
    opened.seek(here)
    if stated:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # reading has said it
            if vertical(crs) is None or vertical(reference_of(stated, str(path)).crs) is not None:
                return None
        if any(one.key in CRS_RECORDS for one in header.evlrs):
            without = "the heights of its CRS are not written, since the input has its CRS in an extended record"
            warn(f"{path}: {without}: give the CRS again when this file is read")
            return None
    if (crs := for_outputs(crs)) is None or (stated and vertical(crs) is None):
        return None
    if header.version >= 4:
        return WKT, crs.to_wkt("WKT1_GDAL").encode() + b"\0"
    if (keys := geokeys(crs)) is None:
        lost = "the heights of its CRS have" if stated else "its CRS has"
        without = f"{lost} no EPSG code, which LAS 1.{header.version} needs, and cannot be written"
        warn(f"{path}: {without}: convert the input to LAS 1.4")
        return None
    return GEOKEYS, keys


def _fresh_header(path: Place, cloud: PointCloud) -> Header:
    """LAS 1.4, point format 6, without points yet."""
    decimals = cloud.source.decimals if isinstance(cloud.source, TextFile) else 3
    made = laspy.LasHeader(version="1.4", point_format=6)
    made.scales, made.offsets = np.full(3, 10.0**-decimals), np.floor(cloud.origin)
    made.generating_software = "jaxfilter"
    made.global_encoding.value = 1 | 16  # adjusted GPS time, CRS as WKT
    if (crs := for_outputs(cloud.crs)) is not None:
        made.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(crs.to_wkt("WKT1_GDAL")))
    file = io.BytesIO()
    laspy.LasWriter(file, made, closefd=False).close()
    identity = Identity(0, 0, file.seek(0, 2), 0)
    file.seek(0)
    return read_header(path, file, identity)


def _fresh_points(path: Place, header: Header, cloud: PointCloud) -> Points:
    """Points of format 6 from a cloud without a LAS file. Raises OutputError for coordinates that do not fit."""
    known = {name: values for name in COLUMN_TYPES if (values := getattr(cloud, name)) is not None}
    if isinstance(cloud.source, TextFile):
        known = cloud.source.columns | known
    points = Points.zeros(len(cloud), laspy.PointFormat(header.point_format))
    for axis, ticks in zip("XYZ", _ticks(path, header, _coordinates(cloud)).T, strict=True):
        points.array[axis] = ticks
    points.return_number = points.number_of_returns = np.ones(len(cloud), np.uint8)  # where nothing is said
    for name in COLUMN_TYPES & known.keys():
        points[name][:] = known[name]
    return points


def _coordinates(cloud: PointCloud) -> np.ndarray:
    """f64[n, 3] in file units: of the source file, or else of the cloud, NaN where it has none."""
    if cloud.source is not None:
        return np.asarray(cloud.source.coordinates())
    xyz = cloud.coordinates()
    return xyz if cloud.valid is None else np.where(cloud.valid[:, None], xyz, np.nan)


def _write_text(path: Place, temporary: Path, cloud: PointCloud, labels: _Labels) -> None:
    source: Handle | TextFile | None = cloud.source
    if isinstance(source, TextFile):
        source.rewrite(temporary, labels.ground, lambda old: labels.classes(old, slice(None)))
        return
    decimals = 3 if source is None else _decimals(source.header)
    delimiter, header = (",", "x,y,z,label") if path.suffix.lower() == ".csv" else ("\t", "")
    table, form = np.column_stack([_coordinates(cloud), ~labels.ground]), [f"%.{decimals}f"] * 3 + ["%d"]
    np.savetxt(temporary, table, form, delimiter, header=header, comments="")


def _decimals(header: Header) -> int:
    """Decimals that show the coordinates of a file: its scales exactly, 12 at most, and no less than 6 for odd offsets."""
    for decimals in range(12):
        if np.allclose(header.scales, header.scales.round(decimals), rtol=1e-9, atol=0):
            lag = header.offsets - header.offsets.round(decimals)
            return decimals if (abs(lag) < 1e-6 * 10.0**-decimals).all() else max(decimals, 6)
    return 12
