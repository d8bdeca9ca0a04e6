"""Filling the holes of a grid: by a membrane of springs, or with the nearest known cell.

The membrane joins every hole to its four neighbours by equal springs, known cells being fixed; at rest it satisfies
Laplace's equation in the holes, with a free border. This is the "springs" metaphor of J. D'Errico's inpaint_nans
(MATLAB Central 4551, 2004), which SMRF uses. It is solved by conjugate gradients, preconditioned by one V-cycle of
multigrid on square aggregates (Trottenberg, Oosterlee & Schueller, Multigrid, 2001).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

_COARSEST = 96, 24  # rows and columns at which coarsening stops, for one grid and for many
_FACTOR = 2  # cells of one level along the side of a cell of the next; 1 along an axis that is a single cell long
_DAMPING = 0.8  # of the Jacobi smoother
_SWEEPS = 2  # of it before and after a correction
_COARSE_SWEEPS = 150, 40  # on the last level; for one grid cheaper than to compile two more levels
_BLOCK = 32, 128  # cells of a grid that are searched together for a nearest one
_FARTHEST = 2**15 - 1  # cells to the nearest one in a column; farther counts as this far, whose square is in 32 bits
_STEPS = ((0, 1), (0, -1), (1, 0), (-1, 0))


_Factors = tuple[int, int]
"""Cells of one level along the rows and columns of a cell of the next."""


class Membrane(NamedTuple):
    """A filled grid, or several.

    Attributes:
        z: f32[rows, columns], or f32[rows, columns, grids].
        error: f32[] or f32[grids], estimate of the largest remaining error in the holes, in the unit of z.
        rounds: i32[], steps of conjugate gradients taken.

    >>> from jaxfilter.engines.grid import inpaint
    >>> z = jnp.array([[1.0, 0.0, 3.0]])
    >>> known = jnp.array([[True, False, True]])
    >>> filled = inpaint.fill_membrane(z, known, jnp.ones((1, 3), bool))
    >>> float(filled.error) < 1e-3, int(filled.rounds) > 0
    (True, True)
    """

    z: jax.Array
    error: jax.Array
    rounds: jax.Array


class _Springs(NamedTuple):
    """Stiffness of the springs of one level, f32[rows, columns] or f32[rows, columns, grids] each; zero outside the holes.

    On the finest level all springs are alike, so that sums of neighbours do without ``right`` and ``up``.
    """

    right: jax.Array | None  # between a hole and the hole to its right
    up: jax.Array | None  # between a hole and the hole in the next row
    total: jax.Array  # of all springs at a hole, those to known cells included


def _shifted(a: jax.Array, rows: int, columns: int) -> jax.Array:
    """a[i + rows, j + columns]; zero beyond the border."""
    others = ((0, 0, 0),) * (a.ndim - 2)
    return lax.pad(a, jnp.zeros((), a.dtype), ((-rows, rows, 0), (-columns, columns, 0), *others))


def _block_sums(a: jax.Array, axis: int, factor: int) -> jax.Array:
    return sum(lax.slice_in_dim(a, k, None, factor, axis) for k in range(factor))  # type: ignore[return-value]


def _pool(a: jax.Array, factors: _Factors) -> jax.Array:
    """Sums over the cells that make up one of the next level."""
    return _block_sums(lax.optimization_barrier(_block_sums(a, 0, factors[0])), 1, factors[1])


def _spread(a: jax.Array, factors: _Factors) -> jax.Array:
    """The transpose of :func:`_pool`: every cell's value for the cells that it is made of."""
    return jnp.repeat(jnp.repeat(a, factors[1], axis=1), factors[0], axis=0)


def _springs(hole: jax.Array, inside: jax.Array) -> _Springs:
    def count(cells: jax.Array) -> jax.Array:
        return (hole & cells).astype(jnp.float32)

    total = jnp.stack([count(_shifted(inside, *s)) for s in _STEPS]).sum(axis=0)
    return _Springs(count(_shifted(hole, 0, 1)), count(_shifted(hole, 1, 0)), total)


def _coarser(springs: _Springs, factors: _Factors) -> _Springs:
    """Springs of the next level: those that cross between its cells, weakened in proportion to their new length."""
    right, up, total = springs
    assert right is not None and up is not None
    to_holes = right + _shifted(right, 0, -1) + up + _shifted(up, -1, 0)
    anchors, (tall, wide) = _pool(total - to_holes, factors), factors
    right = _block_sums(right[:, wide - 1 :: wide], 0, tall) / wide
    up = _block_sums(up[tall - 1 :: tall], 1, wide) / tall
    return _Springs(right, up, anchors + right + _shifted(right, 0, -1) + up + _shifted(up, -1, 0))


