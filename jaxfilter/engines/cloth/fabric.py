"""What the cloth of Zhang et al. (2016) is made of, for the programs that let it fall."""

from __future__ import annotations

from typing import Any, NamedTuple

KEPT = 0.99  # of a particle's speed, from one step to the next
_RING = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (1, -1), (1, 0), (0, 1), (1, 1))
SPRINGS = _RING + tuple((2 * dx, 2 * dy) for dx, dy in _RING)
"""Columns and rows from a particle to those that its springs hold, in the order in which they act."""


class Cloth(NamedTuple):
    """A cloth at rest, or at the limit of steps; NumPy arrays or JAX's.

    Attributes:
        height: f32[rows, columns], over the height that it started from, metres (negative).
        pinned: bool[rows, columns], particles that lie on the surface.
        steps: how many steps it took.
    """

    height: Any
    pinned: Any
    steps: Any
