"""Virtual point clouds: the files of a survey in one JSON file, as PDAL wrench and QGIS read and write them.

A ``.vpc`` is a GeoJSON FeatureCollection of STAC 1.0.0 items with the extensions pointcloud 1.0.0 and projection 1.1.0
(PDAL wrench, vpc-spec.md).
"""

from __future__ import annotations

import collections
import contextlib
import functools
import json
import math
import os
import posixpath
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any

import pyproj

from ..core.errors import DAMAGED, InputError
from ..core.units import WKT, Reference, Stated, Units, reference_of
from ..files.disk import new_file, opened
from ..files.guard import reading_errors
from ..files.points import dimensions_of
from ..files.reading import FARTHEST
from ..files.sources import NO_BOUNDS, Source
from ..files.storage import Place, Remote

_SCHEMES = ("file", "s3", "gs", "az", "abfs", "http", "https")  # of names: others may do more than fetch a file
_EXTENSIONS = [
    "https://stac-extensions.github.io/pointcloud/v1.0.0/schema.json",
    "https://stac-extensions.github.io/projection/v1.1.0/schema.json",
]
_NOT_DATED = "1970-01-01"  # STAC wants a day
_ODD = (*DAMAGED, StopIteration, pyproj.exceptions.CRSError)
_PDAL = {"nir": "Infrared", "scan_angle": "ScanAngleRank"}
"""Names of dimensions that PDAL has for those of laspy; the others are the same in capitals, without underscores."""
_REAL = {"X": 8, "Y": 8, "Z": 8, "ScanAngleRank": 4, "GpsTime": 8}
"""Bytes of dimensions that PDAL reads as real numbers."""


def read_vpc(place: Place, asked: Stated) -> Iterator[str | Source]:
    """The members, as the file describes them, without a look at their files; the name alone of those that it does not
    describe (no bounds, number of points or known suffix).

    Raises: InputError if it is no virtual point cloud, naming the item that is damaged.
    """
    with reading_errors(place), opened(place) as (file, _):
        content = json.load(TextIOWrapper(file, "utf-8"))
    items = content.get("features") if isinstance(content, dict) else None
    if not isinstance(items, list):
        raise InputError(f"{place}: is no virtual point cloud: it has no list of features")
    for number, item in enumerate(items, 1):
        try:
            yield _member(item, place, asked)
        except InputError:
            raise
        except _ODD as error:
            words = f"item {number} is not as it should be in a virtual point cloud: {error!r:.300}"
            raise InputError(f"{place}: {words}") from error


def _member(item: dict[str, Any], place: Place, asked: Stated) -> str | Source:
    """The member that an item describes."""
    assets, facts = item["assets"], item["properties"]
    asset = assets.get("data") or next(a for a in assets.values() if "overview" not in a.get("roles", ()))
    uri = _resolved(asset["href"], place)
    kinds = (("copc", ".copc.laz"), ("laz", ".laz"), ("las", ".las"))
    kind = next((kind for kind, end in kinds if uri.lower().endswith(end)), None)
    box, count = facts.get("proj:bbox"), facts.get("pc:count")
    if kind is None or count is None or box is None or len(box) not in (4, 6):
        return uri
    key = next((facts[k] for k in ("proj:wkt2", "proj:projjson", "proj:code", "proj:epsg") if facts.get(k)), "")
    reference, wkt = _system(json.dumps(key) if isinstance(key, dict) else key, asked, str(place))
    if reference.problem is not None:
        raise InputError(f"{uri}: {reference.problem}")
    half = len(box) // 2
    x0, y0, x1, y1 = (float(box[k]) for k in (0, 1, half, half + 1))
    z = (float(box[2]), float(box[5])) if half == 3 else (math.nan, math.nan)
    far = max(abs(float(one)) for one in box) < FARTHEST
    if not (far and x0 <= x1 and y0 <= y1 and 0 <= count < 1 << 40 and count == int(count)):
        raise ValueError(f"pc:count and proj:bbox say {count} points in {box}")
    date = str(facts["datetime"])[:10] if facts.get("datetime") else None
    bounds = (x0, y0, x1, y1) if count else NO_BOUNDS
    return Source(uri, kind, bounds, int(count), z, wkt, reference.units or Units(), date=date)


