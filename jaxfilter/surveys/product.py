"""What is made of every tile, and of every file whose tiles are done."""

from __future__ import annotations

import dataclasses
import time
from typing import Any, ClassVar

import numpy as np

from ..core.filter import Filter, lowest_among
from ..files.disk import Seal
from ..files.sources import Source
from ..files.storage import Place
from .collection import Collection
from .options import RunOptions
from .report import RunReport, Summary, collected_warnings
from .store import Store
from .targets import Targets
from .tiles import Tile, TileReader


@dataclasses.dataclass(frozen=True)
class FileTask:
    """A file to be written: its number, the tiles that label it, and where it goes."""

    number: int
    source: Source
    tiles: tuple[int, ...]
    target: Place
    in_place: bool


@dataclasses.dataclass(frozen=True)
class Cut:
    """What decides on tiles, in metres: how far around a tile points are read as well, that windows end at multiples of
    ``lattice``, and how far around a tile files may be asked for, by default as far as the halo. Or ``boxes``: the tiles
    themselves, f64[t, 2, 4], see :func:`jaxfilter.surveys.plan.plan_boxes`."""

    halo: float
    lattice: float
    reach: float | None = None
    boxes: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Product:
    """What is made of every tile. A subclass says how, in ``tile``; ``REPORT`` is what is said in the end.

    Attributes:
        reader: of the points.
        store: what is kept of the run, in a folder which all processes see.
        filter: that finds the ground; None if classes say what it is.
        halo: metres around each tile that the filter sees as well; None = as the filter says.
    """

    REPORT: ClassVar[type[RunReport]] = RunReport
    reader: TileReader
    store: Store
    filter: Filter | None
    halo: float | None

    def cut(self) -> Cut:
        """The tiles that it is made in."""
        raise NotImplementedError

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Arrays that are kept until the output is written, by name, and a summary. Raises: InputError, ParameterError."""
        raise NotImplementedError

    def file(self, task: FileTask) -> None:
        """Write a file whose tiles are done. Raises: InputError, OutputError."""
        raise NotImplementedError

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Make the one output of all tiles, and complete the report of the run. Raises: InputError, OutputError."""

    @property
    def writes_files(self) -> bool:
        """Whether there is an output for each input."""
        return type(self).file is not Product.file

    def facts(self) -> dict[str, Any]:
        """What decides on the outcome besides files, filter, reading and tiles."""
        return {}


def do_tile(product: Product, tile: Tile) -> Summary:
    """Work on a tile, and keep what was found of it. Raises: as ``Product.tile``; OutputError."""
    with collected_warnings() as remarks:
        arrays, summary = product.tile(tile)
    summary.remarks.update(remarks)
    product.store.put(tile.number, arrays, found := summary.as_json())
    return Summary.of_json(found)


def write_file(product: Product, task: FileTask) -> dict[str, Any]:
    """Write a file: its seal, what was warned of, and seconds. Raises: as ``Product.file``."""
    start = time.perf_counter()
    with collected_warnings() as remarks:
        product.file(task)
    seal = dataclasses.asdict(Seal.of(task.target))
    seconds = time.perf_counter() - start
    return {"seal": seal, "remarks": list(remarks), "seconds": seconds}


def lowest_in_tile(product: Product, tile: Tile) -> float | None:
    """Elevation of the lowest point of the core that the filter lets count (``lowest_among``), file units; None without any.

    Raises: as ``Product.tile``.
    """
    assert product.filter is not None
    with collected_warnings():
        around = product.reader.read(tile)
        points = product.filter.points_of(around.cloud)
        if len(points) == 0 or not points.has_area():
            return None
        counts = lowest_among(product.filter, points)
    assert counts is not None
    member = around.core[points.index]
    low = points.xyz[points.member[member & counts[points.member]], 2]
    cloud = around.cloud
    return float(cloud.origin[2] + float(low.min()) / cloud.units.z) if len(low) else None
