"""Point records through laspy: read in chunks or in part, looked into, changed, and written again."""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import struct
from collections.abc import Iterator
from typing import Any, BinaryIO, TypeAlias

import laspy
import lazrs
import numpy as np

from ..core.echoes import sample
from ..core.errors import InputError, OutputError
from ..core.inputs import COLUMN_TYPES
from ..core.process import need_threads
from ..core.reading import inside
from ..core.units import PROJECTION, WKT
from .disk import CHANGED_SINCE, Bounds, opened
from .guard import check_chunks, chunk_table, laszip_record, pieces, reading_errors
from .header import COPC, EXTRA_BYTES, HEADER_LENGTHS, LASZIP, RECORD_LENGTHS, Header, Record
from .runs import Runs, nodes
from .storage import Place, Remote

CHUNK = 1_000_000
"""Points that are held at a time."""
_SAME = 1e-5
"""Units, to which coordinates are rounded before they are compared."""
Points: TypeAlias = laspy.PackedPointRecord
"""Records of points as laspy holds them: ``array`` is structured, with the fields of the point format."""

CLOUD = laspy.DecompressionSelection.base().decompress_z().decompress_classification().decompress_flags()
ALL = laspy.DecompressionSelection.all()
"""Fields of LAZ of point formats 6 and above that are decompressed; the others are 0, which is faster."""


def read_points(
    header: Header,
    bounds: Bounds | None = None,
    fields: laspy.DecompressionSelection = ALL,
    runs: Runs | None = None,
    file: BinaryIO | None = None,
) -> Iterator[tuple[Points, np.ndarray]]:
    """The points, up to a million at a time, in file order, and their numbers in the file, i64[k]; only those inside
    ``bounds`` if given.

    Args:
        fields: :data:`ALL` or :data:`CLOUD`.
        runs: where runs of records lie: only those are read that may hold points inside the bounds. By default the nodes of
            the octree of COPC, and else the whole file.
        file: the file, if it is open.

    Raises: InputError if the points are damaged.
    """
    source = header.open() if file is None else contextlib.nullcontext(file)
    with reading_errors(header.path), source as file:
        if header.unread is None:
            check_chunks(header, file)
        if runs is None:
            runs = nodes(header, file) if header.is_copc and bounds is not None else Runs.of_file(header, file)
        for group in (runs if bounds is None else runs.meeting(bounds)).groups(CHUNK):
            points, numbers = decode(header, file, group, fields), group.records
            if bounds is not None:
                if header.is_copc:
                    _check_cubes(header, group, points)
                kept = inside(coordinates(points, header, 2), bounds)
                points, numbers = points[kept], numbers[kept]
            yield points, numbers


def _check_cubes(header: Header, nodes: Runs, points: Points) -> None:
    """Raises: InputError if points of COPC lie outside the cubes of their nodes, so that others of the box may be missing."""
    low, high = (ends[:, :2] * header.scales[:2] + header.offsets[:2] for ends in _ends(nodes, points))
    if not ((low >= nodes.low) & (high <= nodes.high)).all():
        raise InputError(
            f"{header.path}: points lie outside the cubes of its octree, so those of a box cannot be found: read the whole file, "
            "without bounds, and write it anew"
        )


def _ends(runs: Runs, points: Points) -> np.ndarray:
    """i32[2, k, 3]: lowest and highest X, Y, Z of the points of each run."""
    ticks, at = integers(points), np.cumsum(runs.points) - runs.points
    return np.stack([np.minimum.reduceat(ticks, at), np.maximum.reduceat(ticks, at)])


def decode(header: Header, file: BinaryIO, runs: Runs, fields: laspy.DecompressionSelection) -> Points:
    """The points of some runs. As laspy's reader of COPC does it: its ``seek`` takes chunks of several sizes for equal ones
    (laspy 2.7, lazrs 0.8), and returns other points."""
    apart = np.flatnonzero(np.append(True, runs.start[1:] != (runs.start + runs.size)[:-1])[: len(runs.start)])
    sizes = np.add.reduceat(runs.size, apart) if len(apart) else apart
    parts = [pieces(header, file, runs.start[[k]], int(size))[0] for k, size in zip(apart, sizes, strict=True)]
    packed = parts[0] if len(parts) == 1 else np.concatenate([np.zeros(0, np.uint8), *parts])
    if not header.compressed:
        return Points.from_buffer(packed, format_of(header))
    records = np.zeros(int(runs.points.sum()) * header.record_length, np.uint8)
    need_threads()
    table = list(zip(runs.points.tolist(), runs.size.tolist(), strict=True))
    lazrs.decompress_points_with_chunk_table(packed, header.decoder, records, table, fields.to_lazrs())
    return Points.from_buffer(records, format_of(header))


