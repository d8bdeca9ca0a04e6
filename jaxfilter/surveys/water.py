"""Water of a survey: cells are kept tile by tile, and bodies are joined across tiles."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.water import WaterCells
from ..files.vectors import write_features
from ..terrain.levels import WaterRuns, outlines
from .collection import Collection
from .product import Product
from .report import RunReport
from .store import KEPT
from .tiles import Tile


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
        stored = (product.store.arrays(number, _NAMES) for number in np.flatnonzero(report.state != -1).tolist())
        parts = [WaterRuns(*(arrays[name] for name in _NAMES)) for arrays in stored if arrays]
        report.water = WaterRuns.joined(parts) or report.water
    if wanted.path is not None:
        write_features(wanted.path, [outlines(report.water, collection.crs)], "breaklines", overwrite=replace)
        report.breaklines = str(wanted.path)
