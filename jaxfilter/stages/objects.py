"""Segments of a gridded surface that are objects as a whole: roofs, bridges, vehicles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..ops.grid import padded_shape
from ..ops.morphology import erosion


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


def whole_segments(z: np.ndarray, marked: np.ndarray, slope: np.ndarray, cell: float, roofs: Roofs) -> np.ndarray:
    """bool[rows, columns]: cells of segments that are objects as a whole.

    Args:
        z: f32[rows, columns], metres, none missing. marked: bool[rows, columns], cells that openings take for objects.
        slope: f32[rows, columns], rise over run, of the landscape; what it explains of a fall is none.
        cell: metres.
    """
    from ..host.shapes import census, segments  # imports Numba

    wide = np.full(padded_shape(z.shape), np.inf, np.float32)
    wide[: z.shape[0], : z.shape[1]] = z
    lowest = np.asarray(erosion(wide, 2, 2, "square"))[: z.shape[0], : z.shape[1]]
    falls = z - lowest > np.float32(roofs.drop) + 2 * np.float32(cell) * slope
    segment = segments(z, np.float32(roofs.step))
    cells, inside, border, falling = census(segment, marked, falls)
    whole = (inside >= roofs.share * cells) | (falling >= roofs.drop_share * np.maximum(border, 1))
    return (whole & (cells * cell**2 >= roofs.area))[segment]