def format_of(header: Header, more: int = 0) -> laspy.PointFormat:
    """The point format, with all extra bytes, and ``more`` of them, as one dimension ``ExtraBytes``."""
    form, extra = laspy.PointFormat(header.point_format), header.record_length - RECORD_LENGTHS[header.point_format]
    if extra + more:
        form.add_extra_dimension(laspy.ExtraBytesParams("ExtraBytes", f"{extra + more}u1"))
    return form


def dimensions_of(point_format: int) -> dict[str, int]:
    """Bits of the dimensions of a point format, by laspy's names."""
    return {one.name: one.num_bits for one in laspy.PointFormat(point_format).dimensions}


def measure(header: Header) -> tuple[Runs, np.ndarray]:
    """The runs of records of a file with the areas that their points cover, and lowest and highest x, y, z of all, f64[2, 3]:
    by a pass over the file. Raises: InputError."""
    ends = [np.zeros((2, 0, 3), np.int32)]
    with reading_errors(header.path), header.open() as file:
        runs = Runs.of_file(header, file)
        for group in runs.groups(CHUNK):
            ends.append(_ends(group, decode(header, file, group, CLOUD)))
    low, high = np.concatenate(ends, axis=1) * header.scales + header.offsets
    extent = np.stack([low.min(axis=0), high.max(axis=0)]) if len(low) else np.full((2, 3), np.nan)
    return dataclasses.replace(runs, low=low[:, :2], high=high[:, :2]), extent


def sampled_points(header: Header, file: BinaryIO) -> Points:
    """The records of :func:`jaxfilter.core.echoes.sample`, with GPS times: all of a small file."""
    found = Runs.of_file(header, file)
    points = np.zeros_like(found.points)  # from the beginning of each run
    for part in sample(header.count):
        at = slice(np.searchsorted(found.first, part.start, "right") - 1, np.searchsorted(found.first, part.stop))
        points[at] = np.minimum(found.points[at], part.stop - found.first[at])
    if not header.compressed:
        found = dataclasses.replace(found, size=points * header.record_length)
    return decode(header, file, dataclasses.replace(found, points=points)[points > 0], CLOUD.decompress_gps_time())


def sampled_extent(header: Header, file: BinaryIO, some: Points) -> np.ndarray:
    """Lowest and highest x, y, z, f64[2, 3]: of ``some`` points, and of more of a large file on a disk, the first of each
    chunk of LAZ and every so many of LAS."""
    xyz = coordinates(some, header)
    if len(some) < header.count and not isinstance(header.path, Remote):
        xyz = np.concatenate([xyz, spread_points(header, file)])
    return np.stack([xyz.min(axis=0), xyz.max(axis=0)])


def spread_points(header: Header, file: BinaryIO) -> np.ndarray:
    """f64[n, 3], file units, of points from all over a file, found fast: the first of each chunk of LAZ, 1000 of LAS."""
    start = len(header.head) + np.linspace(0, header.count - 1, 1000).astype(np.int64) * header.record_length
    if header.compressed:
        start, size, _ = chunk_table(header, file)
        start = start[size > 12]
    return pieces(header, file, start, 12).view("<i4") * header.scales + header.offsets


def every_xy(header: Header, file: BinaryIO) -> Iterator[np.ndarray]:
    """f64[n, 2], file units, of all points, :data:`CHUNK` about at a time."""
    for group in Runs.of_file(header, file).groups(CHUNK):
        yield coordinates(decode(header, file, group, CLOUD), header, 2)


