"""Points in grid cells: padded grid sizes, and the lowest point per cell.

A grid array has shape [rows, columns]; row 0 is the southern edge. Arrays are padded to a few sizes, so that grids of
nearly equal size share one compilation; the true number of rows and columns is a traced argument.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import operation, takes
from ...core.compilation import bucket
from ...core.points import by_position

_BLOCK = 2**16
"""Points that the device takes at a time for lowest points."""


@takes(n=0)
def padded_length(n: int) -> int:
    """The padded number of rows or columns that holds ``n``: the next multiple of 256; from 1024 on of 128, 256 from 2048, 512
    from 4096, so that a large grid is never padded by more than an eighth of its side.
    """
    step = max(128, 2 ** (max(n - 1, 1).bit_length() - 4)) if n > 1024 else 256
    return -(-max(n, 1) // step) * step


@takes(shape=0)
def padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """:func:`padded_length` of rows and columns; up to 512 cells a side, a square.

    So all grids of at most 512 x 512 cells have one of two shapes: to compile for another one takes longer than empty cells do.
    """
    rows, columns = map(padded_length, shape)
    return (max(rows, columns),) * 2 if max(rows, columns) <= 512 else (rows, columns)


@takes(shape=0, extent="int[2]")
def inside(shape: tuple[int, int], extent: jax.Array | np.ndarray) -> jax.Array:
    """bool[rows, columns] of the padded ``shape``: True for the cells of the true ``extent``, i32[2] (rows, columns).

    >>> from jaxfilter.engines.grid import cells
    >>> cells.inside((2, 3), jnp.array([2, 2])).tolist()
    [[True, True, False], [True, True, False]]
    """
    row, column = (jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(2))
    return (row < extent[0]) & (column < extent[1])


@operation(index="int[n]", z="f32[n]", cells=1)
def block_minima(index: jax.Array, z: jax.Array, cells: int) -> tuple[jax.Array, jax.Array]:
    """Lowest elevation of every cell, and the first point that has it.

    Args:
        index: i32[n], cell of every point.
        z: f32[n] without NaN, metres; +inf for points that do not count (padding).
        cells: number of cells of the padded grid.

    Returns: f32[cells], +inf in empty cells, and i32[cells], the lowest index among equally low points, ``n`` in empty
        cells. With points in canonical order the choice depends on coordinates alone. Raises: InputError for other arrays.

    >>> from jaxfilter.engines.grid import cells
    >>> lowest, first = cells.block_minima(jnp.array([0, 2, 2]), jnp.array([5.0, 4.0, 3.0]), cells=3)
    >>> lowest.tolist(), first.tolist()
    ([5.0, inf, 3.0], [0, 3, 2])
    """
    n = len(z)
    lowest = jnp.full(cells, jnp.inf, z.dtype).at[index].min(z)
    is_lowest = (z == lowest[index]) & (z < jnp.inf)
    first = jnp.full(cells, n, jnp.int32).at[index].min(jnp.where(is_lowest, jnp.arange(n, dtype=jnp.int32), n))
    return lowest, first


@functools.partial(jax.jit, donate_argnums=0)
def _lower(lowest: jax.Array, index: jax.Array, z: jax.Array) -> jax.Array:
    return lowest.at[index].min(z)


@functools.partial(jax.jit, donate_argnums=0)
def _sooner(first: jax.Array, lowest: jax.Array, index: jax.Array, z: jax.Array, start: jax.Array) -> jax.Array:
    row = start + jnp.arange(len(z), dtype=jnp.int32)
    return first.at[index].min(jnp.where((z == lowest[index]) & (z < jnp.inf), row, jnp.iinfo(jnp.int32).max))


def lowest_in_cells(index: np.ndarray, z: np.ndarray, cells: int, rows: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """:func:`block_minima` of a cloud: blocks of points, and tables of cells, have padded sizes, so that none compiles anew.

    Args:
        index: i[n], cell of every point; z: f32[n] without NaN, metres; +inf for points that do not count.
        cells: their number. rows: whether rows are asked for, which take twice as long.

    Returns: f32[cells], +inf in empty cells; i32[cells], the lowest row among equally low points, ``n`` in empty cells, or
        i32[0].
    """

    def blocks() -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        for start in range(0, len(z), block):
            at, low, part = np.zeros(block, np.int32), np.full(block, np.inf, np.float32), slice(start, start + block)
            held = len(z[part])
            at[:held], low[:held] = index[part], z[part]
            yield start, at, low

    size, block = bucket(cells), _BLOCK if len(z) > _BLOCK else _BLOCK // 4
    lowest = jnp.full(size, jnp.inf, jnp.float32)
    for _, at, low in blocks():
        lowest = _lower(lowest, at, low)
    first = jnp.full(size if rows else 0, len(z), jnp.int32)
    for start, at, low in blocks() if rows else ():
        first = _sooner(first, lowest, at, low, np.int32(start))
    return np.asarray(lowest)[:cells], np.asarray(first)[:cells]


def lowest_points(
    xyz: np.ndarray, index: np.ndarray, z: np.ndarray, cells: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The lowest points of cells, of equally low ones the first in the order of :func:`jaxfilter.core.points.by_position`.

    Args: xyz: f32[n, >=2], local metres; others as for :func:`lowest_in_cells`.

    Returns: f32[cells], the elevations; i32[cells], the numbers of the points, as many as there are for cells without any; and
        i64[k], rows of all lowest points, by number.
    """
    lowest, _ = lowest_in_cells(index, z, cells, rows=False)
    found = np.flatnonzero((z == lowest[index]) & (z < np.inf))
    found = found[by_position(xyz[found])]
    return lowest, lowest_in_cells(index[found], z[found], cells)[1], found
