"""Where a terrain model ends: a disc rolls around the ground points from outside, and cells that it covers have no value."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
import scipy

from ..core.cloud import PointCloud
from ..core.reading import Bounds
from .interpolation import nearest_point
from .levels import WaterRuns
from .outline import blocks_of
from .raster import RasterGrid
from .runs import bodies, gaps, mask_of, runs_in, union

LEAST, SPACINGS, STEP = 5.0, 3.0, 0.5
"""Metres, spacings of the ground points, rounded up to a step of metres: their sum is the default of the largest edge."""
_FARTHEST, _CODES = 16.0, 254
"""Metres: the largest disc of the default; and numbers that stand for distances up to the limit."""
_BESIDE = 1.5
"""Cells beside those that the disc covers, of which some are beyond the edge: the middle of the disc is that of a cell."""
_DISJOINT = 1.0 - math.exp(-1.0)
"""Share of the area of discs around random points that they cover together where the mean number of points in a disc is 1."""


class Part(NamedTuple):
    """What a tile says of the edge.

    Attributes:
        own, wide: its cells, and those around them that may look at them. around: with a ring for the disc.
        near: u8 over ``around``: how far ground is, see :meth:`EdgeRule.code`. points: of ground in ``own``.
        circle: the same over ``wide``: radius of the circle through the corners of the triangle there.
    """

    own: RasterGrid
    wide: RasterGrid
    around: RasterGrid
    near: np.ndarray
    points: int
    circle: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class EdgeRule:
    """How the edge is found.

    The disc has half the largest edge as its radius, so that it passes between two points farther apart than this edge. Voids in
    the midst of the data, which it does not reach, are no edge.

    Attributes:
        grid: all cells; metre: metres per unit of their coordinates.
        data: bounds of all points. Sides of the grid that lie inside are no edge.
        max_edge: metres; None: 5 m and three times the spacing of the ground points.
    """

    grid: RasterGrid
    metre: float
    data: Bounds
    max_edge: float | None = None

    @property
    def limit(self) -> float:
        """Metres: the radius of the disc, at most."""
        return _FARTHEST if self.max_edge is None else self.max_edge / 2

    @property
    def side(self) -> float:
        """Of a cell, metres."""
        return self.grid.cell * self.metre

    def around(self, grid: RasterGrid) -> RasterGrid:
        """A grid with a ring that the disc fits into."""
        return grid.grown(math.ceil(self.limit / self.side) + 1)

    def near(self, cloud: PointCloud, ground: np.ndarray, grid: RasterGrid, workers: int | None) -> np.ndarray:
        """u8[rows, columns]: how far ground is from cells. ``ground``: bool[n]."""
        out, xyz = np.full(grid.shape, 255, np.uint8), cloud.xyz[ground]
        if len(xyz):
            nearest = nearest_point(xyz, workers, self.limit)
            for rows, at in blocks_of(cloud, grid):
                out[rows] = self.code(nearest(at)[0]).reshape(-1, grid.columns)
        return out

    def code(self, metres: np.ndarray) -> np.ndarray:
        """u8: distances in steps up to the limit, and 255 beyond."""
        return np.minimum(np.ceil(metres * (_CODES / self.limit)), 255).astype(np.uint8)

    def find(self, parts: Callable[[], Iterable[Part]], levels: WaterRuns | None = None) -> Edge | None:
        """The edge; ``parts``: gives those of all tiles each time that it is called; ``levels``: water counts as ground.

        None: the ground points are too far apart for one.
        """
        radius = self.limit if self.max_edge is not None else (LEAST + SPACINGS * self._spacing(parts())) / 2
        if not radius <= self.limit:
            return None
        most, outer, solid = math.floor(radius / self.limit * _CODES), self.around(self.grid), [np.zeros((0, 3), int)]
        for part in parts():
            wet = False if levels is None else ~np.isnan(levels.over(part.around))
            solid.append(runs_in((part.near <= most) | wet, part.around))
        free = gaps(union(np.concatenate(solid)), outer)
        (left, *_, right), (top, *_, bottom) = outer.centres()
        x0, y0, x1, y1 = self.data
        edge = (free[:, 1] == outer.left) & (left < x0) | (free[:, 2] == outer.left + outer.columns) & (right > x1)
        edge |= (free[:, 0] == outer.bottom) & (bottom < y0)
        edge |= (free[:, 0] == outer.bottom + outer.rows - 1) & (top > y1)
        body = bodies(free)
        free = free[(np.bincount(body, edge) > 0)[body]]
        found, flat = [np.zeros((0, 3), int)], [np.zeros((0, 3), int)]
        for part in parts():
            open_ = mask_of(free, part.around)
            if open_.any():
                away = scipy.ndimage.distance_transform_edt(~open_)[part.around.slices(part.wide)] * self.side
                found.append(runs_in(away <= radius, part.wide))
                if part.circle is not None:
                    flat.append(runs_in((part.circle > most) & (away <= radius + _BESIDE * self.side), part.wide))
        return Edge(union(np.concatenate(found)), union(np.concatenate(flat)))

    def _spacing(self, parts: Iterable[Part]) -> float:
        """Metres between ground points that lie so dense in random places, rounded up; infinite where they are too few."""
        held, points = np.zeros(256), 0
        for part in parts:
            held += np.bincount(part.near[part.around.slices(part.own)].ravel(), minlength=256)
            points += part.points
        radius = np.arange(1, 255) * (self.limit / _CODES)
        thin = held[:255].cumsum()[1:] * self.side**2 <= _DISJOINT * points * math.pi * radius**2
        return math.ceil(radius[thin.argmax()] * math.sqrt(math.pi) / STEP) * STEP if thin.any() else math.inf


@dataclasses.dataclass(frozen=True, eq=False)
class Edge:
    """Cells beyond the edge, i64[k, 3], see ``runs.py``; ``flat``: cells at it whose triangle reaches out of it."""

    run: np.ndarray
    flat: np.ndarray

    def beyond(self, grid: RasterGrid) -> np.ndarray:
        """bool[rows, columns]: cells beyond the edge."""
        return mask_of(self.run, grid)

    def cut(self, heights: np.ndarray, grid: RasterGrid) -> np.ndarray:
        """f32[rows, columns]: heights of a surface as far as the edge."""
        return np.where(mask_of(self.run, grid) | mask_of(self.flat, grid), np.float32(np.nan), heights)
