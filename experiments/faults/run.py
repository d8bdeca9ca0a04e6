"""Writers that are killed, stopped, raced, misled and left without disk, 200 times. See README.md."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments.faults.worker import SCALE, checksum, rule
from experiments.report import Column, Row, markdown, write_csv, write_page
from jaxfilter.core.errors import OutputError
from jaxfilter.files.disk import _host, new_file
from jaxfilter.files.reading import read, write

HERE = Path(__file__).parent
SUFFIXES = (".las", ".laz", ".xyz")
RUNS = {
    "kill -9, writing without end": 60, "kill -9, the command": 20, "SIGTERM": 20, "SIGINT": 15, "SIGHUP": 5,
    "race for one name": 30, "input replaced or changed": 30, "full disk": 20,
}  # fmt: skip
COMMAND = "import sys; from jaxfilter.cli import main; sys.argv[0] = 'jaxfilter'; main()"


def main(arguments: list[str] | None = None) -> None:
    """Run everything and write the tables; the exit code is 1 if anything went wrong."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE / "results")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--share", type=float, default=1.0, help="of the runs of each kind")
    options = parser.parse_args(given)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for row in run_all(Path(folder), {k: max(round(n * options.share), 1) for k, n in RUNS.items()}, options.seed):
            rows.append(row)
            print(" ".join(f"{value}" for value in row.values() if value != ""), file=sys.stderr, flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(options.out / "runs.csv", rows)
    write_page(options.out / "results.md", report(rows), shlex.join(["python", "experiments/faults/run.py", *given]))
    raise SystemExit(any(row["wrong"] or row["lost"] or row["left_over"] for row in rows))


def run_all(folder: Path, runs: dict[str, int], seed: int) -> Iterator[Row]:
    """A row per run: kind, what happened, and what is wrong, lost or left over, each in words or empty."""
    kinds: dict[str, Callable[[Bench], Row]] = {
        "kill -9, writing without end": killed_writer,
        "kill -9, the command": lambda bench: stopped_command(bench, signal.SIGKILL),
        "race for one name": race,
        "input replaced or changed": misled,
        "full disk": full_disk,
    }
    for number in (signal.SIGINT, signal.SIGHUP):  # ignored under nohup or in the background, and children inherit that
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    for kind, count in runs.items():
        act = kinds.get(kind) or (lambda bench, kind=kind: stopped_command(bench, signal.Signals[kind]))
        with contextlib.ExitStack() as stack:
            workers = [stack.enter_context(Worker()) for _ in range(2)] if act in (race, misled) else []
            for number in range(count):
                place = folder / f"{len(os.listdir(folder))}"
                place.mkdir()
                rng = np.random.default_rng([seed, list(RUNS).index(kind), number])
                row = act(Bench(place, rng, workers, number))
                yield {"kind": kind, "run": number, "outcome": "", "wrong": "", "lost": "", "left_over": ""} | row
                shutil.rmtree(place)


class Bench:
    """The folder of a run, and what stands ready for it."""

    def __init__(self, folder: Path, rng: np.random.Generator, workers: list[Worker], number: int) -> None:
        self.folder, self.rng, self.workers, self.number = folder, rng, workers, number
        self.suffix = SUFFIXES[number % len(SUFFIXES)]

    def cloud(self, name: str, n: int) -> tuple[Path, np.ndarray]:
        """A file of ``n`` points, by laspy or NumPy, and its integer coordinates."""
        path = self.folder / f"{name}{self.suffix}"
        ticks = self.rng.integers(0, 100_000, (n, 3)).astype(np.int32)
        make_cloud(path, ticks)
        return path, ticks

    def left_over(self, *expected: Path) -> str:
        """Names in the folder that should not be there."""
        return " ".join(sorted({p.name for p in self.folder.iterdir()} - {p.name for p in expected}))


def make_cloud(path: Path, ticks: np.ndarray) -> None:
    """Points of class 1 at multiples of SCALE."""
    if path.suffix == ".xyz":
        np.savetxt(path, ticks * SCALE, fmt="%.2f")
        return
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, SCALE)
    las = laspy.LasData(header)
    las.X, las.Y, las.Z = ticks.T
    las.return_number = las.number_of_returns = las.classification = np.ones(len(ticks), np.uint8)
    las.write(path)