def _neighbours(x: jax.Array) -> jax.Array:
    """Sum of the four neighbours of each cell; zero beyond the border."""
    wide = jnp.pad(x, [(1, 1), (1, 1), *[(0, 0)] * (x.ndim - 2)])
    return wide[1:-1, 2:] + wide[1:-1, :-2] + wide[2:, 1:-1] + wide[:-2, 1:-1]


def _forces(springs: _Springs, x: jax.Array) -> jax.Array:
    """The stiffness matrix times x; x is zero outside the holes."""
    right, up, total = springs
    if right is None or up is None:
        return jnp.where(total > 0, total * x - _neighbours(x), 0)
    neighbours = (
        right * _shifted(x, 0, 1) + _shifted(right * x, 0, -1) + up * _shifted(x, 1, 0) + _shifted(up * x, -1, 0)
    )
    return total * x - neighbours


def _v_cycle(levels: list[_Springs], inverses: list[jax.Array], plan: list[_Factors], force: jax.Array) -> jax.Array:
    """Approximate solution of ``forces(x) = force``; linear and symmetric in ``force``."""
    springs, inverse = levels[0], inverses[0]

    def smooth(_: int, x: jax.Array) -> jax.Array:
        if springs.right is None:  # the same with fewer reads
            return jnp.where(inverse > 0, x + _DAMPING * ((force + _neighbours(x)) * inverse - x), 0)
        return x + _DAMPING * inverse * (force - _forces(springs, x))

    if len(levels) == 1:
        return lax.fori_loop(0, _COARSE_SWEEPS[force.ndim - 2], smooth, jnp.zeros_like(force))
    x = lax.fori_loop(1, _SWEEPS, smooth, _DAMPING * inverse * force)
    rest = lax.optimization_barrier(force - _forces(springs, x))
    correction = _spread(_v_cycle(levels[1:], inverses[1:], plan[1:], _pool(rest, plan[0])), plan[0])
    return lax.fori_loop(0, _SWEEPS, smooth, x + jnp.where(inverse > 0, correction, 0))


def _first_guess(z: jax.Array, known: jax.Array, plan: list[_Factors]) -> jax.Array:
    """Known cells averaged over ever larger blocks, then spread back into the holes ("pull-push")."""
    sums, counts = [jnp.where(known, z, 0)], [known.astype(z.dtype)]
    for factors in plan:
        sums.append(_pool(sums[-1], factors))
        counts.append(_pool(counts[-1], factors))
    mean = sums[-1].sum(axis=(0, 1)) / jnp.maximum(counts[-1].sum(axis=(0, 1)), 1)
    guess = jnp.broadcast_to(mean, sums[-1].shape)
    for level in range(len(plan), -1, -1):
        if level < len(plan):
            guess = _spread(guess, plan[level])
        guess = jnp.where(counts[level] > 0, sums[level] / jnp.maximum(counts[level], 1), guess)
    return guess


def _dot(a: jax.Array, b: jax.Array) -> jax.Array:
    a, b = lax.optimization_barrier((a, b))  # a reduction fused with stencils would run on one core
    return jnp.vdot(a, b, precision="highest") if a.ndim == 2 else (a * b).sum(axis=(0, 1))


