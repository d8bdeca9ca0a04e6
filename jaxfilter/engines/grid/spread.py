"""Filling empty grid cells from the cells around them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ...core.arrays import GRID, MASK, takes

_State = tuple[jax.Array, jax.Array, jax.Array]
"""Elevations, cells that have one, and rounds done."""


def _sum_of_nine(a: jax.Array) -> jax.Array:
    """Sum over each cell and its eight neighbours; cells beyond the border count as zero."""
    a = jnp.pad(a, 1)
    a = a[:-2] + a[1:-1] + a[2:]
    return a[:, :-2] + a[:, 1:-1] + a[:, 2:]


@takes(z=GRID, seen=MASK, valid=MASK, rounds="int[]")
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

    if any(isinstance(one, jax.core.Tracer) for one in (z, seen, valid, rounds)):
        return _fill_grid(z, seen, valid, rounds)
    filled, known = _fill_rings(np.asarray(z, np.float32), np.asarray(seen), np.asarray(valid), int(rounds))
    return jnp.asarray(filled), jnp.asarray(known)


@jax.jit
def _fill_grid(z: jax.Array, seen: jax.Array, valid: jax.Array, rounds: jax.Array | int) -> tuple[jax.Array, jax.Array]:
    """For arrays that are traced: all cells in each round."""

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


def _fill_rings(z: np.ndarray, seen: np.ndarray, valid: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """The same bits: in each round only the empty cells beside those that the round before has filled."""
    count, empty = np.pad(seen & valid, 1).astype(np.float32), np.pad(valid & ~seen, 1).ravel()
    value, width, inside = np.where(count > 0, np.pad(z, 1), np.float32(0)), count.shape[1], np.s_[1:-1, 1:-1]

    def sum_of_nine(a: np.ndarray, cells: np.ndarray) -> np.ndarray:
        a = a.reshape(-1)
        west, here, east = ((a[at - width] + a[at]) + a[at + width] for at in (cells - 1, cells, cells + 1))
        return np.asarray((west + here) + east)

    new = np.flatnonzero(count)
    for _ in range(rounds):
        beside = []
        for step in (1, -1, width, -width, width + 1, width - 1, 1 - width, -1 - width):
            cells = (new + step)[empty[new + step]]
            empty[cells] = False
            beside.append(cells)
        new = np.concatenate(beside)
        if len(new) == 0:
            break
        value.flat[new], count.flat[new] = sum_of_nine(value, new) / sum_of_nine(count, new), 1
    known = count[inside] > 0
    return np.where(known, value[inside], z), known