def labelled(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Integer coordinates and labels of an output, by laspy or NumPy."""
    if path.suffix == ".xyz":
        table = np.loadtxt(path, ndmin=2)
        return np.rint(table[:, :3] / SCALE).astype(np.int32), table[:, 3] == 0
    las = laspy.read(path)
    return np.rint(np.stack([las.x, las.y, las.z], axis=1) / SCALE).astype(np.int32), np.asarray(
        las.classification
    ) == 2


def not_one_of(path: Path, versions: list[np.ndarray]) -> str:
    """What is wrong with an output that should hold one of these clouds, labelled by the rule; else empty."""
    try:
        ticks, ground = labelled(path)
    except Exception as error:  # any reader's word on a file that is not whole
        return f"{path.name} cannot be read: {error!r}"
    if not any(np.array_equal(ticks, version) for version in versions):
        return f"{path.name} holds {len(ticks)} points of no version"
    return "" if np.array_equal(ground, rule(ticks)) else f"{path.name} has labels of other points"


class Worker:
    """A process of worker.py."""

    def __enter__(self) -> Worker:
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "worker.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._line()
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def start(self, **job: Any) -> None:
        """Give a job."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(job, default=str) + "\n")
        self.process.stdin.flush()

    def outcome(self) -> dict[str, Any]:
        """Wait for the end of the job."""
        line = self._line()
        return json.loads(line) if line else {"error": "crash", "message": "the worker died"}


def killed_writer(bench: Bench) -> Row:
    """Killed while it writes the same output again and again; the next run has to find things in order."""
    source, ticks = bench.cloud("in", 30_000)
    _, older = bench.cloud("older", 10)
    target = bench.folder / f"out{bench.suffix}"
    make_cloud(target, older)
    with Worker() as worker:
        worker.start(source=source, target=target, overwrite=True, forever=True)
        time.sleep(bench.rng.uniform(0.0, 0.5))
    unfinished = len(list(bench.folder.glob(".jaxfilter-*")))
    lost = "" if target.exists() else "the older output"
    wrong = "" if _is_version(target, older) else not_one_of(target, [ticks])
    again(source, bench.folder / f"next{bench.suffix}", ticks)
    outcome = "left a hidden folder, which the next run removed" if unfinished else "left nothing"
    left = bench.left_over(source, bench.folder / f"older{bench.suffix}", target, bench.folder / f"next{bench.suffix}")
    return {"outcome": outcome, "wrong": wrong, "lost": lost, "left_over": left}


def _is_version(path: Path, ticks: np.ndarray) -> bool:
    """Whether a file is the unlabelled one that was there before."""
    with contextlib.suppress(Exception):
        if path.suffix == ".xyz":
            return bool(np.array_equal(np.rint(np.loadtxt(path, ndmin=2)[:, :3] / SCALE), ticks))
        las = laspy.read(path)
        return np.array_equal(np.stack([las.X, las.Y, las.Z], axis=1), ticks)
    return False


def again(source: Path, target: Path, ticks: np.ndarray) -> None:
    """An undisturbed run into the same folder."""
    write(target, read(source, units="m"), rule(ticks))


def stopped_command(bench: Bench, number: signal.Signals) -> Row:
    """``jaxfilter ground`` gets a signal: every second time when it has begun to write, else at any moment, by the processor
    time that it has used. Progress, of which slow machines see more, is off."""
    bench.suffix = SUFFIXES[bench.number % 2]
    source, ticks = bench.cloud("in", 20_000)
    target = bench.folder / f"out{bench.suffix}"
    words = ["ground", "pmf", str(source), str(target), "--cell", "10", "--units", "m", "--quiet"]
    command = [sys.executable, "-c", COMMAND, *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while not _catches(process, signal.SIGTERM) and process.poll() is None:
            time.sleep(0.002)
        if bench.number % 2:
            while process.poll() is None and not list(bench.folder.glob(".jaxfilter-*")):
                time.sleep(0.0005)
            _let_work(process, bench.rng.uniform(0.0, 0.01))
        else:
            worked = min(_worked(process), 60.0)  # infinite if it has ended
            _let_work(process, bench.rng.uniform(0.0, 1.2 * worked + 2.0))
        process.send_signal(number)
        sent = time.monotonic()
        _, messages = process.communicate()
    finally:
        process.kill()
        process.wait()
    seconds = time.monotonic() - sent
    code, wrong, outcome = process.returncode, "", "finished before"
    lines = [line for line in messages.splitlines() if not line.startswith("warning: ")]
    if number == signal.SIGKILL:
        outcome = "killed" if code == -number else outcome
        if list(bench.folder.glob(".*jaxfilter-*")):
            outcome = "killed, left a hidden folder, which the next run removed"
        if target.exists():
            wrong = _unlike_the_source(target, ticks)
        repeated = subprocess.run([*command, "--overwrite"], capture_output=True, text=True)
        wrong = wrong or repeated.stderr or _unlike_the_source(target, ticks)
        return {"outcome": outcome, "wrong": wrong, "left_over": bench.left_over(source, target)}
    if code == 128 + number:
        outcome = f"stopped within {seconds:.1f} s"
        if lines != [f"stopped by {number.name}"]:
            wrong = f"messages {messages!r}"
    elif code == -number and target.exists():
        outcome = "died of the signal after its work"
    elif code != 0:
        wrong = f"exit code {code}, messages {messages!r}"
    if target.exists():
        wrong = wrong or _unlike_the_source(target, ticks)
    return {"outcome": outcome, "wrong": wrong, "left_over": bench.left_over(source, target)}


def _worked(process: subprocess.Popen[str]) -> float:
    """Seconds of processor time that a process has used; infinite when it has ended."""
    try:
        used = psutil.Process(process.pid).cpu_times()
    except psutil.Error:
        return math.inf
    return math.inf if process.poll() is not None else used.user + used.system


def _let_work(process: subprocess.Popen[str], seconds: float) -> None:
    """Wait until a process has used so much more processor time, or has ended."""
    until = min(_worked(process) + seconds, 1e9)
    while _worked(process) < until:
        time.sleep(0.002)


def _catches(process: subprocess.Popen[str], number: int) -> bool:
    """Whether a process has a handler for a signal by now; without /proc, that is taken for granted."""
    try:
        status = Path(f"/proc/{process.pid}/status").read_text()
    except OSError:
        return process.poll() is None and not Path("/proc/self/status").exists()
    return bool(int(status.partition("SigCgt:")[2].split()[0], 16) >> (number - 1) & 1)


def _unlike_the_source(target: Path, ticks: np.ndarray) -> str:
    try:
        found, _ = labelled(target)
    except Exception as error:  # any reader's word on a file that is not whole
        return f"{target.name} cannot be read: {error!r}"
    return "" if np.array_equal(found, ticks) else f"{target.name} is not whole"


def race(bench: Bench) -> Row:
    """Two processes write one name at once, half of them allowed to overwrite, in a folder with what a third one left."""
    clouds = [bench.cloud(f"in{i}", int(bench.rng.integers(2_000, 4_000))) for i in range(2)]
    target = bench.folder / f"out{bench.suffix}"
    overwrite = bool(bench.number % 2)
    dead = bench.folder / f".jaxfilter-{_host()}-deadbeef"
    dead.mkdir()
    (dead / "lock").touch()
    (dead / "part").write_bytes(b"unfinished")
    at = time.monotonic() + 0.05
    for worker, (source, _) in zip(bench.workers, clouds, strict=True):
        worker.start(source=source, target=target, overwrite=overwrite, at=at + bench.rng.uniform(0, 0.005))
    outcomes = [worker.outcome() for worker in bench.workers]
    done = [i for i, outcome in enumerate(outcomes) if outcome["error"] is None]
    refused = [
        o for o in outcomes if o["error"] == "OutputError" and ("exists" in o["message"] or "another" in o["message"])
    ]
    wrong, lost = "", ""
    if len(done) + len(refused) < 2 or len(done) != (2 if overwrite else 1):
        wrong = f"overwrite={overwrite}: {outcomes}"
    if not target.exists():
        lost = "the output"
    else:
        wrong = wrong or not_one_of(target, [clouds[i][1] for i in done])
    late = any("another program" in o["message"] for o in refused)
    text = (
        "both wrote, the later one stays"
        if overwrite
        else f"one wrote, one was refused {'at the end' if late else 'at once'}"
    )
    return {
        "outcome": text,
        "wrong": wrong,
        "lost": lost,
        "left_over": bench.left_over(target, *(p for p, _ in clouds)),
    }


def misled(bench: Bench) -> Row:
    """The input is replaced, rewritten, cut or exchanged for a shorter one while it is read or written."""
    source, _ = bench.cloud("in", 60_000)
    how = ("replaced", "shorter", "rewritten", "cut")[bench.number % 4]
    other, _ = bench.cloud("other", 60_000 if how != "shorter" else 20_000)
    content, whole = other.read_bytes(), source.stat()
    target = bench.folder / f"out{bench.suffix}"
    worker = bench.workers[0]
    worker.start(source=source, target=bench.folder / f"probe{bench.suffix}", chunk=2_000)
    began = time.monotonic()
    worker.outcome()
    duration = time.monotonic() - began
    worker.start(source=source, target=target, chunk=2_000)
    time.sleep(bench.rng.uniform(0.0, 1.1 * duration))
    if how in ("replaced", "shorter"):
        os.utime(other, ns=(whole.st_atime_ns, whole.st_mtime_ns))
        os.replace(other, source)
    elif how == "cut":
        os.truncate(source, int(whole.st_size * bench.rng.uniform(0.3, 0.9)))
    else:
        with open(source, "r+b") as file:
            for start in range(0, len(content), 2**16):
                file.write(content[start : start + 2**16])
            file.truncate()
        os.utime(source, ns=(whole.st_atime_ns, whole.st_mtime_ns))
    outcome = worker.outcome()
    text, wrong = f"{how}: finished before or after", ""
    if outcome["error"] is not None:
        changed = "changed" in outcome["message"]
        text = f"{how}: {'refused as changed' if changed else 'refused as damaged'}"
        if outcome["error"] != "InputError":
            wrong = str(outcome)
        elif target.exists():
            wrong = "an output in spite of the error"
    else:
        found, ground = labelled(target)
        if checksum(found) != outcome["read"]:
            wrong = f"{len(found)} points that are not those that were read"
        elif not np.array_equal(ground, rule(found)):
            wrong = "labels of other points"
    left = bench.left_over(source, other, target, bench.folder / f"probe{bench.suffix}")
    return {"outcome": text, "wrong": wrong, "left_over": left}


def full_disk(bench: Bench) -> Row:
    """Outputs of every kind on a file system that ends somewhere within them; an older output stays."""
    kinds = (*SUFFIXES, ".tif", ".png")
    kind = kinds[bench.number % len(kinds)]
    bench.suffix = kind if kind in SUFFIXES else ".las"
    source, ticks = bench.cloud("in", 40_000)
    disk = bench.folder / "disk"
    disk.mkdir()
    with small_disk(disk, int(bench.rng.integers(24, 160)) * 1024):
        target = disk / f"out{kind}"
        target.write_bytes(b"older")
        try:
            _write_kind(target, source, ticks)
            message = "no error"
        except OutputError as error:
            message = str(error)
        except Exception as error:  # anything else is what is looked for
            message = repr(error)
        wrong = "" if "the disk is full" in message else message
        lost = "" if target.exists() and target.read_bytes() == b"older" else "the older output"
        left = " ".join(p.name for p in disk.iterdir() if p != target)
    return {"outcome": f"{kind}: {message.rpartition(': ')[2]}", "wrong": wrong, "lost": lost, "left_over": left}


def _write_kind(target: Path, source: Path, ticks: np.ndarray) -> None:
    if target.suffix in SUFFIXES:
        write(target, read(source, units="m"), rule(ticks), overwrite=True)
    elif target.suffix == ".tif":
        from jaxfilter.terrain.raster import Raster

        heights = ticks[:, :1].reshape(200, 200).astype(np.float32)
        Raster(np.tile(heights, (2, 2)), (1.0, 0.0, 9.0, 0.0, -1.0, 9.0)).write(target, overwrite=True)
    else:
        from matplotlib.figure import Figure

        figure = Figure(dpi=200)
        figure.subplots().imshow(ticks[:, 0].reshape(200, 200))
        with new_file(target, overwrite=True) as part:
            figure.savefig(part, format="png")


@contextlib.contextmanager
def small_disk(folder: Path, size: int) -> Iterator[None]:
    """A tmpfs, which needs the right to mount; otherwise a limit on the size of files, for this process."""
    if (
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True).returncode
        == 0
    ):
        try:
            yield
        finally:
            subprocess.run(["umount", folder], check=True)
        return
    import resource

    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


def report(rows: list[Row]) -> str:
    """The tables as Markdown."""
    table, outcomes = [], []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine = [row for row in rows if row["kind"] == kind]
        table.append(
            {"kind": kind, "runs": len(mine)}
            | {k: sum(bool(r[k]) for r in mine) for k in ("wrong", "lost", "left_over")}
        )
        counts = Counter(row["outcome"].partition(" within ")[0] for row in mine)
        outcomes += [{"kind": kind, "outcome": text, "runs": count} for text, count in counts.most_common()]
    keys = ("runs", "wrong", "lost", "left_over")
    table.append({"kind": "all"} | {key: sum(row[key] for row in table) for key in keys})
    columns: list[Column] = [("kind", "what was done", ""), *((key, key.replace("_", " "), "d") for key in keys)]
    more: list[Column] = [("kind", "what was done", ""), ("outcome", "what came of it", ""), ("runs", "runs", "d")]
    return "\n\n".join([
        "# Faults", markdown(columns, table),
        "Wrong: a file that is not whole, labels on points that they were not computed for, or an error that does not say "
        "what happened. Lost: a file that was there before, or that a run said it wrote. Left over: any name in the folder "
        "that should not be there, at once, or after kill -9 when the next run into the folder has ended.",
        "## What happened", markdown(more, outcomes),
    ])  # fmt: skip


if __name__ == "__main__":
    main()
