"""Water bodies: level cells, or voids, that lie lower than what is around them."""

from __future__ import annotations

import math

import numpy as np
import scipy

from ..engines.grid.extremes import highest, lowest

FLAT, STEP = 0.25, 0.2
"""Metres between the lowest and the highest of 5 x 5 cells of water, at most, and from one cell to the next: noise of 5 cm."""
LEVEL_RANGE = 0.1
"""Metres between their means of 5 x 5: a slope of 2.5 %."""
CORE = 50.0
"""Square metres of such cells, at least."""
AREA, SLOPING = 200.0, 0.4
"""Square metres of a water body at least, and metres between nearly all its means at most, where it has returned few of the
pulses."""
SLOPE = 0.001
"""Rise over run that such a body, a river, may have along the diagonal of its extent besides: 1 m in 1 km."""
DENSE_AREA, DENSE_LEVEL = 1000.0, 0.15
"""The same of a body that has as many points as land. Courtyards can be as level, but not as large."""
THIN = 0.5
"""Of the points on a cell beside it that a body with few points has on one."""
RISE, RISING, FALLING = 0.15, 0.5, 0.05
"""Metres that land is higher than water, or lower; of the cells beside a body so many are higher, at least, or lower, at most."""
RIM_CELLS = 4
"""Cells from a body up to which others are beside it, and half the width of what stands on water."""
SURFACE, AFLOAT = 0.15, 0.3
"""Metres from the level of water up to which points are its surface, and from which on they are no ground."""


def waters(
    z: np.ndarray, known: np.ndarray, count: np.ndarray, objects: np.ndarray, cell: float
) -> tuple[np.ndarray, np.ndarray]:
    """Water bodies in a surface of lowest points: f32[rows, columns], the elevation of the water, metres, NaN elsewhere, and
    also at objects on it, a few cells wide; and bool[rows, columns], cells where nothing above that or below is ground: those
    without the shore.

    A body is a segment of flat cells whose means differ by centimetres, or by decimetres, or a metre along a kilometre, where
    water has returned few of the pulses; nearly all around it the surface is higher, and nowhere lower. So level meadows, which
    end at ditches, are none, nor are car parks, which slope, nor roofs.

    Args:
        z: f32[rows, columns], metres, none missing, voids at the lowest elevation around.
        known: bool[rows, columns], cells that the data surround. count: i64[rows, columns], points in each cell.
        objects: bool[rows, columns], cells that are none of the ground. cell: side of a cell, metres.
    """
    from ..engines.grid.shapes import segments  # imports Numba

    mean = scipy.ndimage.uniform_filter(z, 5)
    clear = (_range(z) < FLAT) & (_range(mean) < LEVEL_RANGE) & known
    flat = highest(clear, 5) & known
    core, bodies = segments(np.where(flat, z, np.float32(np.nan)), np.float32(STEP), CORE / cell**2)
    level = np.full(z.shape, np.nan, np.float32)
    if bodies == 0:
        return level, core > 0
    names, heights = core[core > 0], z[core > 0]
    heights = np.bincount(names, heights)[1:] / np.bincount(names)[1:]
    rank = np.zeros(bodies + 1, np.int32)
    rank[1 + np.argsort(-heights, kind="stable")] = np.arange(1, bodies + 1)  # at a shore the lower one counts
    core = rank[core]
    near = lowest(np.where(clear & (core > 0), mean, np.float32(np.inf)), 2 * RIM_CELLS + 5)
    shore = (core == 0) & (np.abs(z - near) < SURFACE) & known
    part = np.where(shore, highest(core, 2 * RIM_CELLS + 1), core)
    inner = (part > 0) & (lowest(part, 5) == highest(part, 5))
    area, rough = np.bincount(part.ravel(), minlength=bodies + 1) * cell**2, _spread(mean[inner], part[inner], bodies)
    body = np.zeros_like(part)
    for number, box in enumerate(scipy.ndimage.find_objects(part), 1):
        most = max(SLOPING, SLOPE * cell * math.hypot(*(one.stop - one.start for one in box)))
        if rough[number] > most or area[number] < AREA:
            continue
        box = tuple(slice(max(one.start - RIM_CELLS, 0), one.stop + RIM_CELLS) for one in box)
        own = part[box] == number
        rim = highest(own, 2 * RIM_CELLS + 1) & ~own & known[box]
        thin = rim.any() and count[box][own].mean() < THIN * count[box][rim].mean()
        if not rim.any() or not (thin or (rough[number] <= DENSE_LEVEL and area[number] >= DENSE_AREA)):
            continue
        rise = z[box][rim] - _mean(z[box], own, 2 * RIM_CELLS + 1)[rim]
        if (rise > RISE).sum() >= RISING * rim.sum() and (rise < -RISE).sum() <= FALLING * rim.sum():
            body[box][own] = number
    if not body.any():
        return level, body > 0
    ends = [np.flatnonzero(body.any(axis=axis))[[0, -1]] for axis in (1, 0)]
    box = tuple(slice(max(first - 3 * RIM_CELLS, 0), last + 3 * RIM_CELLS) for first, last in ends)
    body, core, apart = body[box], core[box], np.zeros(z.shape, bool)
    wet = scipy.ndimage.binary_propagation((body > 0) & (core > 0), mask=body > 0)  # without crumbs of the shore
    closed = scipy.ndimage.binary_closing(np.pad(wet, RIM_CELLS), iterations=RIM_CELLS)
    near = closed[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS] & objects[box]
    level[box] = np.where(wet | near, _mean(z[box], wet, 2 * RIM_CELLS + 1), level[box])
    apart[box] = near | lowest(wet | near, 3)
    return level, apart


def _range(z: np.ndarray) -> np.ndarray:
    """f32[rows, columns]: metres between the lowest and the highest of 5 x 5 cells."""
    return highest(z, 5) - lowest(z, 5)


def _spread(z: np.ndarray, name: np.ndarray, most: int) -> np.ndarray:
    """f64[1 + most]: metres within which nine tenths of the values f32[n] of each name i32[n] lie, infinite without any."""
    order = np.argsort(name.astype(np.uint16) if most < 1 << 16 else name, kind="stable")
    out = np.full(most + 1, np.inf)
    values, ends = z[order], np.cumsum(np.bincount(name, minlength=most + 1))
    for number in range(1, most + 1):
        some = values[ends[number - 1] : ends[number]]
        if len(some):
            low, high = (int(share * (len(some) - 1)) for share in (0.05, 0.95))
            some = np.partition(some, (low, high))
            out[number] = some[high] - some[low]
    return out


def _mean(z: np.ndarray, on: np.ndarray, size: int) -> np.ndarray:
    """f32[rows, columns]: the mean of ``z`` over the cells of a square window that are ``on``, NaN without any."""
    share = scipy.ndimage.uniform_filter(on.astype(np.float64), size, mode="constant")
    total = scipy.ndimage.uniform_filter(np.where(on, z, 0).astype(np.float64), size, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share > 0.5 / size**2, total / share, np.nan).astype(np.float32)
