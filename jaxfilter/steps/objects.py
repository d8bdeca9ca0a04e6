"""Segments of a gridded surface that are objects as a whole: roofs, bridges, vehicles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

SMOOTH = 0.2
"""Metres that a bare surface bends by from one cell to the next, along its contours, and that its points scatter by."""
FURTHER, KNOWN = np.float32(1.6), np.float32(0.8)
"""On a face the surface falls so many times as far within four cells as within two, where this share of the cells have points; on
a bank within two as within one."""
ROOFS, WALLS = 0.1, 0.45
"""Shares of the cells of steep terrain that may be in roofs, and of those on its border that may be walls."""
LEVELS = 2 / 3, 1.0, 5 / 3
"""Shares of the drop at the border of an object: steps below these join segments to groups. Fewer trees beside a wall are a way
down by the smaller ones; parts of a large building differ by the larger one."""
TALL, HALL, SHOWN = np.float32(4.0), 0.8, 0.9
"""Metres by which the surface falls at the walls of large halls, at least; the share of their border inside the data that such
walls are; and how many times as many cells are on it as at the edge of the data. A rectangle cut by a corner has as many."""
BANK, EVEN, BANKS = 0.5, 0.1, 0.8
"""Metres that a bank falls by within two cells at least, and that the top of an embankment, or a steep roof, bends by; and the
share of its border, where the surface falls, that banks are at least."""


class Roofs(NamedTuple):
    """When a segment is an object as a whole.

    Attributes:
        step: metres; neighbouring cells that differ by less belong to one segment.
        area: square metres that a segment has at least.
        share: of its cells that are marked.
        drop: metres that the surface falls by, within two cells of its border.
        drop_share: of the cells on its border where it falls so.
    """

    step: float
    area: float
    share: float
    drop: float
    drop_share: float


class Parts(NamedTuple):
    """Parts of a surface, and how far it falls at their borders.

    Attributes:
        number: i32[rows, columns], the part that each cell is in, 0 for those in none that is large enough; last: the largest.
        fall: f32[rows, columns], metres that the surface falls by at their borders, negative on faces, zero elsewhere.
        walls: bool[rows, columns], where it is seen to fall at once.
    """

    number: np.ndarray
    last: int
    fall: np.ndarray
    walls: np.ndarray

    @classmethod
    def from_elevations(cls, z: np.ndarray, inside: np.ndarray, seen: np.ndarray, step: float, least: float) -> Parts:
        """Cells ``inside`` joined over edges where ``z``, f32[rows, columns], differs by less than ``step``, metres; ``least``
        cells at least. ``seen``: bool[rows, columns], cells with points."""
        from ..engines.grid.shapes import falls, segments  # imports Numba

        number, count = segments(np.where(inside, z, np.float32(np.nan)), np.float32(step), least)
        return cls(number, count, *falls(number, z, seen, FURTHER, KNOWN))


class Segments:
    """Segments of a surface, and groups of them with small steps between them: roofs of several levels.

    Attributes:
        segments: joined over edges where elevations differ by less than the ``step`` of roofs.
        groups: by less than shares of their ``drop``, one for each of :data:`LEVELS`.
    """

    def __init__(
        self, z: np.ndarray, inside: np.ndarray, seen: np.ndarray, cell: float, roofs: Roofs, largest: float
    ) -> None:
        """``z``: f32[rows, columns], metres, none missing; ``inside``, ``seen``: bool[rows, columns], cells that the data
        surround, and cells with points; ``cell``: metres; ``largest``: square metres of the largest building."""
        self.z, self.inside, self.seen, self.cell, self.roofs = z, inside, seen, cell, roofs
        self.least, self.largest = roofs.area / cell**2, largest / cell**2
        steps = roofs.step, *(share * roofs.drop for share in LEVELS)
        self.segments, *self.groups = (Parts.from_elevations(z, inside, seen, step, self.least) for step in steps)

    def objects(self, marked: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """bool[rows, columns]: cells of segments that are objects as a whole.

        What the edge of the data cuts is judged by the border that is inside, unless it is larger than the largest building: then
        the edge counts as border along which nothing falls, as that of a plateau above a cliff. Large halls are told from it by
        high walls along nearly all of their border inside, and by how much of it is inside. Nor does it fall on faces of what is
        cut: headlands go on beyond the edge, and decks over a valley are seen with both ends.

        Groups are objects by their border alone, if at least half of their cells are in segments: rocks are not. Those that the
        edge cuts must have the walls of large halls; they may be steep, too, if at least half of their cells are even.

        Args:
            marked: bool[rows, columns], cells that openings take for objects.
            slope: f32[rows, columns], rise over run, of the landscape; what it explains of a fall is none.
        """
        roofs, segment = self.roofs, self.segments.number
        cells, inside, border, falling, faces, walls, edge = self._census(self.segments, marked, slope)
        falling = falling - np.where(edge > 0, faces, 0)
        border = border + np.where((cells > self.largest) & ~_hall(border, walls, edge), edge, 0)
        whole = (inside >= roofs.share * cells) | (falling >= roofs.drop_share * np.maximum(border, 1))
        roof = (whole & (cells > 0))[segment]
        even = np.abs(self.z - uniform_filter(self.z, 3, mode="nearest")) <= EVEN
        for group in self.groups:
            cells, inside, border, falling, _, walls, edge = self._census(group, segment > 0, slope)
            falls = np.where(edge > 0, _hall(border, walls, edge), falling >= roofs.drop_share * border)
            steep = np.where(edge > 0, np.bincount(group.number.ravel(), even.ravel(), group.last + 1), 0)
            roof |= (falls & (border > 0) & (2 * np.maximum(inside, steep) >= cells))[group.number]
        return roof

    def _census(self, parts: Parts, marked: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """See :func:`jaxfilter.engines.grid.shapes.census`."""
        from ..engines.grid.shapes import census

        limits = np.float32(self.roofs.drop), 2 * np.float32(self.cell), TALL
        return census(parts.number, parts.last, marked, parts.fall, parts.walls, slope, self.inside, *limits)

    def terrain(self, objects: np.ndarray, whole: np.ndarray, high: np.ndarray) -> np.ndarray:
        """bool[rows, columns]: cells that are steep ground though openings cut them: parts of the objects, joined over edges,
        that are steep, bare and no roofs, and have no walls, as the rocks and faces of a coast.

        Of their cells half at least must have points as all around them do, and half of these be bare; few may be in segments
        that are objects as a whole, and fewer than half of those on their border walls, from which the surface falls farther, by
        twice the ``step`` of a segment, than it rises to the inside (:func:`jaxfilter.engines.grid.shapes.faces`).

        Args:
            objects: bool[rows, columns], all of them; whole: those that are segments as a whole.
            high: f32[rows, columns], the highest point in each cell, metres.
        """
        from ..engines.grid.shapes import faces, segments

        part, count = segments(np.where(objects, self.z, np.float32(np.nan)), np.float32(np.inf), self.least)
        limits = (np.float32(limit) for limit in (self.roofs.step, SMOOTH, 2 * self.roofs.step))
        cells, roofs, known, bare, border, walls = faces(part, count, self.z, high, self.seen, whole, *limits)
        ground = (2 * known >= cells) & (2 * bare >= known) & (roofs <= ROOFS * cells) & (walls <= WALLS * border)
        return (ground & (cells > 0))[part]

    def embankments(self, objects: np.ndarray) -> np.ndarray:
        """bool[rows, columns]: cells of embankments, dikes and ridges that openings cut since they are narrow: parts of the
        ``objects``, bool[rows, columns], joined over edges where elevations differ by less than twice the ``step`` of a segment,
        that are smooth and fall on banks, not at walls.

        Earth lies at less than 45 degrees. On a bank the surface goes on falling, or rises behind as it falls in front; at a
        wall, or a crown, it falls at once (:func:`jaxfilter.engines.grid.shapes.banks`).
        """
        from ..engines.grid.shapes import banks, segments

        z = np.where(objects, self.z, np.float32(np.nan))
        part, count = segments(z, np.float32(2 * self.roofs.step), self.least)
        limits = np.float32(BANK), np.float32(np.sqrt(8) * self.cell), FURTHER, np.float32(EVEN)
        cells, even, falling, sloping = banks(part, count, self.z, *limits)
        return ((2 * even >= cells) & (sloping >= BANKS * falling) & (falling > 0))[part]


def _hall(border: np.ndarray, walls: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """bool[k]: parts that the edge of the data cuts and that have the walls of large halls, by cells on their border."""
    return (walls >= HALL * border) & (border >= SHOWN * edge)
