"""Runs over a survey whose outputs, inputs and own files are damaged, 120 times; then ``resume``, then ``overwrite``.

    python experiments/faults/surveys.py [--out DIR] [--seed 0] [--runs 120]

Ends with 1 if an output is wrong, an error says nothing of use, or ``overwrite`` leads nowhere. See README.md.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shlex
import shutil
import struct
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import jaxfilter as jf
from experiments.report import Column, Row, markdown, write_csv, write_page
from jaxfilter.surveys.executors import attempt
from jaxfilter.surveys.store import RUN
from jaxfilter.surveys.targets import MAP, REPORT

HERE = Path(__file__).parent
STORE = ".jaxfilter-run"
Damage = Callable[[Path, np.random.Generator], None]


class Stopping:
    """An executor in this process, one task at a time, that is interrupted after so many."""

    def __init__(self, tasks: float = float("inf")) -> None:
        self.left, self.waiting = tasks, []  # type: ignore[var-annotated]

    def room(self) -> int:
        """One, if nothing waits."""
        return 1 - len(self.waiting)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Keep it for ``completed``."""
        self.waiting.append((tag, function, arguments))

    def completed(self, seconds: float) -> list[tuple[Any, Any]]:
        """Do what waits."""
        if self.left <= 0:
            raise KeyboardInterrupt
        self.left -= 1
        tag, function, arguments = self.waiting.pop()
        return [(tag, attempt(function, arguments))]

    def close(self) -> None:
        """Nothing is running."""


# what is done to a file


def missing(path: Path, rng: np.random.Generator) -> None:
    """It is removed."""
    path.unlink()


def empty(path: Path, rng: np.random.Generator) -> None:
    """It has no bytes any more."""
    os.truncate(path, 0)


def cut(path: Path, rng: np.random.Generator) -> None:
    """It ends too early."""
    os.truncate(path, int(path.stat().st_size * rng.uniform(0.1, 0.9)))


def text(path: Path, rng: np.random.Generator) -> None:
    """Something else has its name."""
    path.write_bytes(b"this is something else\n" * 500)


