"""What is asked of a survey is carried out: of one small file in memory, of what is large or many in tiles, see ``run.py``."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import numpy as np

from ..core.cloud import Whole
from ..files.copc import check_format, is_copc
from ..files.sources import WHOLE, squares_of
from .area import meeting
from .measures import whole_of
from .options import check_memory
from .product import FileTask, Product, do_tile, lowest_in_tile, sees_lowest, write_file
from .report import TILE, RunReport, Standing
from .survey import Survey
from .tiles import LOCAL, Local, Tile, read_tile


def carry_out(survey: Survey, product: Product) -> Any:
    """Make a product: of one small file in memory, and of the rest in tiles. Returns: the report of the product.

    Raises: InputError, ParameterError, OutputError, JaxfilterError before anything is done; OutputError if a disk is full;
    of a single small file what is wrong with it.
    """
    files, options = survey.collection, survey.options
    for source, place in zip(files, survey.targets.places, strict=False):
        if is_copc(place) and source.point_format is not None:
            check_format(place, source.point_format)
    small = len(files) == 1 and files.count <= WHOLE and options.tile is None and not options.dry_run
    if small and squares_of(files[0]) is None:
        return in_memory(survey, product)
    from .run import in_tiles

    return in_tiles(survey, product)


def in_memory(survey: Survey, product: Product) -> RunReport:
    """Make a product of one small file. Returns, raises: as :func:`carry_out`."""
    files, targets, options, reading = survey.collection, survey.targets, survey.options, survey.reading
    start, show = time.perf_counter(), options.progress or (lambda standing: None)
    if targets.complete(options):
        return product.REPORT(files=[str(place) for place in targets.places])
    targets.check(options)
    check_memory(options, files.count)
    with targets.made_folder():
        wanted = bool(meeting(reading.aoi, files.footprints).any())
        tiles = (0,) if files.count and wanted else ()
        tile = Tile(0, None, None, (0,), (files[0],))
        product = _set_up(survey, product, tile)
        report = product.REPORT(table=np.array([(files.bounds, math.nan, 0)] * len(tiles), TILE), elapsed=0.0)
        standing = Standing("tiles", 1)
        if tiles:
            local = Local(
                options.workers, lambda share, step: show(dataclasses.replace(standing, step=step, share=share))
            )
            before = LOCAL.set(local)
            try:
                summary = do_tile(product, tile)
            finally:
                LOCAL.reset(before)
            report.add_tile(0, summary)
            standing.points = summary.points
        standing.tiles_done, standing.share, standing.seconds = 1, 1.0, time.perf_counter() - start
        show(standing)
        product.complete(report, files, targets, options)
        if product.writes_files and wanted and (tiles or not targets.in_place):
            how = {"overwrite": options.overwrite or options.resume, "in_place": targets.in_place}
            seconds, remarks = write_file(product, FileTask(0, files[0], tiles, targets.places[0], how))
            report.add_file(targets.places[0], remarks, seconds)
        report.elapsed = time.perf_counter() - start
        if targets.folder is not None:
            report.put_into(targets.folder)
    return report


def _set_up(survey: Survey, product: Product, tile: Tile) -> Product:
    """With the filter, and the measures of the scene that are given."""
    recipe, whole = survey.recipe, whole_of(survey.options.measures)
    if recipe is None:
        return dataclasses.replace(product, whole=whole or Whole())
    filter_ = recipe.on(read_tile(tile, survey.reading, whole, keep=True).cloud) if recipe.by_data else recipe.alone()
    product = dataclasses.replace(product, filter=filter_, whole=whole)
    if whole is not None and sees_lowest(filter_):
        product = dataclasses.replace(product, whole=dataclasses.replace(whole, lowest=lowest_in_tile(product, tile)))
    return product
