"""Initial ground seed points: the lowest points of cells or of sliding windows."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket
from ..core.errors import InputError
from ..core.grid import Grid, most_cells
from ..core.points import Points
from ..ops.grid import block_minima, cell_index, padded_shape
from ..ops.windows import window_layout, window_minima
from .surfaces import Cells, look_up


def lowest_per_window(points: Points, window: float, stride: float, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of windows that slide over the cloud (Li et al. 2021, Sec. II-C).

    Args:
        window: side of the square window, metres; stride: its step, metres, at most ``window``.
        barred: bool[m], points that must not be seeds. A window without others has no seed.

    Windows start at the lower left corner of the points, or at the nearest multiple of the stride from the cloud's anchor.
    Of equally low points the first in canonical order is taken.
    Raises: ParameterError, InputError if window and stride have too small a common measure for the extent.
    """
    corner, high = points.extent
    if points.cloud.anchor is not None:
        offset = np.array(points.offset(stride))
        corner = np.floor((corner - offset) / stride + 1e-9) * stride + offset
    layout = window_layout((float(high[1] - corner[1]), float(high[0] - corner[0])), window, stride)
    if layout.blocks[0] * layout.blocks[1] > most_cells(len(points)):
        raise InputError(
            f"window={window:g} and stride={stride:g} m divide into {layout.block:g} m, which makes "
            f"{layout.blocks[0]} x {layout.blocks[1]} cells over this extent: let the stride divide the window, or remove "
            "stray points far from the rest"
        )
    n = bucket(len(points))
    xyz = np.zeros((n, 3), np.float32)
    xyz[: len(points)] = points.xyz
    xyz[len(points) :, 2] = xyz[: len(points), 2][barred] = np.inf
    blocks, counts = np.array(layout.blocks, np.int32), np.array(layout.counts, np.int32)
    found = _lowest_of_windows(
        xyz,
        corner.astype(np.float32),
        np.float32(layout.block),
        blocks,
        counts,
        shape=padded_shape(layout.blocks, points.least_shape(layout.block)),
        width=layout.width,
        stride=layout.stride,
    )
    found = np.unique(np.asarray(found))
    return found[found < len(points)].astype(np.int64)


@functools.partial(jax.jit, static_argnames=("shape", "width", "stride"))
def _lowest_of_windows(
    xyz: jax.Array,
    corner: jax.Array,
    block: jax.Array,
    blocks: jax.Array,
    counts: jax.Array,
    *,
    shape: tuple[int, int],
    width: int,
    stride: int,
) -> jax.Array:
    """i32[rows, columns]: the lowest point of each window; see :func:`jaxfilter.ops.windows.window_minima`."""
    cell = cell_index(xyz, corner, block, blocks, shape[1])
    lowest, first = block_minima(cell, xyz[:, 2], shape[0] * shape[1])
    return window_minima(lowest.reshape(shape), first.reshape(shape), counts, width, stride)[1]


def lowest_per_cell(points: Points, cell: float, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of square cells of ``cell`` metres that are not ``barred`` (bool[m]).

    Whole cells only; the last of each axis absorbs what is left over, as the blocks of Li et al. (2021), Sec. II-D, do.
    """
    return lowest_per_window(points, cell, cell, barred)


def lowest_on_grid(points: Points, grid: Grid, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of the cells of a grid that are not ``barred`` (bool[m]).

    Cells at the upper edges may reach beyond the cloud. Of equally low points the first in canonical order is taken.
    """
    rows = np.flatnonzero(~barred)
    cell, z = grid.flat(points.xyz[rows]), points.xyz[rows, 2]
    low = np.full(grid.nx * grid.ny, np.inf, np.float32)
    np.minimum.at(low, cell, z)
    lowest = np.flatnonzero(z == low[cell])
    return np.sort(rows[lowest[np.unique(cell[lowest], return_index=True)[1]]])


def lowest_of_cells(points: Points, cells: Cells, chosen: jax.Array, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of the ``chosen`` cells, bool[rows, columns].

    ``barred``: bool[m], the points that were left out when ``cells`` were made, and are here. Of equally low points the
    first in canonical order is taken.
    """
    chosen = jnp.where(chosen & cells.seen, cells.lowest, -jnp.inf)
    (low,) = look_up(points.xyz, cells, chosen)
    rows = np.flatnonzero(~barred & (points.xyz[:, 2] == low))
    n = bucket(len(rows))
    xy = np.zeros((n, 2), np.float32)
    xy[: len(rows)] = points.xyz[rows, :2]
    at = np.asarray(cell_index(xy, cells.frame[:2], cells.frame[2], cells.extent, chosen.shape[1]))[: len(rows)]
    return np.sort(rows[np.unique(at, return_index=True)[1]])


def lowest_seeds(points: Points, grid: Grid, seed: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """bool[m]: the lowest seed of every cell that has seeds, and the lowest of the points ``counted`` of the others.

    Of equally low points the first in canonical order is taken. ``seed``, ``counted``: bool[m].
    """
    at = grid.flat(points.xyz)
    seeded = np.zeros(grid.nx * grid.ny, bool)
    seeded[at[seed]] = True
    found = np.zeros(len(points), bool)
    found[lowest_on_grid(points, grid, ~(seed | (counted & ~seeded[at])))] = True
    return found


def under_canopy(xyz: np.ndarray, counted: np.ndarray, grid: Grid, height: float) -> np.ndarray:
    """bool[m]: points less than ``height`` above the lowest point of their cell, of those ``counted``, bool[m].

    Cai et al. (2023), eq. 1.
    """
    at = grid.flat(xyz)
    lowest = np.full(grid.nx * grid.ny, np.inf, np.float32)
    np.minimum.at(lowest, at[counted], xyz[counted, 2])
    return xyz[:, 2] - lowest[at] < height
