"""What people have decided at places: verdicts are read, and those whose rims meet are put together."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from ..core.errors import InputError, warn
from ..core.reading import Bounds
from ..engines.neighbours import groups
from ..files.vectors import in_system, read_shapes
from ..reports.places import SIDE

GROUND, OBJECT, BRIDGE, WATER, FINE = WORDS = ("ground", "object", "bridge", "water", "fine")
"""What may be said of a place."""
PLACE_RIM = 2 * SIDE
"""Metres around a place in which points are tested again: two of the cells that places are made of."""
HALO = 40.0
"""Metres around that whose ground takes part, as around the tiles of terrain models."""
_OVERLAP = 1.0
"""Square units of the file that two places with different verdicts may share."""


class PlaceVerdict(NamedTuple):
    """What is said of a place.

    Attributes:
        word: one of :data:`WORDS`. shape: polygons in file coordinates. name: the place in words.
    """

    word: str
    shape: shapely.Geometry
    name: str

    @property
    def key(self) -> str:
        """Tells it from others: word and shape decide on it, to a millimetre."""
        plain = shapely.set_precision(self.shape, 0.001).normalize()
        return hashlib.sha256(self.word.encode() + shapely.to_wkb(plain)).hexdigest()[:24]


def read_verdicts(places: Any, crs: Any, bounds: Bounds) -> tuple[list[PlaceVerdict], list[str]]:
    """The verdicts in a file or table of places that can be carried out, in coordinates of the data; in words why others cannot.

    Args:
        places: name of a GeoPackage or GeoJSON, or a GeoDataFrame, with a column ``verdict``; empty ones are passed over.
        crs, bounds: of the data.

    Raises: InputError if it cannot be read, or has no such column. Warns: if it is transformed, and of the others.
    """
    import geopandas
    import pandas

    name, table, choose = "places", places, f"choose one of {', '.join(WORDS)}"
    if isinstance(places, (str, os.PathLike)):
        table = read_shapes(name := os.fspath(places), "places")
    elif not isinstance(places, geopandas.GeoDataFrame):
        raise InputError(f"{name}: a GeoDataFrame or the name of a file is needed, not {type(places).__name__}")
    if not len(table):  # an empty GeoJSON has no columns
        return [], []
    if "verdict" not in table:
        columns = ", ".join(map(str, table.columns))
        raise InputError(f"{name}: has no column verdict; it has {columns}: add it, with one of {', '.join(WORDS)}")
    table = in_system(table, crs, name)
    rows = pandas.Series(range(1, len(table) + 1), table.index)
    ranks = pandas.to_numeric(table.get("rank", rows), errors="coerce")
    verdicts, problems = [], []
    for row, rank, said, shape in zip(rows, ranks, table["verdict"], table.geometry, strict=True):
        which = f"place {rank:.0f}" if np.isfinite(rank) else f"the place in row {row}"
        word = "" if pandas.isna(said) else str(said).strip().lower()
        if not word:
            continue
        if word not in WORDS:
            problems.append(f"{name}: {which}: {said!r} is no verdict: {choose}")
        elif shape is None or "Polygon" not in shape.geom_type or not (valid := shapely.make_valid(shape)).area:
            problems.append(f"{name}: {which}: is no polygon")
        elif not shape.intersects(shapely.box(*bounds)):
            problems.append(f"{name}: {which}: lies outside of the data: is it in another CRS?")
        else:
            verdicts.append(PlaceVerdict(word, valid, which))
    shapes, left_out = np.array([one.shape for one in verdicts], object), set()
    for a, b in sorted(shapely.STRtree(shapes).query(shapes, predicate="intersects").T.tolist()):
        one, other = verdicts[a], verdicts[b]
        if a < b and one.word != other.word and one.shape.intersection(other.shape).area > _OVERLAP:
            both = f"{one.name} is {one.word} and {other.name}, which overlaps it, {other.word}"
            problems.append(f"{name}: {both}: neither is carried out")
            left_out |= {a, b}
    for problem in problems:
        warn(problem)
    return [one for row, one in enumerate(verdicts) if row not in left_out], problems


class VerdictSite(NamedTuple):
    """Verdicts that are carried out together, since points are in the rims of several.

    Attributes:
        verdicts: of these places. touched: box around them and their rims. window: box whose points take part. File coordinates.
    """

    verdicts: list[PlaceVerdict]
    touched: Bounds
    window: Bounds


def sites_of(verdicts: Sequence[PlaceVerdict], metre: float) -> list[VerdictSite]:
    """Places whose rims meet are a site; where nothing is to be changed there is none. ``metre``: metres per unit of the file."""
    rims = np.array([one.shape.buffer(PLACE_RIM / metre) for one in verdicts], object)
    one, other = shapely.STRtree(rims).query(rims, predicate="intersects")
    number, found = groups(one, other, len(rims)), []
    for site in np.unique(number):
        own = sorted((verdicts[row] for row in np.flatnonzero(number == site).tolist()), key=lambda one: one.key)
        if acting := [one.shape for one in own if one.word != FINE]:
            x0, y0, x1, y1 = shapely.union_all(acting).bounds
            boxes = ((x0 - by, y0 - by, x1 + by, y1 + by) for by in (PLACE_RIM / metre, (PLACE_RIM + HALO) / metre))
            found.append(VerdictSite(own, *boxes))
    return found
