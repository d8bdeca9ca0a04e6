"""A cloth of particles that falls onto a surface, one particle after the other, in compiled code.

Particles stand on a grid and move up and down only. In each step gravity moves them (Verlet integration), springs to
the 16 neighbours at one and two nodes, diagonals included, pull them together, and those that are below the surface are
set on it and stay there: W. Zhang et al. (2016), Remote Sens. 8(6), 501, sections 2.2 to 2.4.

The springs of a particle act at once, each on what the one before left, and particles follow each other row by row.
That order stiffens the cloth, and no other order that was tried gives the same ground, so it is kept to the letter; the
memory is laid out so that it can be kept at speed. Particle (x, y) stands at the place

    x w + y (5 w + 1) = w (x + 5 y) + y

of one array, in line x + 5 y of lines that are ``w`` long. ``w`` is a little more than a fifth of a row, or than the number
of rows if that is less: then no place is taken twice. A particle disturbs nothing beyond two nodes, and those nearer than
five nodes to each other are at least ``w`` apart and stand in the order of their turns. So the springs of a whole line act
together, on lines a fixed number of places away, which makes vector instructions of them.

Nothing is disturbed more than 12 lines and 2 places away, so many steps sweep over the array one behind the other, while
what they need is in the cache.

All arrays of the cloth are f32[lines, places]: ``height`` and ``before`` (one step ago), metres; ``spring``, the share of a
gap that a neighbour moves, < 0 if the particle is pinned, 0 where there is none; ``surface``, what it falls onto. ``ends``,
i64[lines, 2]: the first and the last place of each line with particles; ``reach``, i64[springs], places from a particle to
its neighbours; ``numbers``, f32[3]: share of a gap that is moved by the pinned, metres of fall per step, tolerance.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import scipy

from ..compiled import compiled
from ..grid.shapes import segments

BLOCK_LINES = 13
"""Lines that are moved at a time: more than a spring reaches (12 lines and 2 places)."""
MOVED, FAR = np.int32(1), np.int32(2)
"""Flags: a particle moved in a step; one moved as far as the tolerance."""
_KEPT = np.float32(0.99)
"""Of a particle's speed, from one step to the next."""
_SWEEP = 50  # steps that follow each other through the cache
_PARTS = 24  # of a sweep, after which threads wait for each other
_LEAST = 50_000  # particles that are worth a thread
_GROUP = 50  # free particles; smaller groups are not joined to the ground

_RING = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (1, -1), (1, 0), (0, 1), (1, 1))
SPRINGS = _RING + tuple((2 * dx, 2 * dy) for dx, dy in _RING)
"""Columns and rows from a particle to those that its springs hold, in the order in which they act."""


class Cloth(NamedTuple):
    """A cloth at rest, or at the limit of steps.

    Attributes:
        height: f32[rows, columns], over the height that it started from, metres (negative).
        pinned: bool[rows, columns], particles that lie on the surface.
        steps: how many steps it took.
    """

    height: np.ndarray
    pinned: np.ndarray
    steps: int


