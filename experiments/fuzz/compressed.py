"""LAZ with damaged layer sizes, chunk tables and laszip records, read by jaxfilter and by LASzip, the reference decoder.

Each reader has a process of its own, with a limit on memory, which is replaced when it dies or does not answer.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import io
import multiprocessing
import resource
import shlex
import struct
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments import report
from experiments.fuzz import mutations
from jaxfilter.core.errors import JaxfilterError
from jaxfilter.files.header import RECORD_LENGTHS, read_header
from jaxfilter.files.reading import read
from jaxfilter.files.records import read_records, reading_errors

REFUSED, SAME, OTHER, SOUND, FAILURE = "refused", "as LASzip", "other", "as before", "failure"
"""Outcomes: an error that names the file; the points of LASzip, which are those of the sound file, or others; LASzip does not
read it, and the points are those of the sound file; anything else."""

MEMORY, SECONDS = 4 * 2**30, 60.0
"""Bytes of address space and time that a reader may take for a file."""

Records = np.ndarray | str
"""Point records, u8[n, length], or why there are none."""


@dataclasses.dataclass
class Laz:
    """A LAZ file in its parts: what precedes the points, the bytes of each chunk and its number of points."""

    head: bytearray
    chunks: list[bytearray]
    counts: list[int]

    @classmethod
    def of(cls, content: bytes) -> Laz:
        """A sound file."""
        start = struct.unpack_from("<I", content, 96)[0]
        file = io.BytesIO(content)
        file.seek(start)
        table = lazrs.read_chunk_table(file, lazrs.LazVlr(_record(content)))
        at, chunks = start + 8, []
        for _, size in table:
            chunks.append(bytearray(content[at : at + size]))
            at += size
        return cls(bytearray(content[:start]), chunks, [count for count, _ in table])

    @property
    def layers(self) -> int:
        """Layers of a chunk; 0 if they are none."""
        items = list(struct.iter_unpack("<3H", _record(bytes(self.head))[34:]))
        kinds = {10: 9, 12: 2}
        return sum(size if kind == 14 else kinds.get(kind, 1) for kind, size, _ in items) if items[0][0] == 10 else 0

    def bytes(self, table: list[tuple[int, int]] | None = None) -> bytearray:
        """The file, with ``table`` (points and bytes of chunks) or that of its chunks."""
        body = b"".join(bytes(chunk) for chunk in self.chunks)
        if table is None:
            table = [(count, len(chunk)) for count, chunk in zip(self.counts, self.chunks, strict=True)]
        file = io.BytesIO()
        lazrs.write_chunk_table(file, table, lazrs.LazVlr(_record(bytes(self.head))))
        start = len(self.head)
        moved = bytearray(self.head)
        if moved[25] >= 4:
            struct.pack_into("<QI", moved, 235, 0, 0)  # no extended records
        return moved + struct.pack("<q", start + 8 + len(body)) + body + file.getvalue()


def _record(content: bytes) -> bytes:
    at = content.find(b"laszip encoded") + 52
    return content[at : at + 34 + 6 * struct.unpack_from("<H", content, at + 32)[0]]


def seeds(folder: Path) -> list[mutations.Seed]:
    """LAZ of every point format in chunks of 16 points by lazrs, in chunks of 50,000 by LASzip if there is one, and octrees."""
    found = []
    for number in range(len(RECORD_LENGTHS)):
        for extra in (False, True):
            path = folder / f"{number}.las"
            one = {"scanner_channel": np.full(60, 2)} if number > 8 else {}
            las = mutations.make_las(path, number, "1.4", n=60, extra=extra, seed=number, **one)
            name = f"{number}{'+' * extra}"
            found.append(mutations.Seed("lazrs", f"{name}.lazrs", ".laz", mutations.in_chunks(path.read_bytes())))
            las.evlrs = None
            if laspy.LazBackend.Laszip.is_available():
                las.write(folder / "z.laz", laz_backend=laspy.LazBackend.Laszip)
                found.append(mutations.Seed("LASzip", f"{name}.laszip", ".laz", (folder / "z.laz").read_bytes()))
    for seed in range(3):
        mutations.make_copc(folder / "o.copc.laz", 120 + 60 * seed, seed)
        found.append(mutations.Seed("octree", f"octree-{seed}", ".laz", (folder / "o.copc.laz").read_bytes()))
    return found


# what is done to a file


def _near(old: int, rng: np.random.Generator, bits: int = 32) -> int:
    """A value near the old one, a part or a multiple of it, or anything."""
    what = int(rng.integers(5))
    values = (
        old + int(rng.integers(-4, 5)),
        old // 2,
        2 * old,
        0,
        int(rng.integers(1 << int(rng.integers(1, bits + 1)))),
    )
    return values[what] % (1 << bits)


def _layer(laz: Laz, rng: np.random.Generator) -> bytearray:
    """A size of a layer."""
    chunk, at = _layer_of(laz, rng)
    struct.pack_into("<I", chunk, at, _near(struct.unpack_from("<I", chunk, at)[0], rng))
    return laz.bytes()


def _layers(laz: Laz, rng: np.random.Generator) -> bytearray:
    """Bytes of a layer that go to another one of the chunk, so that the sum is the same."""
    chunk, at = _layer_of(laz, rng)
    first = _first_layer(laz)
    others = [first + 4 * k for k in range(laz.layers) if struct.unpack_from("<I", chunk, first + 4 * k)[0]]
    if others:
        to = others[int(rng.integers(len(others)))]
        size = struct.unpack_from("<I", chunk, to)[0]
        by = min(size, int(rng.choice([1, 2, 3, size, int(rng.integers(1, size + 1))])))
        struct.pack_into("<I", chunk, to, size - by)
        struct.pack_into("<I", chunk, at, struct.unpack_from("<I", chunk, at)[0] + by)
    return laz.bytes()


def _count(laz: Laz, rng: np.random.Generator) -> bytearray:
    """The number of points that a layered chunk states."""
    chunk, _ = _layer_of(laz, rng)
    at = _first_layer(laz) - 4
    struct.pack_into("<I", chunk, at, _near(struct.unpack_from("<I", chunk, at)[0], rng))
    return laz.bytes()


def _layer_of(laz: Laz, rng: np.random.Generator) -> tuple[bytearray, int]:
    """A chunk, and where the size of one of its layers is."""
    chunk = laz.chunks[int(rng.integers(len(laz.chunks)))]
    return chunk, _first_layer(laz) + 4 * int(rng.integers(laz.layers))


def _first_layer(laz: Laz) -> int:
    return struct.unpack_from("<H", laz.head, 105)[0] + 4


def _table(laz: Laz, rng: np.random.Generator) -> bytearray:
    """Entries of the table: another size or count, bytes or points moved from one to the next, exchanged, lost, doubled."""
    table = [[count, len(chunk)] for count, chunk in zip(laz.counts, laz.chunks, strict=True)]
    i, j, column = (int(v) for v in rng.integers([len(table), len(table), 2]))
    what = int(rng.integers(5))
    if what == 0:
        table[i][column] = _near(table[i][column], rng, 31)
    elif what == 1:
        by = int(rng.choice([1, 2, 3, int(rng.integers(1, 60))]))
        table[i][column] += by
        table[j][column] = max(0, table[j][column] - by)
    elif what == 2:
        table[i], table[j] = table[j], table[i]
    elif what == 3:
        del table[i]
    else:
        table.insert(i, list(table[j]))
    return laz.bytes([(count, size) for count, size in table])


def _table_bytes(laz: Laz, rng: np.random.Generator) -> bytearray:
    """Bits of the table as it lies in the file, its number of chunks, or where it begins."""
    content, start, what = laz.bytes(), len(laz.head), int(rng.integers(3))
    table = struct.unpack_from("<q", content, start)[0]
    if what == 0:
        content[int(rng.integers(table + 8, len(content)))] ^= 1 << int(rng.integers(8))
    elif what == 1:
        struct.pack_into("<I", content, table + 4, _near(len(laz.chunks), rng))
    else:
        struct.pack_into("<q", content, start, _near(table, rng, 63))
    return content


def _laszip(laz: Laz, rng: np.random.Generator) -> bytearray:
    """A field of the laszip record."""
    content = laz.bytes()
    at = content.find(b"laszip encoded") + 52
    items = struct.unpack_from("<H", content, at + 32)[0]
    fields = [("H", 0), ("H", 2), ("B", 4), ("B", 5), ("H", 6), ("I", 8), ("I", 12), ("q", 16), ("q", 24), ("H", 32)]
    fields += [("H", 34 + 2 * k) for k in range(3 * items)] * 2
    layout, place = fields[int(rng.integers(len(fields)))]
    old = struct.unpack_from("<" + layout, content, at + place)[0]
    bits = 8 * struct.calcsize("<" + layout) - (layout == "q")
    struct.pack_into("<" + layout, content, at + place, _near(old % (1 << bits), rng, bits))
    return content


ACTS: dict[str, Callable[[Laz, np.random.Generator], bytearray]] = {
    "layer": _layer, "layers": _layers, "count": _count, "table": _table, "table bytes": _table_bytes, "laszip": _laszip,
}  # fmt: skip
_LAYERED = ("layer", "layers", "count")


def mutant(found: list[mutations.Seed], seed: int, number: int) -> tuple[mutations.Seed, str, bytes]:
    """The sound file, what was done to it, and its bytes; always the same for the same numbers."""
    rng = np.random.default_rng([seed, number])
    origin = found[int(rng.integers(len(found)))]
    content = sound = Laz.of(origin.content).bytes()
    names = [name for name in ACTS if Laz.of(origin.content).layers or name not in _LAYERED]
    name = names[int(rng.integers(len(names)))]
    while content == sound:
        content = ACTS[name](Laz.of(origin.content), rng)
    return origin, name, bytes(content)


# readers


def ours(path: Path) -> Records:
    """By jaxfilter: all fields, of which :func:`jaxfilter.read` has to see the same."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            cloud = read(path, units="m", drop_invalid=True)
            with reading_errors(path):
                header = read_header(path)
            chunks = [chunk for chunk, _ in read_records(header)]
            records = np.concatenate([np.zeros((0, header.record_length), np.uint8), *chunks])
        except JaxfilterError as error:
            assert str(path) in str(error), f"an error without the name of the file: {error}"
            return str(error)
    classes = records[:, 16] if header.point_format > 5 else records[:, 15] & 31
    assert len(cloud) == len(records) and np.array_equal(cloud.classification, classes), "two ways of reading differ"
    return records


