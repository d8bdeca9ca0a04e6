"""What does not fit together in a survey, found from headers alone."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import pyproj

from ..core.errors import InputError
from ..core.units import Units, horizontal, same_system
from ..files.disk import Bounds

OVERLAP = 0.001
"""Least share of the smaller file's bounds that counts as an overlap; less is a matter of rounding."""


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
        told = [] if self.mixed is None else [self.mixed]
        told += [reason for _, reason in self.unreadable[:most]]
        if len(self.unreadable) > most:
            told.append(f"files that cannot be read: {len(self.unreadable)} in all")
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
                told.append(f"{words}: {len(found)} ({examples}{'; ...' if len(found) > most else ''})")
        return told

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)


def refuse_mixture(uris: Sequence[str], wkts: Sequence[str | None], units: Sequence[Units]) -> None:
    """Raises InputError, naming two files, if files differ in horizontal CRS or in units.

    Files that state no CRS go with those that do, if their units are the same: many surveys have some.
    """
    kinds: dict[tuple[str | None, Units], str] = {}
    for uri, wkt, unit in zip(uris, wkts, units, strict=True):
        kinds.setdefault((wkt, unit), uri)
    (_, unit), named = next(iter(kinds.items()))
    systems: list[tuple[str, pyproj.CRS]] = []
    for (wkt, other), uri in kinds.items():
        if (other.xy, other.z) != (unit.xy, unit.z):
            raise InputError(
                f"{named} is in {unit}, {uri} in {other}: files of different units cannot be run together; convert one, or "
                "pass units= if one states its unit wrongly"
            )
        if wkt is not None:
            crs = horizontal(pyproj.CRS.from_wkt(wkt))
            if not any(crs.equals(known) and known.equals(crs) for _, known in systems):
                systems.append((uri, crs))
    for (one, first), (another, second) in itertools.combinations(systems, 2):
        if not same_system(first, second):
            raise InputError(
                f"{one} is in {first.name}, {another} in {second.name}: files of different coordinate reference systems "
                "cannot be run together; reproject one"
            )
