"""Which tests reach which lines of the package: recorded by coverage.py, a process per file of tests. Also a pytest plugin."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coverage
import pytest

RECORD, TEST = "MUTATIONS_RECORD", "MUTATIONS_TEST"
SETTINGS = """[run]
source = {package}
data_file = {folder}/lines
parallel = true
concurrency = multiprocessing,thread
context = ${{{test}}}
"""
LIMIT = 3600.0
"""Seconds for a file of tests."""

outcomes: dict[str, dict[str, Any]] = defaultdict(lambda: {"seconds": 0.0, "passed": True})


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Lines that run from here on are this test's, those of processes that it starts too."""
    if RECORD in os.environ:
        os.environ[TEST] = item.nodeid
        coverage.Coverage.current().switch_context(item.nodeid)
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """What setup, test and what comes after it took."""
    outcomes[report.nodeid]["seconds"] += report.duration
    outcomes[report.nodeid]["passed"] &= report.passed


def pytest_sessionfinish() -> None:
    """Kept beside the lines."""
    if RECORD in os.environ:
        Path(os.environ[RECORD], "outcomes.json").write_text(json.dumps(outcomes))


def record(tree: Path, files: list[str], folder: Path) -> None:
    """Run each file of tests that is not recorded yet; a folder per file holds lines and outcomes."""
    for number, name in enumerate(files):
        place = folder / name.replace("/", "+")
        if (place / "outcomes.json").exists():
            continue
        place.mkdir(parents=True, exist_ok=True)
        (place / "sitecustomize.py").write_text("import coverage\n\ncoverage.process_startup()\n")
        settings = place / "settings.ini"
        settings.write_text(SETTINGS.format(package=tree / "jaxfilter", folder=place, test=TEST))
        own = {RECORD: str(place), TEST: "", "COVERAGE_PROCESS_START": str(settings)}
        paths = [str(place), str(tree), *filter(None, [os.environ.get("PYTHONPATH")])]
        call = [sys.executable, "-m", "pytest", "-p", __spec__.name, "-p", "no:cacheprovider", "-q", name]
        began = time.perf_counter()
        with open(place / "said.txt", "w") as said:
            environment = os.environ | own | {"PYTHONPATH": os.pathsep.join(paths)}
            done = subprocess.run(call, cwd=tree, env=environment, stdout=said, stderr=said, timeout=LIMIT).returncode
        print(f"{number + 1}/{len(files)} {name}: {time.perf_counter() - began:.0f} s, exit code {done}", flush=True)


class Reached:
    """Tests by the line of the package that they reach."""

    def __init__(self, tree: Path, folder: Path) -> None:
        self.tests: dict[tuple[str, int], set[str]] = defaultdict(set)
        self.seconds: dict[str, float] = {}
        self.failing: list[str] = []
        self.lines: dict[str, int] = defaultdict(int)
        """How many lines a test reaches."""
        for place in sorted(folder.iterdir()):
            if not (place / "outcomes.json").exists():
                continue
            found = json.loads((place / "outcomes.json").read_text())
            self.failing += [test for test, outcome in found.items() if not outcome["passed"]]
            self.seconds |= {test: outcome["seconds"] for test, outcome in found.items() if outcome["passed"]}
            for file in place.glob("lines.*"):
                self._add(tree, file)

    @staticmethod
    def unit(test: str) -> str:
        """What is given to pytest: blocks of a page are run together."""
        return test.split("::")[0] if test.split("::")[0].endswith(".md") else test

    def time(self, unit: str) -> float:
        """Seconds that it took when it was recorded."""
        return (
            self.seconds[unit]
            if unit in self.seconds
            else sum(s for t, s in self.seconds.items() if self.unit(t) == unit)
        )

    def _add(self, tree: Path, file: Path) -> None:
        data = coverage.CoverageData(str(file))
        data.read()
        for module in data.measured_files():
            name = module.partition(f"/{tree.name}/")[2]
            for line, contexts in data.contexts_by_lineno(module).items():
                for test in contexts:
                    if test in self.seconds:
                        self.tests[name, line].add(test)
                        self.lines[test] += 1
