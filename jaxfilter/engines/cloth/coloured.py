"""A cloth of particles that falls onto a surface, in array operations: inside ``jit`` and ``vmap``, on any device.

Particles stand on a grid and move up and down only. In each step gravity moves them (Verlet integration), springs to
the 16 neighbours at one and two nodes, diagonals included, pull them together, and those that are below the surface are
set on it and stay there: W. Zhang et al. (2016), Remote Sens. 8(6), 501, sections 2.2 to 2.4.
"""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
from jax import lax

from ...core.errors import InputError
from ..grid.inpaint import fill_nearest, running
from .fabric import KEPT, SPRINGS, Cloth

_APART = 5  # nodes between particles that disturb none in common
_State = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]  # height, before, spring, steps, longest way


@jax.jit
def settle(
    limit: jax.Array,
    inside: jax.Array,
    moves: tuple[jax.Array | float, jax.Array | float],
    fall: jax.Array | float,
    tolerance: jax.Array | float,
    iterations: jax.Array | int,
) -> Cloth:
    """Let a cloth fall from height 0 onto a surface, every 25th particle at a time.

    The springs of a particle act at once, each on what the one before left. Those of all particles that are five nodes
    apart act together: first of particle (0, 0) of every five by five, then of (0, 1), row by row to (4, 4). The authors'
    program, and :func:`jaxfilter.engines.cloth.wavefront.drape`, take one row of the whole grid after the other. That
    is another order
    and another cloth: over a square hole of 60 particles it sags by 2.4 m instead of 1.8 m (rigidness 2).

    Particles are pinned at once and for good, so there is no gradient.

    Args:
        limit: f32[rows, columns], height of the surface below each particle, metres; NaN: nothing to land on.
        inside: bool[rows, columns], particles that exist.
        moves: share of the gap that a particle moves towards its neighbour, if that is pinned and if it is not.
        fall: metres that gravity adds to a particle's way in each step.
        tolerance: the cloth is at rest when no particle moves as far in a step, metres.
        iterations: limit of steps.

    Returns: Cloth; height 0 and not pinned where no particle is. ``steps`` is i32[].
    Raises: InputError if ``limit`` and ``inside`` differ in shape.

    >>> from jaxfilter.engines.cloth import coloured
    >>> limit = jnp.full((5, 5), -1.0)
    >>> rest = coloured.settle(limit, jnp.ones((5, 5), bool), (0.3, 0.4), 0.01, 0.005, 50)
    >>> float(rest.height.min()), bool(rest.pinned.all())
    (-1.0, True)
    """
    if limit.shape != inside.shape:
        raise InputError(f"settle: limit {limit.shape} and inside {inside.shape} must be grids of one shape")
    limit, fall, tolerance = (jnp.asarray(a, jnp.float32) for a in (limit, fall, tolerance))
    rows, columns = limit.shape
    high, wide = -(-rows // _APART), -(-columns // _APART)

    def planes(a: jax.Array) -> jax.Array:
        """[5, 5, high + 2, wide + 2]: particle (y, x) at [y % 5, x % 5, 1 + y // 5, 1 + x // 5]."""
        padded = jnp.pad(a, ((_APART, _APART * (high + 1) - rows), (_APART, _APART * (wide + 1) - columns)))
        return padded.reshape(high + 2, _APART, wide + 2, _APART).transpose(1, 3, 0, 2)

    surface, start = planes(limit), jnp.zeros((_APART, _APART, high + 2, wide + 2), jnp.float32)
    spring = planes(jnp.where(inside, jnp.float32(moves[1]), 0))  # < 0 for the pinned, 0 where no particle is

    def pull(colour: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        z, spring = state
        y, x = colour // _APART, colour % _APART

        def place(dx: int, dy: int) -> tuple[jax.Array, ...]:
            v, u = y + dy, x + dx
            return v % _APART, u % _APART, 1 + v // _APART, 1 + u // _APART

        def part(a: jax.Array, at: tuple[jax.Array, ...]) -> jax.Array:
            return lax.dynamic_slice(a, at, (1, 1, high, wide))

        places = [place(*step) for step in SPRINGS]
        own, share = part(z, place(0, 0)), part(spring, place(0, 0))
        pulled = []
        for at in places:
            other, its_share = part(z, at), part(spring, at)
            gap = other - own
            own = own + jnp.where(share > 0, jnp.abs(its_share), 0) * gap
            pulled.append(other - jnp.where(its_share > 0, jnp.abs(share), 0) * gap)
        for at, values in zip([place(0, 0), *places], [own, *pulled], strict=True):
            z = lax.dynamic_update_slice(z, values, at)
        return z, spring

    def unfinished(state: _State) -> jax.Array:
        _, _, _, steps, most = state
        return (steps < iterations) & ~((most > 0) & (most < tolerance))

    def move(state: _State) -> _State:
        z, before, spring, steps, _ = state
        free = spring > 0
        fallen = jnp.where(free, z + KEPT * (z - before) - fall, z)
        before = jnp.where(free, z, before)
        z, _ = lax.fori_loop(0, _APART * _APART, pull, (fallen, spring))
        most = jnp.where(free, jnp.abs(z - before), 0).max()
        hit = free & (z < surface)
        return jnp.where(hit, surface, z), before, jnp.where(hit, -jnp.float32(moves[0]), spring), steps + 1, most

    first = (start, start, spring, jnp.int32(0), jnp.float32(0))
    z, _, spring, steps, _ = lax.while_loop(unfinished, move, first)

    def grid(a: jax.Array) -> jax.Array:
        whole = a.transpose(2, 0, 3, 1).reshape(_APART * (high + 2), _APART * (wide + 2))
        return whole[_APART : _APART + rows, _APART : _APART + columns]

    return Cloth(grid(z), grid(spring) < 0, steps)


@functools.partial(jax.jit, static_argnames=("shape", "nearest"))
def lowest_below(
    xyz: jax.Array,
    carries: jax.Array,
    frame: jax.Array,
    extent: jax.Array,
    shape: tuple[int, int],
    nearest: bool,
) -> tuple[jax.Array, jax.Array]:
    """Elevation that each particle of a cloth can fall to, and which ones have a point.

    Points belong to the particle that they are nearest to. It falls onto the lowest of them, or with ``nearest`` onto that
    nearest to it, of equally near ones the lowest.

    Args:
        xyz: f32[n, 3], local metres; carries: bool[n], the points that count.
        frame: f32[3], x and y of particle (0, 0), and the distance between particles, metres.
        extent: i32[2], true numbers of rows and columns; ``shape`` is padded.

    Returns: f32[rows, columns], zero where there is no point; bool[rows, columns].
    """
    at = (xyz[:, :2] - frame[None, :2]) / frame[2]
    node = jnp.floor(at + 0.5).astype(jnp.int32)
    column, row = jnp.clip(node[:, 0], 0, extent[1] - 1), jnp.clip(node[:, 1], 0, extent[0] - 1)
    index, cells = row * shape[1] + column, shape[0] * shape[1]
    if nearest:
        distance = jnp.where(carries, ((at - node.astype(at.dtype)) ** 2).sum(axis=1), jnp.inf)
        carries &= distance == jnp.full(cells, jnp.inf, distance.dtype).at[index].min(distance)[index]
    lowest = jnp.full(cells, jnp.inf, xyz.dtype).at[index].min(jnp.where(carries, xyz[:, 2], jnp.inf)).reshape(shape)
    carried = lowest < jnp.inf
    return jnp.where(carried, lowest, 0), carried


@jax.jit
def fill_along_lines(z: jax.Array, known: jax.Array, inside: jax.Array) -> jax.Array:
    """Give every unknown node the value of the next known one in its row or column.

    The next to the right is taken, else to the left, else below, else above; where row and column are empty, the nearest
    known node. As in the program of Zhang et al. (2016).

    Args: z f32 (metres), known bool, inside bool (nodes that exist), each [rows, columns].
    Returns: f32[rows, columns].

    >>> from jaxfilter.engines.cloth import coloured
    >>> z = jnp.array([[1.0, 0.0, 3.0]])
    >>> known = jnp.array([[True, False, True]])
    >>> coloured.fill_along_lines(z, known, jnp.ones((1, 3), bool)).tolist()
    [[1.0, 3.0, 3.0]]
    """
    known = known & inside

    def fill(axis: int, reverse: bool, filled: jax.Array, done: jax.Array) -> tuple[jax.Array, jax.Array]:
        size = z.shape[axis]
        place = lax.broadcasted_iota(jnp.int32, z.shape, axis)
        if reverse:
            source = running(jnp.minimum, jnp.where(known, place, size), axis, reverse=True)
        else:
            source = running(jnp.maximum, jnp.where(known, place, -1), axis)
        found = (source >= 0) & (source < size)
        value = jnp.take_along_axis(z, jnp.clip(source, 0, size - 1), axis=axis)
        return jnp.where(~done & found, value, filled), done | found

    def across(filled: jax.Array, done: jax.Array) -> jax.Array:
        filled, done = fill(0, True, *fill(0, False, filled, done))
        return fill_nearest(filled, done & inside, inside)

    filled, done = fill(1, False, *fill(1, True, jnp.where(known, z, 0), known))
    return lax.cond((done | ~inside).all(), lambda filled, _: filled, across, filled, done)
