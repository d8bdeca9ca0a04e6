"""One small file: it is read, filtered and written in this process. What is found of it stays in memory until it is written."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.cloud import Whole
from ..files.disk import is_there
from .area import meeting
from .measures import whole_of
from .options import check_memory
from .product import FileTask, Product, lowest_in_tile, sees_lowest
from .report import REPORT, RunReport, Standing, collected_warnings
from .tiles import LOCAL, Local, Memory, Tile

if TYPE_CHECKING:
    from .survey import Survey


def in_memory(survey: Survey, kind: type[Product], settings: dict[str, Any]) -> RunReport:
    """Make a product of one small file. Returns, raises: as ``Survey.run``."""
    files, targets, options, reading = survey.collection, survey.targets, survey.options, survey.reading
    store, start, replaced = Memory(), time.perf_counter(), options.overwrite or options.resume
    product = kind(reading, None, store, None, options.halo, **settings)
    made = [*targets.places, *([] if targets.folder is None else [targets.folder / REPORT])]
    if options.resume and not options.overwrite and not targets.in_place and all(map(is_there, made)):
        return kind.REPORT(files=[str(place) for place in targets.places], was_complete=True)
    targets.check(options)
    check_memory(options, files.count)
    with targets.made_folder():
        source, wanted = files[0], reading.aoi is None or bool(meeting(reading.aoi, files.footprints).any())
        tiles = (0,) if source.count and wanted else ()
        tile = Tile(0, None, None, (0,), (source,))
        product = _set_up(survey, product, tile)
        report = kind.REPORT(tiles=len(tiles), cores=np.array([files.bounds] * len(tiles)).reshape(-1, 4))
        report.state = np.full(len(tiles), math.nan)
        show = options.progress or (lambda standing: None)
        standing = Standing("tiles", 1, 0, int(product.writes_files))
        if tiles:
            local = Local(
                options.workers, lambda share, step: show(dataclasses.replace(standing, step=step, share=share))
            )
            before = LOCAL.set(local)
            try:
                with collected_warnings() as remarks:
                    arrays, summary = product.tile(tile)
            finally:
                LOCAL.reset(before)
            store.put(0, arrays, {})
            summary.remarks.update(remarks)
            report.add(summary)
            if summary.points:
                report.state[0] = summary.ground / summary.points
            standing.points, standing.read = summary.points, summary.read
        standing.tiles_done, standing.share, standing.seconds = 1, 1.0, time.perf_counter() - start
        show(standing)
        product.complete(report, files, targets, options)
        if product.writes_files and wanted and (tiles or not targets.in_place):
            begun = time.perf_counter()
            with collected_warnings() as remarks:
                how = {"overwrite": replaced, "in_place": targets.in_place}
                product.file(FileTask(0, source, tiles, targets.places[0], how))
            report.remarks.update(remarks)
            report.files.append(str(targets.places[0]))
            report.seconds["write"] += time.perf_counter() - begun
        report.elapsed = time.perf_counter() - start
        if targets.folder is not None:
            report.put_into(targets.folder)
    return report


def _set_up(survey: Survey, product: Product, tile: Tile) -> Product:
    """With the filter, and the measures of the scene that are given."""
    recipe, whole = survey.recipe, whole_of(survey.options.measures)
    if recipe is None:
        return dataclasses.replace(product, whole=whole or Whole())
    filter_ = recipe.alone()
    if filter_ is None or recipe.by_data:
        filter_ = recipe.on(product.store.read(tile, survey.reading, whole).cloud)
    product = dataclasses.replace(product, filter=filter_, whole=whole)
    if whole is not None and sees_lowest(filter_):
        product = dataclasses.replace(product, whole=dataclasses.replace(whole, lowest=lowest_in_tile(product, tile)))
    return product
