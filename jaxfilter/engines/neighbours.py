"""Neighbour queries by KD-tree. SciPy is imported when it is first needed: methods on grids mostly do without."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_BATCH, _ENTRIES = 1 << 18, 1 << 22
"""Points that ask a KD-tree at a time, and neighbours that they get together."""


def tree_of(xyz: np.ndarray) -> cKDTree:
    """KD-tree of f32[m, d], split at midpoints: quick to build, and no slower to ask for evenly spread points."""
    from scipy.spatial import cKDTree

    return cKDTree(xyz, balanced_tree=False, compact_nodes=False)


def nearest(
    tree: cKDTree, xyz: np.ndarray, k: int, radius: float, workers: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """The ``k`` nearest of the tree to each of ``xyz`` [q, d]: distances f64[q, k] (+inf: none), indices i64[q, k].

    Neighbours at a distance of ``radius`` count; the query point is among them if it is in the tree.
    """
    bound = np.nextafter(radius, np.inf)  # SciPy returns neighbours nearer than the bound
    distance, index = tree.query(xyz, k=np.arange(1, k + 1), distance_upper_bound=bound, workers=workers or -1)
    return distance, index


def batches(rows: np.ndarray, neighbours: int) -> list[np.ndarray]:
    """Parts of rows that ask for so many neighbours at a time as there is room for."""
    return np.array_split(rows, len(rows) // max(1, min(_BATCH, _ENTRIES // neighbours)) + 1)


def groups(one: np.ndarray, other: np.ndarray, n: int) -> np.ndarray:
    """i32[n]: the connected component of each of ``n`` nodes, by links i[l] - i[l]; numbered as they appear."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(one), bool), (one, other)), (n, n))
    found: np.ndarray = connected_components(links, directed=False)[1]
    return found


def touching(key: np.ndarray, wide: int) -> tuple[np.ndarray, np.ndarray]:
    """i64[l], i64[l]: pairs of cells that touch, at a corner too.

    ``key``: i64[n], ascending: row times ``wide`` plus column; between the last cell of a row and the first of the next one there
    is room for another column at least.
    """
    pairs = []
    for step in (1, wide - 1, wide, wide + 1):
        other = np.searchsorted(key, key + step).clip(max=max(len(key) - 1, 0))
        one = np.flatnonzero(key[other] == key + step)
        pairs.append((one, other[one]))
    ones, others = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return ones, others