@compiled
def sweep(height, before, spring, surface, ends, reach, numbers, motion, step0, step1, time0, time1):
    """Move the cloth by some of the steps that ``motion``, i32[steps], has room for, and say in it what moved in each.

    A step is two blocks behind the step before. A block ends a step, and begins the next one, just before springs reach it.
    """
    steps, blocks = len(motion), -(-len(height) // BLOCK_LINES)
    for time in range(time0, time1):
        for step in range(step0, step1):
            block = time - 2 * step
            if 0 <= block < blocks:
                moved = _turn(height, before, spring, surface, ends, block, numbers, step > 0, step < steps)
                if step > 0:
                    motion[step - 1] |= moved
            if 1 <= block < blocks and step < steps:
                _pull(height.reshape(-1), spring.reshape(-1), ends, reach, block - 1)


@compiled(fused=True)
def _turn(height, before, spring, surface, ends, block, numbers, finish, begin):
    """End a step, and begin the next one, for a block of lines. Returns what moved: 0, or MOVED, and FAR."""
    pinned_move, fall, tolerance = numbers
    moved = np.int32(0)
    for line in range(block * BLOCK_LINES, min(block * BLOCK_LINES + BLOCK_LINES, len(height))):
        first, last = ends[line]
        z, old = height[line, first:last], before[line, first:last]
        move, floor = spring[line, first:last], surface[line, first:last]
        for i in range(last - first):
            free = move[i] > 0
            way = abs(z[i] - old[i])
            moved |= np.int32(finish & free & (way > 0)) * MOVED | np.int32(finish & free & (way >= tolerance)) * FAR
            hit = finish & free & (z[i] < floor[i])
            landed = floor[i] if hit else z[i]
            move[i] = -pinned_move if hit else move[i]
            falls = begin & free & (not hit)
            z[i] = landed + _KEPT * (landed - old[i]) - fall if falls else landed
            old[i] = landed if falls else old[i]
    return moved


@compiled(fused=True)
def _pull(height, spring, ends, reach, block):
    """Let all springs of a block of lines act once, in the order of the particles. ``height``, ``spring``: f32[places]."""
    width = len(height) // len(ends)
    for line in range(block * BLOCK_LINES, block * BLOCK_LINES + BLOCK_LINES):
        first, last = ends[line]
        here, size = line * width + first, last - first
        z, move = height[here : here + size], spring[here : here + size]
        for n in range(len(reach)):
            there = here + reach[n]
            other, its_move = height[there : there + size], spring[there : there + size]
            for i in range(size):
                gap = other[i] - z[i]
                to_other = abs(its_move[i]) if move[i] > 0 else np.float32(0)
                to_this = abs(move[i]) if its_move[i] > 0 else np.float32(0)
                z[i] += to_other * gap
                other[i] -= to_this * gap


def drape(
    limit: np.ndarray,
    moves: tuple[float, float],
    fall: float,
    tolerance: float,
    iterations: int,
    workers: int | None = None,
) -> Cloth:
    """Let a cloth fall from height 0 onto a surface.

    Args:
        limit: f32[rows, columns], height of the surface below each particle, metres.
        moves: share of the gap that a particle moves towards its neighbour, if that is pinned and if it is not.
        fall: metres that gravity adds to a particle's way in each step.
        tolerance: the cloth is at rest when no particle moves as far in a step, metres.
        iterations: limit of steps, at least 1.
        workers: threads; None = one per processor. They change nothing but the time.
    """
    rows, columns = limit.shape
    width = min((columns + 4) // 5, rows + 1) + 1
    lines = columns + 5 * (rows - 1) + (rows - 1) // width + 2 * BLOCK_LINES
    height, before, spring, surface = (np.zeros((lines, width), np.float32) for _ in range(4))
    _nodes(surface, limit.shape)[:] = limit
    _nodes(spring, limit.shape)[:] = moves[1]
    exists = spring != 0
    ends = np.where(exists.any(axis=1), [exists.argmax(axis=1), width - exists[:, ::-1].argmax(axis=1)], 0).T.copy()
    reach = np.array(SPRINGS) @ [width, 5 * width + 1]
    numbers = np.asarray([moves[0], fall, tolerance], np.float32)
    threads = min(workers or os.cpu_count() or 1, 1 + limit.size // _LEAST, _SWEEP // 2)

    def after(steps: int) -> np.ndarray:
        """i32[steps]: what moved in each of so many steps of the cloth, which is moved by them.

        Every thread has some of the steps, and is one part of the time behind the thread with the steps before.
        """
        motion = np.zeros(steps, np.int32)
        share = np.linspace(0, steps + 1, threads + 1).astype(int)
        parts = _PARTS if threads > 1 else 1
        time = np.linspace(0, -(-lines // BLOCK_LINES) + 2 * steps, parts + 1).astype(int)

        def run(thread: int, part: int) -> None:
            if 0 <= part < parts:
                sweep(*state, surface, ends, reach, numbers, motion, *share[thread:][:2], *time[part:][:2])

        for part in range(parts + threads - 1):
            list(pool.map(run, range(threads), range(part, part - threads, -1)))
        return motion

    state = height, before, spring
    start = [np.empty_like(a) for a in state]
    done, resting = 0, False
    with ThreadPoolExecutor(threads) as pool:
        while done < iterations and not resting:
            for now, then in zip(state, start, strict=True):
                then[:] = now
            motion = after(min(_SWEEP, iterations - done))
            resting = bool((motion == MOVED).any())
            taken = int(np.argmax(motion == MOVED)) + 1 if resting else len(motion)
            if taken < len(motion):  # the sweep went on after the step at which all were at rest
                for now, then in zip(state, start, strict=True):
                    now[:] = then
                after(taken)
            done += taken
    return Cloth(_nodes(height, limit.shape).copy(), _nodes(spring, limit.shape) < 0, done)


def _nodes(a: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """View of an array [lines, places] as the grid [rows, columns]."""
    size, width = a.itemsize, a.shape[1]
    strides = (size * (5 * width + 1), size * width)
    return np.lib.stride_tricks.as_strided(a[BLOCK_LINES:], shape, strides)


def join_slopes(limit: np.ndarray, pinned: np.ndarray, max_step: float) -> np.ndarray:
    """bool[rows, columns]: free particles that are put on the ground (Zhang et al. 2016, section 2.5).

    The ground grows from particles that lie on it (``pinned``, bool) to free ones beside them (four neighbours) where
    ``limit``, f32[rows, columns], differs by less than ``max_step`` metres, in connected groups of more than 50 free
    particles. What is reached does not depend on the order in which it grows.
    """
    free = ~pinned
    label, _ = scipy.ndimage.label(free)
    open_ = free & (np.bincount(label.ravel()) > _GROUP)[label]
    reached = np.zeros(free.shape, bool)
    for one, two in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        level = np.abs(limit[one] - limit[two]) < np.float32(max_step)
        reached[one] |= level & open_[one] & ~free[two]
        reached[two] |= level & open_[two] & ~free[one]
    group, count = segments(np.where(open_, limit, np.float32(np.nan)), np.float32(max_step), 1.0)
    joined = np.zeros(count + 1, bool)
    joined[group[reached]] = True
    return joined[group]
