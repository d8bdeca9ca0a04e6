"""What tiles keep for the end of a run, and what is made of it there: places where the terrain may be wrong, and water."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core.cloud import PointCloud
from ..core.errors import DAMAGED_ARRAYS, InputError, warn
from ..core.output import output_errors
from ..core.reading import Reading
from ..core.result import FilterResult
from ..core.water import WaterCells
from ..files.disk import is_there, new_file
from ..files.storage import Place, Remote, place_of
from ..files.vectors import write_features
from ..terrain.levels import WaterRuns, outlines
from .area import within
from .collection import Collection, common
from .product import KEPT, Product
from .report import RunReport
from .targets import Targets
from .tiles import Around, Tile

WATER_FILE = "jaxfilter-water.npz"
"""Name of the file, beside files of points or after the name of one and a dot, that tells later models of their water."""
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
        seeks: tiles look for it.
        levels: what is known; only the process has it that ends the run. classes: of points of this water, which are ground.
        path: a file for outlines.
    """

    seeks: bool = True
    levels: WaterRuns | None = None
    classes: tuple[int, ...] = ()
    path: Path | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"levels": None}


def remembered(wanted: WaterWanted, uris: Iterable[str]) -> WaterWanted:
    """With the water that the runs knew of that have classified files, if they have left it beside them. Raises: InputError if
    what they left is damaged, or was made with another anchor."""
    places = [place_of(uri) for uri in uris]
    beside = [_beside(place, WATER_FILE) for place in places]
    beside += [_beside(place, f"{place.name}.{WATER_FILE}") for place in places if isinstance(place, Path)]
    parts, classes, found = list[WaterRuns](), set[int](), False
    for file in dict.fromkeys(beside):
        if not (file.exists(InputError) if isinstance(file, Remote) else file.is_file()):
            continue
        found = True
        try:
            with file.open() if isinstance(file, Remote) else file.open("rb") as stream:
                arrays = dict(np.load(io.BytesIO(stream.read())))
            classes |= set(arrays.pop("classes").tolist())
            parts += [WaterRuns(**arrays)] if len(arrays["run"]) else []
        except DAMAGED_ARRAYS as error:
            raise InputError(f"{file}: is damaged ({error}): remove it, or classify the files anew") from error
        if parts and not np.array_equal(parts[0].frame, parts[-1].frame):
            raise InputError(
                f"{file}: its water has another anchor or unit than that of other files: make a model of each"
            )
    levels = WaterRuns.together(parts) if parts else None
    return dataclasses.replace(wanted, seeks=False, levels=levels, classes=tuple(sorted(classes))) if found else wanted


def remember(levels: WaterRuns | None, targets: Targets, water: int | None) -> None:
    """Leave the water of a run beside its outputs; ``water``: the class that its points get. Raises: OutputError."""
    places = targets.places
    if targets.folder is not None:
        files = [targets.folder / WATER_FILE]
    elif len(places) == 1:
        files = [_beside(places[0], f"{places[0].name}.{WATER_FILE}")]
    else:
        files = list(dict.fromkeys(_beside(place, WATER_FILE) for place in places))
    empty = WaterRuns(np.zeros(5), np.zeros((0, 3), np.int32), np.zeros(0))
    for file in files:
        if levels is not None or water is not None:
            with new_file(file, overwrite=True) as part, part.open("wb") as stream:
                arrays: Any = (levels or empty).arrays | {"classes": np.array([] if water is None else [water], int)}
                np.savez_compressed(stream, **arrays)
        elif is_there(file):  # of an earlier run
            with output_errors(file):
                file.unlink() if isinstance(file, Path) else file.remove()


def _beside(place: Place, name: str) -> Place:
    """A file of a name in the folder of another one."""
    return place.with_name(name) if isinstance(place, Path) else place_of(str(place).rpartition("/")[0]) / name


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
