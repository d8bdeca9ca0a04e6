"""Damaged files of points: each is refused, or read as it should be, soon; see mutants.py for the damages.

``--slow`` tries 10,000 of them, another number with the environment variable JAXFILTER_MUTANTS, and other ones with
JAXFILTER_SEED; -s prints how many were refused. A file that fails lies in the folder of the test.
"""

from __future__ import annotations

import collections
import logging
import os
import re
import struct
import warnings
from pathlib import Path

import mutants
import numpy as np
import pytest

import jaxfilter as jf

MUTANTS = int(os.environ.get("JAXFILTER_MUTANTS", 10_000)) // len(mutants.KINDS)  # of each kind, with --slow
FEW, PART = 80, 250  # without it; in a test
SEED = int(os.environ.get("JAXFILTER_SEED", 7))
QUANTUM = 2.0**-10  # metres: steps of coordinates
REFUSED, RIGHT = "refused", "right"


class Wrong(Exception):
    """A cloud that is not the one in the file, or an error that does not name the file."""


def judge(sound: mutants.Sound, path: Path, number: int) -> tuple[str, str]:
    """Read a file, write what was read and read that: REFUSED or RIGHT, and a message. ``number`` chooses options of reading.
    Raises Wrong, or whatever else goes wrong."""
    logging.disable(logging.ERROR)  # laspy logs what it also raises
    options = {"units": "m" if number % 2 else None, "drop_invalid": number % 5 == 0}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            cloud = jf.read(path, **options)
        except jf.JaxfilterError as error:
            return REFUSED, named(error, path)
    said = [named(one.message, path) for one in caught if issubclass(one.category, jf.JaxfilterWarning)]
    known = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid
    if not np.isfinite(cloud.coordinates()[known]).all() or (cloud.candidate & ~known).any():
        raise Wrong("points without coordinates")
    if sound.kind == "text":
        of_text(sound, path.read_bytes(), cloud)
    else:
        of_las(sound, path.read_bytes(), cloud, any(re.search(r"\d points", one) for one in said))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        options["units"] = cloud.units
        if number % 3 == 0 and known.any():
            within(path, cloud, options, number)
        return come_back(path, cloud, options, number)


def named(error: Exception | str, path: Path) -> str:
    if str(path) not in str(error):
        raise Wrong(f"a message that does not name the file: {error}")
    return str(error)


def allowed(cloud: jf.PointCloud, xyz: np.ndarray) -> np.ndarray:
    """f64[3]: how far coordinates may be off in units of the file, by rounding."""
    factor = np.array([cloud.units.xy, cloud.units.xy, cloud.units.z])
    local = np.spacing(np.abs(cloud.xyz).max(axis=0, initial=0.0))
    return (0.51 * QUANTUM + local) / factor + 4 * np.spacing(np.abs(xyz).max(axis=0, initial=0.0))


def of_las(sound: mutants.Sound, content: bytes, cloud: jf.PointCloud, said: bool) -> None:
    """Points are those of the records in the file, and all of them unless it is ``said`` how many are read. Those of compressed
    chunks that are damaged may be any."""
    start, kind, length, legacy = struct.unpack_from("<I4xBHI", content, 96)
    announced = {legacy, *(struct.unpack_from("<Q", content, 247) if content[25] >= 4 else ())}
    n = len(cloud)
    if not said and (n not in announced or (n != len(sound.records) and announced != {0})):
        raise Wrong(f"{n} points of {len(sound.records)}, and no warning")
    if kind & 0x80:
        records, known = sound.records[:n], undamaged(sound, content, start)[:n]
        n = len(records)
    elif start + n * length <= len(content):
        records, known = np.frombuffer(content, np.uint8, n * length, start).reshape(n, length), np.ones(n, bool)
    else:
        raise Wrong(f"{n} points of {length} bytes in {len(content)} bytes from {start}")
    echoes, classes, mask, withheld = (4, 16, 0xFF, 2) if kind & 0x3F > 5 else (3, 15, 0x1F, 7)
    expected = {
        "return_number": records[:, 14] & (1 << echoes) - 1,
        "number_of_returns": records[:, 14] >> echoes & (1 << echoes) - 1,
        "withheld": records[:, 15] >> withheld & 1,
        "classification": records[:, classes] & mask,
    }
    for name, values in expected.items():
        if not np.array_equal(getattr(cloud, name)[:n][known], values[known]):
            raise Wrong(f"{name} is another")
    known = known & (True if cloud.valid is None else cloud.valid[:n])
    if known.any():
        ticks = np.ascontiguousarray(records[:, :12]).view("<i4")[known]
        scales, offsets = np.array(struct.unpack_from("<6d", content, 131)).reshape(2, 3)
        xyz = ticks * scales + offsets
        off = np.abs(cloud.coordinates()[:n][known] - xyz)
        if (off > allowed(cloud, xyz)).any():
            raise Wrong(f"coordinates are off by {off.max(axis=0).tolist()}")


