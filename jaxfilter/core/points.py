"""Candidate points in an order that only their coordinates decide, so that labels do not depend on file order."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from .cloud import QUANTUM, PointCloud
from .errors import InputError
from .frame import ends
from .grid import Grid, lattice_over

EXTENT = 2.0**17
"""Metres in x and y from the corner of a cloud up to which its points are filtered; there float32 resolves 8 mm."""
PIECE = 1 << 15
"""Points that are worked on at a time where several arrays are made of them one after the other."""
_SPACINGS: WeakKeyDictionary[PointCloud, dict[int, float]] = WeakKeyDictionary()
"""Spacings of clouds, metres, by the number of points that count: all distinct ones, or those that stand for them."""
_SORTED: WeakKeyDictionary[PointCloud, tuple[np.ndarray, np.ndarray, np.ndarray]] = WeakKeyDictionary()
"""What :func:`canonical_points` keeps."""


@dataclasses.dataclass(frozen=True, eq=False)
class Points:
    """The candidate points of a cloud: distinct and in canonical order, unless made by :func:`plain_points`.

    Attributes:
        cloud: where they come from.
        xyz: f32[m, 3], local metres. In canonical order, points with equal x, y and z are one row.
        index: i64[c], the cloud's candidates.
        member: i64[c], which row of ``xyz`` each candidate is.
        weight: i32[m], how many distinct candidates each row stands for.
        plain: row by row the candidates, in their order.
        kept: what :func:`jaxfilter.core.filter.stage` has kept for other sets of parameters; None = it keeps nothing.
    """

    cloud: PointCloud
    xyz: np.ndarray
    index: np.ndarray
    member: np.ndarray
    weight: np.ndarray
    plain: bool = False
    kept: dict[str, tuple[set[str], Any, Any]] | None = None

    def __len__(self) -> int:
        return len(self.xyz)

    def gather(self, values: np.ndarray) -> np.ndarray:
        """[m] for the rows out of [n] for the cloud; of equal points, which are one row, the first in the cloud counts.
        ``values[points.index]`` is that for methods on a grid only: the rows of others are sorted and distinct."""
        values = np.asarray(values)
        if self.plain:
            return values[self.index]
        first = np.empty(len(self), np.int64)
        first[self.member[::-1]] = self.index[::-1]  # of repeated rows the last one written stays
        return values[first]

    def spread(self, values: Any, empty: Any = 0, dtype: Any = None) -> np.ndarray:
        """[n] for the cloud out of [m] for the rows; ``empty`` for points that are no candidates."""
        values = np.asarray(values)
        dtype = dtype or values.dtype
        if not self.plain:
            values = values[self.member]
        if len(self.index) == len(self.cloud):
            return values.astype(dtype, copy=False)
        out = np.full(len(self.cloud), empty, dtype)
        out[self.cloud.candidate] = values
        return out

    @functools.cached_property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """f64[2] lowest and f64[2] highest x and y, local metres."""
        low, high = ends(self.xyz[:, :2])
        return low.astype(np.float64), high.astype(np.float64)

    def offset(self, cell: float) -> tuple[float, float]:
        """Local corner of the grid with cells of this size, metres."""
        return self.cloud.grid_offset(cell)

    def anchored(self) -> np.ndarray:
        """f64[2], metres from the anchor of the cloud to the zero of its local coordinates."""
        return np.asarray((self.cloud.origin[:2] - self.cloud.anchor) * self.cloud.units.xy)

    def spacing(self) -> float:
        """Mean point spacing in metres: square root of occupied area per distinct point. The occupied area is counted in
        cells that hold about eight points each, so that voids do not count. A cloud that is a part of a scene has the spacing
        of the whole."""
        whole, m = self.cloud.whole, len(self.xyz)
        if whole is not None and whole.spacing is not None:
            return whole.spacing
        if self.plain:
            return canonical_points(self.cloud).spacing()
        if m < 2:
            return 1.0
        known = _SPACINGS.setdefault(self.cloud, {})
        if m in known:
            return known[m]
        sides = np.maximum(self.extent[1] - self.extent[0], QUANTUM)
        spacing = float(np.sqrt(sides.prod() / m))
        for _ in range(3):
            cell = max(3 * spacing, float(sides.max()) / 2**15)
            area = _occupied(self.xyz, self.extent[1], np.float32(cell)) * cell**2
            before, spacing = spacing, float(np.sqrt(min(area, sides.prod()) / m))
            if abs(spacing - before) < 0.01 * before:
                break
        known[m] = spacing
        return spacing

    def near_core(self, distance: float) -> np.ndarray:
        """bool[m]: points at most so many metres, in x and in y, from the box in which labels are asked for."""
        if self.cloud.core is None:
            return np.ones(len(self), bool)
        local = (np.array(self.cloud.core).reshape(2, 2) - self.cloud.origin[:2]) * self.cloud.units.xy
        low, high = local + [[-distance], [distance]]
        return ((self.xyz[:, :2] >= low) & (self.xyz[:, :2] <= high)).all(axis=1)

    def lattice_corner(self, cell: float) -> tuple[float, float]:
        """The corner of a cell of this size at or south-west of all points, local metres."""
        grid = lattice_over(self.xyz, cell, self.offset(cell))
        return grid.x0, grid.y0


def _occupied(xyz: np.ndarray, high: np.ndarray, cell: np.float32) -> int:
    """How many square cells hold some of the local points f32[m, >=2], none of which is above ``high``."""
    grid = Grid(0.0, 0.0, cell, *(int(np.float32(end) / cell) + 1 for end in high))
    if grid.nx * grid.ny > 8 * len(xyz) + 1000:
        return len(np.unique(grid.flat(xyz)))
    seen = np.zeros(grid.nx * grid.ny, bool)
    for part in pieces(len(xyz)):
        seen[grid.flat(xyz[part])] = True
    return int(np.count_nonzero(seen))


def pieces(n: int) -> Iterator[slice]:
    """Rows of n, so many at a time that what is made of them stays in the cache."""
    return (slice(start, min(start + PIECE, n)) for start in range(0, n, PIECE))


def check_extent(cloud: PointCloud, xy: np.ndarray) -> None:
    """Raises: InputError if any of the local points [n, >=2] of the cloud is farther than :data:`EXTENT` from its corner.
    Such an extent comes from stray points. The others would lose their last digits, and grids most of their cells."""
    if len(xy) == 0 or not (ends(xy[:, :2])[1] > EXTENT).any():
        return
    every = (cloud.xyz if cloud.valid is None else cloud.xyz[cloud.valid])[:, :2].astype(np.float64)
    middle, (width, height) = np.median(every, axis=0), np.ptp(every, axis=0) / 1000
    stray = int((np.abs(every - middle) > EXTENT / 2).any(axis=1).sum())
    at = ", ".join(f"{v:.10g}" for v in cloud.origin[:2] + middle / cloud.units.xy)
    name = "the cloud" if cloud.source is None else cloud.source.path
    raise InputError(
        f"{name}: the points extend over {width:.6g} x {height:.6g} km, and clouds are filtered up to {EXTENT / 1000:.0f} km: "
        f"{stray:,} of {len(every):,} lie more than {EXTENT / 2000:.0f} km from the median position ({at}); remove these "
        "stray points, or pass bounds= to read the rest"
    )


def has_area(xy: np.ndarray) -> bool:
    """Whether there are three of the positions [n, >=2] that do not lie on one line (to the quantum of the coordinates)."""
    if len(xy) < 3:
        return False
    few = xy[:: max(1, len(xy) // 1000), :2]
    return _spread_across(few) > 8 * QUANTUM or _spread_across(xy) > 2 * QUANTUM


def _spread_across(xy: np.ndarray) -> float:
    """Largest distance of any point from the line through the first one and the one farthest from it, metres."""
    x, y = (xy[:, axis].astype(np.float64) - float(xy[0, axis]) for axis in range(2))
    far = int(np.argmax(x * x + y * y))
    length = float(np.hypot(x[far], y[far]))
    return float(np.abs(x * y[far] - y * x[far]).max()) / length if length > 0 else 0.0


def by_position(xyz: np.ndarray) -> np.ndarray:
    """i64[n]: the order of points f32[n, >=2] by x, then by y, which no shift changes: of equally low ones the first counts."""
    return np.lexsort((xyz[:, 1], xyz[:, 0]))


def morton(xy: np.ndarray, moved: tuple[int, int] = (0, 0)) -> np.ndarray:
    """u64[n] Z-order code of local points [n, >=2], moved by whole metres; neighbours in the plane are mostly neighbours in
    this order. Codes repeat after 4,194 km."""
    code = np.empty(len(xy), np.uint64)
    for part in pieces(len(xy)):
        x, y = (_spread(xy[part, axis], moved[axis]) for axis in range(2))
        y <<= np.uint64(1)
        np.bitwise_or(x, y, out=code[part])
    return code


def _spread(metres: np.ndarray, moved: int) -> np.ndarray:
    """u64[n]: the quanta of a coordinate, a zero bit above each of their lower 32."""
    v = (metres.astype(np.float64) / QUANTUM).astype(np.uint64)
    if moved:
        v += np.uint64(round(moved / QUANTUM) % 2**32)
        v &= np.uint64(2**32 - 1)
    for shift in (16, 8, 4, 2, 1):  # groups of so many bits, and as many zeros between them
        v |= v << np.uint64(shift)
        v &= np.uint64((2**64 - 1) // (2**shift + 1))
    return v


def plain_points(cloud: PointCloud) -> Points:
    """The candidates of a cloud in file order, repeated points included: for methods whose labels ignore the order."""
    index, xyz = _candidates(cloud)
    return Points(cloud, xyz, index, np.arange(len(index)), np.ones(len(index), np.int32), plain=True)


def _candidates(cloud: PointCloud) -> tuple[np.ndarray, np.ndarray]:
    """i64[c], which points of a cloud are candidates, and f32[c, 3], where they are."""
    index = np.flatnonzero(cloud.candidate)
    return index, cloud.xyz if len(index) == len(cloud) else cloud.xyz[index]


def canonical_points(cloud: PointCloud, keep: bool = False) -> Points:
    """Distinct candidates of a cloud, sorted by Morton code of x and y, then by z. Any point order gives the same arrays.
    Codes count from the anchor, so that clouds with one anchor sort points alike. ``keep``: for the next call with this
    cloud, which so need not sort them again."""
    arrays = _SORTED.pop(cloud, None) or _sorted(cloud)
    if keep:
        _SORTED[cloud] = arrays
    return Points(cloud, *arrays, np.broadcast_to(np.int32(1), len(arrays[0])))


def _sorted(cloud: PointCloud) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``xyz``, ``index`` and ``member`` of :func:`canonical_points`."""
    index, xyz = _candidates(cloud)
    east, north = (round(v) for v in (cloud.origin[:2] - cloud.anchor) * cloud.units.xy)
    order, repeated = _canonical_order(morton(xyz, (east, north)), xyz[:, 2])
    member = np.empty(len(order), np.int64)
    if len(repeated) == 0:
        for part in pieces(len(order)):
            member[order[part]] = np.arange(part.start, part.stop)
        return xyz[order], index, member
    first = np.ones(len(order), bool)
    first[repeated] = False
    member[order] = np.cumsum(first) - 1
    return xyz[order[first]], index, member


def _canonical_order(code: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """i64[n], the order of points by their codes u64[n], then by z, f32[n]; and which places in it, ascending, hold a point that
    is equal to the one before."""
    order, alike = np.argsort(code, kind="stable"), [np.zeros(0, np.int64)]
    for part in pieces(len(code) - 1):
        same = code[order[part]] == code[order[part.start + 1 : part.stop + 1]]
        alike.append(part.start + np.flatnonzero(same))
    rows = np.concatenate(alike)
    rows = np.union1d(rows, rows + 1)
    points = order[rows]
    points = points[np.lexsort((z[points], code[points]))]
    order[rows] = points
    same = (code[points[1:]] == code[points[:-1]]) & (z[points[1:]] == z[points[:-1]])
    return order, rows[1:][same]