@functools.partial(jax.jit, static_argnames="max_rounds")
def fill_membrane(
    z: jax.Array,
    known: jax.Array,
    inside: jax.Array,
    tolerance: jax.Array | float = 1e-3,
    max_rounds: int = 100,
) -> Membrane:
    """Fill holes with the membrane through the known cells.

    ``vmap`` fills several grids at once. Cells that are next to each other in memory then belong to different grids, and are
    computed in one instruction; a grid that is done stays as it is until the others are.

    Args:
        z: f32[rows, columns]; values of unknown cells are ignored but must not be NaN.
        known: bool[rows, columns], the cells that are kept.
        inside: bool[rows, columns], the cells that exist; the membrane ends at their border, without force. Every
            connected part of them needs a known cell.
        tolerance: stop when the estimated error of every cell is below this, in the unit of z. The estimate is the last
            correction by the preconditioner; the true error can be several times as large.
        max_rounds: limit of steps.

    Returns: Membrane; outside cells are zero.

    >>> from jaxfilter.engines.grid import inpaint
    >>> z = jnp.array([[1.0, 0.0, 3.0]])
    >>> known = jnp.array([[True, False, True]])
    >>> inpaint.fill_membrane(z, known, jnp.ones((1, 3), bool)).z.round().tolist()
    [[1.0, 2.0, 3.0]]
    """

    @custom_vmap
    def fill(z: jax.Array, known: jax.Array, inside: jax.Array, tolerance: jax.Array) -> tuple[jax.Array, ...]:
        return tuple(_fill(z, known, inside, tolerance, max_rounds))

    @fill.def_vmap
    def fill_many(grids: int, batched: Sequence[bool], *arguments: jax.Array) -> tuple[Any, Any]:
        z, known, inside, tolerance = (
            jnp.moveaxis(a, 0, -1) if on else a for a, on in zip(arguments, batched, strict=True)
        )
        if not batched[1]:
            known = jnp.broadcast_to(known[..., None], (*known.shape, grids))
        filled = _fill(z, known, inside, tolerance, max_rounds)
        return (jnp.moveaxis(filled.z, -1, 0), filled.error, filled.rounds), (True, True, False)

    return Membrane(*fill(z, known, inside, jnp.asarray(tolerance, z.dtype)))