def undamaged(sound: mutants.Sound, content: bytes, start: int) -> np.ndarray:
    """bool[n]: points of chunks whose compressed bytes are as they were. The sizes of their layers do not count: a reader that
    believes wrong ones reads other points."""
    if not sound.chunks:  # the head of LAZ in place of that of LAS
        return np.zeros(len(sound.records), bool)
    at, known, layers = 8, [], sound.layers()
    for i, (count, size) in enumerate(sound.chunks):
        before, after = sound.content[sound.start + at :][:size], content[start + at :][:size]
        if layers:
            first = layers[i][0] - sound.start - at
            last = first + 4 * layers[i][1]
            before, after = before[: first - 4] + before[last:], after[: first - 4] + after[last:]
        known += [before == after] * count
        at += size
    return np.array(known)[: len(sound.records)]


def of_text(sound: mutants.Sound, content: bytes, cloud: jf.PointCloud) -> None:
    """Every line that is as it was has its point and label, unless other columns may have got the names of the coordinates."""
    lines = content.splitlines()
    if len(cloud) > len([line for line in lines if line.strip()]):
        raise Wrong(f"{len(cloud)} points in {len(lines)} lines")
    if lines[:2] != sound.content.splitlines()[:2]:
        return
    xyz, ground = cloud.coordinates(), np.zeros(len(cloud), bool) if cloud.reference is None else cloud.reference
    for *point, label in (sound.rows[line] for line in lines if line in sound.rows):
        there = (np.abs(xyz - point) <= allowed(cloud, xyz)).all(axis=1)
        if not (ground[there] == label).any():
            raise Wrong(f"no point at {point} with label {label}")


def within(path: Path, cloud: jf.PointCloud, options: dict, number: int) -> None:
    """Within bounds are those points of the whole that lie there. A point that damage has moved out of its node of an octree
    is found only where the node is read."""
    xy = cloud.coordinates()[:, :2]
    step = allowed(cloud, cloud.coordinates())[:2] + QUANTUM / cloud.units.xy
    pair = np.random.default_rng(number).integers(len(xy), size=2)
    low, high = np.sort(xy[pair], axis=0) + np.outer([-0.41, 0.51], step)
    if not (np.isfinite([low, high]).all() and (low < high).all()):
        return
    try:
        part = jf.read(path, bounds=(*low, *high), **options)
    except jf.JaxfilterError as error:
        named(error, path)
        return
    inside = np.minimum((xy - low) / step, (high - xy) / step).min(axis=1)
    valid = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid  # others may be near to those of the part
    least = 0 if cloud.source.format.startswith("COPC") else ((inside > 1) & valid).sum()
    most = ((inside > -1) | ~valid).sum()
    if not least <= len(part) <= most:
        raise Wrong(f"{len(part)} points within bounds that enclose {least} to {most}")


