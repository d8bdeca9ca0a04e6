"""A run: the tiles of a plan are handed out and taken in, and files are written. One file is a run of one.

The order in which tiles end, the executor and interruptions change nothing in the files.
"""

from __future__ import annotations

import collections
import dataclasses
import math
import time
from collections.abc import Callable, Iterator

import numpy as np

from ..core.errors import OutputError
from ..core.filter import lowest_among
from ..files.disk import Seal
from .area import meeting
from .collection import Collection
from .executors import RETRIES, Executor, Outcome, Task, carried_out
from .options import RunOptions, executor_for
from .plan import Plan
from .product import FileTask, Product, do_tile, lowest_in_tile, write_file
from .report import Standing, Summary
from .targets import Targets
from .tiles import Tile

_WAIT = 0.25  # seconds between looks at the progress


@dataclasses.dataclass
class Run:
    """Tiles of a plan on their way through an executor, and the files that are written out of them."""

    product: Product
    plan: Plan
    collection: Collection
    targets: Targets
    options: RunOptions

    def __post_init__(self) -> None:
        product, plan, options = self.product, self.plan, self.options
        self.store = self.targets.store
        self._progress = options.progress or (lambda standing: None)
        self._start = time.perf_counter()
        self._shown = 0.0
        self._unwritten = np.diff(plan.home.start).astype(np.int32)  # files per tile whose labels are still needed
        self._missing = np.diff(plan.tiles_of.start).astype(np.int64)  # tiles per file that are not done
        self._is_written = np.zeros(len(self._missing), bool)
        self._hopeless: dict[int, str] = {}
        if (aoi := product.reader.reading.aoi) is not None:  # nothing of other files is wanted
            for file in np.flatnonzero(~meeting(aoi, self.collection.footprints)).tolist():
                self._is_written[file] = True
                self._need_no_more(file)
        if options.in_place:  # what no tile labels stays as it is
            self._is_written |= self._missing == 0
        files, times = int((~self._is_written).sum()), plan.times_read(self.collection.count)
        files *= product.writes_files
        self._standing = Standing("tiles", len(plan), 0, files, times_read=times)
        self.report = product.REPORT(tiles=len(plan), cores=plan.cores, state=np.full(len(plan), np.nan))

    def __call__(self) -> None:
        """Do what is not done yet. Raises: OutputError if a disk is full; of a single file what its tiles raise."""
        executor = executor_for(self.options, self.plan, self._show_step)
        try:
            self._find_lowest(executor)
            self._carry_out(executor)
        finally:
            executor.close()
        self._complete_report()

    def _find_lowest(self, executor: Executor) -> None:
        """Measure the elevation of the lowest point of the collection, once, if the filter asks for it."""
        filter_, whole = self.product.filter, self.product.reader.whole
        if filter_ is None or whole is None or lowest_among.dispatch(type(filter_)) is lowest_among.dispatch(object):
            return
        if "lowest" not in self.store.facts:
            standing, found = dataclasses.replace(self._standing, step="survey"), [math.inf]
            todo = (Task(lowest_in_tile, n, self._tile(n)) for n in range(len(self.plan)))
            for _, outcome in carried_out(executor, todo, collections.deque(), lambda: self._show(standing)):
                standing.tiles_done += 1
                found += [] if outcome.value is None else [outcome.value]
                self._show(standing)
            self.store.note(lowest=None if len(found) == 1 else min(found))
        whole = dataclasses.replace(whole, lowest=self.store.facts["lowest"])
        reader = dataclasses.replace(self.product.reader, whole=whole)
        self.product = dataclasses.replace(self.product, reader=reader)

    def _carry_out(self, executor: Executor) -> None:
        done = self._look()
        complete = (self._missing == 0) & ~self._is_written & self.product.writes_files
        tiles = (Task(do_tile, n, self._tile(n)) for n in np.flatnonzero(~done).tolist())
        files = collections.deque(self._writing(file) for file in np.flatnonzero(complete).tolist())
        if self.options.in_place:  # no input is replaced before all are read
            self._work(executor, tiles, collections.deque(), files)
        self._work(executor, tiles, files, files)

    def _work(
        self, executor: Executor, tiles: Iterator[Task], now: collections.deque[Task], files: collections.deque[Task]
    ) -> None:
        """Do ``tiles``, and before them what is in ``now``; files that are complete are added to ``files``."""
        plan, standing = self.plan, self._standing
        before = standing.tiles_done
        alone = len(self.collection) == len(plan) == 1
        for task, outcome in carried_out(executor, tiles, now, lambda: self._show(standing), 0 if alone else RETRIES):
            if alone and outcome.error is not None:
                raise outcome.error
            if task.function is write_file:
                self._take_file(task.number, outcome)
            else:
                files.extend(self._writing(file) for file in self._take_tile(task.number, outcome))
            new = standing.tiles_done - before
            if new:
                standing.left = (len(plan) - standing.tiles_done) * (time.perf_counter() - self._start) / new
            self._show(standing)

    def _look(self) -> np.ndarray:
        """bool[t]: tiles that are done, and whose labels are there if a file still needs them."""
        plan, store = self.plan, self.store
        known: dict[int, Summary] = {}
        if not self.options.resume:
            return np.zeros(len(plan), bool)
        for number in range(len(plan)):
            summary = store.summary(number)
            if summary is not None and not summary["unread"]:
                known[number] = Summary.of_json(summary)
            elif summary is not None:  # it lacks a file: it is done again, and the files that have its labels
                for file in plan.home[number].tolist():
                    store.drop_seal(file)
        for file, target in enumerate(self.targets.places):
            kept = store.seal(file)
            if kept is None or "seal" not in kept:
                continue
            wrong = Seal(**kept["seal"]).broken(target)
            if wrong is not None or not set(plan.tiles_of[file].tolist()) <= known.keys():
                self.report.again += [] if wrong is None else [{"file": str(target), "reason": wrong}]
                store.drop_seal(file)
                continue
            self._is_written[file] = True
            self.report.files.append(str(target))
            self.report.remarks.update(kept["remarks"])
            self._need_no_more(file)
        done = np.zeros(len(plan), bool)
        for number, found in known.items():
            used = not self.product.writes_files or bool(self._unwritten[number] > 0)  # by a file, or at the end
            done[number] = not used or store.summary(number, with_arrays=True) is not None
            if done[number]:
                self._missing[plan.home[number]] -= 1
                self._add(number, found)
        self._standing.tiles_done, self._standing.files_done = int(done.sum()), int(self._is_written.sum())
        if self.options.in_place and self.report.files and not done.all():
            raise OutputError(
                f"{store.path}: labels are gone or damaged, and inputs were replaced already: pass overwrite=True to begin anew"
            )
        return done

    def _tile(self, number: int) -> Callable[[bool], tuple[Product, Tile]]:
        several = len(self.collection) > 1
        return lambda last: (self.product, tile_of(self.plan, self.collection, number, patient=last and several))

    def _writing(self, number: int) -> Task:
        def arguments(last: bool) -> tuple[Product, FileTask]:
            tiles, target = tuple(self.plan.tiles_of[number].tolist()), self.targets.places[number]
            source, in_place = self.collection[number], self.options.in_place
            if in_place and self.store.seal(number) is None:  # what the input was, should nobody learn how this ended
                self.store.put_seal(number, {"identity": source.identity})
            return self.product, FileTask(number, source, tiles, target, in_place)

        return Task(write_file, number, arguments)

    def _take_tile(self, number: int, outcome: Outcome) -> list[int]:
        """Take in a tile; the files that are complete with it."""
        standing, homes = self._standing, self.plan.home[number].tolist()
        standing.tiles_done += 1
        if outcome.reason is not None:
            self.report.state[number] = -1
            core = self.plan.core(number)
            self.report.set_aside.append({"tile": number, "core": core, "reason": outcome.reason})
            lost = dict.fromkeys(homes, f"tile {number} was set aside: {outcome.reason}")
        else:
            standing.points += outcome.value.points
            standing.read += outcome.value.read
            self._add(number, outcome.value)
            lost = outcome.value.unread
        for file, reason in lost.items():
            self._hopeless.setdefault(file, reason)
        if not self.product.writes_files:
            return []
        self._missing[homes] -= 1
        complete = {file for file in homes if self._missing[file] == 0 and not self._is_written[file]}
        for file in sorted(complete & self._hopeless.keys()):
            self._fail(file, self._hopeless[file])
        return sorted(complete - self._hopeless.keys())

    def _add(self, number: int, summary: Summary) -> None:
        self.report.add(summary)
        if summary.points:
            self.report.state[number] = summary.ground / summary.points

    def _take_file(self, number: int, outcome: Outcome) -> None:
        if outcome.reason is not None:
            self._fail(number, outcome.reason)
            return
        self._standing.files_done += 1
        self.store.put_seal(number, (self.store.seal(number) or {}) | outcome.value)  # before the labels go
        self.report.files.append(str(self.targets.places[number]))
        self.report.remarks.update(outcome.value["remarks"])
        self.report.seconds["write"] += outcome.value["seconds"]
        for tile in self._need_no_more(number):
            self.store.strip(tile)

    def _fail(self, number: int, reason: str) -> None:
        self.report.failed.append({"file": self.collection[number].uri, "reason": reason})

    def _need_no_more(self, file: int) -> list[int]:
        """The tiles whose labels only this file needed."""
        tiles = self.plan.tiles_of[file]
        self._unwritten[tiles] -= 1
        return [int(tile) for tile in tiles[self._unwritten[tiles] == 0]]

    def _complete_report(self) -> None:
        report, uris = self.report, self.collection.uris
        report.left_out = [{"file": uris[n], "reason": reason} for n, reason in sorted(report.unread.items())]
        report.failed += [{"file": name, "reason": reason} for name, reason in self.collection.unreadable]
        report.files.sort()
        report.classes = collections.Counter(dict(sorted(report.classes.items())))
        filter_ = self.product.filter
        if filter_ is not None:
            report.method, report.parameters = type(filter_).__name__, dataclasses.asdict(filter_)  # type: ignore[call-overload]
        whole = self.product.reader.whole
        report.measures = None if whole is None else dataclasses.asdict(whole)
        self.product.finish(report, self.collection, self.targets, self.options)
        report.elapsed = time.perf_counter() - self._start

    def _show_step(self, share: float, step: str) -> None:
        """The progress of a filter in this process."""
        if len(self.plan) == 1:
            self._progress(dataclasses.replace(self._standing, step=step, share=share))

    def _show(self, standing: Standing) -> None:
        now = time.perf_counter()
        if now - self._shown > _WAIT or standing.tiles_done == standing.tiles:
            self._shown, standing.seconds = now, now - self._start
            standing.share = standing.tiles_done / max(standing.tiles, 1)
            self._progress(standing)


def tile_of(plan: Plan, collection: Collection, number: int, patient: bool = False) -> Tile:
    """A tile of a plan as a task takes it; that of a plan of one tile is everything."""
    files = tuple(plan.near[number].tolist())
    sources = tuple(collection[f] for f in files)
    if not any(plan.many):
        return Tile(number, None, None, files, sources, patient)
    return Tile(number, plan.core(number), plan.window(number), files, sources, patient)