def reference(path: Path) -> Records:
    """By LASzip, as many points as its header says."""
    import laszip

    with open(path, "rb") as file:
        try:
            decoder = laszip.LasUnZipper(file)
            header = decoder.header
            count = header.extended_number_of_point_records or header.number_of_point_records
            records = np.zeros((min(count, 10_000), header.point_data_record_length), np.uint8)
            decoder.decompress_into(records.reshape(-1))
        except Exception as error:
            return f"{type(error).__name__}: {error}"
    return records


class Reader:
    """A reader in a process of its own."""

    def __init__(self, act: Callable[[Path], Records]) -> None:
        self.act, self.pool = act, None

    def __call__(self, path: Path) -> Records:
        """What it returns; raises what it raises, and whatever ends its process."""
        if self.pool is None:
            context = multiprocessing.get_context("spawn")
            self.pool = ProcessPoolExecutor(1, context, initializer=_limit)
        try:
            return self.pool.submit(self.act, path).result(SECONDS)
        except AssertionError:
            raise
        except Exception:
            for process in (self.pool._processes or {}).values():
                process.kill()
            self.pool.shutdown()
            self.pool = None
            raise

    def close(self) -> None:
        """End the process."""
        if self.pool is not None:
            self.pool.shutdown()


def _limit() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)


