"""Points to grid cells: padded grid sizes, cell index, lowest point and number of points per cell.

A grid array has shape [rows, columns]; row 0 is the southern edge. Arrays are padded to a few sizes, so that grids of
nearly equal size share one compilation; the true number of rows and columns is a traced argument.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import operation, takes


@takes(n=0)
def padded_length(n: int) -> int:
    """The padded number of rows or columns that holds ``n``: the next multiple of 256; from 1024 on of 128, 256 from 2048, 512
    from 4096, so that a large grid is never padded by more than an eighth of its side.
    """
    step = max(128, 2 ** (max(n - 1, 1).bit_length() - 4)) if n > 1024 else 256
    return -(-max(n, 1) // step) * step


@takes(shape=0, least=0)
def padded_shape(shape: tuple[int, int], least: tuple[int, int] = (1, 1)) -> tuple[int, int]:
    """:func:`padded_length` of rows and columns, or of ``least`` where that is more; up to 512 cells a side, a square.

    So all grids of at most 512 x 512 cells have one of two shapes: to compile for another one takes longer than empty cells do.
    """
    rows, columns = (padded_length(max(pair)) for pair in zip(shape, least, strict=True))
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


@operation(xy="f32[n, 2+]", corner="f32[2]", cell="number[]", extent="int[2]", columns=1)
def cell_index(xy: jax.Array, corner: jax.Array, cell: jax.Array, extent: jax.Array, columns: int) -> jax.Array:
    """Row-major cell of every point in a padded grid; points outside the extent go to the nearest cell.

    Args:
        xy: f32[n, >=2] without NaN, local metres.
        corner: f32[2], x and y of the lower left corner of cell (0, 0), metres.
        cell: f32[], side of a cell, metres.
        extent: i32[2], true number of rows and columns.
        columns: padded number of columns.

    Returns: i32[n].

    >>> from jaxfilter.engines.grid import cells
    >>> xy = jnp.array([[0.5, 0.5], [3.5, 1.2]])
    >>> cells.cell_index(xy, jnp.zeros(2), jnp.float32(1.0), jnp.array([2, 4]), columns=4).tolist()
    [0, 7]
    """
    step = jnp.floor((xy[:, :2] - corner[None]) / cell).astype(jnp.int32)
    column = jnp.clip(step[:, 0], 0, extent[1] - 1)
    row = jnp.clip(step[:, 1], 0, extent[0] - 1)
    return row * columns + column


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


@operation(index="int[n]", counted="bool[n]", cells=1)
def block_counts(index: jax.Array, counted: jax.Array, cells: int) -> jax.Array:
    """i32[cells]: number of points per cell, of those with ``counted``, bool[n]; ``index`` is i32[n]."""
    return jnp.zeros(cells, jnp.int32).at[index].add(counted.astype(jnp.int32))
