"""Point records through laspy: read in chunks or in part, looked into, changed, and written again.

Runs of records are the chunks of LAZ, the nodes of COPC, and :data:`RUN_LENGTH` records of LAS. What area the points of a run
cover is found by one pass over the file; the octree of COPC says it (Hobu Inc., COPC specification 1.0: info record of 160 bytes,
hierarchy pages of 32-byte entries).
"""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import struct
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, TypeAlias, TypeVar

import laspy
import lazrs
import numpy as np

from ..core.echoes import sample
from ..core.errors import InputError, OutputError, warn
from ..core.inputs import COLUMN_TYPES
from ..core.process import need_threads
from ..core.reading import Bounds, inside
from ..core.units import CRS_RECORDS, PROJECTION, WKT
from .disk import CHANGED_SINCE, opened
from .guard import chunk_table, laszip_record, pieces, reading_errors
from .header import COPC, EXTRA_BYTES, HEADER_LENGTHS, LASZIP, RECORD_LENGTHS, Header, Record
from .storage import Place, Remote

POINTS_AT_ONCE = 1_000_000
"""Points that are held at a time."""
RUN_LENGTH = 16384
"""Records of LAS in a run."""

ENTRY = np.dtype([("key", "<i4", 4), ("offset", "<u8"), ("size", "<i4"), ("points", "<i4")])
"""Level, x, y, z of a node of COPC; where its chunk is; number of points, -1: the entry is of another page."""
_SAME = 1e-5
"""Units, to which coordinates are rounded before they are compared."""
_T = TypeVar("_T")
Points: TypeAlias = laspy.PackedPointRecord
"""Records of points as laspy holds them: ``array`` is structured, with the fields of the point format."""

CLOUD = laspy.DecompressionSelection.base().decompress_z().decompress_classification().decompress_flags()
ALL = laspy.DecompressionSelection.all()
"""Fields of LAZ of point formats 6 and above that are decompressed; the others are 0, which is faster."""


@dataclasses.dataclass(frozen=True)
class Runs:
    """k runs of records of a file, in file order.

    Attributes:
        start, size: i64[k]: where a run begins in the file, and its bytes there.
        first, points: i64[k]: number of its first record in the file, counted from 0, and how many it has.
        low, high: f64[k, 2], file coordinates: all points of a run lie in low <= (x, y) <= high.
    """

    start: np.ndarray
    size: np.ndarray
    first: np.ndarray
    points: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def __getitem__(self, rows: np.ndarray | slice) -> Runs:
        return Runs(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))

    @classmethod
    def of_chunks(cls, start: np.ndarray, size: np.ndarray, points: np.ndarray) -> Runs:
        """Runs of so many points, i64[k], one after the other, whose areas are not known yet: they are infinite."""
        edge = np.full((len(points), 2), np.inf)
        return cls(start, size, np.cumsum(points) - points, points, -edge, edge)[points > 0]

    @classmethod
    def of_file(cls, header: Header, file: BinaryIO) -> Runs:
        """The chunks of LAZ; :data:`RUN_LENGTH` records each of LAS."""
        if header.count and header.compressed:
            start, size, points = chunk_table(header, file)
            return cls.of_chunks(start, size, np.diff(np.minimum(np.cumsum(points), header.count), prepend=0))
        first = np.arange(0, header.count, RUN_LENGTH)
        points, length = np.minimum(header.count - first, RUN_LENGTH), header.record_length
        return cls.of_chunks(len(header.head) + first * length, points * length, points)

    def meeting(self, box: Bounds) -> Runs:
        """Those that may hold points inside a half-open box."""
        low, high = self.low, self.high
        return self[(low[:, 0] < box[2]) & (high[:, 0] >= box[0]) & (low[:, 1] < box[3]) & (high[:, 1] >= box[1])]

    def groups(self, most: int) -> Iterator[Runs]:
        """Runs in succession, about ``most`` points at a time."""
        ends, at = np.cumsum(self.points), 0
        while at < len(ends):
            end = max(at + 1, int(np.searchsorted(ends, ends[at] - self.points[at] + most, side="right")))
            yield self[at:end]
            at = end

    @property
    def records(self) -> np.ndarray:
        """i64[n]: the numbers of the records, run after run."""
        ends = np.cumsum(self.points)
        return np.arange(int(self.points.sum())) + np.repeat(self.first - ends + self.points, self.points)


