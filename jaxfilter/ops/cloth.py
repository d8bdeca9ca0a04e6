"""A cloth of particles that falls onto a surface, in the order of a program that moves one particle after the other.

Particles stand on a grid and move up and down only. In each step gravity moves them (Verlet integration), springs to
the 16 neighbours at one and two nodes, diagonals included, pull them together, and those that are below the surface are
set on it and stay there: W. Zhang et al. (2016), Remote Sens. 8(6), 501, sections 2.2 to 2.4.

The springs of a particle act at once, each on what the one before left, and particles follow each other row by row.
That order stiffens the cloth, and no other order that was tried gives the same ground, so it is kept to the letter, but
not one by one. Particle (x, y) disturbs nothing beyond two nodes, so in step k its turn may be at the time

    t = x + 5 y + 25 k

and all particles with one t move together: those before it in the order that are near enough to matter have a smaller
t, those after it a larger one. A particle is touched from t - 12 to t + 12; so 25 times after its turn the next step
can begin, while distant particles are still in earlier steps, as many as the grid is long. With rows of 5 modulo 25
nodes, particle n of the grid in row-major order has its turn at times that are n modulo 25: the grid is kept as 25
planes, and a spring joins two planes that are shifted by a fixed number of places. Only the rows in motion are visited,
in parts that fit the cache. That the cloth is at rest after some step is known when its last particle has taken it; so
that others are not too far ahead by then, all wait for the last one every 64 steps or more, and the steps since the
last wait are then repeated, up to that one.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from .grid import padded_length
from .inpaint import fill_nearest

_PLANES = 25
_CHUNK = 2048  # particles of a plane that are moved at a time; stays in the cache
_EPOCH = 64  # steps, at least, after which all particles wait for the last one
_LEAD = 13  # turns between a particle's last one and the start of its next step
_DAMPING = 0.01
_RING = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (1, -1), (1, 0), (0, 1), (1, 1))  # (dx, dy), in the order of the springs
_SPRINGS = _RING + tuple((2 * dx, 2 * dy) for dx, dy in _RING)


class Cloth(NamedTuple):
    """A cloth at rest, or at the limit of steps.

    Attributes:
        height: f32[rows, columns], over the height that it started from, metres (negative).
        pinned: bool[rows, columns], particles that lie on the surface.
        steps: how many steps it took.
    """

    height: jax.Array
    pinned: jax.Array
    steps: int


class _State(NamedTuple):
    height: jax.Array  # f32[planes * width], all planes with margins, one after the other
    spring: jax.Array  # f32[planes * width], share of a gap that a neighbour moves; < 0 if pinned, 0 if there is none
    before: jax.Array  # f32[planes, length], height one step ago


def drape(
    limit: jax.Array | np.ndarray,
    extent: tuple[int, int],
    moves: tuple[float, float],
    fall: float,
    tolerance: float,
    iterations: int,
) -> Cloth:
    """Let a cloth fall from height 0 onto a surface.

    Args:
        limit: f32[rows, columns], height of the surface below each particle, metres; padded.
        extent: true number of rows and columns.
        moves: share of the gap that a particle moves towards its neighbour, if that is pinned and if it is not.
        fall: metres that gravity adds to a particle's way in each step.
        tolerance: the cloth is at rest when no particle moves as far in a step, metres.
        iterations: limit of steps.

    Returns: Cloth, padded as ``limit``.
    """
    rows, columns = extent
    pitch = columns + _PLANES + (5 - columns) % _PLANES
    length = padded_length(-(-rows * pitch // _PLANES))
    if length > _CHUNK:
        length = -(-length // _CHUNK) * _CHUNK
    margin = padded_length(2 * (pitch + 1) // _PLANES + 2)
    geometry = np.asarray([rows, columns, pitch], np.int32)
    numbers = np.asarray([*moves, fall], np.float32)
    sizes = {"length": length, "margin": margin}
    state, surface = _unfold(jnp.asarray(limit), geometry, numbers, **sizes)
    epoch = max(_EPOCH, (columns + 5 * rows) // (2 * _PLANES))
    done, resting = 0, False
    while done < iterations and not resting:
        start, steps = state, min(epoch, iterations - done)
        state, needed = _simulate(start, surface, geometry, numbers, np.float32(tolerance), np.int32(steps), **sizes)
        taken, resting = int(needed[0]), bool(needed[1])
        if taken < steps:  # parts of the grid are ahead of the step at which all were at rest
            state, _ = _simulate(start, surface, geometry, numbers, np.float32(0), np.int32(taken), **sizes)
        done += taken
    height, pinned = _fold(state, geometry, shape=np.shape(limit), **sizes)
    return Cloth(height, pinned, done)


@functools.partial(jax.jit, static_argnames=("length", "margin"))
def _unfold(
    limit: jax.Array, geometry: jax.Array, numbers: jax.Array, length: int, margin: int
) -> tuple[_State, jax.Array]:
    """The cloth before the first step, and the surface as planes f32[planes, length]."""
    rows, columns, pitch = geometry
    n = _PLANES * jnp.arange(length, dtype=jnp.int32) + jnp.arange(_PLANES, dtype=jnp.int32)[:, None]
    y, x = n // pitch, n % pitch
    live = (y < rows) & (x < columns)
    surface = limit[jnp.minimum(y, limit.shape[0] - 1), jnp.minimum(x, limit.shape[1] - 1)]
    spring = jnp.pad(jnp.where(live, numbers[1], 0), ((0, 0), (margin, margin))).reshape(-1)
    return _State(jnp.zeros_like(spring), spring, jnp.zeros_like(surface)), surface


@functools.partial(jax.jit, static_argnames=("shape", "length", "margin"))
def _fold(
    state: _State, geometry: jax.Array, shape: tuple[int, int], length: int, margin: int
) -> tuple[jax.Array, jax.Array]:
    """Heights and pins as grids; zero and False in the padding."""
    rows, columns, pitch = geometry
    y, x = (lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(2))
    n = y * pitch + x
    at = (n % _PLANES) * (length + 2 * margin) + margin + n // _PLANES
    live = (y < rows) & (x < columns)
    return jnp.where(live, state.height[at], 0), live & (state.spring[at] < 0)


@functools.partial(jax.jit, static_argnames=("length", "margin"))
def _simulate(
    start: _State,
    surface: jax.Array,
    geometry: jax.Array,
    numbers: jax.Array,
    tolerance: jax.Array,
    iterations: jax.Array,
    length: int,
    margin: int,
) -> tuple[_State, tuple[jax.Array, jax.Array]]:
    """The cloth after so many ``iterations``, or more if fewer were needed; that number, and whether it is at rest."""
    rows, columns, pitch = geometry
    pinned_move, _, fall = numbers
    chunk = min(length, _CHUNK)
    reach = jnp.asarray(_SPRINGS, jnp.int32) @ jnp.stack([jnp.ones_like(pitch), pitch])
    place = jnp.arange(length, dtype=jnp.int32)
    delay = place - (pitch - 5) // _PLANES * ((_PLANES * place + _PLANES - 1) // pitch)  # rounds behind the first
    last = (columns - 1 + 5 * (rows - 1)) // _PLANES

    def part(a: jax.Array, plane: jax.Array, first: jax.Array) -> jax.Array:
        return lax.dynamic_slice(a, (plane * (length + 2 * margin) + margin + first,), (chunk,))

    def with_part(a: jax.Array, values: jax.Array, plane: jax.Array, first: jax.Array) -> jax.Array:
        return lax.dynamic_update_slice(a, values, (plane * (length + 2 * margin) + margin + first,))

    def turn(
        i: jax.Array, first: jax.Array, now: jax.Array, state: _State, moved: jax.Array
    ) -> tuple[_State, jax.Array]:
        height, spring, before = state
        step = now - lax.dynamic_slice(delay, (first,), (chunk,))
        finished, begins = (step >= 0) & (step < iterations), (step >= -1) & (step < iterations - 1)

        def end_and_begin(most: jax.Array, row: jax.Array) -> tuple[jax.Array, jax.Array]:
            z, c = part(height, i, first), part(spring, i, first)
            old, floor = (lax.dynamic_slice(a, (i, first), (1, chunk))[0] for a in (before, surface))
            free = c > 0
            hit = finished & free & (z < floor)
            landed = jnp.where(hit, floor, z)
            falls = begins & free & ~hit
            new = jnp.where(falls, landed + (1 - _DAMPING) * (landed - old) - fall, landed)
            values = (new, jnp.where(hit, -pinned_move, c), jnp.where(falls, landed, old))
            return jnp.maximum(most, jnp.where(finished & free, jnp.abs(z - old), 0)), lax.select_n(row, *values)

        # A scan writes its results beside what it reads, so that no plane has to be copied.
        most, ended = lax.scan(
            end_and_begin, lax.dynamic_slice(moved, (first,), (chunk,)), jnp.arange(3, dtype=jnp.int32)
        )
        moved = lax.dynamic_update_slice(moved, most, (first,))
        height, spring = with_part(height, ended[0], i, first), with_part(spring, ended[1], i, first)
        before = lax.dynamic_update_slice(before, ended[2][None], (i, first))
        return _State(height, spring, before), moved

    def pull_all(i: jax.Array, first: jax.Array, now: jax.Array, state: _State) -> _State:
        height, spring, before = state
        r = (i + _LEAD) % _PLANES
        step = now + (i + _LEAD) // _PLANES - lax.dynamic_slice(delay, (first,), (chunk,))
        own = jnp.where((step >= 0) & (step < iterations), part(spring, r, first), 0)
        free, share = (own > 0).astype(jnp.float32), jnp.abs(own)

        def pull(z: jax.Array, n: jax.Array) -> tuple[jax.Array, jax.Array]:
            plane, shifted = (r + n) % _PLANES, first + (r + n) // _PLANES
            q, other = part(height, plane, shifted), part(spring, plane, shifted)
            gap = q - z
            return z + free * jnp.abs(other) * gap, q - jnp.where(other > 0, share, 0) * gap

        z, pulled = lax.scan(pull, part(height, r, first), reach)
        for k in range(len(_SPRINGS)):
            n = r + reach[k]
            height = with_part(height, pulled[k], n % _PLANES, first + n // _PLANES)
        return _State(with_part(height, z, r, first), spring, before)

    def unfinished(carry: tuple[Any, ...]) -> jax.Array:
        return ~carry[3] & (carry[1] < iterations + last)

    def advance(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        state, now, farthest, _ = carry
        southern = jnp.maximum((_PLANES * (now + 1 - iterations) - columns) // 5, 0)  # rows with particles in motion
        northern = jnp.clip(5 * (now + 2), 0, rows)
        chunks = (
            southern * pitch // _PLANES // chunk,
            jnp.minimum(northern * pitch // _PLANES, length - 1) // chunk + 1,
        )

        def both(i: jax.Array, carry: tuple[_State, jax.Array]) -> tuple[_State, jax.Array]:
            carry = lax.fori_loop(*chunks, lambda c, s: turn(i, c * chunk, now, *s), carry)
            state = lax.fori_loop(*chunks, lambda c, s: pull_all(i, c * chunk, now, s), carry[0])
            return state, carry[1]

        state, moved = lax.fori_loop(jnp.int32(0), jnp.int32(_PLANES), both, (state, jnp.zeros(length, jnp.float32)))
        farthest = farthest.at[(now - delay) % length].max(moved)
        complete = (now - last) % length
        most = farthest[complete]
        return state, now + 1, farthest.at[complete].set(0), (most > 0) & (most < tolerance)

    carry = (start, jnp.int32(-1), jnp.zeros(length, jnp.float32), jnp.bool_(False))
    state, now, _, resting = lax.while_loop(unfinished, advance, carry)
    return state, (now - last, resting)


@jax.jit
def fill_along_lines(z: jax.Array, known: jax.Array, inside: jax.Array) -> jax.Array:
    """Give every unknown node the value of the next known one in its row or column.

    The next to the right is taken, else to the left, else below, else above; where row and column are empty, the nearest
    known node. As in the program of Zhang et al. (2016).

    Args: z f32, known bool, inside bool (nodes that exist), each [rows, columns].
    Returns: f32[rows, columns].
    """
    known = known & inside
    filled = jnp.where(known, z, 0)
    done = known
    for axis, reverse in ((1, True), (1, False), (0, False), (0, True)):
        size = z.shape[axis]
        place = lax.broadcasted_iota(jnp.int32, z.shape, axis)
        if reverse:
            source = lax.cummin(jnp.where(known, place, size), axis=axis, reverse=True)
        else:
            source = lax.cummax(jnp.where(known, place, -1), axis=axis)
        found = (source >= 0) & (source < size)
        value = jnp.take_along_axis(z, jnp.clip(source, 0, size - 1), axis=axis)
        filled = jnp.where(~done & found, value, filled)
        done |= found
    return fill_nearest(filled, done & inside, inside)
