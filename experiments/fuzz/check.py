"""What becomes of a file: refused, or labels whose file reads back equal. Anything else is Wrong."""

from __future__ import annotations

import re
import struct
import warnings
from pathlib import Path
from typing import Any

import laspy
import numpy as np

import jaxfilter as jf
from jaxfilter.core.frame import LARGEST_SPAN, QUANTUM

REFUSED, EQUAL = "refused", "equal"
CLASS_BYTE = (15, 16)  # in a point record, of formats 0 to 5 and 6 to 10


class Wrong(Exception):
    """A result that is neither an error of jaxfilter nor right."""


def outcome(path: Path, number: int, filtered: bool = False) -> tuple[str, str]:
    """Read, label, write and read back a file, in ways that depend on ``number``.

    Args:
        path: the file, which may be damaged in any way.
        number: decides on bounds, units, what is dropped, and on the format of the output.
        filtered: label with SMRF instead of by the numbers of the points.

    Returns: :data:`REFUSED` and the message, or :data:`EQUAL` and what was compared.
    Raises: Wrong; or whatever else goes wrong.
    """
    options: dict[str, Any] = {
        "units": "m" if number % 2 else None,
        "drop_invalid": number % 5 == 0,
        "returns": "all" if number % 4 == 0 else "last,only",
    }
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            cloud = jf.read(path, **options)
        except jf.JaxfilterError as error:
            return REFUSED, _named(error, path)
    _check_cloud(cloud)
    said = " ".join(str(w.message) for w in caught)
    las = cloud.source.kind == "las"
    if las:
        _check_against_laspy(path, cloud, said)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if number % 3 == 0 and len(cloud):
            _check_bounds(path, cloud, options, number)
        ground = np.random.default_rng(number).random(len(cloud)) < 0.5
        if filtered:
            try:
                ground = jf.SMRF()(cloud).ground
            except jf.JaxfilterError as error:
                return REFUSED, str(error)
            if (ground & ~cloud.candidate).any() or ground.shape != (len(cloud),):
                raise Wrong("points that are set aside are ground")
        own = ".las" if path.suffix == ".laz" and number % 2 else path.suffix
        suffix = own if number % 7 else ".csv" if las else ".laz"
        target = path.with_name(f"out{suffix}")
        target.unlink(missing_ok=True)
        try:
            jf.write(target, cloud, ground)
        except jf.JaxfilterError as error:
            if target.exists() or len(list(path.parent.glob("*.part"))):
                raise Wrong(f"an output is there after {error}") from error
            return REFUSED, str(error)
        try:
            again = jf.read(target, **(options | {"units": cloud.units}))
        except jf.JaxfilterError as error:
            raise Wrong(f"the output cannot be read: {error}") from error
    _compare(cloud, ground, again, las, suffix)
    if las and path.suffix == target.suffix == ".las" and path.read_bytes()[104] < 128:
        _compare_bytes(path.read_bytes(), target.read_bytes(), cloud)
    if not las and suffix == own:
        _compare_lines(path.read_bytes(), target.read_bytes())
    return EQUAL, suffix


def _named(error: jf.JaxfilterError, path: Path) -> str:
    if str(path) not in str(error):
        raise Wrong(f"an error without the name of the file: {error}") from error
    return str(error).replace(str(path), "FILE")


def _check_cloud(cloud: jf.PointCloud) -> None:
    n = len(cloud)
    if not (np.isfinite(cloud.xyz).all() and np.isfinite(cloud.origin).all()):
        raise Wrong("coordinates that are not finite")
    if n and (np.ptp(cloud.xyz, axis=0) > LARGEST_SPAN).any():
        raise Wrong(f"an extent of {np.ptp(cloud.xyz, axis=0).tolist()} m")
    if not (1e-3 <= cloud.units.xy <= 1e4 and 1e-3 <= cloud.units.z <= 1e4):
        raise Wrong(f"units {cloud.units}")
    for name in ("classification", "return_number", "number_of_returns", "withheld", "candidate", "reference", "valid"):
        values = getattr(cloud, name)
        if values is not None and len(values) != n:
            raise Wrong(f"{name} of length {len(values)} for {n} points")
    if cloud.valid is not None and (cloud.candidate & ~cloud.valid).any():
        raise Wrong("invalid points that are candidates")


def _check_against_laspy(path: Path, cloud: jf.PointCloud, said: str) -> None:
    """Points and attributes as laspy sees them, if it can read the file."""
    if _chunk_size(path) > 10_000_000:  # laspy takes memory for a whole chunk, whatever the file holds, and dies of it
        return
    try:
        las = laspy.read(path)
        columns = {name: np.asarray(las[name]) for name in ("classification", "return_number", "number_of_returns")}
        ticks = np.stack([las.X, las.Y, las.Z], axis=1).astype(np.float64)
        with np.errstate(all="ignore"):
            xyz = ticks * las.header.scales + las.header.offsets
    except BaseException as error:
        if isinstance(error, (KeyboardInterrupt, MemoryError)):
            raise
        return
    if len(las.points) != len(cloud):
        if "announces" in said:
            return
        raise Wrong(f"{len(cloud)} points, laspy reads {len(las.points)}")
    valid = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid
    if not valid.any():
        return
    factor = np.array([cloud.units.xy, cloud.units.xy, cloud.units.z])
    off = (abs(cloud.coordinates() - xyz) * factor)[valid]
    allowed = (
        0.51 * QUANTUM + np.spacing(np.float32(cloud.xyz.max())) + 4 * np.spacing(abs(xyz[valid]).max()) * factor.max()
    )
    if (off > allowed).any():
        raise Wrong(f"coordinates differ from laspy's by {off.max():g} m")
    for name, values in columns.items():
        if not np.array_equal(getattr(cloud, name), values):
            raise Wrong(f"{name} differs from laspy's")