def judged(path: Path, sound: np.ndarray, mine: Reader, other: Reader) -> tuple[str, str]:
    """An outcome and its detail, of a file whose points were ``sound``."""
    try:
        found = mine(path)
    except Exception as error:
        return FAILURE, f"{type(error).__name__}: {error}"
    try:
        expected = other(path)
    except Exception as error:  # LASzip dies of some files
        expected = f"LASzip ends: {type(error).__name__}"
    told = "" if not isinstance(expected, str) else f"LASzip: {expected}"
    if isinstance(found, str):
        return REFUSED, told
    if isinstance(expected, str):
        same = np.array_equal(found, sound)
        return (SOUND, told) if same else (FAILURE, f"other points than in the sound file; {told}")
    if not np.array_equal(found, expected):
        return FAILURE, "other points than LASzip's"
    return (SAME if np.array_equal(found, sound) else OTHER), ""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/compressed"), help="Folder for results.")
    parser.add_argument("--number", type=int, default=5000, help="Files.")
    parser.add_argument("--seed", type=int, default=20265)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    start, mine, other = time.perf_counter(), Reader(ours), Reader(reference)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = seeds(folder)
        points = {}
        for one in found:
            (folder / "in.laz").write_bytes(Laz.of(one.content).bytes())
            points[one.name] = other(folder / "in.laz")
            mine_too = mine(folder / "in.laz")
            assert not isinstance(mine_too, str) and np.array_equal(mine_too, points[one.name]), (
                f"{one.name}: {mine_too}"
            )
        for number in range(arguments.number):
            origin, act, content = mutant(found, arguments.seed, number)
            path = folder / "in.laz"
            path.write_bytes(content)
            outcome, detail = judged(path, points[origin.name], mine, other)
            rows.append({"number": number, "origin": origin.name, "kind": origin.kind, "act": act, "outcome": outcome,
                         "laszip": "refuses" if detail.startswith("LASzip") else "reads", "detail": detail})  # fmt: skip
            if outcome == FAILURE:
                (arguments.out / f"{number}.laz").write_bytes(content)
                print(rows[-1], flush=True)
            if number % 500 == 499:
                print(f"{number + 1} files, {time.perf_counter() - start:.0f} s", flush=True)
    mine.close()
    other.close()
    write_report(arguments.out, arguments.seed, rows)