def noise(path: Path, rng: np.random.Generator) -> None:
    """A third of it is random bytes, and its time is what it was."""
    size = path.stat().st_size
    _patched(path, int(rng.integers(0, size - size // 3)), rng.bytes(size // 3))


def zeros(path: Path, rng: np.random.Generator) -> None:
    """A third of it is zero, and its time is what it was."""
    size = path.stat().st_size
    _patched(path, int(rng.integers(0, size - size // 3)), bytes(size // 3))


def flip(path: Path, rng: np.random.Generator) -> None:
    """One bit is another, and the time is what it was."""
    at = int(rng.integers(0, path.stat().st_size))
    _patched(path, at, bytes([path.read_bytes()[at] ^ 1 << int(rng.integers(8))]))


def longer(path: Path, rng: np.random.Generator) -> None:
    """Random bytes follow."""
    with open(path, "ab") as file:
        file.write(rng.bytes(5000))


def folder(path: Path, rng: np.random.Generator) -> None:
    """A folder has its name."""
    path.unlink()
    path.mkdir()
    (path / "inner").write_text("something")


def _patched(path: Path, at: int, content: bytes) -> None:
    before = path.stat()
    with open(path, "r+b") as file:
        file.seek(at)
        file.write(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


# what is done to run.json


def number(path: Path, rng: np.random.Generator) -> None:
    """A number in it is another; it is sound JSON."""
    path.write_text(re.sub(r'"halo": [\d.]+', '"halo": 16.0', path.read_text()))


def other_json(path: Path, rng: np.random.Generator) -> None:
    """JSON of another program has its name."""
    path.write_text('{"name": "something else"}')


BYTES: tuple[Damage, ...] = (missing, empty, cut, text, noise, zeros, flip, longer, folder)
RUNS: dict[str, Damage] = {one.__name__: one for one in (empty, cut, text, zeros, noise, number, other_json)}
"""Damages of what decides on a run that ``resume`` has to refuse."""


def turned(path: Path, rng: np.random.Generator) -> None:
    """The points of an input are in reverse order; size, header and time are what they were."""
    data = path.read_bytes()
    length, start = struct.unpack_from("<H", data, 105)[0], struct.unpack_from("<I", data, 96)[0]
    _patched(path, start, np.frombuffer(data, np.uint8, offset=start).reshape(-1, length)[::-1].tobytes())


WHAT: dict[str, tuple[Damage, ...]] = {
    "run.json": (*BYTES, number, other_json),
    "output": BYTES,
    "tiles": (missing, empty, cut, text, noise, zeros, flip, longer),
    "index": (missing, empty, cut, text, noise),
    "report": (missing, empty, text, cut),
    "folder": (missing, text),
    "input": (turned,),
}
"""What is damaged, and how. Tiles, index and folder are there only where a run was stopped."""


def main(arguments: list[str] | None = None) -> None:
    """Run everything and write the tables."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=HERE / "results")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--runs", type=int, default=120)
    options = parser.parse_args(given)
    warnings.simplefilter("ignore", jf.JaxfilterWarning)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        for found in run_all(Path(place), options.runs, options.seed):
            rows.append(found)
            print(" | ".join(f"{value}" for value in found.values()), file=sys.stderr, flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    write_csv(options.out / "surveys.csv", rows)
    command = shlex.join(["python", "experiments/faults/surveys.py", *given])
    write_page(options.out / "surveys.md", report(rows), command)
    raise SystemExit(any(found["wrong"] or found["dead_end"] for found in rows))


def ways() -> list[tuple[str, str, Damage]]:
    """State of the run, what is damaged and how: all that there are."""
    found = []
    for what, damages in WHAT.items():
        states = {"run.json": ("stopped", "complete"), "output": ("stopped", "complete"), "report": ("complete",)}
        for state in states.get(what, ("stopped",)):
            found += [(state, what, damage) for damage in damages]
    return found


def run_all(place: Path, runs: int, seed: int) -> Iterator[Row]:
    """A row per run; the ways in turn, each time at another place of the file and after another number of tasks."""
    survey = place / "survey"
    make_survey(survey)
    complete = place / "complete"
    tiles = ground(survey, complete).tiles
    expected = contents(complete)
    every = ways()
    for number in range(runs):
        rng = np.random.default_rng([seed, number])
        state, what, damage = every[number % len(every)]
        here = place / f"run{number}"
        shutil.copytree(survey, here / "survey")
        for path in (here / "survey").iterdir():
            shutil.copystat(survey / path.name, path)
        out = here / "out"
        first, last = (tiles + 1, tiles + 4) if what == "output" else (1, tiles)
        after = int(rng.integers(first, last)) if state == "stopped" else float("inf")
        with contextlib.suppress(KeyboardInterrupt):
            ground(here / "survey", out, Stopping(after))
        name = {"state": state, "what": what, "damage": damage.__name__, "number": number}
        path = chosen(here, what, rng)
        if path is None:
            yield name | {"outcome": "there was nothing to damage yet", "wrong": "", "dead_end": ""}
        else:
            if path.is_dir():
                shutil.rmtree(path)
                path.touch()
            damage(path, rng)
            yield name | tried(here / "survey", out, expected)
        shutil.rmtree(here)


FILTER = jf.PMF(max_window=10.0, low_clusters=False)


def make_survey(place: Path) -> None:
    """Four LAS files of a town, one of them not judged throughout."""
    place.mkdir()
    scene = jf.scenes.make("town", size=(64.0, 60.0), density=1.0, seed=5)
    xyz, middle = scene.cloud.coordinates(), scene.cloud.origin[:2] + (33.0, 31.0)
    for i in range(2):
        for j in range(2):
            own = xyz[((xyz[:, 0] < middle[0]) == (i == 0)) & ((xyz[:, 1] < middle[1]) == (j == 0))]
            las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
            las.header.scales, las.header.offsets = np.full(3, 0.01), np.floor(xyz.min(axis=0))
            las.x, las.y, las.z = own.T
            las.return_number = las.number_of_returns = np.ones(len(own), np.uint8)
            las.write(place / f"{i}{j}.las")


def ground(survey: Path, out: Path, executor: Stopping | None = None, **how: Any) -> Any:
    """One run."""
    run = jf.RunOptions(tile=30.0, halo=15.0, wide_halos=True, executor=executor or Stopping(), **how)
    return jf.ground(survey, out, FILTER, reading=jf.Reading(units="m"), run=run)


def contents(out: Path) -> dict[str, bytes]:
    """The outputs that are there."""
    return {path.name: path.read_bytes() for path in sorted(out.glob("*.las")) if path.is_file()}


def chosen(here: Path, what: str, rng: np.random.Generator) -> Path | None:
    """The file to be damaged; None if there is none."""
    out = here / "out"
    found = {
        "run.json": [out / STORE / RUN],
        "output": sorted(out.glob("*.las")),
        "tiles": sorted((out / STORE / "tiles").rglob("*.tile")),
        "index": sorted((out / STORE / "index").rglob("*.npz")),
        "report": [path for path in (out / REPORT, out / MAP) if path.exists()],
        "folder": [out / STORE],
        "input": sorted((here / "survey").glob("*.las")),
    }[what]
    return found[int(rng.integers(len(found)))] if found else None


def tried(survey: Path, out: Path, expected: dict[str, bytes]) -> Row:
    """What ``resume`` makes of it, and whether ``overwrite`` leads out."""
    wrong = dead_end = ""
    try:
        report = ground(survey, out, resume=True)
        outcome = "went on" if report.complete else "went on, named what it could not do"
        found, failed = contents(out), {Path(one["file"]).name for one in report.failed}
        bad = [name for name, data in found.items() if data != expected[name] and name not in failed]
        unnamed = [name for name in expected if name not in found and name not in failed]
        if bad or unnamed:
            wrong = f"labels of other points in {bad}, not there and not named {unnamed}"
        if report.again:
            outcome += ", named what it made again"
    except jf.JaxfilterError as error:
        outcome = "refused" if "overwrite=True" in str(error) else "refused, without advice"
        if str(out) not in str(error) and str(survey) not in str(error):
            wrong = f"an error that names no file: {error}"
        dead_end = "" if "overwrite=True" in str(error) or "name another" in str(error) else str(error)
    except Exception as error:  # what is looked for
        outcome, wrong = "crash", repr(error)
    try:
        report = ground(survey, out, overwrite=True)
    except jf.JaxfilterError as error:
        blocking = [path for path in out.glob("*.las") if path.is_dir()]
        if not blocking or str(blocking[0]) not in str(error):
            return {"outcome": outcome, "wrong": wrong, "dead_end": dead_end or f"overwrite: {error}"}
        outcome += "; overwrite named the folder that is in the way"
        shutil.rmtree(blocking[0])
        report = ground(survey, out, overwrite=True)
    except Exception as error:  # what is looked for
        return {"outcome": outcome, "wrong": wrong, "dead_end": dead_end or f"overwrite: {error!r}"}
    ground(survey, out.with_name("fresh"))
    if not report.complete or contents(out) != contents(out.with_name("fresh")):
        dead_end = dead_end or "overwrite made other outputs than a first run"
    if extra := {path.name for path in out.iterdir()} - {path.name for path in out.with_name("fresh").iterdir()}:
        wrong = wrong or f"left over {sorted(extra)}"
    return {"outcome": outcome, "wrong": wrong, "dead_end": dead_end}


def report(rows: list[Row]) -> str:
    """The tables as Markdown."""
    table = []
    for what in WHAT:
        mine = [found for found in rows if found["what"] == what]
        outcomes = Counter(found["outcome"] for found in mine)
        table.append(
            {"what": what, "ways": len({(one["state"], one["damage"]) for one in mine}), "runs": len(mine)}
            | {key: sum(bool(one[key]) for one in mine) for key in ("wrong", "dead_end")}
            | {"outcome": "; ".join(f"{text}: {count}" for text, count in outcomes.most_common())}
        )
    table.append({"what": "all"} | {k: sum(one[k] for one in table) for k in ("ways", "runs", "wrong", "dead_end")})
    columns: list[Column] = [
        ("what", "what was damaged", ""), ("ways", "ways", "d"), ("runs", "runs", "d"), ("wrong", "wrong", "d"),
        ("dead_end", "dead ends", "d"), ("outcome", "what resume did", ""),
    ]  # fmt: skip
    return "\n\n".join([
        "# Damaged surveys", markdown(columns, table),
        "Wrong: an output that is not that of an undisturbed run and is not named as failed, an error that is not the "
        "package's own or names no file, or something left over. Dead end: an error without advice, or `overwrite` that does "
        "not lead to the outputs of a first run.",
    ])  # fmt: skip


if __name__ == "__main__":
    main()
