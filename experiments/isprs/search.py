"""Every method with every set on every sample, once: the table that the class and the oracle protocol choose from.

Rows are appended to ``<out>/<method>.csv`` as they come, so that a run that was cut off goes on where it was. A row counts
as long as the filter's parameters and the labels of its method (``experiments/remake.py``) are what they were.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

import jaxfilter as jf
from experiments.isprs import samples, spaces
from experiments.remake import word
from experiments.report import CommandLine, Row, read_csv, write_csv

COLUMNS = ("sample", "set", "parameters", "kept", "lost", "accepted", "rejected", "status")
"""``kept`` and ``lost``: ground labelled ground and object; ``accepted`` and ``rejected``: objects likewise."""
COUNTS = COLUMNS[3:7]
_ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "OMP_NUM_THREADS": "1"}

T = TypeVar("T", bound=tuple[Any, ...])
Task = tuple[str, str, Path, dict[int, dict[str, float]]]
"""Method, sample, its file, and the thresholds of the sets to run by number."""


def options(script: str, text: str | None, arguments: Sequence[str] | None) -> argparse.Namespace:
    """What a script about clouds is given; see :class:`experiments.report.CommandLine`."""
    parser = CommandLine(script, text)
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="kinds of clouds, or clouds")
    parser.add_argument("--processes", type=int, default=2, help="of one thread each [%(default)s]")
    return parser.options(arguments)


def digest(filter_: jf.Filter, thresholds: dict[str, float] | None = None) -> str:
    """A short word for a filter with all its parameters and the thresholds that are changed in it, and one for the labels of
    its method."""
    names = {method: name for name, method in jf.FILTERS.items()}
    name = next(names[base] for base in type(filter_).__mro__ if base in names)
    parameters = hashlib.blake2b(f"{filter_!r}{thresholds or ''}".encode(), digest_size=4).hexdigest()
    return f"p{parameters}-{word(name)}"


def current(row: Row, methods: Iterable[str] = ()) -> bool:
    """Whether a row that was kept is of the labels of its method, or of one of these, as they are now."""
    return str(row["parameters"]).partition("-")[2] in {word(name) for name in methods or [row["method"]]}


def run(
    out: Path,
    folder: Path,
    methods: Sequence[str],
    numbers: Sequence[str],
    budget: int,
    processes: int,
    say: Callable[[str], None] = print,
) -> dict[str, list[Row]]:
    """Run what is missing and return, per method, the rows of all its sets on all samples.

    Args:
        out: folder of the tables. folder: the data. numbers: samples such as "11". processes: of one thread each; with 1
            it is this process that computes.
    """
    out.mkdir(parents=True, exist_ok=True)
    for method in methods:
        if (path := out / f"{method}.csv").exists():
            rows = [row for row in read_csv(path) if current(row, [method])]
            write_csv(path, rows) if rows else path.unlink()
    tasks = [task for method in methods for task in _missing(out, folder, method, numbers, budget)]
    for number, (task, rows) in enumerate(results(evaluate, tasks, processes), 1):
        _append(out / f"{task[0]}.csv", rows)
        say(f"search {number}/{len(tasks)}: {task[0]} on {task[1]}, {len(rows)} sets")
    return {method: _known(out, method, numbers, budget) for method in methods}


def _known(out: Path, method: str, numbers: Sequence[str], budget: int) -> list[Row]:
    """The rows at hand that belong to the sets as they are now, in order."""
    path = out / f"{method}.csv"
    wanted = _wanted(method, numbers, budget)
    rows = read_csv(path) if path.exists() else []
    found = {
        (row["sample"], row["set"]): row for row in rows if wanted.get((row["sample"], row["set"])) == row["parameters"]
    }
    return [found[key] | {"method": method} for key in sorted(found)]


def _wanted(method: str, numbers: Sequence[str], budget: int) -> dict[tuple[str, int], str]:
    sets = spaces.sets(method, budget)
    return {
        (f"samp{n}", i): digest(spaces.fixed(method, f"samp{n}"), thresholds)
        for n in numbers
        for i, thresholds in enumerate(sets)
    }


def _missing(out: Path, folder: Path, method: str, numbers: Sequence[str], budget: int) -> Iterator[Task]:
    have = {(row["sample"], row["set"]) for row in _known(out, method, numbers, budget)}
    sets = spaces.sets(method, budget)
    for number in numbers:
        left = {i: thresholds for i, thresholds in enumerate(sets) if (f"samp{number}", i) not in have}
        if left:
            yield method, f"samp{number}", samples.sample_path(folder, number), left


def results(function: Callable[..., list[Row]], tasks: Sequence[T], processes: int) -> Iterator[tuple[T, list[Row]]]:
    """Each task, a tuple of arguments, with what the function gives for it, in the order in which they are done.

    ``processes``: of one thread each; with 1 it is this process that computes.
    """
    if processes == 1 or len(tasks) < 2:
        yield from ((task, function(*task)) for task in tasks)
        return
    before = {key: os.environ.get(key) for key in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
            waiting = {pool.submit(function, *task): task for task in tasks}
            for done in as_completed(waiting):
                yield waiting[done], done.result()
    finally:
        for key, value in before.items():
            os.environ.pop(key) if value is None else os.environ.update({key: value})


def evaluate(method: str, sample: str, path: Path, sets: dict[int, dict[str, float]]) -> list[Row]:
    """One row per set. A set that the method refuses or fails with has no counts, and the error as its status."""
    from jaxfilter.core.compilation import keep_compilations

    keep_compilations()
    cloud = jf.read(path)
    rows = []
    for number, thresholds in sets.items():
        row: Row = {"sample": sample, "set": number, "parameters": digest(spaces.fixed(method, sample), thresholds)}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", jf.JaxfilterWarning)
                result = spaces.fixed(method, sample).replace(**thresholds)(cloud, workers=1)
            counts = jf.evaluate(result, cloud.reference).confusion.ravel().tolist()
            row |= dict(zip(COUNTS, counts, strict=True)) | {"status": result.status.name}
        except Exception as error:
            row |= {"status": f"{type(error).__name__}: {error}"[:200]}
        rows.append(row)
    return rows


def _append(path: Path, rows: Iterable[Row]) -> None:
    new = not path.exists()
    with open(path, "a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n", restval="")
        if new:
            writer.writeheader()
        writer.writerows(rows)
