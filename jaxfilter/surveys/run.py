"""A run in tiles: the filter is set up, the survey is cut into tiles, and outputs are claimed; then the tiles are handed out and
taken in, and files are written.

The order in which tiles end, the executor and interruptions change nothing in the files.
"""

from __future__ import annotations

import collections
import dataclasses
import functools
import hashlib
import json
import math
import time
from typing import Any

import numpy as np

from ..core.cloud import Whole
from ..core.errors import InputError, OutputError, ParameterError
from ..core.filter import Filter
from ..core.params import declared
from ..core.version import __version__
from ..files.disk import identify, is_there
from ..files.sources import WHOLE, fingerprint
from ..methods import FILTERS
from .area import meeting
from .claim import Claim, claim_of
from .collection import Collection
from .executors import Executor, Outcome, Task, carried_out
from .measures import Sampler, whole_of
from .options import RunOptions, check_memory, executor_for, need, workers_for
from .plan import Plan, Where, plan_tiles, where_of
from .product import Cut, FileTask, Product, do_tile, lowest_in_tile, sees_lowest, write_file
from .report import TILE, Forecast, RunReport, Standing, Summary, collected_warnings
from .store import written
from .survey import Survey
from .tiles import Tile, joined, read_tile

_RATES = {"OST": 4.0, "PPDF": 4.0, "CSF": 2.0, "MSF": 2.0, "PMF": 2.0, "SMRF": 2.0, "NoneType": 1.0}
"""CPU seconds for a million points that are read, by filter, writing included, on a core of a server (experiments/tiling and
experiments/bench); :data:`_OTHER` for those that are not listed."""
_OTHER, _START = 3.0, 3.0
"""The second: seconds until the first tile begins."""
_TOO_OFTEN = 3.0
"""Times that tiles of a given size may read every point: halos of twice the points. The plan's own read up to 2.5 times."""
_WAIT = 0.25  # seconds between looks at the progress


def in_tiles(survey: Survey, product: Product) -> RunReport:
    """Make a product of a survey in tiles. Returns, raises: as ``carry_out``."""
    files, options = survey.collection, survey.options
    claim = survey.targets if isinstance(survey.targets, Claim) else claim_of(survey.targets, options, len(files) == 1)
    return TiledSurvey(files, claim, survey.recipe, survey.reading, options).carried_out(product)


