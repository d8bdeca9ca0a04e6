"""Places where the terrain model of a survey may be wrong: found tile by tile, and joined across tiles."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import InputError, warn
from ..core.reading import Reading
from ..core.result import FilterResult
from ..files.vectors import write_features
from .collection import Collection
from .product import Product
from .report import RunReport
from .store import KEPT
from .tiles import Around, Tile, common

if TYPE_CHECKING:
    from ..reports.places import Place


def suspects_in(
    around: Around, result: FilterResult | np.ndarray, tile: Tile, reading: Reading
) -> dict[str, np.ndarray]:
    """Arrays to keep of a tile: its cells whose terrain may be wrong. ``reading``: its bounds and its area of
    interest hold all places.

    Warns: if the extent of the points is too large for a grid, and lists none.
    """
    from ..reports.places import (  # late: it brings SciPy's image functions, a quarter of a second
        SIDE,
        Suspects,
        suspects,
    )

    bounds, area = reading.bounds, reading.aoi
    boxes = [source.bounds for source in tile.sources if source.count]
    boxes = boxes if bounds is None else [common(box, bounds) for box in boxes]
    try:
        found = suspects(around.cloud, result, footprints=boxes, window=tile.window, core=tile.core)
    except InputError as error:  # labels are none the worse for it
        warn(f"places where the terrain may be wrong are not looked for: {error}")
        found = Suspects.none()
    if area is not None:
        from .area import within

        at = (found.cell.T + 0.5) * SIDE / around.cloud.units.xy
        found = found.part(within(area, *at))
    return {f"{KEPT}{field.name}": getattr(found, field.name) for field in dataclasses.fields(found)}


def list_places(product: Product, report: RunReport, collection: Collection, path: Path | None, replace: bool) -> None:
    """Put the places of a run into its report, and into a file. Raises: InputError, OutputError."""
    places = places_in(product, report, collection.metre)
    report.places = [place.facts() for place in places]
    if path is not None:
        from ..reports.places import table_of

        table = table_of(places, collection.metre, collection.crs)
        write_features(path, [table], "review", overwrite=replace)
        report.review = str(path)


def places_in(product: Product, report: RunReport, metre: float) -> list[Place]:
    """The places of a run, largest expected error volume first. ``metre``: metres per unit of the file."""
    from ..reports.places import Suspects, places_of

    names = [field.name for field in dataclasses.fields(Suspects)]
    stored = [product.store.arrays(number) for number in np.flatnonzero(report.state != -1).tolist()]
    parts = [Suspects(*(arrays[f"{KEPT}{name}"] for name in names)) for arrays in stored if f"{KEPT}cell" in arrays]
    return places_of(Suspects.together(parts), metre) if parts else []