def come_back(path: Path, cloud: jf.PointCloud, options: dict, number: int) -> tuple[str, str]:
    """A file that is written from the cloud has its points and its labels; or nothing is written."""
    suffix = path.suffix if number % 7 else ".laz" if path.suffix in (".txt", ".xyz", ".csv") else ".csv"
    ground, target = np.random.default_rng(number).random(len(cloud)) < 0.5, path.with_name(f"out{suffix}")
    target.unlink(missing_ok=True)
    try:
        jf.write(target, cloud, ground)
    except jf.JaxfilterError as error:
        if target.exists():
            raise Wrong(f"an output is there after {error}") from error
        return REFUSED, str(error)
    again = jf.read(target, **options)
    known = slice(None) if cloud.valid is None else cloud.valid
    if len(again) != len(cloud):
        raise Wrong(f"{len(again)} points of {len(cloud)} come back")
    xyz = cloud.coordinates()[known]
    off, most = np.abs(again.coordinates()[known] - xyz), 3 * allowed(cloud, xyz) + 0.0006
    if (off > most).any():
        raise Wrong(f"coordinates come back {off.max(axis=0).tolist()} off")
    labels = again.classification == 2 if again.reference is None else again.reference
    if len(cloud) and not np.array_equal(labels[cloud.candidate], ground[cloud.candidate]):
        raise Wrong("labels come back as others")
    return RIGHT, suffix


@pytest.fixture(scope="module")
def sounds(tmp_path_factory):
    return mutants.sound_files(tmp_path_factory.mktemp("sound"))


@pytest.fixture(scope="module")
def worker():
    worker = mutants.Worker(judge)
    yield worker
    worker.close()


def test_sound_files_are_read_right(tmp_path, sounds, worker):
    for number, sound in enumerate(sounds):
        path = tmp_path / sound.name
        path.write_bytes(sound.content)
        outcome, detail = worker(sound, path, 2 * number + 1)
        assert outcome == RIGHT or "scanner channels" in detail, (sound.name, outcome, detail)


@pytest.mark.parametrize("first", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(PART, MUTANTS, PART))])
@pytest.mark.parametrize("kind", mutants.KINDS)
def test_damaged_files_are_refused_or_read_right(tmp_path, sounds, worker, request, kind, first):
    last = min(first + PART, MUTANTS) if request.config.getoption("--slow") else FEW
    outcomes, failures = collections.Counter(), []
    for i in range(first, last):
        sound, damages, content = mutants.mutant(sounds, kind, SEED, i)
        path = tmp_path / f"in{Path(sound.name).suffix}"
        path.write_bytes(content)
        outcome, detail = worker(sound, path, i)
        outcomes[outcome] += 1
        if outcome not in (REFUSED, RIGHT):
            path.rename(path.with_stem(str(i)))
            failures.append(f"{i}: {sound.name}, {damages}: {outcome}: {detail}")
    print(f"{kind} {first}: {dict(outcomes)}")
    assert not failures, "\n".join([f"{dict(outcomes)} in {tmp_path}", *failures[:30]])
    assert min(outcomes[REFUSED], outcomes[RIGHT]) > 0.05 * (last - first)


COMPRESSED = ("layers", "between layers", "chunks", "table", "laszip")


