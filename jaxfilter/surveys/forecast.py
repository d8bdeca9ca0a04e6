"""What a run would do, by its plan and by a piece that is tried: tiles, points, memory, files and time."""

from __future__ import annotations

import dataclasses
import math
import time

import numpy as np

from ..core.errors import InputError
from ..files.disk import Bounds
from .collection import Collection
from .options import RunOptions, need, workers_for
from .plan import Plan
from .product import Product
from .report import Forecast, collected_warnings
from .run import tile_of

TRIED = 300_000
"""Points of the piece, about."""


def forecast(product: Product, plan: Plan, collection: Collection, files: list[str], options: RunOptions) -> Forecast:
    """Try ``product`` on a piece, and tell what the run would be. Nothing is written but what the reader's index keeps."""
    metre, many = collection.metre, any(plan.many)
    times, workers = plan.times_read(collection.count), workers_for(options, plan)
    each = _seconds_per_point(product, plan, collection) * collection.count * times
    side, halo = (plan.width * metre, plan.halo * metre) if many else (math.nan, math.nan)
    memory = need(plan) * (workers if many else 1)
    seconds = each / min(workers, len(plan))
    return Forecast(collection.count, len(plan), side, halo, times, workers, memory, seconds, files)


def _seconds_per_point(product: Product, plan: Plan, collection: Collection) -> float:
    """Of the tile in the middle of all by their points, without compilation: of two trials the faster counts."""
    if not collection.count:
        return 0.0
    number = int(np.argsort(plan.points, kind="stable")[len(plan) // 2])
    tile = tile_of(plan, collection, number, patient=True)
    box, held = (collection.bounds if tile.window is None else tile.window), float(plan.points[number])
    part = _middle(box, min(1.0, math.sqrt(TRIED / max(held, 1.0))))
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


def _middle(box: Bounds, share: float) -> Bounds:
    """The part of a box around its middle, with this share of each side, whose upper edges are inside."""
    x0, y0, x1, y1 = box
    x, y, width, height = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) * share / 2, (y1 - y0) * share / 2
    return x - width, y - height, np.nextafter(x + width, math.inf), np.nextafter(y + height, math.inf)
