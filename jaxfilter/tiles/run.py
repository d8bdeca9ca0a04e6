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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.filter import Filter
from ..host.files import new_file
from ..host.storage import Place
from .collection import Collection
from .journal import Journal
from .outputs import FileReport, FileTask, write_file
from .plan import Plan
from .pool import Executor, Outcome, Task, carried_out
from .task import Job, Tile, TileReport, filter_tile, labels_path, survey_tile

_WAIT = 0.25  # seconds between looks at the progress
_MOST_DRAWN = 100_000  # tiles


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
            todo = (Task(survey_tile, n, self._tile(n)) for n in range(len(self.plan)))
            for _, outcome in carried_out(self.executor, todo, collections.deque(), lambda: self._show(standing)):
                standing.tiles_done += 1
                if outcome.value is not None:
                    lowest = outcome.value if lowest is None else min(lowest, outcome.value)
                self._show(standing)
            facts = [lowest]
            self.journal.keep("lowest", facts)
        self.job = dataclasses.replace(self.job, whole=dataclasses.replace(self.job.whole, lowest=facts[0]))

    def _try_again(self) -> None:
        """Forget tiles that had to do without a file, and the files that have their labels."""
        poor = [n for n, done, facts in self.journal.reports("tiles") if done and facts["left_out"]]
        if poor:
            self.journal.forget("files", np.unique(np.concatenate([self.plan.home[n] for n in poor])).tolist())
            self.journal.forget("tiles", poor)

    def _filter(self) -> None:
        plan, journal = self.plan, self.journal
        self._try_again()
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
        standing = Standing("tiles", len(plan), int(is_done.sum()), len(self._missing), len(written))
        complete: list[int] = np.flatnonzero((self._missing == 0) & ~is_written).tolist()
        todo = itertools.chain(
            (self._writing(f) for f in complete),
            (Task(filter_tile, n, self._tile(n)) for n in np.flatnonzero(~is_done).tolist()),
        )
        now: collections.deque[Task] = collections.deque()
        before = standing.tiles_done
        for task, outcome in carried_out(self.executor, todo, now, lambda: self._show(standing)):
            if task.function is write_file:
                self._took_file(task.number, outcome, standing)
            else:
                now += self._took_tile(task.number, outcome, standing)
            new = standing.tiles_done - before
            if new:
                standing.left = (len(plan) - standing.tiles_done) * (time.perf_counter() - self._start) / new
            self._show(standing)

    def _tile(self, number: int) -> Callable[[bool], tuple[Job, Tile]]:
        return lambda last: (self.job, tile_of(self.plan, self.sources, number, patient=last))

    def _writing(self, number: int) -> Task:
        def arguments(last: bool) -> tuple[Job, FileTask]:
            tiles = tuple(self.plan.tiles_of[number].tolist())
            return self.job, FileTask(number, self.sources[number], tiles, self.targets[number], self.overwrite)

        return Task(write_file, number, arguments)

    def _took_tile(self, number: int, outcome: Outcome, standing: Standing) -> list[Task]:
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
        return [self._writing(file) for file in complete if file not in self._hopeless]

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


def tile_of(plan: Plan, sources: Collection, number: int, patient: bool = False) -> Tile:
    """A tile of a plan as a task takes it."""
    files = tuple(plan.near[number].tolist())
    return Tile(number, plan.core(number), plan.window(number), files, tuple(sources[f] for f in files), patient)


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
    """Put a report beside the output, as JSON and, if matplotlib is there, as a map: share of ground of each tile, those set
    aside with dashes. Raises: OutputError."""
    with new_file(path, overwrite=True) as part:
        part.write_text(json.dumps(report.as_dict(), indent=1) + "\n")
    if not 0 < len(report.cores) <= _MOST_DRAWN:
        return
    try:
        from ..plots import footprints

        shares = np.where(report.state >= 0, 100 * report.state, np.nan)
        aside = [tuple(core) for core in report.cores[report.state < 0].tolist()]
        figure = footprints(report.cores, shares, label="ground, % of the points", gaps=aside).figure
    except ImportError:
        return
    with new_file(path.with_suffix(".png"), overwrite=True) as part:
        figure.savefig(part, format="png", dpi=150, bbox_inches="tight")
