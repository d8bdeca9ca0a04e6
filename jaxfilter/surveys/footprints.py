"""Rectangles of many files: which meet a box, which overlap, and what they leave open."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from ..files.disk import Bounds

_ROWS = 50_000  # rectangles that are compared with all at a time
_CELLS = 1 << 22  # of the raster in which holes are looked for
_PER_TILE = 4  # cells of it along the side of a rectangle of middling size


class Footprints:
    """An index of n axis-parallel closed rectangles.

    Rectangles are sorted into trees of centres by size, by powers of two, so that a few large ones do not make the
    search among many small ones slow.

    Args:
        bounds: f64[n, 4], xmin, ymin, xmax, ymax; rows with NaN meet nothing.
    """

    def __init__(self, bounds: np.ndarray) -> None:
        self.bounds = bounds
        self.centre, self.half = (bounds[:, :2] + bounds[:, 2:]) / 2, (bounds[:, 2:] - bounds[:, :2]).max(axis=1) / 2
        known = np.isfinite(bounds).all(axis=1)
        size = np.full(len(bounds), -(2**31))
        size[known] = np.frexp(self.half[known])[1]
        self.trees = [
            (rows, cKDTree(self.centre[rows]), float(self.half[rows].max()))
            for rows in (np.flatnonzero(known & (size == s)) for s in np.unique(size[known]))
        ]

    def meeting(self, box: Bounds) -> np.ndarray:
        """i64[m], ascending: the rectangles that may hold points inside a half-open box."""
        corner = np.array(box)
        centre, half = (corner[:2] + corner[2:]) / 2, float((corner[2:] - corner[:2]).max()) / 2
        near = [
            rows[tree.query_ball_point(centre, (half + most) * (1 + 1e-9), p=np.inf)] for rows, tree, most in self.trees
        ]
        found = np.sort(np.concatenate([np.zeros(0, np.int64), *near]))
        b = self.bounds[found]
        return found[(b[:, 0] < box[2]) & (b[:, 2] >= box[0]) & (b[:, 1] < box[3]) & (b[:, 3] >= box[1])]

    def overlaps(self, least: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs i64[m, 2], the lower number first, and the share f64[m] of the smaller one's area that both cover;
        those from ``least`` on, the largest first."""
        pairs, shares = [np.zeros((0, 2), np.int64)], [np.zeros(0)]
        for one, other in self._near():
            a, b = self.bounds[one], self.bounds[other]
            sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
            areas = [np.prod(each[:, 2:] - each[:, :2], axis=1) for each in (a, b)]
            with np.errstate(invalid="ignore", divide="ignore"):
                share = np.where((sides > 0).all(axis=1), np.prod(sides, axis=1) / np.minimum(*areas), 0.0)
            share[(a == b).all(axis=1)] = 1.0
            kept = share >= least
            pairs.append(np.column_stack([one, other])[kept])
            shares.append(share[kept])
        pair, share = np.concatenate(pairs), np.concatenate(shares)
        order = np.lexsort((pair[:, 1], pair[:, 0], -share))
        return pair[order], share[order]

    def _near(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Pairs of numbers i64[k] each, the first the lower, of rectangles that may meet."""
        for start in range(0, len(self.bounds), _ROWS):
            rows = np.arange(start, min(start + _ROWS, len(self.bounds)))
            rows = rows[np.isfinite(self.bounds[rows]).all(axis=1)]
            for members, tree, most in self.trees:
                lists = tree.query_ball_point(self.centre[rows], self.half[rows] + most, p=np.inf)
                other = members[np.concatenate([np.zeros(0, np.int64), *map(np.array, lists)]).astype(np.int64)]
                one = np.repeat(rows, [len(found) for found in lists])
                yield one[one < other], other[one < other]

    def holes(self) -> list[Bounds]:
        """The rectangles around places that no footprint covers and footprints enclose, the largest first.

        Places are seen from about a quarter of the side of a footprint of middling size on.
        """
        known = self.bounds[np.isfinite(self.bounds).all(axis=1)]
        sides = known[:, 2:] - known[:, :2]
        sides = sides[(sides > 0).all(axis=1)]
        if not len(sides):
            return []
        low, high = known[:, :2].min(axis=0), known[:, 2:].max(axis=0)
        cell = max(float(np.median(sides)) / _PER_TILE, float(np.sqrt(np.prod(high - low) / _CELLS)))
        shape = np.ceil((high - low) / cell).astype(int) + 1
        edges = np.zeros(shape + 1, np.int64)  # +1 and -1 at the corners: their double sum is the cover
        first = np.ceil((known[:, :2] - low) / cell - 0.5).astype(int)
        last = np.floor((known[:, 2:] - low) / cell - 0.5).astype(int) + 1
        last = np.maximum(first, last)
        for i, j, sign in (("a", "a", 1), ("b", "a", -1), ("a", "b", -1), ("b", "b", 1)):
            x, y = (first if i == "a" else last)[:, 0], (first if j == "a" else last)[:, 1]
            np.add.at(edges, (x, y), sign)
        covered = edges.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
        named, count = ndimage.label(ndimage.binary_fill_holes(covered) & ~covered)
        sizes = np.bincount(named.reshape(-1), minlength=count + 1)[1:]
        boxes = ndimage.find_objects(named)
        found: list[Bounds] = []
        for k in np.argsort(-sizes, kind="stable"):
            (x0, y0), (x1, y1) = (
                low + cell * np.array([getattr(s, end) for s in boxes[k]]) for end in ("start", "stop")
            )
            found.append((float(x0), float(y0), float(x1), float(y1)))
        return found
