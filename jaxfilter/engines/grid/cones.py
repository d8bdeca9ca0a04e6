"""Erosion of a grid with a cone: how high each cell may lie if the surface rises no faster than a slope.

A flat structuring element takes the lowest value around a cell; a cone adds an allowance that grows with distance
(Vosselman 2000). Offsets are taken one after the other; their number is traced, up to a static reach.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ...core.arrays import GRID, operation, takes

_AT_ONCE = 4  # offsets per step of the loop


@takes(reach=0)
@functools.cache
def disk_offsets(reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Offsets i32[n, 2] (rows, columns) within ``reach`` cells, nearest first, and their lengths f32[n] in cells.

    Their number is filled up to a multiple of four with the offset (0, 0) at an infinite length.
    """
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    square = row * row + column * column
    order = np.argsort(square, kind="stable")
    order = order[: np.count_nonzero(square <= reach * reach)]
    spare = -len(order) % _AT_ONCE
    offsets = np.pad(np.stack((row, column), axis=1)[order], ((0, spare), (0, 0)))
    lengths = np.pad(np.sqrt(square[order]), (0, spare), constant_values=np.inf)
    return offsets.astype(np.int32), lengths.astype(np.float32)


@operation(z=GRID, slope="number[]", radius="number[]", reach=0)
def cone_erosion(z: jax.Array, slope: jax.Array, radius: jax.Array, reach: int) -> jax.Array:
    """The lowest of ``z`` + ``slope`` x distance over the cells around every cell.

    Args:
        z: f32[rows, columns] without NaN, metres; +inf in cells that set no limit. Cells beyond the border set none.
        slope: f32[], metres per cell of distance between centres.
        radius: f32[], cells; further cells set no limit, nor do any beyond ``reach``.
        reach: the largest radius that this compilation serves.

    Returns: f32[rows, columns].

    >>> from jaxfilter.engines.grid import cones
    >>> z = jnp.array([[0.0, 9.0, 9.0, 9.0]])
    >>> cones.cone_erosion(z, jnp.float32(0.5), jnp.float32(2.0), reach=2).tolist()
    [[0.0, 0.5, 1.0, 9.0]]
    """
    offsets, lengths = disk_offsets(reach)
    shifts, distances = jnp.asarray(offsets), jnp.asarray(lengths)
    border = jnp.pad(z, reach, constant_values=jnp.inf)
    taken = jnp.sum(distances <= radius, dtype=jnp.int32)

    def step(i: jax.Array, out: jax.Array) -> jax.Array:
        for k in range(_AT_ONCE):
            distance = distances[_AT_ONCE * i + k]
            near = (distance <= radius) & (distance < jnp.inf)
            row, column = jnp.where(near, shifts[_AT_ONCE * i + k], 0)  # the cell itself, which is there already
            there = lax.dynamic_slice(border, (reach + row, reach + column), z.shape)
            out = jnp.minimum(out, there + jnp.where(near, slope * distance, 0))
        return out

    return lax.fori_loop(0, (taken + _AT_ONCE - 1) // _AT_ONCE, step, z)
