"""A run over a collection: tiles are handed out and taken in, files written, and all of it recorded.

The order in which tiles end, the executor and interruptions change nothing in the files.
"""

from __future__ import annotations

import collections
import dataclasses
import itertools
import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.filter import Filter
from ..files.disk import Seal, new_file
from ..files.storage import Place
from .collection import Collection
from .journal import Journal
from .outputs import FileReport, FileTask
from .plan import Plan
from .pool import Executor, Outcome, Task, carried_out
from .task import Job, Tile, survey_tile

_WAIT = 0.25  # seconds between looks at the progress
_MOST_DRAWN = 100_000  # tiles


@dataclasses.dataclass(frozen=True)
class Step:
    """What a run does.

    Attributes:
        tile: with each tile: from job and :class:`Tile` to a dataclass with ``number``, ``points``, ``read``, ``seal`` and
            ``left_out``.
        kept: where that puts what it found, by folder and number; ``seal`` is of that.
        file: with each file whose tiles are done: from job and :class:`FileTask` to a FileReport; None = nothing.
    """

    tile: Callable[[Any, Tile], Any]
    kept: Callable[[Path, int], Path]
    file: Callable[[Any, FileTask], FileReport] | None


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
        tiles: number of them; set_aside: number, core and reason of those that failed.
        files: written; failed: URI and reason of those that were not; left_out: URI and reason of files that could not be
            read, so that tiles beside them had no halo there; again: those written by an earlier run, but missing or changed
            when this one went on, which made them again, with what was wrong.
        points, candidates, ground: of all tiles that are done; read: with halos.
        seconds: of this process; tile_seconds: sum over the tiles.
        classes: points by (old class, new class).
        overlap: ``points`` that the producer has marked as overlap of flight lines, how many were ``judged``, and how many are
            ``ground``.
        statuses: tiles by the filter's status; remarks: what was warned of, with how often.
        cut_objects: objects that the border of the data cuts, a dict of a :class:`jaxfilter.surveys.border.CutObject` each,
            from south to north.
        heights: lowest and highest height above ground, units of Z, where these were asked for; uncertain: points whose
            height may be another in the whole.
        cores, state: f64[t, 4] in file units, and f64[t]: share of ground of the points, NaN where there are none, -1 for
            tiles that were set aside. For the map.
    """

    tiles: int
    set_aside: list[dict[str, Any]]
    files: list[str]
    failed: list[dict[str, str]]
    left_out: list[dict[str, str]]
    again: list[dict[str, str]]
    points: int
    candidates: int
    ground: int
    read: int
    seconds: float
    tile_seconds: float
    classes: dict[tuple[int, int], int]
    overlap: dict[str, int]
    statuses: dict[str, int]
    remarks: dict[str, int]
    cut_objects: list[dict[str, Any]]
    heights: tuple[float, float] | None
    uncertain: int
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

    def draw(self, place: Place) -> None:
        """Write a map: share of ground of each tile, those set aside with dashes, and objects that the
        border cuts as dots, large ones for those that are ground. Raises: OutputError."""
        if not 0 < len(self.cores) <= _MOST_DRAWN:
            return
        from ..plots import footprints

        shares = np.where(self.state >= 0, 100 * self.state, np.nan)
        aside = [tuple(core) for core in self.cores[self.state < 0].tolist()]
        ax = footprints(self.cores, shares, label="ground, % of the points", gaps=aside)
        for is_ground, size, name in ((False, 6.0, "cut by the border"), (True, 30.0, "the same, and ground")):
            shown = [(one["x"], one["y"]) for one in self.cut_objects if (one["ground"] >= 0.5) == is_ground]
            if shown:
                ax.scatter(*zip(*shown, strict=True), s=size, c="red", edgecolors="black", linewidths=0.5, label=name)
        if self.cut_objects:
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False)
        with new_file(place, overwrite=True) as part:
            ax.figure.savefig(part, format="png", dpi=150, bbox_inches="tight")


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
        step: Step,
        overwrite: bool = False,
        progress: Callable[[Standing], None] | None = None,
    ) -> None:
        """``targets``: where each source is written to, if ``step`` does; ``overwrite``: replace what is there.

        ``sources`` is indexed when a task is made, so that it may make them as they are needed.
        """
        self.job, self.plan, self.sources, self.targets = job, plan, sources, targets
        self.journal, self.executor, self.step, self.overwrite = journal, executor, step, overwrite
        self._progress = progress or (lambda standing: None)
        self._start = time.perf_counter()
        self._shown = 0.0
        self._unwritten = np.diff(plan.home.start).astype(np.int32)  # files per tile whose labels are still needed
        self._missing = np.diff(plan.tiles_of.start).astype(np.int64)  # tiles per file that are not done
        self._is_written = np.zeros(len(self._missing), bool)
        self._hopeless: dict[int, str] = {}
        self.again: list[dict[str, str]] = []

    def __call__(self) -> None:
        """Do what is not done yet. Raises: OutputError if the journal cannot be written."""
        try:
            if type(self.job.filter).lowest is not Filter.lowest:
                self._survey()
            self._carry_out()
        finally:
            self.executor.close()
            self.journal.commit()

    @property
    def seconds(self) -> float:
        """Since it was made."""
        return time.perf_counter() - self._start

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

    def _carry_out(self) -> None:
        plan, journal = self.plan, self.journal
        self._try_again()
        written = self._written()
        for file in written:
            self._needs_no_more(file)
        is_done = np.zeros(len(plan), bool)
        for number, done, facts in journal.reports("tiles"):
            is_done[number] = done and not (self._needed(number) and Seal(**facts["seal"]).broken(self._kept(number)))
        for number in np.flatnonzero(is_done).tolist():
            self._missing[plan.home[number]] -= 1
        self._is_written[written] = True
        standing = Standing("tiles", len(plan), int(is_done.sum()), len(self._missing), len(written))
        writes = self.step.file is not None
        complete: list[int] = np.flatnonzero((self._missing == 0) & ~self._is_written).tolist() if writes else []
        todo = itertools.chain(
            (self._writing(f) for f in complete),
            (Task(self.step.tile, n, self._tile(n)) for n in np.flatnonzero(~is_done).tolist()),
        )
        now: collections.deque[Task] = collections.deque()
        before = standing.tiles_done
        for task, outcome in carried_out(self.executor, todo, now, lambda: self._show(standing)):
            if task.function is self.step.file:
                self._took_file(task.number, outcome, standing)
            else:
                now += self._took_tile(task.number, outcome, standing)
            new = standing.tiles_done - before
            if new:
                standing.left = (len(plan) - standing.tiles_done) * (time.perf_counter() - self._start) / new
            self._show(standing)

    def _written(self) -> list[int]:
        """Numbers of the files that are done and lie there as they were written."""
        found = []
        for number, done, facts in self.journal.reports("files"):
            if not done:
                continue
            wrong = Seal(**facts["seal"]).broken(self.targets[number])
            if wrong is None:
                found.append(number)
            else:
                self.again.append({"file": str(self.targets[number]), "reason": wrong})
        return found

    def _tile(self, number: int) -> Callable[[bool], tuple[Job, Tile]]:
        return lambda last: (self.job, tile_of(self.plan, self.sources, number, patient=last))

    def _writing(self, number: int) -> Task:
        def arguments(last: bool) -> tuple[Job, FileTask]:
            tiles = tuple(self.plan.tiles_of[number].tolist())
            return self.job, FileTask(number, self.sources[number], tiles, self.targets[number], self.overwrite)

        assert self.step.file is not None
        return Task(self.step.file, number, arguments)

    def _took_tile(self, number: int, outcome: Outcome, standing: Standing) -> list[Task]:
        """Record a tile; the files that are complete with it."""
        standing.tiles_done += 1
        homes = [int(f) for f in self.plan.home[number]]
        if outcome.reason is not None:
            self.journal.record("tiles", number, False, {"reason": outcome.reason})
            for file in homes:
                self._hopeless.setdefault(file, f"tile {number} was set aside: {outcome.reason}")
        else:
            report = outcome.value
            standing.points += report.points
            standing.read += report.read
            self.journal.record("tiles", number, True, _facts_of(report))
            for file, reason in report.left_out:
                self._hopeless.setdefault(file, reason)
        if self.step.file is None:
            return []
        self._missing[homes] -= 1
        complete = [file for file in homes if self._missing[file] == 0 and not self._is_written[file]]
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
        self.journal.record("files", number, True, _facts_of(report))
        self.journal.commit()  # before the labels go
        self._needs_no_more(number)

    def _failed(self, file: int) -> None:
        self.journal.record("files", file, False, {"reason": self._hopeless[file]})

    def _needs_no_more(self, file: int) -> None:
        """Remove the labels that only this file needed."""
        tiles = self.plan.tiles_of[file]
        self._unwritten[tiles] -= 1
        for number in tiles[self._unwritten[tiles] == 0]:
            self._kept(number).unlink(missing_ok=True)

    def _needed(self, tile: int) -> bool:
        """Whether what a tile found is still to be used: by a file that is not written, or at the end."""
        return self.step.file is None or bool(self._unwritten[tile] > 0)

    def _kept(self, tile: int) -> Path:
        return self.step.kept(self.job.folder, int(tile))

    def _show(self, standing: Standing) -> None:
        now = time.perf_counter()
        if now - self._shown > _WAIT or standing.tiles_done == standing.tiles:
            self._shown, standing.seconds = now, now - self._start
            self._progress(standing)


def tile_of(plan: Plan, sources: Collection, number: int, patient: bool = False) -> Tile:
    """A tile of a plan as a task takes it."""
    files = tuple(plan.near[number].tolist())
    return Tile(number, plan.core(number), plan.window(number), files, tuple(sources[f] for f in files), patient)


def report_of(run: Run) -> RunReport:
    """What the journal knows of a run that labels points."""
    plan, sources, journal = run.plan, run.sources, run.journal
    report = RunReport(
        tiles=len(plan), set_aside=[], files=[], failed=[], left_out=[], again=run.again, points=0, candidates=0, ground=0,
        read=0, seconds=run.seconds, tile_seconds=0.0, classes=collections.Counter(), overlap=collections.Counter(),
        statuses=collections.Counter(), remarks=collections.Counter(), cut_objects=[], heights=None, uncertain=0,
        cores=plan.cores(), state=np.full(len(plan), np.nan),
    )  # fmt: skip
    left_out: dict[int, str] = {}
    heights: list[float] = []
    for number, done, facts in journal.reports("tiles"):
        if not done:
            report.state[number] = -1
            report.set_aside.append({"tile": number, "core": plan.core(number), "reason": facts["reason"]})
            continue
        for name in ("points", "candidates", "ground", "read", "uncertain"):
            setattr(report, name, getattr(report, name) + facts[name])
        report.tile_seconds += facts["seconds"]
        for old, new, n in facts["classes"]:
            report.classes[old, new] += n
        report.overlap.update(facts["overlap"])
        report.statuses[facts["status"]] += 1
        report.remarks.update(facts["remarks"])
        report.cut_objects += facts["cut_objects"]
        heights += facts["heights"] or ()
        left_out |= dict(facts["left_out"])
        if facts["points"]:
            report.state[number] = facts["ground"] / facts["points"]
    for number, done, facts in journal.reports("files"):
        if done:
            report.files.append(str(run.targets[number]))
            report.remarks.update(facts["remarks"])
        else:
            report.failed.append({"file": sources[number].uri, "reason": facts["reason"]})
    report.left_out = [{"file": sources[n].uri, "reason": reason} for n, reason in sorted(left_out.items())]
    report.classes = dict(sorted(report.classes.items()))
    report.cut_objects.sort(key=lambda one: (one["y"], one["x"]))
    report.heights = (min(heights), max(heights)) if heights else None
    return report


def _facts_of(report: Any) -> dict[str, Any]:
    facts = dataclasses.asdict(report)
    del facts["number"]
    if "classes" in facts:
        facts["classes"] = [[old, new, n] for (old, new), n in report.classes.items()]
    return facts


def write_report(facts: dict[str, Any], place: Place) -> None:
    """Put a report beside the output. Raises: OutputError."""
    with new_file(place, overwrite=True) as part:
        part.write_text(json.dumps(facts, indent=1) + "\n")
