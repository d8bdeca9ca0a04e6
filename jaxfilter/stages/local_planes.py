"""Planes fitted to neighbouring seeds and moved down to the lowest of them (Zhao et al. 2016)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from ..host.neighbours import nearest, tree_of
from ..ops.planes import fit_planes, plane_residuals

TRANSLATIONS = ("lowest", "none")
"""Where the plane is moved, without turning: down to the lowest seed of the neighbourhood, or nowhere."""
_SEEDS_AT_ONCE = 2048


def over_local_planes(xyz: np.ndarray, k: int, translation: str = "lowest", workers: int | None = None) -> np.ndarray:
    """f32[s]: metres, along the normal, of each seed over the plane of its neighbourhood.

    A plane z = a x + b y + c is fitted to the ``k`` seeds nearest in x and y, the seed itself included, by least squares.
    Fewer than ``k`` seeds are all taken. With fewer than three, or all on one line, the plane is level.

    Args:
        xyz: f32[s, 3], local metres, at positions of their own.
        translation: one of :data:`TRANSLATIONS`.
    """
    s, few = len(xyz), min(k, len(xyz))
    tree = tree_of(xyz[:, :2])
    mask = np.arange(k) < few
    out = np.empty(s, np.float32)
    for start in range(0, s, _SEEDS_AT_ONCE):
        own = xyz[start : start + _SEEDS_AT_ONCE]
        _, index = nearest(tree, own[:, :2], few, np.inf, workers)
        around = np.zeros((_SEEDS_AT_ONCE, k, 3), np.float32)
        around[: len(own), :few] = np.take(xyz, index, axis=0)
        centre = np.zeros((_SEEDS_AT_ONCE, 3), np.float32)
        centre[: len(own)] = own
        out[start : start + len(own)] = np.asarray(_over_planes(around, mask, centre, translation == "lowest"))[
            : len(own)
        ]
    return out


@jax.jit
def _over_planes(around: jax.Array, mask: jax.Array, own: jax.Array, lowest: jax.Array) -> jax.Array:
    """f32[B]: residual of f32[B, 3] to the plane through f32[B, k, 3], where ``lowest`` over the lowest of these."""
    mask = jnp.broadcast_to(mask, around.shape[:2])
    planes = fit_planes(around, mask)
    below = jnp.where(mask, plane_residuals(planes, around), jnp.inf).min(axis=1)
    return plane_residuals(planes, own[:, None])[:, 0] - jnp.where(lowest, below, 0)
