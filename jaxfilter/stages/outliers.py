"""Outliers: points that must not become ground seeds. None of them is lost; filters test them again like other points."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..core.errors import ParameterError
from ..core.grid import Grid, grid_over
from ..core.points import Points
from ..host.depressions import Depressions, depressions
from ..host.neighbours import few_neighbours, nearest, tree_of


def radius_outliers(
    xyz: np.ndarray,
    weight: np.ndarray,
    radius: float,
    min_neighbours: int,
    *,
    include_self: bool = False,
    planar: bool = False,
    workers: int | None = None,
) -> np.ndarray:
    """bool[m]: points with fewer than ``min_neighbours`` others within ``radius`` metres (Li et al. 2021, Sec. II-B).

    Args:
        xyz: f32[m, 3], local metres, distinct points in canonical order.
        weight: i32[m], how many points each row stands for; points that coincide are neighbours.
        include_self: count the point itself as well.
        planar: measure distances in x and y only.
    """
    least = min_neighbours - 1 if include_self else min_neighbours
    return few_neighbours(xyz[:, :2] if planar else xyz, weight, radius, least, workers)


def knn_outliers(
    xyz: np.ndarray,
    weight: np.ndarray,
    k: int,
    *,
    deviations: float = 3.0,
    workers: int | None = None,
) -> np.ndarray:
    """bool[m]: points whose elevation is unlike that of their ``k`` nearest neighbours (after Zheng et al. 2024, Sec. 2.1).

    The statistic is the difference between a point's elevation and the mean elevation of its ``k`` nearest neighbours in
    3-D, itself excluded. Outliers exceed its mean over the cloud by more than ``deviations`` standard deviations. The
    paper's own formula compares metres with square metres and cannot be applied as printed.

    Args:
        xyz: f32[m, 3], local metres, distinct points in canonical order.
        weight: i32[m], how many points each row stands for; a point that coincides with k others differs by zero.
    """
    m = len(xyz)
    if m < 2:
        return np.zeros(m, bool)
    k = min(k, m - 1)
    _, index = nearest(tree_of(xyz), xyz, k + 1, np.inf, workers)
    order = np.argsort(index != np.arange(m)[:, None], axis=1, kind="stable")  # the point itself first
    index = np.take_along_axis(index, order, axis=1)
    copies = weight[index].astype(np.int64)
    copies[:, 0] -= 1
    taken = np.diff(np.minimum(np.cumsum(copies, axis=1), k), axis=1, prepend=0)
    z = xyz[:, 2].astype(np.float64)
    difference = np.abs(z - (taken * z[index]).sum(axis=1) / k)
    mean = np.average(difference, weights=weight)
    deviation = np.sqrt(np.average((difference - mean) ** 2, weights=weight))
    return difference > mean + deviations * deviation


def isolated_low(xyz: np.ndarray, k: int, depth: float, *, workers: int | None = None) -> np.ndarray:
    """bool[m]: points more than ``depth`` metres below the lowest of their ``k`` nearest neighbours in x and y.

    ``xyz`` f32[m, 3] local metres, distinct points. Single low points are found, clusters are not: see :func:`low_clusters`.
    """
    m = len(xyz)
    if m < 2:
        return np.zeros(m, bool)
    _, index = nearest(tree_of(xyz[:, :2]), xyz[:, :2], min(k, m - 1) + 1, np.inf, workers)
    z = np.where(index == np.arange(m)[:, None], np.inf, xyz[index, 2])
    return xyz[:, 2] < z.min(axis=1) - depth


@dataclasses.dataclass(frozen=True, eq=False)
class LowClusters:
    """Clusters of low points. ``barred``: bool[m]; ``clusters``: how many there are."""

    barred: np.ndarray
    clusters: int


def low_clusters(
    points: Points,
    *,
    depth: float = 2.0,
    max_points: int = 120,
    reach: float = 15.0,
) -> LowClusters:
    """Points in clusters, or alone, that lie ``depth`` metres and more below everything around them.

    Echoes from below the ground (multiple reflections, mostly) are few, near each other, and hang below the surface with
    a gap. Three steps tell them from low ground, by the lowest points of cells of 1.5 point spacings (1 m at least):

    1. Depressions. A cluster lies in one that is at least ``depth`` deep and has at most ``max_points`` points below the
       level where it overflows. Valleys, streets and ditches drain further on; a quarry holds more points.
    2. Company. Under trees and in narrow yards each gap in the cover is such a depression with ground at its bottom, but
       it has others of about its level near it. Depressions within ``reach`` of each other whose bottoms differ by less
       than 1 m and a slope of one half are counted together; with more than ``max_points`` they are ground.
    3. Surroundings. The lowest straight line between points on opposite sides, up to ``reach`` away and not in suspected
       clusters, must pass ``depth`` above the bottom, whatever the slope. At the edge of the data, where nothing lies
       opposite, the lowest point within reach must.

    Small true pits are barred as well. That does no harm to a filter that tests barred points again and has other
    seeds near them.

    Args:
        points: distinct candidates.
        depth: metres, > 0.
        max_points: largest cluster, points.
        reach: metres; at least eight point spacings are used.

    Raises: ParameterError.
    """
    if not depth > 0:
        raise ParameterError(f"low_clusters(depth={depth!r}): must be > 0 m")
    if not max_points >= 1:
        raise ParameterError(f"low_clusters(max_points={max_points!r}): must be at least 1")
    if not reach > 0:
        raise ParameterError(f"low_clusters(reach={reach!r}): must be > 0 m")
    xyz, spacing = points.xyz, points.spacing()
    cell = max(1.0, 1.5 * spacing)
    reach = max(reach, 8.0 * spacing)
    grid = grid_over(xyz, cell, points.offset(cell), name="cell of low_clusters")
    flat = grid.flat(xyz)
    lowest = np.full(grid.nx * grid.ny, np.inf, np.float32)
    import os
    level_z = xyz[:, 2]
    if os.environ.get("TREND"):
        level_z = xyz[:, 2] - _trend(xyz, grid, float(os.environ["TREND"]))
    np.minimum.at(lowest, flat, level_z)
    lowest = lowest.reshape(grid.shape)
    pits = depressions(_close_gaps(lowest), np.bincount(flat, minlength=lowest.size), depth, max_points)
    none = np.zeros(len(points), bool)
    if len(pits) == 0:
        return LowClusters(none, 0)
    size = np.bincount(pits.owner, weights=np.bincount(flat, minlength=lowest.size)[pits.cell], minlength=len(pits))
    z = lowest.ravel()[pits.cell]
    order = np.lexsort((pits.cell, z, pits.owner))
    bottom = pits.cell[order[np.searchsorted(pits.owner, np.arange(len(pits)))]]
    suspect = _alone(grid, bottom, lowest.ravel()[bottom], size, reach, max_points)
    roof = np.full(len(pits), -np.inf)
    roof[suspect] = _surroundings(lowest, grid, pits, suspect, bottom[suspect], reach)
    found = roof - lowest.ravel()[bottom] >= depth
    level = np.full(lowest.size, -np.inf, np.float32)
    level[pits.cell] = np.where(found, np.minimum(roof, pits.spill) - depth / 2, -np.inf)[pits.owner]
    return LowClusters(level_z < level[flat], int(found.sum()))


def _trend(xyz, grid, size):
    from scipy import ndimage
    c = max(size, 8*grid.cell)
    n = [int(np.ceil(v * grid.cell / c)) + 1 for v in (grid.ny, grid.nx)]
    i = ((xyz[:, 1] - grid.y0) / c).astype(int); j = ((xyz[:, 0] - grid.x0) / c).astype(int)
    low = np.full(n[0]*n[1], np.inf, np.float32)
    np.minimum.at(low, i * n[1] + j, xyz[:, 2])
    low = low.reshape(n)
    e = ~np.isfinite(low)
    if e.any():
        low = low[tuple(ndimage.distance_transform_edt(e, return_distances=False, return_indices=True))]
    low = ndimage.median_filter(low, 3, mode="nearest")
    low = ndimage.uniform_filter(low, 3, mode="nearest")
    y = (xyz[:, 1] - grid.y0) / c - .5; x = (xyz[:, 0] - grid.x0) / c - .5
    return ndimage.map_coordinates(low, [y, x], order=1, mode="nearest").astype(np.float32)


def _close_gaps(lowest: np.ndarray) -> np.ndarray:
    """f32[ny, nx] with empty (+inf) cells set to the lowest of their eight neighbours; wider voids stay walls."""
    ny, nx = lowest.shape
    rows = np.pad(lowest, 1, constant_values=np.inf)
    rows = np.minimum(np.minimum(rows[:-2], rows[1:-1]), rows[2:])
    around = np.minimum(np.minimum(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
    return np.where(np.isfinite(lowest), lowest, around)


def _alone(
    grid: Grid, bottom: np.ndarray, z: np.ndarray, size: np.ndarray, reach: float, max_points: int
) -> np.ndarray:
    """bool[k]: depressions that, with those of about their level around them, hold at most ``max_points`` points."""
    k = len(bottom)
    if k == 1:
        return np.ones(1, bool)
    xy = np.stack((bottom % grid.nx, bottom // grid.nx), axis=1) * grid.cell
    distance, other = nearest(tree_of(xy), xy, min(9, k), reach, 1)
    one, column = np.nonzero(np.isfinite(distance))
    distance, other = distance[one, column], other[one, column]
    level = np.abs(z[one] - z[other]) <= 1.0 + 0.5 * distance
    links = coo_array((np.ones(int(level.sum()), np.int8), (one[level], other[level])), shape=(k, k))
    _, group = connected_components(links, directed=False)
    return np.bincount(group, weights=size)[group] <= max_points


def _surroundings(
    lowest: np.ndarray, grid: Grid, pits: Depressions, suspect: np.ndarray, bottom: np.ndarray, reach: float
) -> np.ndarray:
    """f64[s]: the level at each bottom of the lowest line between cells on opposite sides that are in no suspect."""
    steps = int(np.ceil(reach / grid.cell))
    outside = lowest.ravel().copy()
    outside[pits.cell[suspect[pits.owner]]] = np.inf
    outside = np.pad(outside.reshape(grid.shape), steps, constant_values=np.inf)
    y, x = (i[:, None] + steps for i in np.divmod(bottom, grid.nx))
    roof = np.full(len(bottom), np.inf)
    least = np.full(len(bottom), np.inf)
    for angle in np.arange(8) * (np.pi / 8):
        dx = np.rint(np.arange(1, steps + 1) * np.cos(angle)).astype(np.int64)
        dy = np.rint(np.arange(1, steps + 1) * np.sin(angle)).astype(np.int64)
        distance = np.hypot(dx, dy)
        ahead = outside[y + dy, x + dx].astype(np.float64)
        behind = outside[y - dy, x - dx].astype(np.float64)
        least = np.minimum(least, np.minimum(ahead.min(axis=1), behind.min(axis=1)))
        for i in range(steps):
            line = (ahead[:, i, None] * distance + behind * distance[i]) / (distance[i] + distance)
            roof = np.minimum(roof, line.min(axis=1))
    one_sided = np.where(np.isfinite(least), least, -np.inf)
    return np.where(np.isfinite(roof), roof, one_sided)


def bar_outliers(
    points: Points, *, radius: float, min_neighbours: int, clusters: bool, workers: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Which points no filter should take as seeds: bool[m] all of them, and bool[m] those in low clusters.

    ``radius`` 0 switches the radius test off, ``clusters`` False the test for low clusters.
    """
    low = low_clusters(points).barred if clusters else np.zeros(len(points), bool)
    barred = low.copy()
    if radius > 0:
        barred |= radius_outliers(points.xyz, points.weight, radius, min_neighbours, workers=workers)
    return barred, low
