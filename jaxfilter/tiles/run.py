"""A run over a collection: tiles are handed out and taken in, files written, and all of it recorded.

The order in which tiles end, the executor and interruptions change nothing in the files.
"""

from __future__ import annotations

import collections
import dataclasses
import itertools
import json
import math
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import OutputError
from ..core.filter import Filter
from ..host.storage import Place
from .collection import Collection
from .journal import Journal
from .outputs import FileReport, FileTask, write_file
from .plan import Plan
from .pool import Executor, Outcome
from .task import Job, Tile, TileReport, filter_tile, labels_path, survey_tile

RETRIES = 2
"""Times that a tile or a file that failed is tried again before it is set aside."""
_WAIT = 0.25  # seconds between looks at the progress


@dataclasses.dataclass
class Standing:
    """How far a run is: what progress is made of.

    Attributes:
        step: ``"survey"`` or ``"tiles"``.
        tiles, tiles_done: all, and those that are done or set aside.
        points: of the cores done in this process; read: the same with halos; seconds: since it began.
        files, files_done: all, and those written.
        left: seconds, by the tiles done so far; NaN before the first.
    """

    step: str
    tiles: int
    tiles_done: int
    files: int
    files_done: int = 0
    points: int = 0
    read: int = 0
    seconds: float = 0.0
    left: float = math.nan

    @property
    def rate(self) -> float:
        """Points per second."""
        return self.points / self.seconds if self.seconds > 0 else 0.0