@dataclasses.dataclass(frozen=True)
class TiledSurvey(Survey):
    """A survey that is done in tiles."""

    targets: Claim

    @functools.cached_property
    def where(self) -> Where:
        """Where the points lie. Raises: InputError."""
        return where_of(self.collection)

    def carried_out(self, product: Product) -> RunReport:
        """Set the filter up, cut the survey into tiles, and do what is to be done. Returns, raises: as ``carry_out``."""
        if self.options.dry_run:
            return self._forecast(product)
        targets, store = self.targets, self.targets.store
        with targets.claimed(self.options):
            if (failed := self._done_before(product)) is not None:
                return product.REPORT(files=[str(place) for place in targets.places], failed=failed)
            if store.facts:
                store.check_facts(store.facts, self._begin_of(product))
            with collected_warnings() as remarks:
                filter_, whole = self._filter()
                product = dataclasses.replace(product, whole=whole, store=store, filter=filter_)
                plan = self._plan(product.cut())
            self._record(product, plan)
            run = Run(product, plan, self.collection, targets, self.options)
            run.report.total.remarks.update(remarks)
            try:
                run()
                if targets.in_place:
                    self._check_inputs()
                    targets.replace(self._asked(product), run.report.failed)
                    return run.report
            except BaseException as error:
                written = store.done or (not targets.in_place and any(map(is_there, targets.places)))
                if len(plan) == 1 and not written:  # there is nothing to go on with
                    targets.discard()
                elif isinstance(error, (KeyboardInterrupt, OutputError)):
                    error.add_note("pass resume=True to go on")
                raise
            if targets.folder is None:
                if run.report.complete:
                    store.discard()
                return run.report
            run.report.put_into(targets.folder)
            for number in range(len(plan)) if run.report.complete else ():
                store.strip(number)
        return run.report

    def _done_before(self, product: Product) -> list[dict[str, str]] | None:
        """If ``resume`` finds that an earlier run has done all, but for renames: what that could not do. None if it has not."""
        targets, store = self.targets, self.targets.store
        if targets.complete(self.options):
            return []
        if targets.in_place and self.options.resume and store.done:
            return targets.finish(self._asked(product))
        return None

    def _forecast(self, product: Product) -> RunReport:
        """A report with nothing but the forecast: files are counted and cut into tiles by their headers. No point is filtered;
        what depends on points is set by their density."""
        self.targets.check(self.options)
        collection, options, nan, recipe = self.collection, self.options, math.nan, self.recipe
        filter_ = None if recipe is None else recipe.on(joined([], Whole(self.where.spacing)))
        plan = self._plan(dataclasses.replace(product, filter=filter_).cut())
        many, times, workers = not plan.whole, plan.times_read(collection.count), workers_for(options, plan.points)
        area = np.median((plan.cores[:, 2:] - plan.cores[:, :2]).prod(axis=1)) if many and len(plan) else nan
        side, halo = (math.sqrt(area) * collection.metre, plan.halo) if many else (nan, nan)
        memory = need(plan.points.max(initial=0.0)) * (workers if many else 1)
        rate = _RATES.get(type(filter_).__name__, _OTHER) * 1e-6
        seconds = _START + rate * collection.count * times / max(1, min(workers, len(plan)))
        files = [str(place) for place in self.targets.places]
        found = Forecast(collection.count, len(plan), side, halo, times, workers, memory, seconds, files)
        return product.REPORT(forecast=found)

    def _plan(self, cut: Cut) -> Plan:
        """The tiles. Raises: ParameterError, InputError."""
        options, files = self.options, self.collection
        plan = plan_tiles(self.where, cut, options.tile)
        if cut.boxes is not None:
            return plan
        if self.reading.aoi is not None:
            plan = plan.part(np.flatnonzero(meeting(self.reading.aoi, plan.cores)))
        check_memory(options, float(plan.points.max(initial=0.0)))
        times = plan.times_read(files.count)
        if options.tile is not None and times > _TOO_OFTEN and not options.wide_halos:
            raise ParameterError(
                f"tile={options.tile:g}: every point would be read {times:.1f} times, since {cut.halo:g} m around each tile are "
                "read as well: pass tile= with more, leave it out, or pass wide_halos=True"
            )
        return plan

    def _filter(self) -> tuple[Filter | None, Whole | None]:
        """The filter, and measures of the scene that its parts share: those that the run began with, or new ones."""
        recipe, facts = self.recipe, self.targets.store.facts
        whole = whole_of(facts.get("measures", self.options.measures))
        if recipe is None:
            return None, whole or Whole()
        if found := facts.get("parameters"):
            return (recipe.method or FILTERS[found["method"]])(**found["fields"]), whole
        if self.options.tile is None and self.collection.count <= WHOLE and self.where.fills:
            if not recipe.by_data:
                return recipe.alone(), whole
            used = tuple(np.flatnonzero(self.collection.counts).tolist())  # as the only tile of a run has them
            sources = tuple(self.collection[number] for number in used)
            everything = Tile(0, None, None, used, sources, patient=len(self.collection) > 1)
            return recipe.on(read_tile(everything, self.reading, whole, keep=True).cloud), whole
        sampler = Sampler(self.collection, self.reading, self.where)
        filter_ = sampler.filter_for(recipe)
        return filter_, sampler.whole_for(filter_) if whole is None else whole

    def _record(self, product: Product, plan: Plan) -> None:
        """Begin the run, or go on with it. Raises: InputError if another one was begun; OutputError."""
        store = self.targets.store
        tiles = {"halo": plan.halo, "number": len(plan), "digest": plan.digest()}
        store.begin(self._begin_of(product) | {"tiles": tiles})
        parameters, filter_, whole = None, product.filter, product.whole
        if filter_ is not None:
            fields = {field.name: getattr(filter_, field.name) for field in declared(filter_)}
            parameters = {"method": type(filter_).__name__.lower(), "fields": fields}
        store.note(parameters=parameters, measures=None if whole is None else dataclasses.asdict(whole))

    def _begin_of(self, product: Product) -> dict[str, Any]:
        """What is known of a run before its tiles are: it must be the same in a run that goes on."""
        files = "".join(json.dumps([one.uri, one.count, one.identity]) for one in self.collection)
        return {"version": __version__, "inputs": hashlib.sha256(files.encode()).hexdigest(), **self._asked(product)}

    def _asked(self, product: Product) -> dict[str, Any]:
        """What the command says, besides the files: it is the same before they are replaced and after."""
        files, recipe, area = self.collection, self.recipe, self.reading.aoi
        reading = dataclasses.asdict(self.reading) | {"aoi": area and area.wkt}
        del reading["units"]
        filter_ = None
        if recipe is not None:
            filter_ = dataclasses.asdict(recipe) | {"method": recipe.method and recipe.method.__name__}
        names = files.uris if self.targets.in_place else None
        units = [files.units.xy, files.units.z]
        return {"units": units, "filter": filter_, "reading": reading, **product.facts(), "names": names}

    def _check_inputs(self) -> None:
        """Raises: InputError if an input, which is to be replaced, was changed while the run was at work."""
        for source in self.collection:
            if source.identity and fingerprint(source.place) != source.identity:
                raise InputError(
                    f"{source.uri}: was changed while the run was at work, and no input was replaced: pass overwrite=True to "
                    "begin anew"
                )