def write_report(folder: Path, seed: int, rows: list[dict[str, Any]]) -> None:
    """``compressed.csv`` and ``compressed.md``."""
    tables = []
    for column in ("act", "kind"):
        counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
        for row in rows:
            counts[row[column]].update(
                ["files", row["outcome"], *[f"LASzip {row['laszip']}"] * (row["outcome"] == REFUSED)]
            )
        tables.append([{"name": name, **counts[name]} for name in sorted(counts)])
    words = {REFUSED: "refused", "LASzip reads": "of these LASzip reads", SAME: "sound points", OTHER: "other points, as LASzip",
             SOUND: "sound points, LASzip refuses", FAILURE: "failures"}  # fmt: skip
    columns = [("name", "", ""), ("files", "files", ",.0f"), *((key, text, ",.0f") for key, text in words.items())]
    failures = sum(row["outcome"] == FAILURE for row in rows)
    text = [
        "# Damaged layers, chunk tables and laszip records",
        "",
        f"{len(rows):,} files, seed {seed}. Failures: {failures}.",
        *(line for table in tables for line in ("", report.markdown(columns, table))),
        "",
    ]
    command = shlex.join(["python", "experiments/fuzz/compressed.py", *sys.argv[1:]])
    report.write_page(folder / "compressed.md", "\n".join(text), command)
    report.write_csv(folder / "compressed.csv", tables[0] + tables[1])
    print("\n".join(text))


if __name__ == "__main__":
    main()