def nodes(header: Header) -> Runs:
    """The nodes of COPC with points, in file order, with the squares that their cubes cover.

    Of files on a disk the octree is held against the table of chunks, and the first point of each chunk, which is not compressed,
    against the cube of its node: a damaged cube would lose points. If a point lies outside, all nodes cover everything,
    with a warning. Raises: InputError if the octree is damaged.
    """
    at, remote = header.vlrs[0].payload, isinstance(header.path, Remote)  # there each look is a request of its own
    *centre, half, _, page, size = struct.unpack_from("<5d2Q", header.head.ljust(at + 160, b"\0"), at)
    with reading_errors(header.path), header.open() as (file, _):
        entries = np.sort(_entries(header, file, page, size), order=("offset", "size", "points"))
        start, length, points = (entries[name].astype(np.int64) for name in ("offset", "size", "points"))
        complete = points.sum() == header.count and (start[1:] >= start[:-1] + length[:-1]).all()
        if not remote:
            chunks = chunk_table(header, file)
            complete = np.array_equal(chunks[:, chunks[2] > 0], np.stack([start, length, points]))
        if not complete:
            words = "the octree does not name the chunks that are in the table of chunks; it is damaged"
            raise InputError(f"{header.path}: {words}: read the file without bounds")
        first = None if remote else pieces(header, file, start, 12).view("<i4") * header.scales + header.offsets
    found, key = Runs.of_chunks(start, length, points), entries["key"]
    with np.errstate(over="ignore", invalid="ignore"):
        edge = 2 * half / 2.0 ** key[:, :1]
        low = np.array(centre) - half + key[:, 1:] * edge - header.scales  # cubes are rounded by some writers
        high = np.array(centre) - half + (key[:, 1:] + 1) * edge + header.scales
    if first is not None and not ((first >= low) & (first <= high)).all():
        what = "points lie outside the cubes of its octree, so all of it is read to find those within bounds"
        warn(f"{header.path}: {what}")
        return found
    return dataclasses.replace(found, low=low[:, :2], high=high[:, :2])


def _entries(header: Header, file: BinaryIO, page: int, size: int) -> np.ndarray:
    """The entries of all pages that are of nodes with points."""
    found, pages, seen = [np.zeros(0, ENTRY)], [(page, size)], set()
    while pages:
        page, size = pages.pop()
        if page in seen or size % ENTRY.itemsize or page + size > header.identity.size:
            raise InputError(f"{header.path}: page of the octree at byte {page}, {size} bytes long, is damaged")
        seen.add(page)
        file.seek(page)
        entries = np.frombuffer(file.read(size), ENTRY)
        level, points, length = entries["key"][:, 0], entries["points"], entries["size"]
        end = entries["offset"].astype(np.float64) + length
        if not ((level >= 0) & (level < 64) & (length >= 0) & (points >= -1) & (end <= header.identity.size)).all():
            raise InputError(f"{header.path}: entry of the octree's page at byte {page} is damaged")
        pages += entries[points == -1][["offset", "size"]].tolist()
        found.append(entries[points > 0])
    return np.concatenate(found)


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
    source = header.open() if file is None else contextlib.nullcontext((file, header.identity))
    with reading_errors(header.path), source as (file, _):
        if runs is None:
            runs = nodes(header) if header.is_copc and bounds is not None else Runs.of_file(header, file)
        for group in (runs if bounds is None else runs.meeting(bounds)).groups(POINTS_AT_ONCE):
            points, numbers = decode(header, file, group, fields), group.records
            if bounds is not None:
                if header.is_copc:  # points outside the cubes of their nodes: others of the box may be missing
                    low, high = (ends[:, :2] * header.scales[:2] + header.offsets[:2] for ends in _ends(group, points))
                    if not ((low >= group.low) & (high <= group.high)).all():
                        words = "points lie outside the cubes of its octree, so those of a box cannot be found"
                        raise InputError(f"{header.path}: {words}: read all of it, without bounds, and write it anew")
                kept = inside(coordinates(points, header, 2), bounds)
                points, numbers = points[kept], numbers[kept]
            yield points, numbers


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
    lazrs.decompress_points_with_chunk_table(packed, header.laszip, records, table, fields.to_lazrs())
    return Points.from_buffer(records, format_of(header))


def format_of(header: Header) -> laspy.PointFormat:
    """The point format, with all extra bytes as one dimension ``ExtraBytes``."""
    form, extra = laspy.PointFormat(header.point_format), header.record_length - RECORD_LENGTHS[header.point_format]
    if extra:
        form.add_extra_dimension(laspy.ExtraBytesParams("ExtraBytes", f"{extra}u1"))
    return form


