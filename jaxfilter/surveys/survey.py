"""What a command asks for: the files are opened, and the outputs are named."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

from ..core.errors import ParameterError, warn
from ..core.process import check_main
from ..core.reading import Reading
from .area import area_of
from .collection import Collection
from .collection import open as open_collection
from .measures import Recipe
from .options import RunOptions
from .targets import Targets, check_out, targets_of


def check_in_place(reading: Reading) -> None:
    """Raises: ParameterError if points would be removed from inputs."""
    for name in ("bounds", "aoi", "drop_duplicates"):
        value = getattr(reading, name)
        if value is not None and value is not False:
            raise ParameterError(
                f"{name} with in_place=True would remove points: name an output, or leave out one of the two"
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
    collection = collection.with_true_extents()
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
    targets = targets_of(None if options.in_place else out, collection.uris)
    return Survey(collection, targets, recipe, reading, options)
