"""Rectangles of many files: which meet a box, which overlap, and what they leave open."""

from __future__ import annotations

import numpy as np
import scipy
import shapely

from ..files.disk import Bounds

_CELLS = 1 << 22  # of the raster in which holes are looked for
_PER_TILE = 4  # cells of it along the side of a rectangle of middling size


class Footprints:
    """An index of n axis-parallel closed rectangles.

    Args:
        bounds: f64[n, 4], xmin, ymin, xmax, ymax; rows with NaN meet nothing.
    """

    def __init__(self, bounds: np.ndarray) -> None:
        self.bounds, self.known = bounds, np.flatnonzero(np.isfinite(bounds).all(axis=1))
        self.boxes = shapely.box(*bounds[self.known].T)
        self.tree = shapely.STRtree(self.boxes)

    def meeting(self, box: Bounds) -> np.ndarray:
        """i64[m], ascending: the rectangles that may hold points inside a half-open box."""
        found = np.sort(self.known[self.tree.query(shapely.box(*box))])
        return found[(self.bounds[found, :2] < box[2:]).all(axis=1)]

    def overlaps(self, least: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs i64[m, 2], the lower number first, and the share f64[m] of the smaller one's area that both cover;
        those from ``least`` on, the largest first."""
        one, other = self.known[self.tree.query(self.boxes)]
        pair = np.column_stack([one, other])[one < other]
        a, b = np.moveaxis(self.bounds[pair], 1, 0)
        sides = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
        areas = [np.prod(each[:, 2:] - each[:, :2], axis=1) for each in (a, b)]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where((sides > 0).all(axis=1), np.prod(sides, axis=1) / np.minimum(*areas), 0.0)
        share[(a == b).all(axis=1)] = 1.0
        kept = np.flatnonzero(share >= least)
        kept = kept[np.lexsort((pair[kept, 1], pair[kept, 0], -share[kept]))]
        return pair[kept], share[kept]

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
        last = np.maximum(first, np.floor((known[:, 2:] - low) / cell - 0.5).astype(int) + 1)
        for x, y, sign in ((first, first, 1), (last, first, -1), (first, last, -1), (last, last, 1)):
            np.add.at(edges, (x[:, 0], y[:, 1]), sign)
        covered = edges.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
        named, count = scipy.ndimage.label(scipy.ndimage.binary_fill_holes(covered) & ~covered)
        sizes = np.bincount(named.reshape(-1), minlength=count + 1)[1:]
        boxes = scipy.ndimage.find_objects(named)
        found = [
            [getattr(side, end) for end in ("start", "stop") for side in boxes[k]]
            for k in np.argsort(-sizes, kind="stable")
        ]
        return [tuple((np.tile(low, 2) + cell * np.array(box)).tolist()) for box in found]  # type: ignore[misc]
