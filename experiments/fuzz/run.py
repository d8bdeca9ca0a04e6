"""Thousands of damaged LAS, LAZ, COPC and text files: each is refused, or labelled into a file that reads back equal.

A worker, in a process of its own with a limit on memory, is replaced when it dies or does not answer; both count as failures.
"""

from __future__ import annotations

import argparse
import collections
import csv
import multiprocessing
import re
import resource
import shlex
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Iterable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments import report
from experiments.fuzz import check, mutations

MEMORY = 2 * 2**30
"""Bytes of address space that a worker may take on top of what it has when it begins."""
SECONDS = 60.0
"""For one file."""
FILTERED = 20
"""Every so manieth file is labelled by SMRF."""
COLUMNS = ("group", "seed", "number", "kind", "origin", "mutations", "outcome", "seconds", "megabytes", "detail")


def job(found: list[mutations.Seed], group: str, seed: int, number: int, folder: Path) -> dict[str, Any]:
    """One file: made, judged, and described by :data:`COLUMNS`."""
    origin, done, content = mutations.mutant(of_group(found, group), seed, number)
    path = folder / f"in{origin.suffix}"
    path.write_bytes(content)
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        outcome, detail = check.outcome(path, number, filtered=number % FILTERED == 0)
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        outcome, detail = "failure", f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    finally:
        for other in folder.glob("out*"):
            other.unlink()
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return {
        "group": group, "seed": seed, "number": number, "kind": origin.kind, "origin": origin.name, "mutations": done,
        "outcome": outcome, "seconds": round(time.perf_counter() - start, 3), "megabytes": round(grown), "detail": detail,
    }  # fmt: skip


def of_group(found: list[mutations.Seed], group: str) -> list[mutations.Seed]:
    """The sound files of ``"binary"`` (LAS, LAZ, COPC) or of ``"text"``."""
    return [one for one in found if (one.kind == "text") == (group == "text")]


def work(pipe: Connection, found: list[mutations.Seed]) -> None:
    """Answer jobs until there are none. Runs in a process of its own."""
    import logging

    import jaxfilter as jf

    logging.disable(logging.ERROR)  # laspy logs what it also raises
    jf.SMRF()(np.random.default_rng(0).uniform(0, 30, (100, 3)))  # takes the memory that JAX needs anyway
    pages = int(Path("/proc/self/statm").read_text().split()[0]) if sys.platform == "linux" else 0
    if pages:
        limit = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with tempfile.TemporaryDirectory() as folder:
        while (task := pipe.recv()) is not None:
            pipe.send(job(found, *task, Path(folder)))


class Worker:
    """The process that does the jobs, replaced where it fails."""

    def __init__(self, found: list[mutations.Seed]) -> None:
        self.found, self.context = found, multiprocessing.get_context("spawn")
        self._start()

    def _start(self) -> None:
        self.pipe, other = self.context.Pipe()
        self.process = self.context.Process(target=work, args=(other, self.found), daemon=True)
        self.process.start()
        other.close()
        self.fresh = True

    def do(self, group: str, seed: int, number: int) -> dict[str, Any]:
        """A row of :data:`COLUMNS`."""
        self.pipe.send((group, seed, number))
        start = time.perf_counter()
        try:
            if self.pipe.poll(SECONDS + 60 * self.fresh):
                self.fresh = False
                return self.pipe.recv()
            reason = f"no answer after {SECONDS:g} s"
        except (EOFError, ConnectionError):
            self.process.join()
            reason = f"the process died ({self.process.exitcode})"
        self.process.kill()
        self.process.join()
        self._start()
        origin, done, _ = mutations.mutant(of_group(self.found, group), seed, number)
        return {
            "group": group, "seed": seed, "number": number, "kind": origin.kind, "origin": origin.name, "mutations": done,
            "outcome": "failure", "seconds": round(time.perf_counter() - start, 3), "megabytes": "", "detail": reason,
        }  # fmt: skip

    def close(self) -> None:
        """End the process."""
        self.pipe.send(None)
        self.process.join(10)


def tables(rows: Iterable[dict[str, Any]]) -> tuple[list[report.Row], list[report.Row], list[report.Row]]:
    """Counts by kind of file, by mutation, and by what files were refused for."""
    kinds: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    acts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    reasons: collections.Counter[str] = collections.Counter()
    slowest: dict[str, float] = collections.defaultdict(float)
    for row in rows:
        kinds[row["kind"]][row["outcome"]] += 1
        slowest[row["kind"]] = max(slowest[row["kind"]], float(row["seconds"]))
        for act in set(row["mutations"].split("+")):
            acts[f"{'text' if row['group'] == 'text' else 'LAS'}: {act}"][row["outcome"]] += 1
        if row["outcome"] == check.REFUSED:
            reasons[_reason(row["detail"])] += 1

    def counted(table: dict[str, collections.Counter[str]]) -> list[report.Row]:
        return [
            {"name": name, "files": sum(c.values())} | {key: c[key] for key in (check.REFUSED, check.EQUAL, "failure")}
            for name, c in sorted(table.items())
        ]

    first = [row | {"seconds": slowest[str(row["name"])]} for row in counted(kinds)]
    return first, counted(acts), [{"name": reason, "files": n} for reason, n in reasons.most_common(40)]


