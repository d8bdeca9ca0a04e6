"""From what is asked for to a run: the filter is set up, the survey is cut into tiles, and outputs are claimed."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import Whole
from ..core.errors import InputError, ParameterError, warn
from ..core.filter import Filter
from ..core.params import declared
from ..core.reading import Reading
from ..core.version import __version__
from ..files.copc import check_format, is_copc
from ..files.disk import Seal
from ..methods import FILTERS
from .area import area_of, meeting
from .collection import Collection
from .collection import open as open_collection
from .executors import check_main
from .measures import Recipe, Sampler, middle
from .options import RunOptions, need, workers_for
from .plan import WHOLE, Plan, plan_boxes, plan_tiles
from .product import Cut, Product
from .report import Forecast, RunReport, collected_warnings
from .run import Run, tile_of
from .store import Store
from .targets import MAP, REPORT, Targets, check_out, targets_of
from .tiles import Tile, TileReader

TRIED = 300_000
"""Points of the piece that a forecast tries, about."""
FIND_GROUND = "classify it first, or find the ground with a filter (ground=jf.SMRF(), or --filter smrf)"
"""What to do where no point is ground."""
_TOO_OFTEN = 3.0
"""Times that tiles of a given size may read every point: halos of twice the points. The plan's own read up to 2.3 times."""


def check_in_place(reading: Reading) -> None:
    """Raises: ParameterError if points would be removed from inputs."""
    for name in ("bounds", "aoi"):
        if getattr(reading, name) is not None:
            raise ParameterError(
                f"{name} with in_place=True would remove all points outside: name an output, or leave out one of the two"
            )


def open_files(what: Any, reading: Reading, clip: bool = True) -> tuple[Collection, Reading]:
    """The collection of a run, and the reading with polygons as area of interest; ``clip``: only files that meet its bounds.

    Raises: JaxfilterError if the workers of a run would come here themselves; InputError if files cannot be found, or do not go
    together; ParameterError.
    """
    check_main()
    collection = what if isinstance(what, Collection) else open_collection(what, units=reading.units, crs=reading.crs)
    if collection.assumes_metres and reading.units is None:
        warn(
            f"{collection.name}: no CRS states the units, metres are assumed; pass units= if that is wrong, or pass crs="
        )
    if not collection.count:
        warn(f"{collection.name}: holds no points")
    if reading.aoi is not None:
        reading = dataclasses.replace(reading, aoi=area_of(reading, collection))
    if clip and reading.bounds is not None:
        collection = collection.clipped(reading.bounds)
    return collection, reading