@dataclasses.dataclass
class RunReport:
    """What a run, with those that it went on from, has done.

    Attributes:
        tiles: number of them; set_aside: number, core and reason of those without labels.
        files: written; failed: URI and reason of those that were not; left_out: URI and reason of files that could not be
            read, so that tiles beside them had no halo there.
        points, candidates, ground: of all labelled tiles; read: with halos.
        seconds: of this process; tile_seconds: sum over the tiles.
        classes: points by (old class, new class).
        statuses: tiles by the filter's status; remarks: what was warned of, with how often.
        cores, state: f64[t, 4] in file units, and f64[t]: share of ground of the points, NaN where there are none, -1 for
            tiles that were set aside. For the map.
    """

    tiles: int
    set_aside: list[dict[str, Any]]
    files: list[str]
    failed: list[dict[str, str]]
    left_out: list[dict[str, str]]
    points: int
    candidates: int
    ground: int
    read: int
    seconds: float
    tile_seconds: float
    classes: dict[tuple[int, int], int]
    statuses: dict[str, int]
    remarks: dict[str, int]
    cores: np.ndarray
    state: np.ndarray

    @property
    def complete(self) -> bool:
        """Whether every file was written and none was left out."""
        return not (self.set_aside or self.failed or self.left_out)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, without the arrays."""
        found = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        del found["cores"], found["state"]
        found["classes"] = [{"before": old, "after": new, "points": n} for (old, new), n in self.classes.items()]
        return found | {"complete": self.complete}


class Run:
    """Tiles of a plan on their way through an executor."""

    def __init__(
        self,
        job: Job,
        plan: Plan,
        sources: Collection,
        targets: Sequence[Place],
        journal: Journal,
        executor: Executor,
        *,
        overwrite: bool = False,
        progress: Callable[[Standing], None] | None = None,
    ) -> None:
        """``targets``: where each source is written to; ``overwrite``: replace what is there.

        ``sources`` is indexed when a task is made, so that it may make them as they are needed.
        """
        self.job, self.plan, self.sources, self.targets = job, plan, sources, targets
        self.journal, self.executor, self.overwrite = journal, executor, overwrite
        self._progress = progress or (lambda standing: None)
        self._start = time.perf_counter()
        self._shown = 0.0
        self._unwritten = np.diff(plan.home.start).astype(np.int32)  # files per tile whose labels are still needed
        self._missing = np.diff(plan.tiles_of.start).astype(np.int64)  # tiles per file that are not done
        self._hopeless: dict[int, str] = {}

    def __call__(self) -> RunReport:
        """Do what is not done yet. Raises: OutputError if the journal cannot be written."""
        try:
            if type(self.job.filter).lowest is not Filter.lowest:
                self._survey()
            self._filter()
        finally:
            self.executor.close()
            self.journal.commit()
        report = report_of(self.plan, self.sources, self.targets, self.journal, time.perf_counter() - self._start)
        if report.complete:
            shutil.rmtree(self.job.folder, ignore_errors=True)
        return report

    def _survey(self) -> None:
        """The elevation of the lowest point of the collection, once."""
        facts = self.journal.fact("lowest")
        if facts is None:
            standing = Standing("survey", len(self.plan), 0, 0)
            lowest: float | None = None
            for _, outcome in self._carried_out(
                ((number, survey_tile, self._tile) for number in range(len(self.plan))), standing
            ):
                standing.tiles_done += 1
                if outcome.value is not None:
                    lowest = outcome.value if lowest is None else min(lowest, outcome.value)
                self._show(standing)
            facts = [lowest]
            self.journal.keep("lowest", facts)
        self.job = dataclasses.replace(self.job, whole=dataclasses.replace(self.job.whole, lowest=facts[0]))

    def _filter(self) -> None:
        plan, journal = self.plan, self.journal
        written = journal.done("files")
        for file in written:
            self._needs_no_more(file)
        is_done = np.zeros(len(plan), bool)
        done = np.array(journal.done("tiles"), np.int64)
        lost = [int(n) for n in done if self._unwritten[n] > 0 and not labels_path(self.job.folder, int(n)).exists()]
        if lost:
            journal.forget("tiles", lost)
        is_done[done] = True
        is_done[lost] = False
        for number in np.flatnonzero(is_done).tolist():
            self._missing[plan.home[number]] -= 1
        is_written = np.zeros(len(self._missing), bool)
        is_written[written] = True
        for tile, finished, facts in journal.reports("tiles"):
            if finished and is_done[tile]:
                self._hopeless |= dict(facts["left_out"])
        standing = Standing("tiles", len(plan), int(is_done.sum()), len(self._missing), len(written))
        complete: list[int] = np.flatnonzero((self._missing == 0) & ~is_written).tolist()
        todo: Iterator[_Task] = itertools.chain(
            ((f, write_file, self._file) for f in complete if f not in self._hopeless),
            ((n, filter_tile, self._tile) for n in np.flatnonzero(~is_done).tolist()),
        )
        for f in complete:
            if f in self._hopeless:
                self._failed(f)
        now: collections.deque[_Task] = collections.deque()
        before = standing.tiles_done
        for (number, function), outcome in self._carried_out(todo, standing, now):
            if function is write_file:
                self._took_file(number, outcome, standing)
            else:
                now += self._took_tile(number, outcome, standing)
            new = standing.tiles_done - before
            if new:
                standing.left = (len(plan) - standing.tiles_done) * (time.perf_counter() - self._start) / new
            self._show(standing)

    def _carried_out(
        self, todo: Iterator[_Task], standing: Standing, now: collections.deque[_Task] | None = None
    ) -> Iterator[tuple[tuple[int, Callable[..., Any]], Outcome]]:
        """Tasks with their outcomes, as they end; those in ``now`` come first. What fails is tried again."""
        now = collections.deque() if now is None else now
        running, ended = 0, False
        tries: collections.Counter[tuple[int, str]] = collections.Counter()
        while True:
            while self.executor.room() > 0:
                task = now.popleft() if now else next(todo, None)
                if task is None:
                    ended = True
                    break
                number, function, make = task
                key = number, function.__name__
                patient = tries[key] >= RETRIES
                self.executor.submit((task, key), function, self.job, make(number, patient))
                running += 1
            if ended and not running and not now:
                return
            for (task, key), outcome in self.executor.completed(_WAIT):
                running -= 1
                if outcome.reason is not None:
                    tries[key] += 1
                    if tries[key] <= RETRIES:
                        now.appendleft(task)
                        continue
                tries.pop(key, None)
                yield (task[0], task[1]), outcome
            self._show(standing)
            ended = False

    def _tile(self, number: int, patient: bool) -> Tile:
        files = tuple(int(f) for f in self.plan.near[number])
        sources = tuple(self.sources[f] for f in files)
        return Tile(number, self.plan.core(number), self.plan.window(number), files, sources, patient)

    def _file(self, number: int, patient: bool) -> FileTask:
        tiles = tuple(int(t) for t in self.plan.tiles_of[number])
        return FileTask(number, self.sources[number], tiles, self.targets[number], self.overwrite)

    def _took_tile(self, number: int, outcome: Outcome, standing: Standing) -> list[_Task]:
        """Record a tile; the files that are complete with it."""
        standing.tiles_done += 1
        homes = [int(f) for f in self.plan.home[number]]
        if outcome.reason is not None:
            self.journal.record("tiles", number, False, {"reason": outcome.reason})
            for file in homes:
                self._hopeless.setdefault(file, f"tile {number} was set aside: {outcome.reason}")
        else:
            report: TileReport = outcome.value
            standing.points += report.points
            standing.read += report.read
            self.journal.record("tiles", number, True, _facts_of(report))
            for file, reason in report.left_out:
                self._hopeless.setdefault(file, reason)
        self._missing[homes] -= 1
        complete = [file for file in homes if self._missing[file] == 0]
        for file in complete:
            if file in self._hopeless:
                self._failed(file)
        return [(file, write_file, self._file) for file in complete if file not in self._hopeless]

    def _took_file(self, number: int, outcome: Outcome, standing: Standing) -> None:
        if outcome.reason is not None:
            self._hopeless[number] = outcome.reason
            self._failed(number)
            return
        report: FileReport = outcome.value
        standing.files_done += 1
        self.journal.record("files", number, True, {"ground": report.ground, "remarks": report.remarks})
        self.journal.commit()  # before the labels go
        self._needs_no_more(number)

    def _failed(self, file: int) -> None:
        self.journal.record("files", file, False, {"reason": self._hopeless[file]})

    def _needs_no_more(self, file: int) -> None:
        """Remove the labels that only this file needed."""
        tiles = self.plan.tiles_of[file]
        self._unwritten[tiles] -= 1
        for number in tiles[self._unwritten[tiles] == 0]:
            labels_path(self.job.folder, int(number)).unlink(missing_ok=True)

    def _show(self, standing: Standing) -> None:
        now = time.perf_counter()
        if now - self._shown > _WAIT or standing.tiles_done == standing.tiles:
            self._shown, standing.seconds = now, now - self._start
            self._progress(standing)


_Task = tuple[int, Callable[..., Any], Callable[[int, bool], Any]]


def report_of(plan: Plan, sources: Collection, targets: Sequence[Place], journal: Journal, seconds: float) -> RunReport:
    """What the journal knows."""
    report = RunReport(
        tiles=len(plan), set_aside=[], files=[], failed=[], left_out=[], points=0, candidates=0, ground=0, read=0,
        seconds=seconds, tile_seconds=0.0, classes=collections.Counter(), statuses=collections.Counter(),
        remarks=collections.Counter(),
        cores=plan.cores(),
        state=np.full(len(plan), np.nan),
    )  # fmt: skip
    left_out: dict[int, str] = {}
    for number, done, facts in journal.reports("tiles"):
        if not done:
            report.state[number] = -1
            report.set_aside.append({"tile": number, "core": plan.core(number), "reason": facts["reason"]})
            continue
        for name in ("points", "candidates", "ground", "read"):
            setattr(report, name, getattr(report, name) + facts[name])
        report.tile_seconds += facts["seconds"]
        for old, new, n in facts["classes"]:
            report.classes[old, new] += n
        report.statuses[facts["status"]] += 1
        report.remarks.update(facts["remarks"])
        left_out |= dict(facts["left_out"])
        if facts["points"]:
            report.state[number] = facts["ground"] / facts["points"]
    for number, done, facts in journal.reports("files"):
        if done:
            report.files.append(str(targets[number]))
            report.remarks.update(facts["remarks"])
        else:
            report.failed.append({"file": sources[number].uri, "reason": facts["reason"]})
    report.left_out = [{"file": sources[n].uri, "reason": reason} for n, reason in sorted(left_out.items())]
    report.classes = dict(sorted(report.classes.items()))
    return report


def _facts_of(report: TileReport) -> dict[str, Any]:
    facts = dataclasses.asdict(report)
    del facts["number"]
    return facts | {"classes": [[old, new, n] for (old, new), n in report.classes.items()]}


def write_report(report: RunReport, path: Path) -> None:
    """Put a report beside the output, as JSON."""
    try:
        path.write_text(json.dumps(report.as_dict(), indent=1) + "\n")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