def _reason(message: str) -> str:
    """A message without what differs from file to file."""
    text = re.sub(r"FILE: |/\S+: ", "", message).split(": remove stray")[0]
    return re.sub(r"'[^']*'|b'.*?'|\([^)]*\)|[-+]?\d[\d.,]*(e[-+]?\d+)?", "#", text)[:90].strip()


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "out")
    parser.add_argument("--number", type=int, default=10_000, help="Files of each group.")
    parser.add_argument("--seeds", type=int, nargs="+", default=[20260], help="Each gives other files.")
    parser.add_argument("--groups", nargs="+", choices=("binary", "text"), default=("binary", "text"))
    parser.add_argument("--only", type=int, nargs="+", help="Numbers of files, to look at again; with the traceback.")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(arguments.out / "failures", ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        found = mutations.seeds(Path(folder))
    if arguments.only:
        for number in arguments.only:
            again(found, arguments.groups[0], arguments.seeds[0], number, arguments.out)
        return
    start, rows, worker = time.perf_counter(), [], Worker(found)
    with open(arguments.out / "files.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        for seed in arguments.seeds:
            for group in arguments.groups:
                for number in range(arguments.number):
                    row = worker.do(group, seed, number)
                    rows.append(row)
                    writer.writerow(row)
                    if row["outcome"] == "failure":
                        keep(found, row, arguments.out / "failures")
                        print(row, flush=True)
                    if number % 500 == 499:
                        file.flush()
                        print(f"{group} {seed}: {number + 1} files, {time.perf_counter() - start:.0f} s", flush=True)
    worker.close()
    write_report(arguments.out, arguments.seeds, rows)


def keep(found: list[mutations.Seed], row: dict[str, Any], folder: Path) -> None:
    """Keep the file of a failure."""
    folder.mkdir(exist_ok=True)
    origin, _, content = mutations.mutant(of_group(found, row["group"]), row["seed"], row["number"])
    (folder / f"{row['group']}-{row['seed']}-{row['number']}{origin.suffix}").write_bytes(content)


def again(found: list[mutations.Seed], group: str, seed: int, number: int, folder: Path) -> None:
    """One file in this process; its traceback goes to standard error."""
    origin, done, content = mutations.mutant(of_group(found, group), seed, number)
    path = folder / f"in{origin.suffix}"
    path.write_bytes(content)
    print(f"{group} {seed} {number}: {origin.name}, {done}, {path}")
    try:
        print(*check.outcome(path, number, filtered=number % FILTERED == 0))
    except Exception:
        traceback.print_exc()


def write_report(folder: Path, seeds: list[int], rows: list[dict[str, Any]]) -> None:
    """``results.md`` and ``counts.csv``."""
    kinds, acts, reasons = tables(rows)
    failures = [row for row in rows if row["outcome"] == "failure"]
    outcomes = [("name", "", ""), ("files", "files", ",.0f"), (check.REFUSED, "refused", ",.0f")]
    outcomes += [(check.EQUAL, "labels read back equal", ",.0f"), ("failure", "neither", ",.0f")]
    text = [
        "# Damaged files",
        "",
        f"{len(rows):,} files, seeds {', '.join(map(str, seeds))}, one process. Failures: {len(failures)}.",
        "",
        "## By kind of file",
        "",
        report.markdown([*outcomes, ("seconds", "longest, s", ".1f")], kinds),
        "",
        "## By what was done",
        "",
        "A file may have had several of these.",
        "",
        report.markdown(outcomes, acts),
        "",
        "## What files were refused for",
        "",
        "The most frequent, without names and numbers.",
        "",
        report.markdown([("name", "", ""), ("files", "files", ",.0f")], reasons),
        "",
    ]
    if failures:
        text += [
            "## Failures",
            "",
            *(f"- {row['group']} {row['seed']} {row['number']}: {row['detail'][:300]}" for row in failures),
            "",
        ]
    command = shlex.join(["python", "experiments/fuzz/run.py", *sys.argv[1:]])
    report.write_page(folder / "results.md", "\n".join(text), command)
    report.write_csv(folder / "counts.csv", [*kinds, *acts])
    print((folder / "results.md").read_text())


if __name__ == "__main__":
    main()