def our_records(path: Path, length: int) -> tuple[str, str]:
    """The bytes of all points, as they are written once more."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            target = path.with_name("plain.las")
            target.unlink(missing_ok=True)
            jf.write(target, jf.read(path, units="m", drop_invalid=True), None)
        except jf.JaxfilterError as error:
            return REFUSED, named(error, path)
    content = target.read_bytes()
    start, count = struct.unpack_from("<I", content, 96)[0], struct.unpack_from("<I", content, 107)[0]
    if content[25] >= 4:
        count = struct.unpack_from("<Q", content, 247)[0]
    return RIGHT, content[start : start + count * length].hex()


def laszip_records(path: Path, length: int) -> tuple[str, str]:
    """The same by LASzip."""
    import laszip

    with open(path, "rb") as file:
        try:
            decoder = laszip.LasUnZipper(file)
            count = decoder.header.extended_number_of_point_records or decoder.header.number_of_point_records
            records = np.zeros(min(count, 10_000) * length, np.uint8)
            decoder.decompress_into(records)
        except Exception as error:
            return REFUSED, str(error)
    return RIGHT, records.tobytes().hex()


@pytest.mark.parametrize("first", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(PART, 5000, PART))])
def test_compressed_points_are_those_of_laszip(tmp_path, sounds, request, first):
    """Of files whose layers, chunks or laszip record are damaged: what LASzip reads, or those of the sound file, or none."""
    pytest.importorskip("laszip", reason="laszip is not installed: nothing is compared with it")
    ours, theirs, failures = mutants.Worker(our_records), mutants.Worker(laszip_records), []
    outcomes: collections.Counter[str] = collections.Counter()
    for number in range(first, first + (PART if request.config.getoption("--slow") else FEW)):
        sound, damages, content = mutants.mutant(sounds, ("laz", "copc")[number % 5 == 0], SEED, number, COMPRESSED)
        path, length = tmp_path / "in.laz", sound.records.shape[1]
        path.write_bytes(content)
        outcome, found = ours(path, length)
        outcomes[outcome] += 1
        if outcome == RIGHT and found != sound.records.tobytes().hex():
            outcome = RIGHT if theirs(path, length) == (RIGHT, found) else "other points than LASzip's"
        if outcome not in (REFUSED, RIGHT):
            path.rename(path.with_stem(str(number)))
            failures.append(f"{number}: {sound.name}, {damages}: {outcome}: {found[:200]}")
    ours.close()
    theirs.close()
    print(f"compressed {first}: {dict(outcomes)}")
    assert not failures, "\n".join(failures)
    assert min(outcomes[REFUSED], outcomes[RIGHT]) > 0


@pytest.mark.parametrize("kind", ["las", "laz", "text"])
def test_the_judge_sees_what_is_wrong(tmp_path, sounds, monkeypatch, kind):
    """Readers that change a coordinate or a label, or lose points; a writer that changes labels."""
    sound = next(one for one in sounds if one.kind == kind and one.name[0] in "6i")
    path, read, write = tmp_path / sound.name, jf.read, jf.write
    path.write_bytes(sound.content)
    assert judge(sound, path, 1)[0] == RIGHT

    def other(field, change):
        def reads(source, **options):
            cloud = read(source, **options)
            values = getattr(cloud, field).copy()
            values[3] = change(values[3])
            object.__setattr__(cloud, field, values)
            return cloud

        return reads

    low, high = (part(read(path).coordinates()[:, :2], axis=0) for part in (np.median, np.max))
    label = other("reference", np.invert) if kind == "text" else other("return_number", np.invert)
    part = lambda source, **options: read(source, bounds=(*low, *high), **options)  # noqa: E731
    for reads in (other("xyz", lambda one: one + 1), other("xyz", lambda one: one * np.inf), label, part):
        with monkeypatch.context() as patch, pytest.raises(Wrong):
            patch.setattr(jf, "read", reads)
            judge(sound, path, 1)
    monkeypatch.setattr(jf, "write", lambda target, cloud, ground: write(target, cloud, ~ground))
    with pytest.raises(Wrong):
        judge(sound, path, 1)


def test_what_hangs_dies_or_takes_too_much_is_seen():
    worker = mutants.Worker(eval, seconds=3.0, memory=2**28)
    assert worker("'right', str(1 + 1)") == (RIGHT, "2")
    assert [worker(one)[0] for one in ("1 / 0", "bytes(2**32)")] == ["ZeroDivisionError", "MemoryError"]
    assert worker("__import__('time').sleep(60)")[0] == "killed"
    assert worker("__import__('os').kill(__import__('os').getpid(), 11)")[0] == "died"
    worker.close()
