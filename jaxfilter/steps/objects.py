"""Segments of a gridded surface, and how far it falls at their borders."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

FURTHER = np.float32(1.6)
"""On a face the surface falls so many times as far within four cells as within two; on a bank within two as within one."""
EVEN = 0.1
"""Metres that a smooth surface bends by from one cell to the next: a crest, a steep roof. Bare rock bends by twice as much."""
MOST = 0.8
"""Share of its border where the surface falls that banks of an embankment, and walls of a large hall, are at least."""


class Census(NamedTuple):
    """Counts of cells of each part, i32[1 + parts]: all its ``cells``; those on its ``border`` with other parts; of these where
    the surface is ``falling``, where that is on ``faces``, and high ``walls``; and other cells at the ``edge`` of the data."""

    cells: np.ndarray
    border: np.ndarray
    falling: np.ndarray
    faces: np.ndarray
    walls: np.ndarray
    edge: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """Parts of a surface, of cells joined over edges where elevations differ by less than a step.

    Attributes:
        number: i32[rows, columns], the part that each cell is in, 0 for those in none that is large enough; last: the largest.
        fall: f32[rows, columns], metres that the surface falls by at their borders, negative on faces, zero elsewhere.
        walls: bool[rows, columns], where it is seen to fall at once.
        inside, seen: bool[rows, columns], cells that the data surround, and cells with points. cell: metres.
        least: cells of a part, at least.
    """

    number: np.ndarray
    last: int
    fall: np.ndarray
    walls: np.ndarray
    inside: np.ndarray
    seen: np.ndarray
    cell: float
    least: float

    @classmethod
    def from_elevations(
        cls, z: np.ndarray, inside: np.ndarray, seen: np.ndarray, cell: float, step: float, area: float
    ) -> Parts:
        """Of elevations f32[rows, columns]; ``step``: metres; ``area``: square metres of a part, at least."""
        from ..engines.grid.shapes import falls, segments  # imports Numba

        least = area / cell**2
        number, last = segments(np.where(inside, z, np.float32(np.nan)), np.float32(step), least)
        fall, walls = falls(number, z, seen, FURTHER)
        return cls(number, last, fall, walls, inside, seen, cell, least)

    def joined(self, z: np.ndarray, step: float) -> Parts:
        """Those with another step between cells."""
        return Parts.from_elevations(z, self.inside, self.seen, self.cell, step, self.least * self.cell**2)

    def census(self, slope: np.ndarray, drop: float, tall: float) -> Census:
        """Counts of cells; the surface falls by more than ``drop``, metres, and what ``slope``, rise over run,
        f32[rows, columns], explains of it. High walls fall by more than ``tall``, metres."""
        from ..engines.grid.shapes import census

        limits = np.float32(drop), 2 * np.float32(self.cell), np.float32(tall)
        return Census(*census(self.number, self.last, self.fall, self.walls, slope, self.inside, *limits))