def echo_keys(points: Points, header: Header) -> np.ndarray:
    """u64[n], a hash of X, Y, Z (to 0.01 mm of a unit in metres), GPS time, return number and point source of each point, whose
    scales and offsets do not count. Different echoes have one hash in a case of 2**64."""
    columns = list(np.rint(coordinates(points, header) / _SAME).astype(np.int64).T)
    columns += [points.gps_time.view(np.int64)] if "gps_time" in points.array.dtype.names else []
    columns += [np.asarray(points.return_number).astype(np.int64) << 16 | points.point_source_id]
    key = np.zeros(len(points), np.uint64)
    for column in columns:
        key = (key ^ column.view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(32)
    return key


def integers(points: Points) -> np.ndarray:
    """i32[n, 3]: X, Y, Z."""
    return np.stack([points.array[axis] for axis in "XYZ"], axis=1)


def coordinates(points: Points, header: Header, axes: int = 3) -> np.ndarray:
    """f64[n, axes], file units."""
    return integers(points)[:, :axes] * header.scales[:axes] + header.offsets[:axes]


def attributes(points: Points, header: Header) -> dict[str, np.ndarray]:
    """The columns of a cloud, u8[n] each, as far as the point format has them."""
    found = {name: np.asarray(points[name]) for name in COLUMN_TYPES if name != "overlap" or header.point_format >= 6}
    if at := header.upper:  # the rules by which LASzip makes LAS 1.4 of it
        extra = points.array["ExtraBytes"]
        echoes = extra[:, at["extended returns"]]
        found["return_number"] = found["return_number"] + (echoes >> 4)
        found["number_of_returns"] = found["number_of_returns"] + (echoes & 15)
        found["classification"] = found["classification"] + extra[:, at["classification"]]
        found["overlap"] = extra[:, at["flags and channel"]] & 1
    return found


def put_classes(points: Points, header: Header, classes: np.ndarray) -> None:
    """Put in new classes, u8[n]; fields that share their bytes stay."""
    if at := header.upper:
        above = classes > 31
        points.array["ExtraBytes"][:, at["classification"]] = np.where(above, classes, 0)
        classes = np.where(above, np.uint8(0), classes)
    points.classification = classes


@dataclasses.dataclass(frozen=True)
class Handle:
    """The LAS, LAZ or COPC file that a cloud was read from: lossless writing streams it again instead of keeping a second copy.

    Attributes:
        header: of the file when it was read.
        points: number of points taken from the file, the length of the cloud.
        bounds: the cut that was applied, or None; reading with it again gives the same points in the same order.
        rows: bool of all points of the file, those that were taken; None = those inside the bounds.
    """

    header: Header
    points: int
    bounds: Bounds | None = None
    rows: np.ndarray | None = None

    @property
    def path(self) -> Place:
        """Absolute, or remote."""
        return self.header.path.absolute()

    @property
    def format(self) -> str:
        """In words, for messages."""
        return str(self.header)

    def records(self, file: BinaryIO, fields: laspy.DecompressionSelection = ALL) -> Iterator[Points]:
        """The points, read once more from the open file. Raises InputError."""
        for points, number in read_points(self.header, self.bounds, fields, file=file):
            yield points if self.rows is None else points[self.rows[number]]

    def coordinates(self) -> np.ndarray:
        """f64[n, 3] in file units: those of the file, to the last digit. Raises: InputError as :meth:`again`."""
        with self.again() as file:
            parts = [coordinates(points, self.header) for points in self.records(file, CLOUD)]
            return np.concatenate([np.zeros((0, 3)), *parts])

    @contextlib.contextmanager
    def again(self) -> Iterator[BinaryIO]:
        """A block in which the points are read once more, from this open file. Raises: InputError if it is gone, or is another
        now."""
        with contextlib.ExitStack() as stack:
            try:
                file, found = stack.enter_context(opened(self.path))
            except OSError as error:
                lost = f"{self.path}: the source of the cloud cannot be read again: {error.strerror}"
                raise InputError(f"{lost}; put it back, or read it again where it is now") from error
            if found != self.header.identity:
                raise InputError(f"{self.path}: {CHANGED_SINCE}")
            stack.enter_context(self.header.identity.kept(self.path, CHANGED_SINCE))
            yield file


class Writer:
    """Writes the points of a file once more, through laspy. What laspy would not keep is copied from the file ``header`` is
    of: dates, names, variable length records with their padding, what follows the points.

    Args:
        file: binary, empty; read and written.
        compressed: LAZ instead of LAS.
        extra: names and descriptions of float32 dimensions that are added.
        crs: number and data of a record that is added.
    """

    def __init__(
        self,
        file: BinaryIO,
        header: Header,
        compressed: bool,
        extra: dict[str, str],
        crs: tuple[int, bytes] | None = None,
    ) -> None:
        self.file, self.header, self.extra = file, header, extra
        self._wkt = crs is not None and crs[0] == WKT
        self._records = list(_kept_records(header, extra, crs))
        number, form = header.point_format, format_of(header, 4 * len(extra))
        minor = max(2, header.version, 3 if number > 3 else 0, 4 if number > 5 else 0)
        made = laspy.LasHeader(version=f"1.{minor if number > 5 else min(minor, 4)}", point_format=form)
        made.scales, made.offsets = header.scales, header.offsets
        made.vlrs.clear()
        made.extra_header_bytes = header.head[HEADER_LENGTHS[header.minor] : header.size]
        made.extra_vlr_bytes = (
            b"".join(self._records) + header.head[header.vlrs[-1].end if header.vlrs else header.size :]
        )
        self._laszip = laszip_record(number, form.num_extra_bytes) if compressed else b""
        self._output = _Output(file)
        with self._output.errors():
            need_threads()
            self._laspy = laspy.LasWriter(
                self._output, made, do_compress=compressed, laz_backend=laspy.LazBackend.LazrsParallel, closefd=False
            )

    def write(self, points: Points, columns: dict[str, np.ndarray]) -> None:
        """Append points, with the dimensions that are added, f32[n] each. Raises: OSError."""
        form, array = self._laspy.header.point_format, points.array
        if self.extra:
            old = array.view(np.uint8).reshape(len(array), array.dtype.itemsize)
            new = np.stack([columns[name] for name in self.extra], axis=1).astype("<f4").view(np.uint8)
            array = np.concatenate([old, new], axis=1).view(form.dtype())[:, 0]
        with self._output.errors():
            self._laspy.write_points(Points(array, form))

    def finish(self, source: BinaryIO | None) -> None:
        """Complete the points and the header, and append what follows the points of the file ``source``. Raises: OSError."""
        with self._output.errors():
            self._laspy.close()
        made, old = self._laspy.header, self.header.head
        patches = {4: old[4:24], 26: old[26:94]}  # source, encoding, project; names, dates
        patches[100] = struct.pack("<I", len(self._records) + bool(self._laszip))
        if self._wkt:
            patches[6] = bytes([old[6] | 16])
        if made.version.minor == 2:  # the same header as those before it
            patches[25] = old[25:26]
        if self._laszip:
            patches[HEADER_LENGTHS[made.version.minor] + len(made.extra_header_bytes) + 54] = self._laszip
        if made.version.minor >= 4 and self.header.point_format < 6 and made.point_count < 2**32:
            patches[107] = struct.pack("<6I", made.point_count, *made.number_of_points_by_return[:5].tolist())
        if source is not None:
            patches |= self._copy_tail(source)
        for at, value in patches.items():
            self.file.seek(at)
            self.file.write(value)

    def _copy_tail(self, file: BinaryIO) -> dict[int, bytes]:
        """Append what follows the points of a file. Returns: what the header says of it, by the byte where it stands."""
        source, at = self.header, self.file.seek(0, 2)
        kept = without_octree(source, source.evlrs)
        if len(kept) < len(source.evlrs):
            starts = {235: at} if kept else {}
            for record in kept:
                file.seek(record.start)
                self.file.write(file.read(record.end - record.start))
        else:
            file.seek(source.tail)
            shutil.copyfileobj(file, self.file, 2**20)
            old = {227: source.waveform_start, 235: source.evlr_start}
            there = {field: start for field, start in old.items() if source.tail <= start <= source.identity.size}
            starts = {field: start + at - source.tail for field, start in there.items() if start}
        found = {field: struct.pack("<Q", start) for field, start in starts.items()}
        return found | ({243: struct.pack("<I", len(kept))} if kept else {})


def _kept_records(header: Header, extra: dict[str, str], crs: tuple[int, bytes] | None) -> Iterator[bytes]:
    """The variable length records of an output, as bytes."""
    kept = [record for record in without_octree(header, header.vlrs) if record.key != LASZIP]
    if extra:
        known = header.extra_dimensions()
        if known is None:
            raise OutputError(f"{header.path}: the description of its extra bytes is damaged, so none can be added")
        first = RECORD_LENGTHS[header.point_format]
        end = max((one.start + one.size for one in known), default=0)
        entries = [(f"undescribed {i + 1}", 1, "") for i in range(header.record_length - first - end)]
        entries += [(name, 9, words) for name, words in extra.items()]
        data = [header.head[record.payload : record.end] for record in kept if record.key == EXTRA_BYTES]
        data += [
            struct.pack("<HBB32s124x32s", 0, kind, 0, name.encode(), words.encode()) for name, kind, words in entries
        ]
        if len(described := b"".join(data)) > 65_535:
            raise OutputError(
                f"{header.path}: its points have too many extra bytes: one record cannot describe more of them"
            )
        yield vlr(*EXTRA_BYTES, described)  # readers look at one record only
        kept = [record for record in kept if record.key != EXTRA_BYTES]
    for record in kept:
        yield header.head[record.start : record.end]
    if crs is not None:
        yield vlr(PROJECTION, *crs)


def without_octree(header: Header, records: tuple[Record, ...]) -> list[Record]:
    """Those of some records that are not on the octree of COPC."""
    return [record for record in records if not header.is_copc or record.key[0] != COPC]


def vlr(user: str, number: int, payload: bytes, description: str = "") -> bytes:
    """A variable length record in bytes."""
    return struct.pack("<H16sHH32s", 0, user.encode(), number, len(payload), description.encode()) + payload


class _Output:
    """A file that keeps what was raised when the LAZ encoder used it, of which the encoder passes on only a few words."""

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.error: BaseException | None = None

    def __getattr__(self, name: str) -> Any:
        method = getattr(self.file, name)

        def call(*arguments: Any) -> Any:
            try:
                return method(*arguments)
            except BaseException as error:  # a full disk, or a signal
                self.error = error
                raise

        return call

    @contextlib.contextmanager
    def errors(self) -> Iterator[None]:
        """A block that encodes: raises what the file raised."""
        try:
            yield
        except (lazrs.LazrsError, laspy.LaspyException) as error:
            raise self.error or OSError(str(error)) from error