@dataclasses.dataclass
class Run:
    """Tiles of a plan on their way through an executor, and the files that are written out of them."""

    product: Product
    plan: Plan
    collection: Collection
    targets: Claim
    options: RunOptions

    def __post_init__(self) -> None:
        product, plan, options = self.product, self.plan, self.options
        self.store = self.targets.store
        self._progress = options.progress or (lambda standing: None)
        self._start = time.perf_counter()
        self._shown = 0.0
        self._missing = np.array([len(tiles) for tiles in plan.tiles_of], np.int64)  # tiles per file that are not done
        wanted = meeting(product.reading.aoi, self.collection.footprints) & product.writes_files
        if self.targets.in_place:  # what no tile labels stays as it is
            wanted &= self._missing > 0
        self._is_written = ~wanted  # or need not be
        self._lost: dict[int, str] = {}  # files without all their labels, and why
        self._standing = Standing("tiles", len(plan), times_read=plan.times_read(self.collection.count))
        self.report = product.REPORT(table=np.zeros(len(plan), TILE), elapsed=0.0)
        self.report.table["core"], self.report.table["ground"] = plan.cores, np.nan

    def __call__(self) -> None:
        """Do what is not done yet. Raises: OutputError if a disk is full; of a single file what its tiles raise."""
        if self.targets.in_place:
            numbers = np.flatnonzero(~self._is_written).tolist()
            self.targets.check_room({n: identify(self.collection[n].place).size for n in numbers})
        executor = executor_for(self.options, self.plan.points, self._show_step)
        try:
            self._find_lowest(executor)
            self._carry_out(executor)
        finally:
            executor.close()
        report, uris = self.report, self.collection.uris
        report.left_out = [{"file": uris[n], "reason": reason} for n, reason in sorted(report.total.unread.items())]
        report.files.sort()
        self.product.complete(report, self.collection, self.targets, self.options)
        report.elapsed = time.perf_counter() - self._start

    def _find_lowest(self, executor: Executor) -> None:
        """Measure the elevation of the lowest point of the collection, once, if the filter asks for it."""
        filter_, whole = self.product.filter, self.product.whole
        if whole is None or not sees_lowest(filter_):
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
        self.product = dataclasses.replace(self.product, whole=whole)

    def _carry_out(self, executor: Executor) -> None:
        """Do tiles, and before them files, to which those are added that are complete."""
        done = self._look_for_done() if self.options.resume else np.zeros(len(self.plan), bool)
        complete = (self._missing == 0) & ~self._is_written
        tiles = (Task(do_tile, n, self._tile(n)) for n in np.flatnonzero(~done).tolist())
        files = collections.deque(self._writing(file) for file in np.flatnonzero(complete).tolist())
        for task, outcome in carried_out(executor, tiles, files, self._show):
            if task.function is do_tile:
                files.extend(self._writing(file) for file in self._take_tile(task.number, outcome))
            elif outcome.reason is not None:
                self._fail(task.number, outcome.reason)
            else:
                seconds, remarks = outcome.value
                self.report.add_file(self.targets.places[task.number], remarks, seconds)
            self._show()

    def _look_for_done(self) -> np.ndarray:
        """bool[t]: tiles that are done, and whose labels are there if a file still needs them."""
        plan, store = self.plan, self.store
        known: dict[int, tuple[Summary, bool]] = {}
        for number in range(len(plan)):
            if (found := store.summary(number)) is None:
                continue
            if not found[0].unread:
                known[number] = found
            else:  # it lacks a file: it is done again, and the files that have its labels
                for file in plan.home[number].tolist():
                    store.drop_seal(file)
        for file, target in enumerate(self.targets.places):
            if (kept := store.seal(file)) is None:
                continue
            wrong = kept[0].broken(written(target, self.targets.part(file)))
            if wrong is not None:
                self.report.total.remarks[f"{target}: {wrong}, so it had to be made again"] += 1
            if wrong is None and set(plan.tiles_of[file].tolist()) <= known.keys():
                self._is_written[file] = True
                self.report.add_file(target, kept[1])
            else:
                store.drop_seal(file)
        done = np.zeros(len(plan), bool)
        for number, (summary, labels) in known.items():
            done[number] = labels or self._is_written[plan.home[number]].all()
            if done[number]:
                self._missing[plan.home[number]] -= 1
                self.report.add_tile(number, summary)
        self._standing.tiles_done = int(done.sum())
        return done

    def _tile(self, number: int) -> tuple[Product, Tile]:
        return self.product, tile_of(self.plan, self.collection, number, patient=len(self.collection) > 1)

    def _writing(self, number: int) -> Task:
        tiles, target = tuple(self.plan.tiles_of[number].tolist()), self.targets.places[number]
        how = {"overwrite": True, "into": self.targets.part(number)}
        return Task(write_file, number, (self.product, FileTask(number, self.collection[number], tiles, target, how)))

    def _take_tile(self, number: int, outcome: Outcome) -> list[int]:
        """Take in a tile; the files that can be written now."""
        homes = self.plan.home[number].tolist()
        self._standing.tiles_done += 1
        if outcome.reason is None:
            self._standing.points += outcome.value.points
            self.report.add_tile(number, outcome.value)
            lost = outcome.value.unread
        else:
            self.report.table["ground"][number] = -1
            core = self.plan.core(number)
            self.report.set_aside.append({"tile": number, "core": core, "reason": outcome.reason})
            lost = dict.fromkeys(homes, f"tile {number} was set aside: {outcome.reason}")
        self._lost = lost | self._lost
        self._missing[homes] -= 1
        complete = [file for file in homes if self._missing[file] == 0 and not self._is_written[file]]
        for file in complete:
            if file in self._lost:
                self._fail(file, self._lost[file])
        return [file for file in complete if file not in self._lost]

    def _fail(self, number: int, reason: str) -> None:
        self.report.failed.append({"file": self.collection[number].uri, "reason": reason})

    def _show_step(self, share: float, step: str) -> None:
        """The progress of a filter in this process."""
        if len(self.plan) == 1:
            self._progress(dataclasses.replace(self._standing, step=step, share=share))

    def _show(self, standing: Standing | None = None) -> None:
        standing, now = standing or self._standing, time.perf_counter()
        if now - self._shown > _WAIT or standing.tiles_done == standing.tiles:
            self._shown, standing.seconds = now, now - self._start
            standing.share = standing.tiles_done / max(standing.tiles, 1)
            self._progress(standing)


def tile_of(plan: Plan, collection: Collection, number: int, patient: bool = False) -> Tile:
    """A tile of a plan as a task takes it; that of a plan of one tile is everything."""
    files = tuple(plan.near[number].tolist())
    core, window = (None, None) if plan.whole else (plan.core(number), plan.window(number))
    return Tile(number, core, window, files, tuple(collection[file] for file in files), patient)
