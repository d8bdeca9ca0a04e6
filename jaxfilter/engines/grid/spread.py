"""Filling empty grid cells from the cells around them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ...core.compilation import jit

_FEW = 4096
"""Cells of a round, at most, that are worked on alone instead of the whole grid."""

_State = tuple[jax.Array, jax.Array, jax.Array]
"""Elevations, cells that have one, and rounds done."""
_Few = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]


def _sum_of_nine(a: jax.Array) -> jax.Array:
    """Sum over each cell and its eight neighbours; cells beyond the border count as zero."""
    a = jnp.pad(a, 1)
    a = a[:-2] + a[1:-1] + a[2:]
    return a[:, :-2] + a[:, 1:-1] + a[:, 2:]


def _fill_few(state: _State, valid: jax.Array, rounds: jax.Array | int) -> _State:
    """Rounds in which at most :data:`_FEW` cells get a value; others are not looked at. Sums add up as in the whole grid."""
    z, known, done = state
    most, width = min(_FEW, z.size), z.shape[1] + 2  # with a border, of which cell 0 stands for none
    nine = (np.arange(-1, 2)[:, None] * width + np.arange(-1, 2)).astype(np.int32)
    exists = jnp.pad(valid, 1).ravel()

    def more(state: _Few) -> jax.Array:
        _, _, done, _, count, _ = state
        return (done < rounds) & (count > 0) & (count <= most)

    def once(state: _Few) -> _Few:
        z, known, done, cells, _, claim = state
        at = cells[:, None, None] + nine[None]

        def total(a: jax.Array) -> jax.Array:
            a = a[:, 0] + a[:, 1] + a[:, 2]
            return a[:, 0] + a[:, 1] + a[:, 2]

        mean = total(jnp.where(known[at], z[at], 0)) / jnp.maximum(total(known[at].astype(jnp.float32)), 1)
        z, known = z.at[cells].set(jnp.where(cells > 0, mean, 0)), known.at[cells].set(cells > 0)
        near, number = at.ravel(), jnp.arange(at.size, dtype=jnp.int32)
        empty = exists[near] & ~known[near] & jnp.repeat(cells > 0, 9)
        claim = claim.at[jnp.where(empty, near, 0)].set(number)
        new = empty & (claim[near] == number)  # each cell once
        chosen = jnp.nonzero(new, size=most, fill_value=at.size)[0]
        return z, known, done + 1, near.at[chosen].get(mode="fill", fill_value=0), new.sum(), claim

    new = valid & ~known & (_sum_of_nine(known.astype(jnp.float32)) > 0)
    cells = jnp.nonzero(jnp.pad(new, 1).ravel(), size=most, fill_value=0)[0].astype(jnp.int32)
    z, known = jnp.pad(z, 1).ravel(), jnp.pad(known, 1).ravel()
    z, known, done, *_ = lax.while_loop(
        more, once, (z, known, done, cells, new.sum(), jnp.zeros(exists.shape, jnp.int32))
    )
    return z.reshape(-1, width)[1:-1, 1:-1], known.reshape(-1, width)[1:-1, 1:-1], done


@jit
def fill_from_neighbours(
    z: jax.Array, seen: jax.Array, valid: jax.Array, rounds: jax.Array | int
) -> tuple[jax.Array, jax.Array]:
    """Give empty cells the mean of those of their eight neighbours that have a value, ring by ring.

    Args:
        z: f32[rows, columns], metres; of empty cells any finite value.
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
        state = jnp.where(new, mean, z), known | new, done + 1
        return lax.cond(new.sum() <= _FEW, lambda state: _fill_few(state, valid, rounds), lambda state: state, state)

    return lax.while_loop(more, once, (z, seen & valid, jnp.int32(0)))[:2]