@functools.lru_cache(maxsize=256)
def _system(key: str | int, asked: Stated, place: str) -> tuple[Reference, str | None]:
    """The system that an item states as WKT, PROJJSON or a code, "" for none, with what is ``asked`` for; and its CRS as WKT."""
    plain = isinstance(key, str) and (not key or ("[" in key and not key.startswith("{")))
    text = str(key) if plain else pyproj.CRS(key).to_wkt()
    reference = asked.of(reference_of({WKT: text.encode()}, place), place)
    return reference, None if reference.crs is None else reference.crs.to_wkt()


def _resolved(href: str, place: Place) -> str:
    """A name relative to the folder of the .vpc, or as it is. Raises InputError for other stores than :data:`_SCHEMES`."""
    scheme, mark, _ = href.partition("://")
    if "::" in href or "\0" in href or (mark and scheme.lower() not in _SCHEMES):
        raise InputError(
            f"{place}: names {href!r}: its members may be local files or {', '.join(_SCHEMES)} URLs, without chains (::); "
            "correct the name, or copy that file"
        )
    if mark or os.path.isabs(href):
        return href
    path = href.removeprefix("./")
    if isinstance(place, Remote):
        return f"{place.uri.rpartition('/')[0]}/{path}"
    return os.path.abspath(os.path.join(os.path.dirname(place), path))


def write_vpc(sources: Iterable[Source], path: Path, overwrite: bool) -> Path:
    """Write the files that have points. Local names are relative to the folder of ``path``. Raises: OutputError."""
    folder, names = os.path.dirname(os.path.abspath(path)), collections.Counter[str]()
    items = [_item(source, folder, names) for source in sources if source.count]
    with new_file(path, overwrite=overwrite) as part:
        text = json.dumps({"type": "FeatureCollection", "features": items}, indent=1)
        part.write_text(f"{text}\n", encoding="utf-8", newline="\n")
    return path


def _item(source: Source, folder: str, names: collections.Counter[str]) -> dict[str, Any]:
    """A file as an item; ``names``: how often each was given."""
    (x0, y0, x1, y1), z = source.bounds, source.z
    corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    x, y = _to_degrees(source.wkt)(*zip(*corners, strict=True))
    stem = posixpath.basename(source.uri).rpartition(".")[0]
    names[stem] += 1
    low, high = ([], []) if math.isnan(sum(z)) else ([z[0]], [z[1]])  # JSON knows no NaN
    local = not isinstance(source.place, Remote)
    return {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": _EXTENSIONS,
        "id": stem if names[stem] == 1 else f"{stem}-{names[stem]}",
        "geometry": {"type": "Polygon", "coordinates": [[*zip(x, y, strict=True)]]},
        "bbox": [min(x), min(y), *low, max(x), max(y), *high],
        "properties": {
            "datetime": f"{source.date or _NOT_DATED}T00:00:00Z",
            "pc:count": source.count,
            "pc:type": "lidar",
            "pc:encoding": source.format,
            "pc:schemas": _schemas(source.point_format),
            "proj:wkt2": source.wkt or "",
            "proj:geometry": {"type": "Polygon", "coordinates": [corners]},
            "proj:bbox": [x0, y0, *low, x1, y1, *high],
        },
        "links": [],
        "assets": {"data": {"href": _relative(source.uri, folder) if local else source.uri, "roles": ["data"]}},
    }


@functools.lru_cache(maxsize=256)
def _to_degrees(wkt: str | None) -> Callable[..., tuple[Sequence[float], Sequence[float]]]:
    """A function from x and y to longitudes and latitudes; to themselves without a CRS, and for one that is not of the Earth."""
    with contextlib.suppress(pyproj.exceptions.ProjError):
        if wkt is not None:
            return pyproj.Transformer.from_crs(wkt, 4326, always_xy=True).transform
    return lambda x, y: (x, y)


def _relative(uri: str, folder: str) -> str:
    """As PDAL wrench does it: from ``./`` on, so that folder and .vpc can be moved together."""
    try:
        return "./" + Path(os.path.relpath(uri, folder)).as_posix()
    except ValueError:  # another drive
        return os.path.abspath(uri)


def _schemas(point_format: int | None) -> list[dict[str, Any]]:
    """The dimensions of a point format as PDAL has them."""
    found = []
    for known, bits in dimensions_of(point_format or 0).items():
        name = _PDAL.get(known, known.title().replace("_", ""))
        size, kind = _REAL.get(name, max(1, bits // 8)), "floating" if name in _REAL else "unsigned"
        found.append({"name": name, "size": size, "type": kind})
    return found
