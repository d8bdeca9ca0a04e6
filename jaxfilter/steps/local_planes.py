"""Planes fitted to neighbouring seeds and moved down to the lowest of them (Zhao et al. 2016)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ..engines.plane_sums import slopes_by_sums

TRANSLATIONS = ("lowest", "none")
"""Where the plane is moved, without turning: down to the lowest seed of the neighbourhood, or nowhere."""
_DEGENERATE = 1e-6  # share of the squared spread below which positions count as lying on a line
_TIES = 32  # on a lattice fewer seeds than this are as near as the last one
_PAIRS = 1 << 19  # seeds times neighbours at a time


def over_local_planes(xyz: np.ndarray, k: int, translation: str = "lowest", workers: int | None = None) -> np.ndarray:
    """f32[s]: metres, along the normal, of each seed over the plane of its neighbourhood.

    A plane z = a x + b y + c is fitted by least squares to the ``k`` seeds nearest in x and y, the seed itself included, and
    those as near as the last of them. Fewer than ``k`` seeds are all taken. With fewer than three, or all on one line, the
    plane is level.

    Args:
        xyz: f32[s, 3], local metres, at positions of their own.
        translation: one of :data:`TRANSLATIONS`.
    """
    over = np.empty(len(xyz), np.float32)
    if len(xyz) == 0:
        return over
    xyz, k, asked = xyz.astype(np.float64), min(k, len(xyz)), min(k + _TIES, len(xyz))
    tree, step = cKDTree(xyz[:, :2]), max(1, _PAIRS // asked)
    for first in range(0, len(xyz), step):
        part = slice(first, first + step)
        near = tree.query(xyz[part, :2], np.arange(1, asked + 1), workers=workers or -1)[1]
        x, y, z = np.moveaxis(xyz[near] - xyz[part, None], 2, 0)
        square = x * x + y * y
        taken = square <= square[:, k - 1, None]
        x, y, count = x * taken, y * taken, taken.sum(axis=1)
        # sums are exact, since coordinates are multiples of a quantum: the order of the seeds decides nothing
        sx, sy, sz = x.sum(axis=1), y.sum(axis=1), (z * taken).sum(axis=1)
        xx, xy, yy, xz, yz = ((u * v).sum(axis=1) for u, v in ((x, x), (x, y), (y, y), (x, z), (y, z)))
        xx, xy, yy = xx - sx * sx / count, xy - sx * sy / count, yy - sy * sy / count
        xz, yz = xz - sx * sz / count, yz - sy * sz / count
        along_x, along_y, determinant = slopes_by_sums(xx, xy, yy, xz, yz)
        divisor = np.where((count >= 3) & (determinant > _DEGENERATE * (xx + yy) ** 2), determinant, np.inf)
        a, b = along_x / divisor, along_y / divisor
        level = (sz - a * sx - b * sy) / count  # of the plane at the seed, above the seed
        if translation == "lowest":
            residual = z - level[:, None] - a[:, None] * x - b[:, None] * y
            level += np.where(taken, residual, np.inf).min(axis=1)
        over[part] = -level / np.sqrt(1 + a * a + b * b)
    return over