def _fill(z: jax.Array, known: jax.Array, inside: jax.Array, tolerance: jax.Array, max_rounds: int) -> Membrane:
    """:func:`fill_membrane`, of one grid, or of several in the third axis of ``known``, and of other arguments or not."""
    (rows, columns), many = known.shape[:2], known.ndim - 2
    depth = max(0, math.ceil(math.log(max(rows, columns) / _COARSEST[many], _FACTOR)))
    halvings = [min(depth, math.ceil(math.log(n, _FACTOR))) for n in (rows, columns)]  # until one cell is left
    plan = [(_FACTOR if k < halvings[0] else 1, _FACTOR if k < halvings[1] else 1) for k in range(depth)]
    margin = [(0, -n % _FACTOR**k) for n, k in zip((rows, columns), halvings, strict=True)]

    def prepared(a: jax.Array) -> jax.Array:
        a = jnp.pad(a, [*margin, *[(0, 0)] * (a.ndim - 2)])
        return a.reshape(*a.shape, *(1,) * (known.ndim - a.ndim))

    z, inside, known = prepared(z), prepared(inside), prepared(known)
    known = known & inside
    hole = inside & ~known

    start = jnp.where(hole, _first_guess(z, known, plan), jnp.where(known, z, 0))
    levels = [_springs(hole, inside)]
    for factors in plan:
        levels.append(_coarser(levels[-1], factors))
    levels[0] = levels[0]._replace(right=None, up=None)
    inverses = [jnp.where(s.total > 0, 1 / jnp.maximum(s.total, 1e-6), 0) for s in levels]
    levels, inverses = lax.optimization_barrier((levels, inverses))

    # The unknown is the correction to the first guess; differences of neighbours keep the forces exact in float32.
    force = jnp.zeros_like(start)
    for s in _STEPS:
        force += jnp.where(hole & _shifted(inside, *s), _shifted(start, *s) - start, 0)

    def unfinished(state: tuple[jax.Array, ...]) -> jax.Array:
        *_, error, rounds = state
        return jnp.any(error > tolerance) & (rounds < max_rounds)

    def each(of_grid: jax.Array) -> jax.Array:
        return of_grid[None, None] if many else of_grid

    def advance(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        x, force, direction, product, before, rounds = state
        open_ = before > tolerance  # a grid that is done stays as it is until the others are
        step = lax.optimization_barrier(_v_cycle(levels, inverses, plan, force))
        new_product = _dot(force, step)
        direction = lax.optimization_barrier(step + each(jnp.where(open_, new_product / product, 0)) * direction)
        pull = lax.optimization_barrier(_forces(levels[0], direction))
        length = new_product / jnp.maximum(_dot(direction, pull), jnp.finfo(z.dtype).tiny)
        length = jnp.where(open_, length, 0)
        error = jnp.where(open_, jnp.abs(step).max(axis=(0, 1)), before)
        return x + each(length) * direction, force - each(length) * pull, direction, new_product, error, rounds + 1

    zero, infinite = jnp.zeros_like(start), jnp.full(start.shape[2:], jnp.inf, start.dtype)
    state: tuple[jax.Array, ...] = (zero, force, zero, infinite, infinite, jnp.int32(0))
    x, *_, error, rounds = lax.while_loop(unfinished, advance, state)
    return Membrane((start + x)[:rows, :columns], error, rounds)


def running(
    pick: Callable[[jax.Array, jax.Array], jax.Array], a: jax.Array, axis: int = 0, *, reverse: bool = False
) -> jax.Array:
    """``pick`` (``jnp.minimum``, ``jnp.maximum``) of each cell and all before it along an axis, or all after it.

    ``a`` is of any type, [rows, columns]. On a processor 20 times as fast as ``lax.cummax`` along the same axis.
    """

    def step(last: jax.Array, line: jax.Array) -> tuple[jax.Array, jax.Array]:
        last = pick(last, line)
        return last, last

    lines = jnp.moveaxis(a, axis, 0)
    return jnp.moveaxis(lax.scan(step, lines[-1 if reverse else 0], lines, reverse=reverse)[1], 0, axis)


@jax.jit
def fill_nearest(z: jax.Array, known: jax.Array, inside: jax.Array) -> jax.Array:
    """Give every hole the value of a nearest known cell, by Euclidean distance between cell centres.

    The exact two-pass distance transform: nearest known cell in the column, then along the row out to the largest
    distance found, block by block, so that only blocks in wide voids look far. Of equally near cells the one with the
    smaller column offset is taken (left before right), then the one in the lower row.

    Args: z f32, known bool, inside bool, each [rows, columns], as for :func:`fill_membrane`.
    Returns: f32[rows, columns]; unknown cells are unchanged if there is no known cell, outside cells always.

    >>> from jaxfilter.engines.grid import inpaint
    >>> z = jnp.array([[1.0, 0.0, 3.0]])
    >>> known = jnp.array([[True, False, True]])
    >>> inpaint.fill_nearest(z, known, jnp.ones((1, 3), bool)).tolist()
    [[1.0, 1.0, 3.0]]
    """
    known = known & inside
    rows, columns = z.shape
    far = rows + columns
    row, column = (lax.broadcasted_iota(jnp.int32, z.shape, axis) for axis in range(2))
    below = running(jnp.maximum, jnp.where(known, row, -far))
    above = running(jnp.minimum, jnp.where(known, row, rows + far), reverse=True)
    nearest_row = jnp.where(row - below <= above - row, below, above)
    gap = jnp.minimum(jnp.abs(nearest_row - row), min(far, _FARTHEST))

    tall, wide = _BLOCK if jax.default_backend() == "cpu" else z.shape
    down, across = -(-rows // tall), -(-columns // wide)
    margin = across * wide
    squares = jnp.pad(
        gap * gap,
        ((0, down * tall - rows), (margin, 2 * margin - columns)),
        constant_values=jnp.iinfo(jnp.int32).max // 2,
    )
    wanted = jnp.pad(inside, ((0, down * tall - rows), (0, across * wide - columns)))

    def search(block: jax.Array, found: jax.Array) -> jax.Array:
        corner = block // across * tall, block % across * wide
        asked = lax.dynamic_slice(wanted, corner, (tall, wide))

        def there(offset: jax.Array) -> jax.Array:
            return lax.dynamic_slice(squares, (corner[0], corner[1] + margin + offset), (tall, wide))

        def unfinished(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
            offset, least, _ = state
            return (offset < columns) & jnp.any(asked & (least > offset * offset))

        def look(state: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
            offset, least, at = state
            for side in (-offset, offset):
                distance = there(side) + offset * offset
                closer = distance < least
                least, at = jnp.where(closer, distance, least), jnp.where(closer, side, at)
            return offset + 1, least, at

        start = (jnp.int32(1), there(jnp.int32(0)), jnp.zeros((tall, wide), jnp.int32))
        return lax.dynamic_update_slice(found, lax.while_loop(unfinished, look, start)[2], corner)

    offsets = lax.fori_loop(jnp.int32(0), down * across, search, jnp.zeros(wanted.shape, jnp.int32))
    there = column + offsets[:rows, :columns]
    value = z[jnp.clip(nearest_row[row, there], 0, rows - 1), there]
    return jnp.where(inside & ~known & known.any(), value, z)