def dimensions_of(point_format: int) -> dict[str, int]:
    """Bits of the dimensions of a point format, by laspy's names."""
    return {one.name: one.num_bits for one in laspy.PointFormat(point_format).dimensions}


def measure(header: Header) -> tuple[Runs, np.ndarray]:
    """The runs of records of a file with the areas that their points cover, and lowest and highest x, y, z of all, f64[2, 3]:
    by a pass over the file. Raises: InputError."""
    ends = [np.zeros((2, 0, 3), np.int32)]
    with reading_errors(header.path), header.open() as (file, _):
        runs = Runs.of_file(header, file)
        for group in runs.groups(POINTS_AT_ONCE):
            ends.append(_ends(group, decode(header, file, group, CLOUD)))
    low, high = np.concatenate(ends, axis=1) * header.scales + header.offsets
    extent = np.stack([low.min(axis=0), high.max(axis=0)]) if len(low) else np.full((2, 3), np.nan)
    return dataclasses.replace(runs, low=low[:, :2], high=high[:, :2]), extent


def sample_points(header: Header, file: BinaryIO) -> tuple[Points, np.ndarray]:
    """The records of :func:`jaxfilter.core.echoes.sample`, with GPS times: all of a small file. And lowest and highest x, y, z,
    f64[2, 3], of these, and of more of a large file on a disk: the first of each chunk of LAZ, and some of LAS."""
    found = Runs.of_file(header, file)
    taken = np.zeros_like(found.points)  # from the beginning of each run
    for part in sample(header.count):
        at = slice(np.searchsorted(found.first, part.start, "right") - 1, np.searchsorted(found.first, part.stop))
        taken[at] = np.minimum(found.points[at], part.stop - found.first[at])
    size = found.size if header.compressed else taken * header.record_length
    some = dataclasses.replace(found, size=size, points=taken)[taken > 0]
    points = decode(header, file, some, CLOUD.decompress_gps_time())
    ticks = integers(points)
    if len(points) < header.count and not isinstance(header.path, Remote):
        ticks = np.concatenate([ticks, pieces(header, file, found.start, 12).view("<i4")])
    xyz = ticks * header.scales + header.offsets
    return points, np.stack([xyz.min(axis=0), xyz.max(axis=0)])


def first_points(header: Header) -> np.ndarray:
    """f64[n, 2], file units: the first point of each run of records, which are all over the file and soon found."""
    with reading_errors(header.path), header.open() as (file, _):
        ticks = pieces(header, file, Runs.of_file(header, file).start, 12).view("<i4")
    return ticks[:, :2] * header.scales[:2] + header.offsets[:2]


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
                file, _ = stack.enter_context(opened(self.path, self.header.identity, CHANGED_SINCE))
            except OSError as error:
                lost = f"{self.path}: the source of the cloud cannot be read again: {error.strerror}"
                raise InputError(f"{lost}; put it back, or read it again where it is now") from error
            yield file


