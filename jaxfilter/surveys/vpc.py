"""Virtual point clouds: the files of a survey in one JSON file, as PDAL wrench and QGIS read and write them.

A ``.vpc`` is a GeoJSON FeatureCollection of STAC 1.0.0 items with the extensions pointcloud 1.0.0 and projection 1.1.0
(PDAL wrench, vpc-spec.md).
"""

from __future__ import annotations

import json
import math
import os
import posixpath
from collections.abc import Iterable, Iterator
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
    known: dict[Any, tuple[Reference, str | None]] = {}
    with reading_errors(place), opened(place) as (file, _):
        content = json.load(TextIOWrapper(file, "utf-8"))
    items = content.get("features") if isinstance(content, dict) else None
    if not isinstance(items, list):
        raise InputError(f"{place}: is no virtual point cloud: it has no list of features")
    for number, item in enumerate(items):
        try:
            yield _member(item, place, known, asked)
        except _ODD as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{place}: item {number + 1} is not as it should be in a virtual point cloud: {error!r:.300}"
            ) from error


def _member(
    item: dict[str, Any], place: Place, known: dict[Any, tuple[Reference, str | None]], asked: Stated
) -> str | Source:
    """The member that an item describes; ``known``: systems of items before, by how these state them."""
    assets = item["assets"]
    asset = assets.get("data") or next(a for a in assets.values() if "overview" not in a.get("roles", ()))
    uri, facts = _resolved(asset["href"], place), item["properties"]
    kinds = (("copc", ".copc.laz"), ("laz", ".laz"), ("las", ".las"))
    kind = next((kind for kind, end in kinds if uri.lower().endswith(end)), None)
    box, count = facts.get("proj:bbox"), facts.get("pc:count")
    if kind is None or count is None or box is None or len(box) not in (4, 6):
        return uri
    key = next((facts[k] for k in ("proj:wkt2", "proj:projjson", "proj:code", "proj:epsg") if facts.get(k)), None)
    stated = json.dumps(key) if isinstance(key, dict) else key
    if stated not in known:
        text = key if isinstance(key, str) and "[" in key else "" if key is None else pyproj.CRS(key).to_wkt()
        reference = asked.of(reference_of({WKT: text.encode()}, str(place)), str(place))
        known[stated] = reference, None if reference.crs is None else reference.crs.to_wkt()
    reference, wkt = known[stated]
    if reference.problem is not None:
        raise InputError(f"{uri}: {reference.problem}")
    half = len(box) // 2
    x0, y0, x1, y1 = (float(box[k]) for k in (0, 1, half, half + 1))
    far = max(abs(float(one)) for one in box) < FARTHEST
    if not (far and x0 <= x1 and y0 <= y1 and 0 <= count < 1 << 40 and count == int(count)):
        raise ValueError(f"pc:count and proj:bbox say {count} points in {box}")
    return Source(
        uri,
        kind,
        (x0, y0, x1, y1) if count else NO_BOUNDS,
        int(count),
        (float(box[2]), float(box[5])) if half == 3 else (math.nan, math.nan),
        wkt,
        reference.units or Units(),
        date=str(facts["datetime"])[:10] if facts.get("datetime") else None,
    )


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
    folder = os.path.dirname(os.path.abspath(path))
    content = {"type": "FeatureCollection", "features": list(_features(sources, folder))}
    with new_file(path, overwrite=overwrite) as part:
        part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8", newline="\n")
    return path


def _features(sources: Iterable[Source], folder: str) -> Iterator[dict[str, Any]]:
    used: dict[str, int] = {}
    to_world: dict[str | None, Any] = {}
    for source in sources:
        if not source.count:
            continue
        (x0, y0, x1, y1), (z0, z1) = source.bounds, source.z
        x, y = (x0, x1, x1, x0, x0), (y0, y0, y1, y1, y0)
        corners = [*zip(x, y, strict=True)]
        if source.wkt not in to_world:
            to_world[source.wkt] = _to_degrees(source.crs)
        if to_world[source.wkt] is not None:
            x, y = to_world[source.wkt](x, y)
        stem = posixpath.basename(source.uri).rpartition(".")[0]
        used[stem] = used.get(stem, 0) + 1
        flat = math.isnan(z0) or math.isnan(z1)  # a box of the .vpc that was read had no heights: JSON knows no NaN
        local = not isinstance(source.place, Remote)
        yield {
            "type": "Feature",
            "stac_version": "1.0.0",
            "stac_extensions": _EXTENSIONS,
            "id": stem if used[stem] == 1 else f"{stem}-{used[stem]}",
            "geometry": {"type": "Polygon", "coordinates": [[*zip(x, y, strict=True)]]},
            "bbox": [min(x), min(y), *[z0] * (not flat), max(x), max(y), *[z1] * (not flat)],
            "properties": {
                "datetime": f"{source.date or _NOT_DATED}T00:00:00Z",
                "pc:count": source.count,
                "pc:type": "lidar",
                "pc:encoding": source.format,
                "pc:schemas": _schemas(source.point_format),
                "proj:wkt2": source.wkt or "",
                "proj:geometry": {"type": "Polygon", "coordinates": [corners]},
                "proj:bbox": [x0, y0, *[z0] * (not flat), x1, y1, *[z1] * (not flat)],
            },
            "links": [],
            "assets": {"data": {"href": _relative(source.uri, folder) if local else source.uri, "roles": ["data"]}},
        }


def _to_degrees(crs: pyproj.CRS | None) -> Any:
    """A function from x and y to longitudes and latitudes; None for a CRS that is not of the Earth."""
    if crs is None:
        return None
    try:
        return pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform
    except pyproj.exceptions.ProjError:
        return None


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
