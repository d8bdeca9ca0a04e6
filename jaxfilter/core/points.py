"""Candidate points in an order that only their coordinates decide, so that labels do not depend on file order."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np

from .cloud import QUANTUM, PointCloud
from .errors import InputError
from .grid import lattice_over

EXTENT = 2.0**17
"""Metres in x and y from the corner of a cloud up to which its points are filtered; there float32 resolves 8 mm."""


@dataclasses.dataclass(frozen=True, eq=False)
class Points:
    """The candidate points of a cloud: distinct and in canonical order, unless made by :func:`plain_points`.

    Attributes:
        cloud: where they come from.
        xyz: f32[m, 3], local metres. In canonical order, points with equal x, y and z are one row.
        index: i64[c], the cloud's candidates.
        member: i64[c], which row of ``xyz`` each candidate is.
        weight: i32[m], how many candidates each row stands for.
    """

    cloud: PointCloud
    xyz: np.ndarray
    index: np.ndarray
    member: np.ndarray
    weight: np.ndarray

    def __len__(self) -> int:
        return len(self.xyz)

    @functools.cached_property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """f64[2] lowest and f64[2] highest x and y, local metres."""
        return extent(self.xyz)

    def offset(self, cell: float) -> tuple[float, float]:
        """Local corner of the grid with cells of this size, metres."""
        return self.cloud.grid_offset(cell)

    def anchored(self) -> np.ndarray | None:
        """f64[2], metres from the anchor of the cloud to the zero of its local coordinates; None without an anchor."""
        cloud = self.cloud
        return None if cloud.anchor is None else (cloud.origin[:2] - cloud.anchor) * cloud.units.xy

    def has_area(self) -> bool:
        """As :func:`has_area` of all."""
        return has_area(self.xyz)

    def spacing(self) -> float:
        """Mean point spacing in metres: square root of occupied area per point.

        The occupied area is counted in cells that hold about eight points each, so that voids do not count. A cloud that
        is a part of a scene has the spacing of the whole.
        """
        whole = self.cloud.whole
        return self._spacing if whole is None or whole.spacing is None else whole.spacing

    def least_shape(self, cell: float, margin: int = 0) -> tuple[int, int]:
        """Rows and columns of cells that arrays over the largest part of the whole scene have; (1, 1) for a scene of its own."""
        whole = self.cloud.whole
        if whole is None:
            return 1, 1
        return tuple(math.ceil(side / cell) + 1 + margin for side in (whole.height, whole.width))  # type: ignore[return-value]

    def lattice_corner(self, cell: float) -> tuple[float, float]:
        """The node of the anchored lattice of cells of this size at or south-west of all points, local metres."""
        grid = lattice_over(self.xyz, cell, self.offset(cell))
        return grid.x0, grid.y0

    @functools.cached_property
    def _spacing(self) -> float:
        m = len(self.xyz)
        if m < 2:
            return 1.0
        sides = np.maximum(self.extent[1] - self.extent[0], QUANTUM)
        spacing = float(np.sqrt(sides.prod() / m))
        for _ in range(3):
            cell = max(3 * spacing, float(sides.max()) / 2**15)
            x, y = ((self.xyz[:, axis] / np.float32(cell)).astype(np.int32) for axis in range(2))
            columns = int(y.max()) + 1
            key = x.astype(np.int64) * columns + y
            few = int(key.max()) < 8 * m + 1000
            occupied = int(np.count_nonzero(np.bincount(key))) if few else len(np.unique(key))
            before, spacing = spacing, float(np.sqrt(min(occupied * cell**2, sides.prod()) / m))
            if abs(spacing - before) < 0.01 * before:
                break
        return spacing


def extent(xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[2] lowest and f64[2] highest x and y of positions [n, >=2]. By columns: across rows NumPy takes 30 times as long."""
    low, high = (np.array([pick(xy[:, axis]) for axis in range(2)], np.float64) for pick in (np.min, np.max))
    return low, high


def check_extent(cloud: PointCloud, xy: np.ndarray) -> None:
    """Raises: InputError if any of the local points [n, >=2] of the cloud is farther than :data:`EXTENT` from its corner.

    Such an extent comes from stray points. The others would lose their last digits, and grids most of their cells.
    """
    if len(xy) == 0 or not (extent(xy)[1] > EXTENT).any():
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


def morton(xy: np.ndarray, moved: tuple[int, int] = (0, 0)) -> np.ndarray:
    """u64[n] Z-order code of local points [n, >=2], moved by whole metres; neighbours in the plane are mostly neighbours in
    this order. Codes repeat after 4,194 km."""
    code = np.zeros(len(xy), np.uint64)
    for axis in range(2):
        v = (xy[:, axis].astype(np.float64) / QUANTUM).astype(np.uint64)
        if moved[axis]:
            v = (v + np.uint64(round(moved[axis] / QUANTUM) % 2**32)) & np.uint64(2**32 - 1)
        for shift, mask in (
            (16, 0x0000FFFF0000FFFF),
            (8, 0x00FF00FF00FF00FF),
            (4, 0x0F0F0F0F0F0F0F0F),
            (2, 0x3333333333333333),
            (1, 0x5555555555555555),
        ):
            v = (v | (v << np.uint64(shift))) & np.uint64(mask)
        code |= v << np.uint64(axis)
    return code


def plain_points(cloud: PointCloud) -> Points:
    """The candidates of a cloud in file order, repeated points included: for methods whose labels ignore the order."""
    index = np.flatnonzero(cloud.candidate)
    xyz = cloud.xyz if len(index) == len(cloud) else cloud.xyz[index]
    return Points(cloud, xyz, index, np.arange(len(index)), np.ones(len(index), np.int32))


def canonical_points(cloud: PointCloud) -> Points:
    """Distinct candidates of a cloud, sorted by Morton code of x and y, then by z. Any point order gives the same arrays.

    Codes count from the corner of the cloud, or from its anchor, so that clouds with one anchor sort points alike.
    """
    index = np.flatnonzero(cloud.candidate)
    xyz = cloud.xyz if len(index) == len(cloud) else cloud.xyz[index]
    shift = (0, 0)
    if cloud.anchor is not None:
        shift = tuple(round(v) for v in (cloud.origin[:2] - cloud.anchor) * cloud.units.xy)
    code = morton(xyz, shift)
    order = np.argsort(code)  # equal ones are ordered below
    code, z = code[order], xyz[order, 2]
    tied = np.zeros(len(code), bool)
    if len(code) > 1:
        same_xy = code[1:] == code[:-1]
        tied[1:] |= same_xy
        tied[:-1] |= same_xy
        rows = np.flatnonzero(tied)
        order[rows] = order[rows[np.lexsort((z[rows], code[rows]))]]
        z = xyz[order, 2]
        first = np.ones(len(code), bool)
        first[1:] = ~same_xy | (z[1:] != z[:-1])
    else:
        first = np.ones(len(code), bool)
    group = np.cumsum(first) - 1
    member = np.empty(len(order), np.int64)
    member[order] = group
    weight = np.bincount(group, minlength=int(first.sum())).astype(np.int32) if len(group) else np.zeros(0, np.int32)
    return Points(cloud, np.ascontiguousarray(xyz[order[first]]), index, member, weight)
