"""Filling empty grid cells from the cells around them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import lax

from ...core.arrays import GRID, MASK, operation

_State = tuple[jax.Array, jax.Array, jax.Array]
"""Elevations, cells that have one, and rounds done."""


def _sum_of_nine(a: jax.Array) -> jax.Array:
    """Sum over each cell and its eight neighbours; cells beyond the border count as zero."""
    a = jnp.pad(a, 1)
    a = a[:-2] + a[1:-1] + a[2:]
    return a[:, :-2] + a[:, 1:-1] + a[:, 2:]


@operation(z=GRID, seen=MASK, valid=MASK, rounds="int[]")
def fill_from_neighbours(
    z: jax.Array, seen: jax.Array, valid: jax.Array, rounds: jax.Array | int
) -> tuple[jax.Array, jax.Array]:
    """Give empty cells the mean of those of their eight neighbours that have a value, ring by ring.

    Args:
        z: f32[rows, columns] without NaN, metres; of empty cells any value.
        seen: bool[rows, columns], cells with a value; valid: bool[rows, columns], cells that exist.
        rounds: i32[], how often at most; each round reaches one cell further. Values made in a round serve the next one.

    Returns: f32[rows, columns], and bool[rows, columns], the cells with a value now. Cells out of reach keep ``z``.

    >>> from jaxfilter.engines.grid import spread
    >>> z = jnp.array([[1.0, 0.0, 3.0]])
    >>> known = jnp.array([[True, False, True]])
    >>> filled, has_value = spread.fill_from_neighbours(z, known, jnp.ones((1, 3), bool), rounds=1)
    >>> filled.tolist(), bool(has_value.all())
    ([[1.0, 2.0, 3.0]], True)
    """

    def more(state: _State) -> jax.Array:
        _, known, done = state
        return (done < rounds) & (valid & ~known).any()

    def once(state: _State) -> _State:
        z, known, done = state
        count = _sum_of_nine(known.astype(jnp.float32))
        new = valid & ~known & (count > 0)
        mean = _sum_of_nine(jnp.where(known, z, 0)) / jnp.maximum(count, 1)
        return jnp.where(new, mean, z), known | new, done + 1

    return lax.while_loop(more, once, (z, seen & valid, jnp.int32(0)))[:2]
