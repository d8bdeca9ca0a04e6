"""Values of a grid at points: bilinear, and of the cell that a point lies in."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp


def bilinear(at: jax.Array, extent: jax.Array, columns: int) -> Callable[[jax.Array], jax.Array]:
    """Interpolation between the nodes of a grid, at given places: indices and weights are found once for several grids.

    Args:
        at: f32[n, 2], column and row of every place, in steps between nodes; node (0, 0) lies at (0, 0). Places beyond the
            nodes get the values of the border.
        extent: i32[2], true number of rows and columns of nodes.
        columns: padded number of columns.

    Returns: a function of a grid f32[rows, columns] that gives f32[n]. It is differentiable in the grid and the places.
    """
    last = (jnp.asarray(extent) - 1)[::-1]
    at = jnp.clip(at, 0, last)
    low = jnp.minimum(jnp.floor(at).astype(jnp.int32), jnp.maximum(last - 1, 0))
    (u, v), (column, row) = (at - low).T, low.T
    right, above = jnp.minimum(column + 1, last[0]), jnp.minimum(row + 1, last[1])

    def sample(grid: jax.Array) -> jax.Array:
        flat = grid.reshape(-1)
        southern = (1 - u) * flat[row * columns + column] + u * flat[row * columns + right]
        northern = (1 - u) * flat[above * columns + column] + u * flat[above * columns + right]
        return (1 - v) * southern + v * northern

    return sample
