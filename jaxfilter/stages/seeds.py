"""Initial ground seed points: the lowest points of cells or of sliding windows."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket
from ..core.errors import InputError
from ..core.grid import MAX_CELLS
from ..core.points import Points
from ..ops.grid import block_minima, cell_index, padded_shape
from ..ops.windows import window_layout, window_minima


def lowest_per_window(points: Points, window: float, stride: float, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of windows that slide over the cloud (Li et al. 2021, Sec. II-C).

    Args:
        window: side of the square window, metres; stride: its step, metres, at most ``window``.
        barred: bool[m], points that must not be seeds. A window without others has no seed.

    Windows start at the lower left corner of the points, or at the nearest multiple of the stride from the cloud's anchor.
    Of equally low points the first in canonical order is taken.
    Raises: ParameterError, InputError if window and stride have too small a common measure for the extent.
    """
    xy = points.xyz[:, :2].astype(np.float64)
    corner, high = xy.min(axis=0), xy.max(axis=0)
    if points.cloud.anchor is not None:
        offset = np.array(points.offset(stride))
        corner = np.floor((corner - offset) / stride + 1e-9) * stride + offset
    layout = window_layout((float(high[1] - corner[1]), float(high[0] - corner[0])), window, stride)
    if layout.blocks[0] * layout.blocks[1] > MAX_CELLS:
        raise InputError(
            f"window={window:g} and stride={stride:g} m divide into {layout.block:g} m, which makes "
            f"{layout.blocks[0]} x {layout.blocks[1]} cells over this extent: let the stride divide the window, or remove "
            "stray points far from the rest"
        )
    rows, columns = padded_shape(layout.blocks)
    n = bucket(len(points))
    z = np.full(n, np.inf, np.float32)
    z[: len(points)] = np.where(barred, np.inf, points.xyz[:, 2])
    where = np.zeros((n, 2), np.float32)
    where[: len(points)] = points.xyz[:, :2]
    cell = cell_index(
        where, jnp.asarray(corner, jnp.float32), np.float32(layout.block), np.array(layout.blocks, np.int32), columns
    )
    lowest, first = block_minima(cell, z, rows * columns)
    _, lowest_point = window_minima(
        lowest.reshape(rows, columns),
        first.reshape(rows, columns),
        np.array(layout.counts, np.int32),
        layout.width,
        layout.stride,
    )
    found = np.unique(np.asarray(lowest_point))
    return found[found < len(points)].astype(np.int64)


def lowest_per_cell(points: Points, cell: float, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of square cells of ``cell`` metres that are not ``barred`` (bool[m]).

    Whole cells only; the last of each axis absorbs what is left over, as the blocks of Li et al. (2021), Sec. II-D, do.
    """
    return lowest_per_window(points, cell, cell, barred)
