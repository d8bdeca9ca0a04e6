"""Small seeded changes of the package, each tried on the tests that reach its line; those that no test notices. See README.md."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments.mutations.felt import Felt
from experiments.mutations.kinds import Mutation, places
from experiments.mutations.reached import Reached, record
from experiments.report import Row, markdown, read_csv, write_csv, write_page

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PACKAGE = "jaxfilter"
CONSTANTS = 1 / 3
"""Share of the constants among which is drawn: they are more than a third of all places."""
KINDS = [("kind", "change", ""), *((name, name, "d") for name in ("killed", "survived", "not run"))]
LISTED = [("number", "number", "d"), *((name, name, "") for name in ("place", "change", "note"))]
WHOLE = ".whole"
"""Ends the name of a module while it is changed."""
LOAD = 60
"""Seconds for the imports of a changed program, and for compiling its loops."""


def main(arguments: list[str] | None = None) -> None:
    """Draw, try and write the tables."""
    given = sys.argv[1:] if arguments is None else arguments
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=300)
    parser.add_argument("--seed", type=int, default=20262)
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests for each, by the times of the recording")
    parser.add_argument("--again", action="store_true", help="try the survivors again, with the tests as they are now")
    parser.add_argument("--only", type=int, nargs="*", help="these numbers, tried before or not; none: only the tables")
    parser.add_argument("--as-recorded", action="store_true", help="record no more tests")
    parser.add_argument("--fresh", action="store_true", help="forget what was recorded and tried")
    parser.add_argument("--work", type=Path, default=HERE / "out")
    parser.add_argument("--out", type=Path, default=HERE / "results")
    options = parser.parse_args(given)
    if options.fresh:
        shutil.rmtree(options.work, ignore_errors=True)
    work = Work(options.work.resolve())
    if not options.as_recorded:
        record(work.tree, work.tests(), work.map)
    drawn = draw(work.tree, options.number, options.seed)
    done = work.done()
    if options.only is not None:
        numbers = options.only
    else:
        numbers = [
            n for n in range(len(drawn)) if n not in done or (options.again and done[n]["outcome"] == "survived")
        ]

    with Trial(work, options.seconds) as trial:

        def try_one(number: int) -> None:
            row = {"number": number, **trial(drawn[number])}
            if row["tests"] or not options.as_recorded:
                work.keep(row)
            said = (drawn[number].file, drawn[number].line, row["outcome"], f"{row['seconds']} s", row["test"])
            print(number, *said, file=sys.stderr, flush=True)

        for number in numbers:
            try_one(number)
        while numbers := trial.doubted(work.done()):
            for number in numbers:
                try_one(number)
    write(options.out, drawn, work.done(), shlex.join(["python", "experiments/mutations/run.py", *given]))


def draw(tree: Path, number: int, seed: int) -> list[Mutation]:
    """One change of each of so many places; the first hundred of 300 are the hundred of 100."""
    rng = random.Random(seed)
    found = []
    for path in sorted((tree / PACKAGE).rglob("*.py")):
        found += list(places(path.read_text(), path.relative_to(tree).as_posix()))
    found = [place for place in found if place[0].kind != "constant" or rng.random() < CONSTANTS]
    rng.shuffle(found)
    return [rng.choice(place) for place in found[:number]]


class Work:
    """The folder that a run works in: a copy of the repository, what was recorded, and what was tried."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tree, self.map = folder, folder / "tree", folder / "map"
        self.log = folder / "tried.jsonl"
        for whole in list(self.tree.rglob(f"*{WHOLE}")):  # the run was killed
            whole.replace(whole.with_suffix(""))
            for compiled in self.tree.rglob("*.nb?"):
                compiled.unlink()
        names = subprocess.run(
            ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, check=True
        )
        for name in names.stdout.decode().splitlines():
            source, target = ROOT / name, self.tree / name
            if not source.exists() or (target.exists() and target.read_bytes() == source.read_bytes()):
                continue
            if self.log.exists() and name.startswith(PACKAGE + "/"):
                raise SystemExit(f"{name} is not what the mutations were drawn from: begin anew with --fresh")
            if target.exists():  # recorded again
                shutil.rmtree(self.map / name.replace("/", "+"), ignore_errors=True)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)

    def tests(self) -> list[str]:
        """Files that pytest collects."""
        patterns = ("tests/test_*.py", "README.md", "CONTRIBUTING.md", "docs/*.md", "docs/filters/*.md")
        return [
            path.relative_to(self.tree).as_posix() for pattern in patterns for path in sorted(self.tree.glob(pattern))
        ]

    def done(self) -> dict[int, Row]:
        """What was tried, the last time."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return {row["number"]: row for row in map(json.loads, lines)}

    def keep(self, row: Row) -> None:
        """Add what was tried."""
        with open(self.log, "a") as file:
            file.write(json.dumps(row) + "\n")


class Trial:
    """Applies a change to the copy, runs tests, and takes it back."""

    def __init__(self, work: Work, seconds: float) -> None:
        self.work, self.seconds = work, seconds
        self.reached, self.felt = Reached(work.tree, work.map), Felt(work.tree, PACKAGE)
        self.sound: set[str] = set()
        """Tests that killed, and pass without a change when run in the same way."""
        self.unsound: set[str] = set()

    def __enter__(self) -> Trial:
        call = [sys.executable, str(HERE / "server.py")]
        path = os.pathsep.join([str(self.work.tree), *filter(None, [os.environ.get("PYTHONPATH")])])
        own = os.environ | {"PYTHONPATH": path, "TMPDIR": str(self.work.folder)}
        self.server = subprocess.Popen(call, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=own, cwd="/")
        names = sorted({self.reached.unit(test) for test in self.reached.seconds})
        self.pytest(names, 10 * LOAD, "--collect-only", "-q")
        said = (self.work.folder / "said.txt").read_text(errors="replace")
        self.unsound |= set(re.findall(rf"^ERROR: not found: {self.work.tree}/(.*)$", said, re.MULTILINE))
        return self

    def __exit__(self, *_: object) -> None:
        self.server.stdin.close()
        self.server.wait()

    def __call__(self, mutation: Mutation) -> Row:
        """Outcome, the test that noticed it, how many were run, and seconds."""
        began = time.perf_counter()
        tests, left = self.chosen(mutation)
        outcome, test = "survived", "" if tests else "no test reaches it"
        if tests:
            with self.changed(mutation) as compiled:
                limit = LOAD + 4 * sum(self.reached.time(one) for one in tests) + 5 * LOAD * compiled
                code = self.pytest(tests, limit, "-x")
            if code:
                outcome, test = "killed", self.killer(code)
        seconds = round(time.perf_counter() - began, 1)
        return {"outcome": outcome, "test": test, "tests": len(tests), "left": left, "seconds": seconds}

    def doubted(self, done: dict[int, Row]) -> list[int]:
        """Numbers whose killers fail without a change too, all run together; those are used no more."""
        killers = {row["number"]: self.reached.unit(row["test"]) for row in done.values() if "::" in row["test"]}
        names = sorted(set(killers.values()) - self.sound)
        if names and self.pytest(names, 10 * LOAD + 4 * sum(map(self.reached.time, names))):
            self.unsound |= {self.reached.unit(name) for name in self.failed()}
        self.sound |= set(names) - self.unsound
        return [number for number, name in killers.items() if name in self.unsound]

    def chosen(self, mutation: Mutation) -> tuple[list[str], int]:
        """Tests that reach a line, near and fast ones first; then others of their files, which may use what they compiled."""
        found = {test for line in self.felt(mutation) for test in self.reached.tests.get(line, ())}
        files = {test.split("::")[0] for test in found}
        beside = {test for test in self.reached.seconds if test.split("::")[0] in files} - found
        names = dict.fromkeys(
            self.reached.unit(t) for some in (found, beside) for t in sorted(some, key=self.cost(mutation))
        )
        tests, spent = [], 0.0
        names = [name for name in names if name not in self.unsound]
        for name in names:
            if spent < self.seconds and (not tests or spent + self.reached.time(name) < 2 * self.seconds):
                tests.append(name)
                spent += self.reached.time(name)
        return tests, len(names) - len(tests)

    def cost(self, mutation: Mutation) -> Any:
        """Tests that take long, run many lines or belong to another module come late."""
        stem = f"test_{Path(mutation.file).stem}."
        return lambda test: (self.reached.seconds[test] + 0.1) * self.reached.lines[test] / (1 + 9 * (stem in test))

    @contextlib.contextmanager
    def changed(self, mutation: Mutation) -> Iterator[bool]:
        """The copy with a change; whether loops are compiled anew, since Numba does not see changes of what they call."""
        path, away = self.work.tree / mutation.file, self.work.folder / "numba"
        whole = path.with_name(path.name + WHOLE)
        modules = [self.work.tree / name for name in self.felt.compiled_with(mutation.file)]
        kept = [file for one in modules for file in (one.parent / "__pycache__").glob(f"{one.stem}.*.nb?")]
        away.mkdir(exist_ok=True)
        for file in kept:
            file.rename(away / file.name)
        path.rename(whole)
        path.write_bytes(mutation.apply(whole.read_bytes()))
        try:
            yield bool(modules)
        finally:
            whole.replace(path)
            for one in modules:
                for file in (one.parent / "__pycache__").glob(f"{one.stem}.*.nb?"):
                    file.unlink()
            for file in kept:
                (away / file.name).rename(file)

    def pytest(self, tests: list[str], limit: float, *more: str) -> int:
        """Its exit code; negative after the time limit or a crash."""
        arguments = [
            "-p",
            "no:cacheprovider",
            "--tb=line",
            "--basetemp",
            str(self.work.folder / "base"),
            *more,
            *tests,
        ]
        task = {"tree": str(self.work.tree), "said": str(self.work.folder / "said.txt"), "arguments": arguments}
        self.server.stdin.write(json.dumps(task | {"limit": int(limit), "environment": {}}) + "\n")
        self.server.stdin.flush()
        return int(self.server.stdout.readline())

    def failed(self) -> list[str]:
        """Tests that failed in the last run."""
        said = (self.work.folder / "said.txt").read_text(errors="replace")
        return [found[1] for found in re.finditer(r"^(?:FAILED|ERROR) (\S+::.*?)(?: - .*)?$", said, re.MULTILINE)]

    def killer(self, code: int) -> str:
        """The test that failed, or how the run ended."""
        return (self.failed() or [{-14: "(time limit)"}.get(code, f"(exit code {code})")])[0]


def write(out: Path, drawn: list[Mutation], done: dict[int, Row], command: str) -> None:
    """All mutations as CSV; numbers and survivors as Markdown, with what was found by looking at them (``looked_at.csv``)."""
    out.mkdir(parents=True, exist_ok=True)
    notes = {row["number"]: row for row in read_csv(out / "looked_at.csv")} if (out / "looked_at.csv").exists() else {}
    rows = []
    for number, mutation in enumerate(drawn):
        row = {
            key: value for key, value in asdict(mutation).items() if key in ("file", "line", "kind", "before", "after")
        }
        tried = done.get(number, {"outcome": "not run", "test": "", "tests": 0, "left": 0, "seconds": 0})
        rows.append({"number": number, **row, **tried, "note": notes.get(number, {}).get("note", "")})
    write_csv(out / "mutations.csv", rows)
    survivors = [row for row in rows if row["outcome"] == "survived"]
    counts = Counter(notes.get(row["number"], {}).get("verdict", "not looked at") for row in survivors)
    kinds = [
        {
            "kind": kind,
            **{name: sum(row["outcome"] == name for row in some) for name in ("killed", "survived", "not run")},
        }
        for kind in dict.fromkeys(sorted(row["kind"] for row in rows))
        for some in [[row for row in rows if row["kind"] == kind]]
    ]
    total = {"kind": "all", **{key: sum(row[key] for row in kinds) for key in ("killed", "survived", "not run")}}
    listed = [
        row
        | {
            "place": f"`{row['file']}:{row['line']}`",
            "change": f"`{_short(row['before'])}` to `{_short(row['after'])}`",
        }
        for row in survivors
    ]
    text = f"# Mutations\n\n{markdown(KINDS, [*kinds, total])}\n\n## Survivors\n\n"
    text += (
        ", ".join(f"{name}: {count}" for name, count in sorted(counts.items()))
        + "\n\n"
        + markdown(LISTED, listed)
        + "\n"
    )
    write_page(out / "results.md", text, command)


def _short(text: str) -> str:
    text = " ".join(text.split()).replace("|", "\\|")
    return text if len(text) < 70 else text[:66] + " ..."


if __name__ == "__main__":
    main()
