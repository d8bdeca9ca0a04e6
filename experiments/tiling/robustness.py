"""Runs that are killed, and a Dask cluster whose workers are: the same bytes."""

from __future__ import annotations

import argparse
import collections
import filecmp
import itertools
import math
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from experiments.report import Column, Row
from experiments.tiling import scale
from jaxfilter.surveys.dask import Cluster
from jaxfilter.surveys.executors import Task, carried_out

FLAGS = ["--tile", "150", "--halo", "40", "--wide-halos", "--quiet"]
_KILL_EVERY = 20.0  # seconds
_LOOK = 0.5  # seconds


def kills(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    """The command is killed one to three times at random moments, then goes on."""
    from experiments.tiling.run import generated

    inputs = [str(path) for path in generated(options.work, options.small, 3, 1.0)]
    undisturbed = options.work / "undisturbed"
    seconds = _run(inputs, undisturbed)
    rng = random.Random(1)
    rows: list[Row] = []
    for trial in range(options.trials):
        out = options.work / "killed"
        shutil.rmtree(out, ignore_errors=True)
        killed = 0
        for _ in range(1 + trial % 3):
            process = subprocess.Popen(_command(inputs, out), stderr=subprocess.DEVNULL)
            try:
                process.wait(rng.uniform(0.5, seconds))
            except subprocess.TimeoutExpired:
                process.send_signal(signal.SIGKILL)
                process.wait()
                killed += 1
        code = subprocess.run(_command(inputs, out), stderr=subprocess.DEVNULL).returncode
        rows.append({"trial": trial, "kills": killed, "code": code, **compared(undisturbed, out)})
        print(rows[-1], file=sys.stderr, flush=True)
    return rows, _COLUMNS, "Kills at random moments, then the same command"


def cluster(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    """A scheduler and two workers as processes of their own, over TCP: left alone, and with a worker killed now and then."""
    from experiments.tiling.run import generated

    inputs = [str(path) for path in generated(options.work, options.small, 3, 1.0)]
    undisturbed = options.work / "undisturbed"
    local = _run(inputs, undisturbed)
    rows: list[Row] = []
    with _scheduler(options.work) as (address, workers, more, _):
        for every in (None, _KILL_EVERY):
            out = options.work / "clustered"
            shutil.rmtree(out, ignore_errors=True)
            start, killed = time.perf_counter(), 0
            process = subprocess.Popen([*_command(inputs, out), "--scheduler", address])
            while process.poll() is None:
                try:
                    process.wait(every)
                except subprocess.TimeoutExpired:
                    victim = workers.pop(0)
                    victim.kill()
                    victim.wait()
                    workers.append(more())
                    killed += 1
            rows.append(
                {
                    "trial": "workers killed" if every else "left alone",
                    "kills": killed,
                    "code": process.returncode,
                    "seconds": time.perf_counter() - start,
                    "local": local,
                    **compared(undisturbed, out),
                }
            )
            print(rows[-1], file=sys.stderr, flush=True)
    columns: list[Column] = [*_COLUMNS, ("seconds", "seconds", ".1f"), ("local", "seconds of the local pool", ".1f")]
    return rows, columns, "A Dask cluster of two workers"


def tasks(options: argparse.Namespace) -> tuple[list[Row], list[Column], str]:
    """Tasks that do nothing, more and more of them, through a real scheduler, in bundles and one by one: time, and what the
    scheduler holds."""
    rows: list[Row] = []
    for most, count in itertools.product((100, 1), options.tasks):
        with _scheduler(options.work) as (address, _, _, scheduler):
            executor = Cluster(address, most)
            todo = (Task(abs, number, lambda last, number=number: (number,)) for number in range(count))
            done = carried_out(executor, todo, collections.deque(), lambda: None)
            held, peak, looked = 0, 0, -math.inf
            start = time.perf_counter()
            for number, (task, outcome) in enumerate(done):
                if outcome.value != task.number:
                    raise AssertionError(f"task {task.number}: {outcome}")
                if time.perf_counter() - looked > _LOOK or number == count - 1:
                    held = max(held, executor._client.run_on_scheduler(_tasks_of))
                    peak = max(peak, psutil.Process(scheduler.pid).memory_info().rss)
                    looked = time.perf_counter()
            seconds, submissions = time.perf_counter() - start, executor.submissions
            executor.close()
        rows.append(
            {
                "tasks": count, "most": most, "submissions": submissions, "seconds": seconds, "each": 1000 * seconds / count,
                "held": held, "peak": peak / 1e6,
            }
        )  # fmt: skip
        print(rows[-1], file=sys.stderr, flush=True)
    columns: list[Column] = [
        ("tasks", "tasks", ",d"), ("most", "at most in a bundle", "d"), ("submissions", "bundles", ",d"),
        ("seconds", "seconds", ".1f"), ("each", "ms per task", ".2f"), ("held", "most bundles in the scheduler", "d"),
        ("peak", "peak memory of the scheduler, MB", ".0f"),
    ]  # fmt: skip
    return rows, columns, "Empty tasks through the scheduler of a Dask cluster of two workers"


def _tasks_of(dask_scheduler: Any) -> int:
    return len(dask_scheduler.tasks)


_COLUMNS: list[Column] = [
    ("trial", "trial", ""), ("kills", "kills", "d"), ("code", "exit code", "d"), ("same", "files with the same bytes", "d"),
    ("files", "files", "d"), ("left", "other files left", "d"),
]  # fmt: skip


def compared(one: Path, other: Path) -> Row:
    """How many outputs of two runs have the same bytes, and what else the second has left."""
    names = [path.name for path in one.glob("*.laz")]
    same = sum(filecmp.cmp(one / name, other / name, False) for name in names if (other / name).exists())
    left = {path.name for path in other.iterdir()} - {path.name for path in one.iterdir()}
    return {"same": same, "files": len(names), "left": len(left)}


def _command(inputs: list[str], out: Path) -> list[str]:
    return [*scale.COMMAND, "pmf", *inputs, str(out), "--resume", *FLAGS]


def _run(inputs: list[str], out: Path) -> float:
    shutil.rmtree(out, ignore_errors=True)
    start = time.perf_counter()
    subprocess.run(_command(inputs, out), check=True, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start


@contextmanager
def _scheduler(
    work: Path,
) -> Iterator[
    tuple[str, list[subprocess.Popen[bytes]], Callable[[], subprocess.Popen[bytes]], subprocess.Popen[bytes]]
]:
    """Address, two workers, what starts another, and the scheduler."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    dask = [sys.executable, "-m"]
    quiet = {"stderr": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "env": dict(os.environ)}

    def worker() -> subprocess.Popen[bytes]:
        flags = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0"]
        command = [*dask, "distributed.cli.dask_worker", address, *flags, "--local-directory", str(work / "dask")]
        return subprocess.Popen(command, **quiet)

    flags = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    scheduler = subprocess.Popen([*dask, "distributed.cli.dask_scheduler", *flags], **quiet)
    workers = [worker(), worker()]
    try:
        time.sleep(6)
        yield address, workers, worker, scheduler
    finally:
        for process in [*workers, scheduler]:
            process.kill()
            process.wait()
