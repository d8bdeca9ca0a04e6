"""Writing classified clouds. What is not asked to change is copied from the file the cloud came from: LAS byte for byte."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

import lazrs
import numpy as np
import pyproj

from ..core.cloud import GROUND_CLASS, OVERLAP_CLASS, PointCloud
from ..core.errors import InputError, OutputError, ParameterError, warn
from ..core.inputs import COLUMNS
from ..core.result import FilterResult
from ..core.units import GEOKEYS, STATED, WKT, geokeys
from . import copc, records
from .classes import Classes, Found, asked, findings_of, largest, table_of
from .disk import Tally, new_file
from .handles import Handle
from .header import FLOATS, RECORD_LENGTHS, Header, laszip_record, new_header
from .records import CHUNK, Writer
from .storage import Place, Remote, place_of
from .text import SUFFIXES as TEXT_SUFFIXES
from .text import TextFile, write_table

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


@dataclasses.dataclass(frozen=True, eq=False)
class Additions:
    """What is written along with the points.

    Attributes:
        extra: quantities of the result that become float32 extra bytes, see :func:`write`.
        columns: f[n] by name, further extra bytes.
        z: f[n], in place of Z.

    Raises: ParameterError for quantities that there are not, or twice.
    """

    extra: Iterable[str] = ()
    columns: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    z: np.ndarray | None = None

    def __post_init__(self) -> None:
        names = tuple(self.extra)
        object.__setattr__(self, "extra", names)
        if set(names) - set(EXTRAS) or len(set(names)) < len(names):
            raise ParameterError(f"extra={names!r}: distinct names out of {', '.join(EXTRAS)} are needed")

    @classmethod
    def of_heights(cls, heights: np.ndarray | None, replace_z: bool, extra: Iterable[str] = ()) -> Additions:
        """With heights above ground f[n], in place of Z or as a column. Raises: ParameterError if they are to replace Z and
        there are none; InputError for others than finite numbers."""
        if heights is None:
            if replace_z:
                raise ParameterError("replace_z=True: there are no heights to put there; pass heights=")
            return cls(extra)
        if not np.isfinite(heights := np.asarray(heights)).all():
            raise InputError(f"heights: {heights.size} finite numbers are needed")
        return cls(extra, z=heights) if replace_z else cls(extra, {HEIGHT: heights})


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
    copied byte for byte (header with its dates, scales, records, extra bytes, flags, integer coordinates, waveforms).
    Counts and extent in the header are renewed only for a cloud that was read with ``bounds``. Clouds from text keep their
    other cells when written as text; comments and blanks around cells are lost. Clouds without a LAS file become LAS 1.4,
    point format 6, to 0.001 units (0.0001 if the text has more than three decimals).

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
    additions = Additions.of_heights(heights, replace_z, extra)
    return write_cloud(
        place_of(path), cloud, result, classes or named, additions, overwrite=overwrite, in_place=in_place
    )


def write_cloud(
    path: Place,
    cloud: PointCloud,
    result: FilterResult | np.ndarray | Found | None,
    classes: Classes = Classes(),  # noqa: B008
    additions: Additions = Additions(),
    *,
    overwrite: bool = False,
    in_place: bool = False,
    into: Path | None = None,
) -> Place:
    """:func:`write`, with what it takes as values; ``into``: a file for the content, as of ``new_file``."""
    kind = path.suffix.lower()
    if kind not in LAS_SUFFIXES + TEXT_SUFFIXES:
        known = ", ".join((*LAS_SUFFIXES, copc.SUFFIX, *TEXT_SUFFIXES))
        raise OutputError(f"{path}: the suffix must be one of {known}")
    labels = _Labels(cloud, result, classes, additions)
    source: Handle | TextFile | None = cloud.source
    if source is not None and source.points != len(cloud):
        raise InputError(f"{source.path}: {source.points} points were read, but the cloud has {len(cloud)}")
    if kind in TEXT_SUFFIXES:
        if result is None:
            raise OutputError(f"{path}: text holds labels, and there are none; pass result=, or write .las or .laz")
        named = [*additions.extra, *additions.columns, *(["heights"] if additions.z is not None else [])]
        named += [] if isinstance(source, TextFile) and "classification" in source.columns else asked(classes)
        if named:
            raise OutputError(f"{path}: this text holds labels only; {', '.join(named)} needs .las or .laz")
    if (octree := copc.is_copc(path)) and isinstance(source, Handle):
        copc.check_format(path, source.header().point_format)
    origin = None if source is None else source.path
    again = source.again() if isinstance(source, Handle) else contextlib.nullcontext(Tally())
    with new_file(path, overwrite=overwrite, in_place=in_place, source=origin, into=into) as temporary, again as tally:
        if kind in TEXT_SUFFIXES:
            _write_text(path, temporary, cloud, labels, tally)
        else:
            plain = temporary.with_name("plain.las") if octree else temporary
            with open(plain, "xb") as file:
                _write_las(path, file, cloud, labels, tally)
            if octree:
                copc.write_octree(plain, temporary)
    return path


class _Labels:
    """The outcome of a run as new classes and extra values, for any run of points."""

    def __init__(
        self,
        cloud: PointCloud,
        result: FilterResult | np.ndarray | Found | None,
        classes: Classes,
        additions: Additions,
    ) -> None:
        found = result if isinstance(result, FilterResult) else None
        if result is None:
            nothing = np.zeros(len(cloud), np.uint8)
            self.table, result = np.arange(256, dtype=np.uint8)[None], Found(nothing.astype(bool), nothing)
        else:
            self.table = table_of(classes)
        given = result if isinstance(result, Found) else findings_of(cloud, result, classes)
        self.rule, self.ground, self.code = classes, given.ground, given.code
        names = tuple(additions.extra)
        if found is None and names:
            raise ParameterError(f"extra={names!r}: labels alone hold no such quantities; pass the FilterResult")
        self.extra: dict[str, np.ndarray] = {name: getattr(found, name) for name in names}
        if absent := [name for name, values in self.extra.items() if values is None]:
            raise ParameterError(f"extra={names!r}: the method states no {absent[0]}; OST does")
        self.extra |= additions.columns
        self.z = None if additions.z is None else additions.z.astype(np.float64)
        for name, values in [*self.extra.items(), *([] if self.z is None else [("heights", self.z)])]:
            if values.shape != self.ground.shape:
                raise InputError(f"{name}: {len(cloud)} numbers are needed for this cloud, not {list(values.shape)}")

    def classes(self, old: np.ndarray, rows: slice) -> np.ndarray:
        """u8[k]: the classes of the points ``rows``, whose classes were ``old``."""
        return np.asarray(self.table[self.code[rows], old])

    def put(self, chunk: np.ndarray, rows: slice, point_format: int) -> None:
        """Put classes into the records u8[k, record_length] of the points ``rows``."""
        old = records.get(chunk, point_format, "classification")
        new = self.classes(old, rows)
        if self.rule.overlap_flag and point_format >= 6:
            flags = records.get(chunk, point_format, "overlap") | ((old == OVERLAP_CLASS) & (new != old))
            records.put(chunk, point_format, "overlap", flags)
        records.put(chunk, point_format, "classification", new)


def _write_las(path: Place, file: BinaryIO, cloud: PointCloud, labels: _Labels, tally: Tally) -> None:
    las = cloud.source if isinstance(cloud.source, Handle) else None
    header = _fresh_header(path, cloud) if las is None else las.header()
    chunks = _fresh_records(path, header, cloud, tally) if las is None else las.records(header, tally)
    number = header.point_format
    most = largest(labels.rule)
    if number < 6 and most > 31:
        raise OutputError(
            f"{path}: class {most} does not fit into point format {number}, which holds 0 to 31; upgrade the "
            "input to point format 6 or above first (laspy convert --point-format-id 6), or choose another class"
        )
    existing = {d.name: d for d in header.extra_dimensions() or () if d.name in labels.extra}
    if wrong := [name for name, dimension in existing.items() if dimension.data_type not in FLOATS]:
        raise OutputError(
            f"{path}: the input has extra bytes named {wrong[0]!r} that are not float32 or float64: rename them first"
        )
    added = {name: _DESCRIPTIONS.get(name, "") for name in labels.extra if name not in existing}
    compressor, octree = None, copc.is_copc(path)
    if path.suffix.lower() == ".laz" and not octree:
        compressor = laszip_record(number, header.record_length + 4 * len(added) - RECORD_LENGTHS[number])
    if header.is_copc and not octree:
        kind = "LAS" if compressor is None else "LAZ"
        warn(f"{path}: the input is COPC, the output is plain {kind}, without an octree")
    recount = las is None or las.bounds is not None or las.rows is not None
    crs = None if las is None else _crs_record(path, header, cloud)
    if las is not None and compressor is not None and not (recount or labels.extra or crs) and labels.z is None:
        same = _untouched(las, header, labels)
        if same.any():
            _write_chunks(file, las, header, labels, same, tally)
            return
    writer = Writer(file, header.rewritten(compressor, added, crs), recount, labels.z is not None)
    packed_waves = number in (9, 10) and (compressor is not None or header.compressed)
    channels: set[int] = set()
    for chunk in chunks:
        rows = slice(tally.points - len(chunk), tally.points)
        if packed_waves:
            channels |= set(np.unique(records.get(chunk, number, "channel")).tolist())
            if len(channels) > 1:  # lazrs 0.8 mixes up the wave packets of different channels
                raise OutputError(
                    f"{path}: LAZ does not keep the waveform references of several scanner channels apart; use "
                    ".las for input and output"
                )
        labels.put(chunk, rows, number)
        for name, dimension in existing.items():
            values = labels.extra[name][rows].astype(FLOATS[dimension.data_type])
            chunk[:, dimension.start : dimension.start + dimension.size] = values.view(np.uint8).reshape(len(chunk), -1)
        if labels.z is not None:
            records.integers(chunk)[:, 2] = _ticks(path, header, labels.z[rows, None], slice(2, 3))[:, 0]
        if added:
            columns = np.stack([labels.extra[name][rows] for name in added], axis=1).astype("<f4")
            chunk = np.concatenate([chunk, columns.view(np.uint8)], axis=1)
        writer.write(chunk)
    writer.finish(None if las is None else header)


def _untouched(source: Handle, header: Header, labels: _Labels) -> np.ndarray:
    """bool[k]: the chunks of a file that was read in windows, in which no class changes; none of a file whose chunks cannot be
    copied: other than plain LAZ, or with wave packets."""
    blocks = source.blocks
    if blocks is None or not header.compressed or header.is_copc or header.point_format in (9, 10):
        return np.zeros(0, bool)
    if lazrs.LazVlr(header.laszip).uses_variable_size_chunks() or not blocks.points.all():
        return np.zeros(len(blocks), bool)
    same = (labels.table == np.arange(256)).all(axis=1)
    return np.asarray(np.logical_and.reduceat(same[labels.code], blocks.first))


def _write_chunks(
    file: BinaryIO, source: Handle, header: Header, labels: _Labels, same: np.ndarray, tally: Tally
) -> None:
    """A LAZ file once more: chunks that are the ``same``, bool[k], are copied, and not even decompressed."""
    writer, counts, sizes = Writer(file, header, recount=False, chunks=True), source.blocks.points.tolist(), []
    file.write(bytes(8))  # where the table of chunks will be
    for chunk, points in zip(records.read_chunks(header, source.blocks, same), counts, strict=True):
        if chunk.ndim == 1:
            tally.points += points
            sizes.append(file.write(chunk.data))
        else:
            tally.add(chunk[:, :12].view("V12"))
            labels.put(chunk, slice(tally.points - points, tally.points), header.point_format)
            sizes.append(file.write(records.in_one_chunk(chunk, header.laszip)))
    end = file.tell()
    with writer.encoded.heard():
        lazrs.write_chunk_table(writer.encoded, list(zip(counts, sizes, strict=True)), lazrs.LazVlr(header.laszip))
    file.seek(len(header.head))
    file.write(end.to_bytes(8, "little"))
    writer.finish(header)


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


def _crs_record(path: Place, header: Header, cloud: PointCloud) -> tuple[int, bytes] | None:
    """Number and data of the record that states the CRS of a cloud whose file states none: WKT where LAS knows it, and else the
    EPSG codes as GeoTIFF keys."""
    if cloud.crs is None or any(record.key in STATED for record in (*header.vlrs, *header.evlrs)):
        return None
    if header.minor >= 4:
        wkt = _wkt(path, cloud.crs)
        return None if wkt is None else (WKT, wkt.encode() + b"\0")
    keys = geokeys(cloud.crs)
    if keys is None:
        without = f"its CRS has no EPSG code, which LAS 1.{header.minor} needs, and is left out"
        warn(f"{path}: {without}: convert the input to LAS 1.4")
    return None if keys is None else (GEOKEYS, keys)


def _wkt(path: Place, crs: pyproj.CRS) -> str | None:
    try:
        return str(crs.to_wkt("WKT1_GDAL"))
    except pyproj.exceptions.CRSError as error:
        warn(f"{path}: its CRS cannot be written as WKT 1 and is left out: {error}")
        return None


def _fresh_header(path: Place, cloud: PointCloud) -> Header:
    decimals = cloud.source.decimals if isinstance(cloud.source, TextFile) else 3
    wkt = None if cloud.crs is None else _wkt(path, cloud.crs)
    today = datetime.date.today()
    created = (today.timetuple().tm_yday, today.year)
    return new_header(path, np.full(3, 10.0**-decimals), np.floor(cloud.origin), wkt, created)


def _fresh_records(path: Place, header: Header, cloud: PointCloud, tally: Tally) -> Iterator[np.ndarray]:
    """Records of point format 6 from a cloud without a LAS file. Raises OutputError for coordinates that do not fit."""
    known = {name: values for name in COLUMNS if (values := getattr(cloud, name)) is not None}
    if isinstance(cloud.source, TextFile):
        known = cloud.source.columns | known
    for xyz in _runs(cloud, tally):
        rows = slice(tally.points - len(xyz), tally.points)
        chunk = np.zeros((len(xyz), header.record_length), np.uint8)
        records.integers(chunk)[:] = _ticks(path, header, xyz)
        for name in COLUMNS:
            one = name in ("return_number", "number_of_returns")  # where nothing is said: the only echo
            records.put(chunk, header.point_format, name, known[name][rows] if name in known else int(one))
        yield chunk


def _runs(cloud: PointCloud, tally: Tally) -> Iterator[np.ndarray]:
    """The coordinates in file units, f64[k, 3], added to ``tally``: of the source file, or else of the cloud."""
    if isinstance(cloud.source, Handle):
        yield from cloud.source.runs(tally)
        return
    for start in range(0, len(cloud), CHUNK):
        rows = slice(start, start + CHUNK)
        if isinstance(cloud.source, TextFile):
            xyz = cloud.source.xyz[rows]
        else:
            xyz = dataclasses.replace(cloud, xyz=cloud.xyz[rows]).coordinates()
            xyz = xyz if cloud.valid is None else np.where(cloud.valid[rows, None], xyz, np.nan)
        tally.points += len(xyz)
        yield xyz


def _write_text(path: Place, temporary: Path, cloud: PointCloud, labels: _Labels, tally: Tally) -> None:
    source: Handle | TextFile | None = cloud.source
    if isinstance(source, TextFile):
        source.rewrite(temporary, labels.ground, lambda old: labels.classes(old, slice(None)))
        return
    with open(temporary, "xb") as file:
        decimals = 3 if source is None else _decimals(source.header())
        delimiter = "," if path.suffix.lower() == ".csv" else "\t"
        if delimiter == ",":
            file.write(b"x,y,z,label\n")
        for xyz in _runs(cloud, tally):
            write_table(file, xyz, labels.ground[tally.points - len(xyz) : tally.points], decimals, delimiter)


def _decimals(header: Header) -> int:
    """Decimals that show the coordinates of a file: its scales exactly, 12 at most, and no less than 6 for odd offsets."""
    for decimals in range(12):
        steps, lag = header.scales * 10.0**decimals, header.offsets * 10.0**decimals
        if np.allclose(steps, np.rint(steps), rtol=1e-9, atol=0) and (np.rint(steps) > 0).all():
            return decimals if np.allclose(lag, np.rint(lag), rtol=1e-12, atol=1e-6) else max(decimals, 6)
    return 12