class Writer:
    """Writes the points of a file once more: its header and records as they are, but for what is known of the points only
    when all are written, and what follows its points.

    Args:
        file: binary, empty; read and written.
        header: of the file; its variable length records are copied.
        compressed: LAZ instead of LAS.
        extra: names and descriptions of float32 dimensions that are added.
        crs: number and data of a record that takes the place of those that state a CRS.
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
        number, length = header.point_format, header.record_length + 4 * len(extra)
        laszip = laszip_record(number, length - RECORD_LENGTHS[number])
        records = [*_kept_records(header, extra, crs), *([vlr(*LASZIP, laszip)] if compressed else [])]
        size = max(header.size, HEADER_LENGTHS[header.version])  # LAS 1.3 may come with the header of LAS 1.2
        self.head = bytearray(header.head[: header.size].ljust(size, b"\0"))
        if crs is not None and crs[0] == WKT:
            self.head[6] |= 16
        start = size + sum(map(len, records))
        struct.pack_into("<H2I", self.head, 94, size, start, len(records))
        struct.pack_into("<BH", self.head, 104, number | 0x80 * compressed, length)
        file.write(self.head + b"".join(records))
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._returns, self._count = np.zeros(15, np.int64), 0
        self._output, self._coder = _Output(file), None
        if compressed:
            need_threads()
            self._coder = self._output.encode(lazrs.ParLasZipCompressor, self._output, lazrs.LazVlr(laszip))

    def write(self, points: Points, columns: dict[str, np.ndarray]) -> None:
        """Append points, with the dimensions that are added, f32[n] each. Raises: OSError."""
        if not len(points):
            return
        axes = [points.array[axis] for axis in "XYZ"]
        self._low = np.minimum(self._low, [ticks.min() for ticks in axes])
        self._high = np.maximum(self._high, [ticks.max() for ticks in axes])
        self._returns += np.bincount(np.asarray(points.return_number), minlength=16)[1:16]
        self._count += len(points)
        data = points.array.view(np.uint8).reshape(len(points), -1)
        if self.extra:
            new = np.stack([columns[name] for name in self.extra], axis=1).astype("<f4").view(np.uint8)
            data = np.concatenate([data, new], axis=1)
        if self._coder is None:
            self.file.write(data.data)
        else:
            self._output.encode(self._coder.compress_many, data.reshape(-1))

    def finish(self, source: BinaryIO | None) -> None:
        """Complete the points and the header, and append what follows the points of the file ``source``. Raises: OSError."""
        if self._coder is not None:
            self._output.encode(self._coder.done)
        header, head = self.header, self.head
        ends = np.stack([self._high, self._low]) * header.scales + header.offsets if self._count else np.zeros((2, 3))
        struct.pack_into("<6d", head, 179, *ends.T.reshape(-1))
        known = header.version < 4 or (header.point_format < 6 and self._count < 2**32)
        struct.pack_into("<6I", head, 107, *(self._count, *self._returns[:5].tolist()) if known else [0] * 6)
        if header.version >= 4:
            struct.pack_into("<QI16Q", head, 235, 0, 0, self._count, *self._returns.tolist())
        if source is not None:
            self._copy_tail(source)
        self.file.seek(0)
        self.file.write(head)

    def _copy_tail(self, file: BinaryIO) -> None:
        """Append what follows the points of a file, and put into the header where that lies."""
        source, at = self.header, self.file.seek(0, 2)
        kept, starts = without_octree(source, source.evlrs), {227: 0} if source.version >= 3 else {}
        if len(kept) < len(source.evlrs):
            starts |= {235: at} if kept else {}
            for record in kept:
                file.seek(record.start)
                self.file.write(file.read(record.end - record.start))
        else:
            file.seek(source.tail)
            shutil.copyfileobj(file, self.file, 2**20)
            for field, start in ((227, source.waveform_start), (235, source.evlr_start)):
                if start and source.tail <= start <= source.identity.size:
                    starts[field] = start + at - source.tail
        for field, start in starts.items():
            struct.pack_into("<Q", self.head, field, start)
        if kept:
            struct.pack_into("<I", self.head, 243, len(kept))


def _kept_records(header: Header, extra: dict[str, str], crs: tuple[int, bytes] | None) -> Iterator[bytes]:
    """The variable length records of an output, as bytes."""
    dropped = {LASZIP, *(CRS_RECORDS if crs is not None else ())}
    kept = [record for record in without_octree(header, header.vlrs) if record.key not in dropped]
    if extra:
        if (known := header.extra_dimensions()) is None:
            raise OutputError(f"{header.path}: the description of its extra bytes is damaged, so none can be added")
        undescribed = header.record_length - RECORD_LENGTHS[header.point_format] - sum(one.size for one in known)
        entries = [(f"undescribed {i + 1}", 1, "") for i in range(undescribed)]
        entries += [(name, 9, words) for name, words in extra.items()]
        data = [header.head[record.payload : record.end] for record in kept if record.key == EXTRA_BYTES]
        data += [
            struct.pack("<HBB32s124x32s", 0, kind, 0, name.encode(), text.encode()) for name, kind, text in entries
        ]
        if len(described := b"".join(data)) > 65_535:
            raise OutputError(f"{header.path}: its points have too many extra bytes: one record cannot describe more")
        yield vlr(*EXTRA_BYTES, described)  # readers look at one record only
    for record in kept:
        if not extra or record.key != EXTRA_BYTES:
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
        def call(*arguments: Any) -> Any:
            try:
                return getattr(self.file, name)(*arguments)
            except BaseException as error:  # a full disk, or a signal
                self.error = error
                raise

        return call

    def encode(self, function: Callable[..., _T], *arguments: Any) -> _T:
        """What a function of the encoder returns. Raises: what the file raised."""
        try:
            return function(*arguments)
        except lazrs.LazrsError as error:
            raise self.error or OSError(str(error)) from error
