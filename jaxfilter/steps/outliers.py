"""Outliers: points that must not become ground seeds. None is lost: filters test them again, like other points."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy

from ..core.errors import ParameterError
from ..core.frame import perturbed
from ..core.grid import lattice_over
from ..core.points import Points, canonical_points, pieces
from ..engines.grid.cells import lowest_in_cells
from ..engines.grid.sparse import CellSet
from ..engines.neighbours import batches, groups, nearest, tree_of
from ..engines.tin.growth import Outliers
from .surfaces import Cells, look_up
from .trend import low_trend

if TYPE_CHECKING:
    from ..engines.grid.depressions import Basins


_NEAR = 48
"""So many points before and after one in canonical order are looked at before a KD-tree is asked."""


LOW_DEPTH = 2.0
"""Metres: few points around a low point are less than this above it, or lower."""
SCATTER = 0.4
"""Metres: neighbours in a cluster of false echoes differ by more than this in elevation, in the median."""


def radius_outliers(xyz: np.ndarray, radius: float, min_neighbours: int, workers: int | None = None) -> np.ndarray:
    """bool[m]: points with fewer than ``min_neighbours`` others within ``radius`` metres (Li et al. 2021, Sec. II-B).

    The answer is exact. Most points have enough neighbours near them in canonical order already; only the others ask a
    KD-tree for as many nearest.

    Args:
        xyz: f32[m, 3], local metres, distinct points in canonical order.
    """
    m = len(xyz)
    if min_neighbours >= m:
        return np.ones(m, bool)
    found = np.zeros(m, np.int32)
    columns = [np.ascontiguousarray(xyz[:, axis]) for axis in range(xyz.shape[1])]
    limit = np.float32((radius * (1 - 1e-6)) ** 2)  # what rounding could carry in is left to the KD-tree
    for shift in range(1, min(_NEAR, m - 1) + 1):
        square = np.zeros(m - shift, np.float32)
        for column in columns:
            step = column[shift:] - column[:-shift]
            step *= step
            square += step
        near = square <= limit
        found[:-shift] += near
        found[shift:] += near
    rows = np.flatnonzero(found < min_neighbours)
    few = np.zeros(m, bool)
    if len(rows) == 0:
        return few
    tree = tree_of(xyz)
    for part in batches(rows, min_neighbours + 1):
        few[part] = np.isinf(nearest(tree, xyz[part], min_neighbours + 1, radius, workers)[0][:, -1])
    return few


def knn_outliers(xyz: np.ndarray, k: int, *, workers: int | None = None) -> np.ndarray:
    """bool[m]: points whose elevation is unlike that of their ``k`` nearest neighbours (after Zheng et al. 2024).

    The statistic is the absolute difference between a point's elevation and the mean elevation of its ``k`` nearest neighbours
    in 3-D, itself excluded. Outliers exceed its mean over the cloud by more than three standard deviations.
    The paper's own formula compares metres with square metres and cannot be applied as printed. Of equally near points those
    count that :func:`perturbed` moves nearer. ``xyz``: f32[m, 3], local metres, distinct points.
    """
    m = len(xyz)
    if m < 2:
        return np.zeros(m, bool)
    k = min(k, m - 1)
    z, difference = xyz[:, 2].astype(np.float64), np.empty(m)
    places = np.column_stack([perturbed(xyz), perturbed(xyz[:, 1:])[:, 1]])
    tree = tree_of(places)
    for part in batches(np.arange(m), k + 1):
        _, index = nearest(tree, places[part], k + 1, np.inf, workers)
        difference[part] = np.abs(z[part] - z[index[:, 1:]].mean(axis=1))  # the point itself comes first
    return difference > difference.mean() + 3.0 * difference.std()


def isolated_low(xyz: np.ndarray, k: int, depth: float, *, workers: int | None = None) -> np.ndarray:
    """bool[m]: points more than ``depth`` metres below the lowest of their ``k`` nearest neighbours in x and y.

    ``xyz``: f32[m, 3], local metres, distinct points. Single low points are found, clusters are not: for these see
    :func:`low_clusters`.
    """
    m = len(xyz)
    if m < 2:
        return np.zeros(m, bool)
    xy = perturbed(xyz)
    _, index = nearest(tree_of(xy), xy, min(k, m - 1) + 1, np.inf, workers)
    z = np.where(index == np.arange(m)[:, None], np.inf, xyz[index, 2])
    return xyz[:, 2] < z.min(axis=1) - depth


@dataclasses.dataclass(frozen=True, eq=False)
class LowClusters:
    """Clusters of low points. ``barred``: bool[m]; ``clusters``: how many there are."""

    barred: np.ndarray
    clusters: int


FARTHER = 2
"""Clusters of its square times ``max_points`` are barred if so many times as deep, seen from so many times as far."""


def low_clusters(points: Points, *, depth: float = 2.0, max_points: int = 30, reach: float = 15.0) -> LowClusters:
    """Points in clusters, or alone, that lie ``depth`` metres and more below everything around them.

    Echoes from below the ground (multiple reflections, mostly) are few and hang below the surface with a gap. The test
    looks at the lowest point in each cell of 1.5 point spacings (1 m at least), after a trend of the low terrain has
    been subtracted so that hillsides are level. Four questions tell false echoes from low ground:

    1. Is it a depression? A cluster lies in one that is ``depth`` deep, counted from where it would overflow, and holds
       at most ``max_points`` points. Valleys, streets and ditches drain further on; a quarry holds more points.
    2. Is it alone? Under trees and between houses each gap in the cover is such a depression, with ground at its
       bottom, but others of about its level are near. Depressions within ``reach`` whose bottoms differ by less than
       1 m and a slope of one half are counted together; with more than ``max_points`` they are ground.
    3. Is it below its surroundings? The lowest straight line over its bottom between points on opposite sides, up to
       ``reach`` away and in no other suspected cluster, must pass at ``depth`` or more. Where nothing lies opposite, as
       at the edge of the data, the lowest point within reach must be as high.
    4. Is it cut off? In true elevations, trend included, every cell that touches its deeper part is higher than its
       lowest point by a quarter of ``depth`` at least, so that it is no bend or narrow of a gully.

    Then the points of the depression that are more than half of ``depth`` below its rim are barred. The same is asked once
    more of clusters four times as large, with twice the depth and twice the reach: few true pits are so deep, and the ground
    of a courtyard is level with that of the streets beyond the houses, which is seen from so far. Small true pits and
    courtyards are barred too. A filter that tests barred points again recovers them where they are level with ground
    around, as courtyards mostly are; a small pit whose whole floor was barred may stay out.

    Args:
        points: candidates; of equal ones one counts.
        depth: metres, > 0.
        max_points: of the largest cluster. Ground at its edge counts as well, but not points that are higher by half of
            ``depth`` than the lowest in their cell.
        reach: metres; at least eight point spacings are used.

    Only cells with points and those beside them are held, so that memory does not grow with the extent. Raises: ParameterError.
    """
    from ..engines.grid.depressions import Basins  # imports Numba

    for name, value in (("depth", depth), ("max_points", max_points), ("reach", reach)):
        if not value > 0:
            raise ParameterError(f"low_clusters({name}={value!r}): must be > 0")
    if points.plain:
        distinct = canonical_points(points.cloud)
        found = low_clusters(distinct, depth=depth, max_points=max_points, reach=reach)
        return LowClusters(found.barred[distinct.member], found.clusters)
    spacing = points.spacing()
    cell = max(1.0, 1.5 * spacing)
    reach = max(reach, 8.0 * spacing)
    grid = lattice_over(points.xyz, cell, points.offset(cell))
    occupied, at = CellSet.of(grid, points.xyz)
    coarse = max(15.0, 4.0 * cell)
    z = low_trend(points.xyz, *points.lattice_corner(coarse), coarse)
    np.subtract(points.xyz[:, 2], z, out=z)
    cells = occupied.grown()
    number = cells.find(occupied.row, occupied.column)
    at = number[at]
    lowest = [lowest_in_cells(at, level, len(cells), rows=False)[0] for level in (z, points.xyz[:, 2])]
    around = cells.around()
    closed, empty = lowest[0].copy(), np.flatnonzero(np.isinf(lowest[0]))  # wider voids stay walls
    closed[empty] = np.append(lowest[0], np.float32(np.inf))[around[:, empty]].min(axis=0)
    low = _Low(cells, cell, around, Basins(closed, around), *lowest)
    level = np.full(len(cells), -np.inf, np.float32)
    clusters = 0
    for times in (1, FARTHER):
        held = np.zeros(len(cells), np.int64)
        for part in pieces(len(points)):
            own = at[part]
            np.add.at(held, own[z[part] < lowest[0][own] + times * depth / 2], 1)
        clusters += low.search(held, times * depth, times**2 * max_points, times * reach, level)
    barred = np.empty(len(points), bool)
    for part in pieces(len(points)):
        np.less(z[part], level[at[part]], out=barred[part])
    return LowClusters(barred, clusters)


class _Low(NamedTuple):
    """The lowest points of cells: ``z``, f32[c], over the trend of the terrain, and ``elevation``, f32[c]; +inf where none is.

    ``side``: of a cell, metres; ``around``: i64[9, c]; ``basins``: of ``z`` with small gaps closed.
    """

    cells: CellSet
    side: float
    around: np.ndarray
    basins: Basins
    z: np.ndarray
    elevation: np.ndarray

    def search(self, held: np.ndarray, depth: float, max_points: int, reach: float, level: np.ndarray) -> int:
        """Raise f32[c], the level below which points of a cell are barred, in clusters; how many have not been found before.

        ``held``: i64[c], points of each cell that count.
        """
        pits = self.basins.depressions(held, depth, max_points)
        if len(pits) == 0:
            return 0
        deepest = np.lexsort((pits.cell, self.z[pits.cell], pits.owner))
        bottom = pits.cell[deepest[np.searchsorted(pits.owner, np.arange(len(pits)))]]
        alone = _alone(self.cells, self.side, bottom, self.z[bottom], pits.points, reach, max_points)
        over = np.full(len(pits), -np.inf)
        steps = int(np.ceil(reach / self.side))
        over[alone] = _surroundings(self.z, self.cells, pits.cell[alone[pits.owner]], bottom[alone], steps)
        rim = np.minimum(over, pits.spill) - depth / 2
        deep = self.z[pits.cell] < rim[pits.owner]
        cut_off = _climb(self.elevation, self.around, pits.cell[deep], pits.owner[deep], len(pits)) >= depth / 4
        found = (over - self.z[bottom] >= depth) & cut_off
        new = int((found & ~(self.z[bottom] < level[bottom])).sum())
        level[pits.cell] = np.maximum(level[pits.cell], np.where(found, rim, -np.inf)[pits.owner])
        return new


def _alone(
    cells: CellSet, side: float, bottom: np.ndarray, z: np.ndarray, size: np.ndarray, reach: float, max_points: int
) -> np.ndarray:
    """bool[k]: depressions that, with those of about their level around them, hold at most ``max_points`` points."""
    if len(bottom) == 1:  # as in small clouds, for which the import of SciPy's trees would take a sixth of the time
        return size <= max_points
    xy = np.stack((cells.column[bottom], cells.row[bottom]), axis=1) * side
    distance, other = nearest(tree_of(xy), xy, min(9, len(xy)), reach, workers=1)
    one, column = np.nonzero(np.isfinite(distance))
    distance, other = distance[one, column], other[one, column]
    level = np.abs(z[one] - z[other]) <= 1.0 + 0.5 * distance
    group = groups(one[level], other[level], len(xy))
    return np.bincount(group, weights=size)[group] <= max_points


def _climb(elevation: np.ndarray, around: np.ndarray, cell: np.ndarray, owner: np.ndarray, groups: int) -> np.ndarray:
    """f32[groups]: how far the lowest cell that touches a group of cells is above the lowest in it.

    ``elevation``: f32[c], of the cells. +inf for groups that no cell touches, or empty.
    """
    low = np.append(elevation, np.float32(np.inf))
    group = np.full(len(low), -1)
    group[cell] = owner
    own = np.full(groups, np.inf, np.float32)
    np.minimum.at(own, owner, low[cell])
    touching = np.full(groups, np.inf, np.float32)
    for neighbour in around[:, cell]:
        beyond = group[neighbour] != owner
        np.minimum.at(touching, owner[beyond], low[neighbour[beyond]])
    return np.subtract(touching, own, out=np.full_like(own, np.inf), where=np.isfinite(touching))


def _surroundings(
    lowest: np.ndarray, cells: CellSet, suspect: np.ndarray, bottom: np.ndarray, steps: int
) -> np.ndarray:
    """f64[s]: the level over each bottom of the lowest line between cells on opposite sides that are not suspect."""
    outside = np.append(lowest, np.float32(np.inf)).astype(np.float64)
    outside[suspect] = np.inf
    y, x = (i[bottom][:, None] for i in (cells.row, cells.column))
    line, least = np.full((2, len(bottom)), np.inf)
    for angle in np.arange(8) * (np.pi / 8):
        dx = np.rint(np.arange(1, steps + 1) * np.cos(angle)).astype(np.int64)
        dy = np.rint(np.arange(1, steps + 1) * np.sin(angle)).astype(np.int64)
        distance = np.hypot(dx, dy)
        ahead = outside[cells.find(y + dy, x + dx)]
        behind = outside[cells.find(y - dy, x - dx)]
        least = np.minimum(least, np.minimum(ahead, behind).min(axis=1))
        for i in range(steps):
            over = (ahead[:, i, None] * distance + behind * distance[i]) / (distance[i] + distance)
            line = np.minimum(line, over.min(axis=1))
    return np.where(np.isfinite(line), line, np.where(np.isfinite(least), least, -np.inf))


def bar_outliers(
    points: Points,
    *,
    clusters: bool,
    radius: float = 0.0,
    min_neighbours: int = 1,
    neighbours: int = 0,
    workers: int | None = None,
) -> Outliers:
    """Which points no filter should take as seeds; those in low clusters are late.

    ``radius`` 0 switches the radius test off, ``clusters`` False the test for low clusters, ``neighbours`` 0 the test of
    elevations (:func:`knn_outliers`). Where every point would be barred, as in a cloud too sparse for the radius, none is.
    """
    low = low_clusters(points).barred if clusters else np.zeros(len(points), bool)
    barred = low.copy()
    if radius > 0:
        barred |= radius_outliers(points.xyz, radius, min_neighbours, workers=workers)
    if neighbours > 0:
        barred |= knn_outliers(points.xyz, neighbours, workers=workers)
    if barred.all():
        low, barred = np.zeros_like(low), np.zeros_like(low)
    return Outliers(barred, low)


_STEPS = 8
"""Cells to each side of a point that hold those within the radius of :func:`lowest_few`."""


def lowest_few(xyz: np.ndarray, radius: float, depth: float, most: int) -> np.ndarray:
    """bool[m]: points, f32[m, 3], metres, that are low: only ``most`` others or fewer within ``radius`` metres, in x and y, lie
    less than ``depth`` metres above them or lower, and more than ``most`` lie higher.

    These are false echoes from below the ground, alone or in clusters. Ground has ground of its level within the radius of the
    largest building around it, in courtyards and streets too. Small deep pits are low; nothing on a hillside is, which has lower
    ground around it. No grid has a part in it: only distances count.
    """
    from ..engines.below import few_below  # imports Numba

    low = np.zeros(len(xyz), bool)
    if most > 0 and len(xyz) > 0:
        side = radius / _STEPS
        grid = lattice_over(xyz, side)
        grid = dataclasses.replace(grid, nx=grid.nx + 1 + _STEPS)  # what lies beyond a row is not in the next one
        cells, at = CellSet.of(grid, xyz)
        few_below(low, xyz, at, cells.key, cells.wide, _STEPS, radius, depth, most)
    return low


def scattered(points: Points, low: np.ndarray) -> np.ndarray:
    """bool[m]: those of the points ``low``, bool[m], that are alone, or in a cluster whose neighbours differ much in elevation.

    False echoes have paths of any length, and the floor of a pit is smooth: see :data:`SCATTER`. Points up to three spacings from
    each other, and up to 3 m, are in one cluster.
    """
    rows, found = np.flatnonzero(low), np.zeros(len(points), bool)
    if len(rows) == 0:
        return found
    xy, z, reach = perturbed(points.xyz[rows]), points.xyz[rows, 2], max(3.0, 3 * points.spacing())
    tree = tree_of(xy)
    pairs = tree.query_pairs(reach, output_type="ndarray")
    cluster = groups(pairs[:, 0], pairs[:, 1], len(rows))
    index = nearest(tree, xy, min(2, len(rows)), reach, workers=1)[1]
    index = np.where(index[:, :1] == np.arange(len(rows))[:, None], index[:, -1:], index[:, :1])[:, 0]
    step = np.where(np.bincount(cluster)[cluster] > 1, np.abs(z - z[np.minimum(index, len(rows) - 1)]), np.inf)
    middle = scipy.ndimage.median(step, cluster, np.arange(cluster.max() + 1))
    found[rows] = middle[cluster] > SCATTER
    return found


def pits(xyz: np.ndarray, cells: Cells, depth: float, largest: float) -> np.ndarray:
    """bool[m]: points, f32[m, 3], more than ``depth`` metres below what a closing makes of the lowest elevations of cells, in
    parts of at most ``largest`` square metres.

    The disk of the closing is as wide as they may be. What is long, such as a ditch, is no pit.
    """
    rows, columns = cells.grid.shape
    z, seen = (np.array(v)[:rows, :columns] for v in (cells.lowest, cells.seen))
    side = float(cells.grid.cell)
    reach = max(1, round(math.sqrt(largest) / 2 / side))
    i, j = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disk = i * i + j * j <= reach * reach
    high = scipy.ndimage.grey_dilation(np.where(seen, z, -np.inf), footprint=disk, mode="constant", cval=-np.inf)
    high[np.isinf(high)] = np.inf
    closed = scipy.ndimage.grey_erosion(high, footprint=disk, mode="constant", cval=np.inf)
    part, _ = scipy.ndimage.label(seen & (closed - z > depth), np.ones((3, 3)))
    small = np.bincount(part.ravel()) * side**2 <= largest
    small[0] = False
    level = np.zeros(cells.lowest.shape, np.float32)
    level[:rows, :columns] = np.where(small[part], closed - depth, -np.inf)
    level[rows:], level[:, columns:] = -np.inf, -np.inf
    return xyz[:, 2] < look_up(xyz, cells, level)[0]
