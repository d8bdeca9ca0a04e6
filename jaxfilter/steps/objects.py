"""Segments of a gridded surface that are objects as a whole: roofs, bridges, vehicles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engines.grid.cells import padded_shape
from ..engines.grid.morphology import erosion


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


class Segments:
    """Segments of a surface, and how far it falls at their borders.

    Attributes:
        segment: i32[rows, columns], the segment that each cell is in, 0 for those in none that is large enough; count: of these.
        fall: f32[rows, columns], metres to the lowest elevation within two rows and columns.
    """

    def __init__(self, z: np.ndarray, cell: float, roofs: Roofs) -> None:
        """``z``: f32[rows, columns], metres, none missing; ``cell``: metres."""
        from ..engines.grid.shapes import segments  # imports Numba

        self.cell, self.roofs = cell, roofs
        inner = slice(0, z.shape[0]), slice(0, z.shape[1])
        wide = np.full(padded_shape(z.shape), np.inf, np.float32)
        wide[inner] = z
        self.fall = z - np.asarray(erosion(wide, 2, 2, "square"))[inner]
        self.segment, self.count = segments(z, np.float32(roofs.step), roofs.area / cell**2)

    def objects(self, marked: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """bool[rows, columns]: cells of segments that are objects as a whole.

        Args:
            marked: bool[rows, columns], cells that openings take for objects.
            slope: f32[rows, columns], rise over run, of the landscape; what it explains of a fall is none.
        """
        from ..engines.grid.shapes import census

        roofs, run = self.roofs, 2 * np.float32(self.cell)
        given = marked, self.fall, slope, np.float32(roofs.drop), run
        cells, inside, border, falling = census(self.segment, self.count, *given)
        whole = (inside >= roofs.share * cells) | (falling >= roofs.drop_share * np.maximum(border, 1))
        return (whole & (cells > 0))[self.segment]
