"""What tiles keep for the end of a run, and what is made of it there: places where the terrain may be wrong, and water."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import InputError, warn
from ..core.reading import Reading
from ..core.result import FilterResult
from ..core.water import WaterCells
from ..files.vectors import write_features
from ..terrain.levels import WaterRuns, outlines
from .area import within
from .collection import Collection, common
from .product import KEPT, Product
from .report import RunReport
from .tiles import Around, Tile

_SUSPECTS, _AREA = (f"{KEPT}{name}" for name in ("suspects", "area"))


def suspects_in(
    around: Around, result: FilterResult | np.ndarray, tile: Tile, reading: Reading
) -> dict[str, np.ndarray]:
    """Arrays to keep of a tile: its cells whose terrain may be wrong. ``reading``: its bounds and its area of
    interest hold all places.

    Warns: if the extent of the points is too large for a grid, and lists none.
    """
    from ..reports.places import SUSPECT, Suspects, find_suspects  # late: it brings SciPy's image functions

    boxes = [source.bounds for source in tile.sources if source.count]
    if reading.bounds is not None:
        boxes = [common(box, reading.bounds) for box in boxes]
    try:
        inside = partial(within, reading.aoi)
        found = find_suspects(around.cloud, result, footprints=boxes, window=tile.window, core=tile.core, inside=inside)
    except InputError as error:  # labels are none the worse for it
        warn(f"places where the terrain may be wrong are not looked for: {error}")
        found = Suspects(np.zeros(0, SUSPECT), 0.0)
    return {_SUSPECTS: found.cells, _AREA: np.array(found.area)}


def list_places(product: Product, report: RunReport, collection: Collection, path: Path | None, replace: bool) -> None:
    """Put the places of a run into its report, largest expected error volume first, and into a file.

    Raises: InputError, OutputError.
    """
    from ..reports.places import Suspects, places_of, table_of

    kept = product.kept(report, (_SUSPECTS, _AREA))
    places = places_of([Suspects(arrays[_SUSPECTS], float(arrays[_AREA])) for arrays in kept], collection.metre)
    report.places = [place.facts() for place in places]
    if path is not None:
        write_features(path, [table_of(places, collection.metre, collection.crs)], "review", overwrite=replace)


@dataclasses.dataclass(frozen=True, eq=False)
class WaterWanted:
    """How rasters come to know of water.

    Attributes:
        seeks: tiles look for it. known: it is known already, and tiles only keep what has to be made anew where it is.
        levels: what is known; only the process has it that ends the run. path: a file for outlines.
    """

    seeks: bool = True
    known: bool = False
    levels: WaterRuns | None = None
    path: Path | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"levels": None}


_NAMES = tuple(f"{KEPT}water_{name}" for name in ("frame", "run", "z"))


def kept_water(cloud: PointCloud, cells: WaterCells | None, tile: Tile) -> dict[str, np.ndarray]:
    """Arrays to keep of a tile: the water in its core."""
    runs = WaterRuns.of(cells, cloud, tile.core)
    return {} if runs is None else dict(zip(_NAMES, (runs.frame, runs.run, runs.z), strict=True))


def list_water(product: Product, report: RunReport, collection: Collection, wanted: WaterWanted, replace: bool) -> None:
    """Put the water of a run into its report, and into a file. Raises: InputError, OutputError."""
    report.water = wanted.levels
    if wanted.seeks:
        parts = [WaterRuns(*(arrays[name] for name in _NAMES)) for arrays in product.kept(report, _NAMES)]
        report.water = WaterRuns.joined(parts) or report.water
    if wanted.path is not None:
        write_features(wanted.path, [outlines(report.water, collection.crs)], "breaklines", overwrite=replace)
