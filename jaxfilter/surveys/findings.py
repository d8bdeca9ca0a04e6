"""What does not fit together in a survey, found from headers alone."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import pyproj

from ..core.errors import InputError
from ..core.reading import Bounds
from ..core.units import Units, difference
from ..files.sources import Source

OVERLAP = 0.001
"""Least share of the smaller file's bounds that counts as an overlap; less is a matter of rounding."""
_LEAST_HOLE = 0.25  # sides of a rectangle of middling size


@dataclasses.dataclass(frozen=True)
class Findings:
    """What :meth:`Collection.check` found. A list is empty where nothing is wrong.

    Attributes:
        mixed: why files cannot be run together (different CRS or units), or None.
        unreadable: (file, reason).
        repeated: files that were named twice and count once.
        doubles: pairs of files with the same number of points in the same bounds.
        overlaps: (file, file, share of the smaller one's bounds), the largest first; without doubles.
        gaps: bounds around places that no file covers and files enclose, the largest first.
        empty: files without points.
        no_crs: files that state no CRS.
    """

    mixed: str | None
    unreadable: tuple[tuple[str, str], ...]
    repeated: tuple[str, ...]
    doubles: tuple[tuple[str, str], ...]
    overlaps: tuple[tuple[str, str, float], ...]
    gaps: tuple[Bounds, ...]
    empty: tuple[str, ...]
    no_crs: tuple[str, ...]

    def lines(self, most: int = 3) -> list[str]:
        """In words, one line for each kind, with the ``most`` first examples."""
        lines = [] if self.mixed is None else [self.mixed]
        lines += [reason for _, reason in self.unreadable[:most]]
        if len(self.unreadable) > most:
            lines.append(f"files that cannot be read: {len(self.unreadable)} in all")
        kinds: tuple[tuple[Sequence[Any], str, Callable[[Any], str]], ...] = (
            (self.repeated, "named more than once, counted once", str),
            (self.doubles, "pairs with the same number of points in the same bounds", " and ".join),
            (self.overlaps, "overlapping pairs", lambda o: f"{o[0]} and {o[1]} ({100 * o[2]:.3g} % of the smaller)"),
            (self.gaps, "gaps enclosed by files", lambda b: ", ".join(f"{v:.10g}" for v in b)),
            (self.empty, "files without points", str),
            (self.no_crs, "files without a CRS", str),
        )
        for found, words, show in kinds:
            if found:
                examples = "; ".join(show(one) for one in found[:most])
                lines.append(f"{words}: {len(found)} ({examples}{'; ...' if len(found) > most else ''})")
        return lines


class Footprints:
    """An index of n axis-parallel closed rectangles.

    Args:
        bounds: f64[n, 4], xmin, ymin, xmax, ymax; rows with NaN meet nothing.
    """

    def __init__(self, bounds: np.ndarray) -> None:
        import shapely

        self.bounds, self.known = bounds, np.flatnonzero(np.isfinite(bounds).all(axis=1))
        self.boxes = shapely.box(*bounds[self.known].T)
        self.tree = shapely.STRtree(self.boxes)

    def meeting(self, box: Bounds) -> np.ndarray:
        """i64[m], ascending: the rectangles that may hold points inside a half-open box."""
        import shapely

        found = np.sort(self.known[self.tree.query(shapely.box(*box))])
        return found[(self.bounds[found, :2] < box[2:]).all(axis=1)]

    def overlaps(self, least: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs i64[m, 2], the lower number first, and the share f64[m] of the smaller one's area that both cover;
        those from ``least`` on, the largest first."""
        one, other = self.known[self.tree.query(self.boxes)]
        pair = np.column_stack([one, other])[one < other]
        a, b = self.bounds[pair].swapaxes(0, 1)
        sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
        areas = ((each[:, 2:] - each[:, :2]).prod(axis=1) for each in (a, b))
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where((sides > 0).all(axis=1), sides.prod(axis=1) / np.minimum(*areas), 0.0)
        share[(a == b).all(axis=1)] = 1.0
        order = np.lexsort((*pair.T[::-1], -share))[: (share >= least).sum()]
        return pair[order], share[order]

    def holes(self) -> list[Bounds]:
        """The rectangles around places that no footprint covers and footprints enclose, the largest first.

        Places are seen from about a quarter of the side of a footprint of middling size on.
        """
        import shapely

        known = self.bounds[self.known]
        sides = known[:, 2:] - known[:, :2]
        sides = sides[(sides > 0).all(axis=1)]
        if not len(sides):
            return []
        wider = np.array([-1, -1, 1, 1]) * float(np.median(sides)) * _LEAST_HOLE / 2  # closes what is narrower
        covered = shapely.union_all(shapely.box(*(known + wider).T))
        rings = [ring for part in shapely.get_parts(covered) for ring in part.interiors]
        rings.sort(key=lambda ring: -shapely.area(shapely.polygons(ring)))
        return [tuple((np.array(ring.bounds) + wider).tolist()) for ring in rings]


def refuse_mixture(sources: Iterable[Source]) -> None:
    """Raises InputError, naming two files, if files differ in horizontal CRS, in what heights count from, or in units.

    Files that state no CRS, or nothing of heights, go with those that do, if their units are the same: many surveys have some.
    """
    kinds: dict[tuple[str | None, Units], str] = {}
    for source in sources:
        kinds.setdefault((source.wkt, source.units), source.uri)
    if len(kinds) < 2:
        return
    (_, unit), named = next(iter(kinds.items()))
    systems: list[tuple[str, pyproj.CRS]] = []
    for (wkt, other), uri in kinds.items():
        if (other.xy, other.z) != (unit.xy, unit.z):
            stated = ", or pass units= if one states its unit wrongly" * (len({wkt for wkt, _ in kinds} - {None}) < 2)
            raise InputError(
                f"{named} is in {unit}, {uri} in {other}: files of different units cannot be run together; convert one{stated}"
            )
        if wkt is not None:
            crs = pyproj.CRS.from_wkt(wkt)
            if not any(crs.equals(known) and known.equals(crs) for _, known in systems):
                systems.append((uri, crs))
    for (one, first), (another, second) in itertools.combinations(systems, 2):
        if names := difference(first, second):
            raise InputError(
                f"{one} is in {names[0]}, {another} in {names[1]}: files of different coordinate reference systems "
                "cannot be run together; reproject one"
            )
