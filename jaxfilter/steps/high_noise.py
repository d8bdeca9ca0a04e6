"""Isolated echoes far above everything around: birds, clouds, and echoes from nowhere."""

from __future__ import annotations

import numpy as np
import scipy

from ..core.cloud import PointCloud
from ..core.grid import grid_over

SIDE, ABOVE = 20.0, 15.0
"""Metres: squares in which other echoes are looked for, and how far below all of these must be. No lamp post is as tall, and
wires, masts and cranes have other echoes so near. Both were set by that, and by no labels."""
REACH = 2 * SIDE
"""Metres within which all echoes lie that have a say."""
_RING = np.array([[True, True, True], [True, False, True], [True, True, True]])


def isolated_above(cloud: PointCloud) -> np.ndarray:
    """bool[n]: points that every other point of their square of 20 m and of the eight around it lies more than 15 m below.

    Squares count from the anchor, so tiles of a survey have the same. A point without others in these squares is none: nothing
    tells how high it lies. Nor are two that are less than 15 m apart in height. Raises: InputError for an absurd extent.
    """
    valid = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid
    if not valid.any():
        return np.zeros(len(cloud), bool)
    z = np.where(valid, cloud.xyz[:, 2], np.float32(-np.inf))
    grid = grid_over(cloud.xyz[valid], SIDE, cloud.grid_offset(SIDE), name="squares of high noise")
    cell = grid.flat(cloud.xyz)
    top = np.full(grid.ny * grid.nx, -np.inf, np.float32)
    np.maximum.at(top, cell, z)
    limit = top - np.float32(ABOVE)
    near = np.bincount(cell[z >= limit[cell]], minlength=len(top))
    others = np.bincount(cell[valid], minlength=len(top)) > 1
    highest = scipy.ndimage.maximum_filter(
        top.reshape(grid.shape), footprint=_RING, mode="constant", cval=-np.inf
    ).ravel()
    alone = (near == 1) & (highest < limit) & (others | np.isfinite(highest))
    return np.asarray(alone[cell] & (z == top[cell]) & valid)