def _chunk_size(path: Path) -> int:
    """Points of a chunk as the laszip record says; 0 if there is none, or if chunks vary in size."""
    content = path.read_bytes()
    at = content.find(b"laszip encoded", 0, struct.unpack_from("<I", content, 96)[0])
    size = struct.unpack_from("<I", content, at + 52 + 12)[0] if 0 <= at <= len(content) - 68 else 0
    return 0 if size == 2**32 - 1 else size


def _check_bounds(path: Path, cloud: jf.PointCloud, options: dict[str, Any], number: int) -> None:
    """Within bounds are those points of the whole that lie there, in their order or, for COPC, in any.

    A point that damage has moved out of its node of an octree is found only where the node is read.
    """
    xy = cloud.coordinates()[:, :2]
    rng = np.random.default_rng(number)
    step = QUANTUM / cloud.units.xy
    a, b = np.sort(xy[rng.integers(len(xy), size=2)], axis=0) + [[-0.4137 * step], [0.5123 * step]]
    if not (a < b).all():
        return
    try:
        part = jf.read(path, bounds=(*a, *b), **(options | {"units": cloud.units}))
    except jf.JaxfilterError as error:
        _named(error, path)
        return
    near = (abs(xy - a) < step).any(axis=1) | (abs(xy - b) < step).any(axis=1)  # known to half a step
    inside = ((xy >= a) & (xy < b)).all(axis=1)
    if cloud.valid is not None:
        inside, near = inside & cloud.valid, near | ~cloud.valid
    least = 0 if cloud.source.format.startswith("COPC") else int((inside & ~near).sum())
    if not least <= len(part) <= int((inside | near).sum()):
        raise Wrong(f"{len(part)} points within bounds that enclose {int(inside.sum())}")


def _compare(cloud: jf.PointCloud, ground: np.ndarray, again: jf.PointCloud, las: bool, suffix: str) -> None:
    """The cloud that was written and the one that was read back."""
    if len(again) != len(cloud):
        raise Wrong(f"{len(again)} points of {len(cloud)} come back")
    if not len(cloud):
        return
    _check_cloud(again)
    for one, other in ((cloud, again), (again, cloud)):
        if one.valid is not None and not np.array_equal(
            one.valid, np.ones(len(one), bool) if other.valid is None else other.valid
        ):
            raise Wrong("other points are invalid")
    same_format = las == (suffix in (".las", ".laz"))
    if same_format and not (
        again.xyz.tobytes() == cloud.xyz.tobytes() and again.origin.tolist() == cloud.origin.tolist()
    ):
        raise Wrong("coordinates differ")
    valid = slice(None) if cloud.valid is None else cloud.valid
    factor = np.array([cloud.units.xy, cloud.units.xy, cloud.units.z])
    off = abs((again.coordinates() - cloud.coordinates()) * factor)[valid]
    allowed = 2 * QUANTUM + 0.0006 * factor.max() + np.spacing(np.ptp(cloud.xyz)) * 4
    if (off > allowed).any():
        raise Wrong(f"coordinates differ by {off.max():g} m")
    if suffix not in (".las", ".laz"):
        labelled = not same_format or cloud.classification is None or "label" in cloud.source.format
        if labelled and (again.reference is None or not np.array_equal(again.reference, ground)):
            raise Wrong("labels differ")
        if labelled:
            return
    old = np.zeros(len(cloud), np.uint8) if cloud.classification is None else cloud.classification
    other = np.where(cloud.candidate & np.isin(old, (0, 2)), 1, old)
    if not np.array_equal(again.classification, np.where(cloud.candidate & ground, 2, other)):
        raise Wrong("classes differ")
    for name in ("return_number", "number_of_returns", "withheld"):
        before = getattr(cloud, name)
        if before is not None and not np.array_equal(before, getattr(again, name)):
            raise Wrong(f"{name} differs")


def _compare_bytes(before: bytes, after: bytes, cloud: jf.PointCloud) -> None:
    """Uncompressed LAS differs in class bytes of candidates only."""
    old, new = np.frombuffer(before, np.uint8), np.frombuffer(after, np.uint8)
    if len(old) != len(new):
        raise Wrong(f"{len(new)} bytes of {len(old)} come back")
    start, kind, length = struct.unpack_from("<I4xBH", before, 96)
    changed = np.flatnonzero(old != new) - start
    row, place = changed // length, changed % length
    if not len(changed):
        return
    if changed.min() < 0 or row.max() >= len(cloud) or (place != CLASS_BYTE[kind % 64 >= 6]).any():
        raise Wrong("other bytes than classes differ")
    if not cloud.candidate[row].all():
        raise Wrong("classes of points that are set aside differ")


def _compare_lines(before: bytes, after: bytes) -> None:
    """Text keeps its lines and cells: but for blanks and quotes, and one or two cells that change or are added."""
    old, new = (re.split(rb"\r\n|\r|\n", text) for text in (before, after))
    while old and not old[-1]:
        old.pop()
    while new and not new[-1]:
        new.pop()
    if len(old) != len(new):
        raise Wrong(f"{len(new)} lines of {len(old)} come back")
    for one, other in zip(*([re.sub(rb'[ \t"]+', b"", line) for line in lines] for lines in (old, new)), strict=True):
        head = next((i for i, (p, q) in enumerate(zip(one, other, strict=False)) if p != q), min(len(one), len(other)))
        if head < len(one) and len(other) - len(one) > 3:
            raise Wrong(f"a line has grown: {one[:60]!r}, {other[:60]!r}")