@dataclasses.dataclass(frozen=True)
class Survey:
    """Points out of which something is made, and how.

    Attributes:
        collection: its files; targets: where the outputs go.
        recipe: of the filter that finds the ground; None if classes say what it is.
        reading: which points count; options: how the run is carried out.
    """

    collection: Collection
    targets: Targets
    recipe: Recipe | None
    reading: Reading
    options: RunOptions

    def run(self, kind: type[Product], **settings: Any) -> Any:
        """Set the filter up, cut the survey into tiles, and do what is to be done. Returns: the report of the product.

        ``settings``: the fields of the product, besides those of every :class:`Product`.

        Raises: InputError, ParameterError, OutputError, JaxfilterError before anything is done; OutputError if a disk is full;
        of a single file what is wrong with it.
        """
        for source, place in zip(self.collection, self.targets.places, strict=False):
            if is_copc(place) and source.point_format is not None:
                check_format(place, source.point_format)
        if self.options.dry_run:
            return self._forecast(kind, settings)
        targets, store = self.targets, self.targets.store
        with targets.claimed(self.options):
            product, plan = self._planned(kind, settings)
            run = Run(product, plan, self.collection, targets, self.options)
            self._record(product, plan)
            try:
                run()
            except BaseException as error:
                if len(plan) == 1:  # there is nothing to go on with
                    store.discard()
                elif isinstance(error, KeyboardInterrupt):
                    error.add_note("pass resume=True to go on")
                raise
            if targets.folder is not None:
                run.report.write(targets.folder / REPORT)
                run.report.draw(targets.folder / MAP)
            if run.report.complete:
                store.discard() if targets.folder is None else store.drop_index()
        return run.report

    def _forecast(self, kind: type[Product], settings: dict[str, Any]) -> RunReport:
        """A report with nothing but the forecast. What is found out about inputs on the way is not kept."""
        self.targets.check(self.options)
        collection, options, nan = self.collection, self.options, math.nan
        with tempfile.TemporaryDirectory() as folder:
            targets = dataclasses.replace(self.targets, store=Store(Path(folder)))
            product, plan = dataclasses.replace(self, targets=targets)._planned(kind, settings)
            each = _seconds_per_point(product, plan, collection)
        many, times, workers = any(plan.many), plan.times_read(collection.count), workers_for(options, plan)
        side, halo = (plan.width * collection.metre, plan.halo * collection.metre) if many else (nan, nan)
        memory = need(plan) * (workers if many else 1)
        seconds = each * collection.count * times / min(workers, len(plan))
        files = [str(place) for place in targets.places]
        found = Forecast(collection.count, len(plan), side, halo, times, workers, memory, seconds, files)
        return product.REPORT(forecast=found)

    def _planned(self, kind: type[Product], settings: dict[str, Any]) -> tuple[Product, Plan]:
        """What is to be made, and of which tiles."""
        (filter_, whole), path = self._filter(), self.targets.store.path
        reader = TileReader(self.reading, whole, self.targets.store.index)
        product = kind(reader, Store(path), filter_, self.options.halo, **settings)
        plan = self._plan(product.cut())
        if whole is not None and any(plan.many):
            width, height = (side * self.collection.metre for side in plan.largest())
            reader = dataclasses.replace(reader, whole=dataclasses.replace(whole, width=width, height=height))
            product = dataclasses.replace(product, reader=reader)
        return product, plan

    def _plan(self, cut: Cut) -> Plan:
        """The tiles. Raises: ParameterError, InputError."""
        options, files = self.options, self.collection
        if cut.boxes is not None:
            return plan_boxes(files.footprints, files.counts, cut.boxes)
        plan = plan_tiles(
            files.footprints,
            files.counts,
            metre=files.metre,
            halo=cut.halo,
            lattice=cut.lattice,
            side=options.tile,
            reach=cut.reach,
        )
        if self.reading.aoi is not None:
            plan = plan.part(np.flatnonzero(meeting(self.reading.aoi, plan.cores)))
        if options.memory is not None and options.memory < need(plan):
            raise ParameterError(
                f"memory={options.memory:.3g} bytes do not suffice for a worker, which needs {need(plan):.3g}: pass memory= with "
                "more, or tile= with less"
            )
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
        begun = facts.get("filter") == json.loads(json.dumps(facts_of(recipe)))
        given = facts["measures"] if begun and "measures" in facts else self.options.measures
        plain: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in (given or {}).items()}
        whole = None if given is None else Whole(**plain)
        if recipe is None:
            return None, whole or Whole()
        if begun and "parameters" in facts:
            found = facts["parameters"]
            return FILTERS[found["method"]](**found["fields"]), whole
        filter_, index = recipe.alone(), self.targets.store.index
        if self.options.tile is None and self.collection.count <= WHOLE:
            if filter_ is None or recipe.by_data:  # of all points, as the only tile of a run has them
                used = tuple(np.flatnonzero(self.collection.counts).tolist())
                sources = tuple(self.collection[number] for number in used)
                everything = Tile(0, None, None, used, sources, patient=len(self.collection) > 1)
                filter_ = recipe.on(TileReader(self.reading, whole, index).read(everything, keep=True).cloud)
            return filter_, whole
        sampler = Sampler(self.collection, self.reading, index)
        if filter_ is None or recipe.by_data:
            filter_ = sampler.filter_for(recipe)
        return filter_, sampler.whole_for(filter_) if whole is None else whole

    def _record(self, product: Product, plan: Plan) -> None:
        """Begin the run, or go on with it. Raises: InputError if another one was begun; OutputError."""
        store, files = self.targets.store, self.collection
        area = self.reading.aoi and self.reading.aoi.wkt
        reading = dataclasses.asdict(self.reading) | {"units": [files.units.xy, files.units.z], "aoi": area}
        tiles = {name: getattr(plan, name) for name in ("width", "height", "halo")}
        tiles |= {"number": len(plan), "digest": plan.digest()}
        facts = {"version": __version__, "inputs": self._digest(), "units": reading.pop("units")}
        facts |= {"filter": facts_of(self.recipe), "reading": reading, "tiles": tiles}
        store.begin(facts | product.facts())
        if "parameters" not in store.facts and product.filter is not None:
            fields = {field.name: getattr(product.filter, field.name) for field in declared(product.filter)}
            store.note(parameters={"method": type(product.filter).__name__.lower(), "fields": fields})
        if "measures" not in store.facts and product.reader.whole is not None:
            store.note(measures=dataclasses.asdict(product.reader.whole))

    def _digest(self) -> str:
        """Tells the files, by name and content, from others; of those that were replaced in place, by what they were."""
        found, store = hashlib.sha256(), self.targets.store
        for number, source in enumerate(self.collection):
            identity = source.identity
            kept = store.seal(number) if self.options.in_place else None
            if kept is not None and ("seal" not in kept or Seal(**kept["seal"]).broken(source.place) is None):
                identity = kept["identity"]
            found.update(json.dumps([source.uri, source.count, identity]).encode())
        return found.hexdigest()


def survey_of_points(
    what: Any, out: str | Path | None, recipe: Recipe | None, reading: Reading, options: RunOptions
) -> Survey:
    """A survey whose outputs are files of points.

    Raises: as :func:`open_files`; ParameterError, OutputError if it is clear already that ``out`` cannot be written.
    """
    check_main()
    if options.in_place:
        check_in_place(reading)
    elif out is None:
        raise ParameterError("out=None: name a file or a folder to write, or pass in_place=True")
    else:
        check_out(out, [what] if isinstance(what, (str, os.PathLike)) else [], options)
    collection, reading = open_files(what, reading)
    targets = targets_of(None if options.in_place else out, collection.uris, options)
    return Survey(collection, targets, recipe, reading, options)


def facts_of(recipe: Recipe | None) -> dict[str, Any] | None:
    """A recipe as plain values."""
    if recipe is None:
        return None
    return dataclasses.asdict(recipe) | {"method": recipe.method and recipe.method.__name__}


def _seconds_per_point(product: Product, plan: Plan, collection: Collection) -> float:
    """Of the tile in the middle of all by their points, without compilation: of two trials the faster counts."""
    if not collection.count:
        return 0.0
    number = int(np.argsort(plan.points, kind="stable")[len(plan) // 2])
    tile = tile_of(plan, collection, number, patient=True)
    box, held = (collection.bounds if tile.window is None else tile.window), float(plan.points[number])
    part = middle(box, TRIED / max(held, 1.0), collection.metre)
    tile, best = dataclasses.replace(tile, core=part, window=part), math.inf
    for _ in range(2):
        start = time.perf_counter()
        try:
            with collected_warnings():
                _, summary = product.tile(tile)
        except InputError:  # a piece in which nothing can be made, such as a lake
            return math.nan
        best = min(best, (time.perf_counter() - start) / max(summary.read, 1))
    return best
