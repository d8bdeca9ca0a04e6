"""Removing noise from potential seeds on their triangulation (Chen et al. 2023, Sec. 2.3)."""

from __future__ import annotations

import numpy as np

from ..engines.neighbours import groups
from ..engines.tin.reference import TRIANGULATIONS
from ..engines.tin.triangulation import triangulated

NARROW, STEEP = 30.0, 60.0
"""Degrees: a facet with a smaller angle, in 3-D, is narrow; one of more slope is steep."""
_RAISED = 2 / 3


def clustered_seeds(
    xyz: np.ndarray, *, long_edge: float, raised: float, workers: int | None = None, triangulation: str = "own"
) -> np.ndarray:
    """bool[s]: the potential seeds that are ground, by the facets of their Delaunay triangulation.

    1. The highest vertices of a facet with a long edge are noise.
    2. Facets with such a vertex, and facets that are both narrow and steep (as between a roof and the ground beside it),
       separate; the others form clusters with the neighbours that they share an edge with (flood fill).
    3. Seeds are the vertices of ground clusters. A vertex in no cluster at all, such as a lone high point, is noise,
       unless there is no cluster: then all vertices but those of step 1 are kept.

    Args:
        xyz: f32[s, 3], local metres, at positions of their own, in canonical order.
        long_edge: metres, in 3-D.
        raised: metres. A cluster is raised if the ground drops by more than this over at least two thirds of its perimeter,
            the border of the network included in the perimeter. The largest cluster never is.
        triangulation: of :data:`jaxfilter.engines.tin.reference.TRIANGULATIONS`.

    Fewer than four seeds, or seeds on one line, are all kept.
    """
    s = len(xyz)
    xy = xyz[:, :2].astype(np.float64)
    if s < 4 or np.linalg.matrix_rank(xy - xy[0], tol=1e-3) < 2:
        return np.ones(s, bool)
    facet, beside = triangulated(xyz, workers, TRIANGULATIONS[triangulation]).facets()
    corner = xyz[facet]
    z = corner[:, :, 2]
    edge = np.roll(corner, -1, axis=1) - np.roll(corner, 1, axis=1)  # edge k lies opposite vertex k
    square = (edge.astype(np.float64) ** 2).sum(axis=2)
    noise = np.zeros(s, bool)
    long_facet = np.flatnonzero(square.max(axis=1) > long_edge**2)
    noise[facet[long_facet][z[long_facet] == z[long_facet].max(axis=1, keepdims=True)]] = True
    a, b, c = np.sort(square, axis=1).T
    cosine = (b + c - a) / (2 * np.sqrt(np.maximum(b * c, 1e-12)))  # of the smallest angle, opposite the shortest edge
    narrow = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))) < NARROW
    cut = narrow & (_slope(edge[:, 0], edge[:, 1]) > STEEP)
    separates = noise[facet].any(axis=1) | cut
    row, side = np.nonzero((beside >= 0) & ~separates[beside] & ~separates[:, None])
    cluster = groups(row, beside[row, side], len(facet))
    cluster[separates] = -1
    inner = np.flatnonzero(~separates)
    if len(inner) == 0:
        return ~noise
    size = np.bincount(cluster[inner], minlength=cluster.max() + 1)
    good = ~_raised(corner, beside, cluster, len(size), raised) & (size > 0)
    good[size.argmax()] = True
    keep = np.zeros(s, bool)
    keep[facet[inner[good[cluster[inner]]]]] = True
    return keep


def _slope(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """f64[t], degrees: slope of the planes spanned by f32[t, 3] and f32[t, 3]."""
    n = np.cross(u.astype(np.float64), v.astype(np.float64))
    return np.degrees(np.arctan2(np.hypot(n[:, 0], n[:, 1]), np.abs(n[:, 2])))


def _raised(corner: np.ndarray, beside: np.ndarray, cluster: np.ndarray, count: int, raised: float) -> np.ndarray:
    """bool[count]: clusters of which at least two thirds of the perimeter border on facets that fall by more than ``raised``.

    ``corner``: f32[t, 3, 3]; ``beside``: i32[t, 3]; ``cluster``: i32[t], -1 for facets that separate.
    """
    facet, side = np.nonzero((cluster[:, None] >= 0) & ((beside < 0) | (cluster[beside] != cluster[:, None])))
    one, two = corner[facet, (side + 1) % 3], corner[facet, (side + 2) % 3]
    length = np.hypot(*(one - two)[:, :2].T.astype(np.float64))
    beyond = beside[facet, side]
    lowest = corner[beyond, :, 2].min(axis=1)
    falls = (beyond >= 0) & (np.minimum(one[:, 2], two[:, 2]) - lowest > raised)
    perimeter = np.bincount(cluster[facet], weights=length, minlength=count)
    return np.bincount(cluster[facet], weights=length * falls, minlength=count) >= _RAISED * perimeter
