"""Values of a grid between its nodes."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from ...core.arrays import takes

Corners = tuple[jax.Array, jax.Array, jax.Array, jax.Array]


@takes(at="f32[n, 2]", extent="int[2]", columns=1)
def corners(
    at: jax.Array, extent: jax.Array | np.ndarray, columns: int
) -> tuple[Callable[[jax.Array], Corners], jax.Array, jax.Array]:
    """The four nodes around places in a grid, found once for several grids.

    Args:
        at: f32[n, 2], column and row of every place, in steps between nodes; node (0, 0) lies at (0, 0). Places beyond the
            nodes are moved to the border.
        extent: i32[2], true number of rows and columns of nodes.
        columns: padded number of columns.

    Returns: a function of a grid f32[rows, columns] that gives its values at the southwest, southeast, northwest and
        northeast, f32[n] each; and how far the places lie east and north of the first, f32[n] each, 0 to 1.
    """
    last = (jnp.asarray(extent) - 1)[::-1]
    at = jnp.clip(at, 0, last[None].astype(at.dtype))
    low = jnp.minimum(jnp.floor(at).astype(jnp.int32), jnp.maximum(last - 1, 0)[None])
    (u, v), (column, row) = (at - low.astype(at.dtype)).T, low.T
    right, above = jnp.minimum(column + 1, last[0]), jnp.minimum(row + 1, last[1])

    @takes(grid=f"f32?[rows, {columns}]")
    def values(grid: jax.Array) -> Corners:
        flat = grid.reshape(-1)
        south, north = row * columns, above * columns
        return flat[south + column], flat[south + right], flat[north + column], flat[north + right]

    return values, u, v


def bilinear(at: jax.Array, extent: jax.Array | np.ndarray, columns: int) -> Callable[[jax.Array], jax.Array]:
    """Interpolation between the nodes of a grid, once prepared for several grids.

    Args: as for :func:`corners`.

    Returns: a function of a grid f32[rows, columns] that gives f32[n]. It is differentiable in the grid and the places.

    >>> from jaxfilter.engines.grid import sampling
    >>> at = jnp.array([[0.5, 0.0], [1.0, 0.5]])  # column and row
    >>> grid = jnp.array([[0.0, 1.0], [2.0, 3.0]])
    >>> sampling.bilinear(at, jnp.array([2, 2]), columns=2)(grid).tolist()
    [0.5, 2.0]
    """
    values, u, v = corners(at, extent, columns)

    def sample(grid: jax.Array) -> jax.Array:
        southwest, southeast, northwest, northeast = values(grid)
        return (1 - v) * ((1 - u) * southwest + u * southeast) + v * ((1 - u) * northwest + u * northeast)

    return sample
