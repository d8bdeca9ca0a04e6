"""Compiled steps of :mod:`jaxfilter.engines.cloth.wavefront`: gravity, springs and pins, for a cloth laid out in lines.

All arrays of the cloth are f32[lines, places]: ``height`` and ``before`` (one step ago), metres; ``spring``, the share of a
gap that a neighbour moves, < 0 if the particle is pinned, 0 where there is none; ``surface``, what it falls onto. ``ends``,
i64[lines, 2]: the first and the last place of each line with particles; ``reach``, i64[springs], places from a particle to
its neighbours; ``numbers``, f32[3]: share of a gap that is moved by the pinned, metres of fall per step, tolerance.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .fabric import KEPT

BLOCK = 13
"""Lines that are moved at a time: more than a spring reaches (12 lines and 2 places)."""
MOVED, FAR = np.int32(1), np.int32(2)
"""Flags: a particle moved in a step; one moved as far as the tolerance."""
_KEPT = np.float32(KEPT)


@compiled
def sweep(height, before, spring, surface, ends, reach, numbers, motion, step0, step1, time0, time1):
    """Move the cloth by some of the steps that ``motion``, i32[steps], has room for, and say in it what moved in each.

    A step is two blocks behind the step before. A block ends a step, and begins the next one, just before springs reach it.
    """
    steps, blocks = len(motion), -(-len(height) // BLOCK)
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
    for line in range(block * BLOCK, min(block * BLOCK + BLOCK, len(height))):
        first, last = ends[line]
        z, old, move, floor = (
            height[line, first:last],
            before[line, first:last],
            spring[line, first:last],
            surface[line, first:last],
        )
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
    for line in range(block * BLOCK, block * BLOCK + BLOCK):
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
