"""Objects that the border of the data cuts: what stands there above its surroundings, and how it is labelled.

A roof of which only a part was surveyed has ground on one side only. A method may take it for a terrace, and nothing in its
labels says so. Here the surface of the lowest points is looked at, whatever the method, and then the labels on it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import InputError, warn
from ..core.grid import grid_over
from ..core.points import pieces, plain_points
from ..core.result import FilterResult
from ..engines.neighbours import groups
from ..files.disk import Bounds
from ..steps.surfaces import cell_for

REACH = 100.0
"""Metres that a cut object reaches into the data at most; what reaches further is taken for terrain."""
STEP = 0.7
"""Rise over run between neighbouring cells of one object, at most: roofs are seldom steeper than 35 degrees."""
DROP, DROP_SHARE = 2.5, 0.5
"""Metres that the surface falls by within two cells, and the share of the inner border of an object where it falls so."""
AREA, TOUCH = 20.0, 3.0
"""Square metres, and metres along the border of the data, that an object has at least."""
_CELLS = 6  # that it has at least
_CLOSED = 2  # cells: voids of up to twice as many are no border
_MARGIN = 2 * _CLOSED + 1

_Box = tuple[float, float, float, float]
"""xmin, ymin, xmax, ymax, local metres."""


@dataclasses.dataclass(frozen=True)
class CutObject:
    """An object that touches the border of the data.

    Attributes:
        x, y: middle of its cells, file coordinates; bounds: (xmin, ymin, xmax, ymax) of them.
        area: square metres that are in the data. touch: metres along the border.
        fall: metres from it to what surrounds it, the median along its inner border.
        ground: share of its cells whose lowest point is ground, 0 to 1.

    >>> x, y = np.meshgrid(np.arange(0.5, 60), np.arange(0.5, 60))
    >>> roof = (x > 45) & (abs(y - 30) < 8)
    >>> points = np.stack([x, y, np.where(roof, 6.0, 0.0)], axis=-1).reshape(-1, 3)
    >>> cut = jf.cut_objects(points, ~roof.ravel())[0]
    >>> cut.area, cut.touch, cut.fall, cut.ground
    (225.0, 15.0, 6.0, 0.0)
    """

    x: float
    y: float
    bounds: Bounds
    area: float
    touch: float
    fall: float
    ground: float

    @property
    def is_ground(self) -> bool:
        """Whether most of it is labelled ground, which is wrong if it is a roof.

        >>> jf.CutObject(53.0, 30.5, (45.5, 23.0, 60.5, 38.0), area=225.0, touch=15.0, fall=6.0, ground=1.0).is_ground
        True
        """
        return self.ground >= 0.5


def cut_objects(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    *,
    footprints: Iterable[Bounds] | None = None,
    window: Bounds | None = None,
    core: Bounds | None = None,
) -> list[CutObject]:
    """Objects that touch the border of the data and may be cut roofs, by the lowest points and labels of a classification.

    The surface of the lowest candidates, in cells of at least a metre, is cut into segments whose neighbouring cells differ by
    less than :data:`STEP` times the cell. A segment is listed if it touches the border, reaches no further than
    :data:`REACH` into the data, has :data:`AREA` and :data:`TOUCH`, and if the surface falls by :data:`DROP` along
    :data:`DROP_SHARE` of its border with other segments. So dense trees and cliffs are listed as well as roofs.

    The border is where data end to the outside: voids, such as water, that ``footprints`` enclose are none.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: what is ground: a FilterResult, or bool[n].
        footprints: rectangles that are known to hold all data, file coordinates; by default the extent of the cloud.
        window: of a cloud that was cut out of more data: the box that was read; its edges are no border.
        core: only objects whose southernmost touching cell (of several, the westernmost) has its middle in this box.

    Returns: list of CutObject, from south to north.
    Raises: InputError for labels that do not fit. Warns: if the extent is too large for a grid, and returns none.

    >>> x, y = np.meshgrid(np.arange(0.5, 60), np.arange(0.5, 60))
    >>> roof = (x > 45) & (abs(y - 30) < 8)
    >>> points = np.stack([x, y, np.where(roof, 6.0, 0.0)], axis=-1).reshape(-1, 3)
    >>> everything = np.ones(len(points), bool)
    >>> [one.is_ground for one in jf.cut_objects(points, everything)], jf.cut_objects(cloud, truth)
    ([True], [])
    """
    cloud = as_cloud(cloud)
    ground = result.ground if isinstance(result, FilterResult) else np.asarray(result)
    if ground.shape != (len(cloud),) or ground.dtype != bool:
        raise InputError(f"result: bool[{len(cloud)}] is needed for this cloud, not {ground.dtype}{list(ground.shape)}")
    if not cloud.candidate.any():
        return []
    try:
        frame = _Frame.of(cloud)
    except InputError as error:  # labels are none the worse for it
        warn(f"objects that the border of the data cuts are not looked for: {error}")
        return []
    boxes = None if footprints is None else [frame.local(box) for box in footprints]
    outside, unknown = frame.beyond(boxes, None if window is None else frame.local(window))
    if not outside.any():
        return []
    covered, z, is_ground = _surface(frame, ground)
    outside = _connected(~_closed(covered) & ~unknown, outside)
    found = _standing(_filled(z), outside, is_ground, frame.cell)
    objects = [(frame.place(one), one) for one in found]
    if core is not None:
        x0, y0, x1, y1 = core
        objects = [(at, one) for at, one in objects if x0 <= at[0] < x1 and y0 <= at[1] < y1]
    return [frame.described(one) for _, one in sorted(objects, key=lambda pair: (pair[0][1], pair[0][0]))]


class _Found(NamedTuple):
    """Rows and columns i64[k] of the cells of an object, its first touching cell, and what is measured of it."""

    row: np.ndarray
    column: np.ndarray
    first: tuple[int, int]
    touching: int
    fall: float
    ground: float


@dataclasses.dataclass(frozen=True)
class _Frame:
    """Cells of ``cell`` metres around a cloud, with a margin; (``x0``, ``y0``): local metres of the corner."""

    cloud: PointCloud
    x0: float
    y0: float
    cell: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, cloud: PointCloud) -> _Frame:
        cell = cell_for(plain_points(cloud).spacing(), 1.5)
        known = cloud.xyz if cloud.valid is None else cloud.xyz[cloud.valid]
        grid = grid_over(known, cell, cloud.grid_offset(cell), name="cut_objects: cell")
        lag = _MARGIN * cell
        return cls(cloud, grid.x0 - lag, grid.y0 - lag, cell, (grid.ny + 2 * _MARGIN, grid.nx + 2 * _MARGIN))

    def cells_of(self, xyz: np.ndarray) -> np.ndarray:
        """i64[n]: the cell that each of the local points f32[n, 3] is in, row by row."""
        row, column = (
            np.floor((xyz[:, axis] - corner) / self.cell).astype(np.int64)
            for axis, corner in ((1, self.y0), (0, self.x0))
        )
        return row * self.shape[1] + column

    def beyond(self, boxes: list[_Box] | None, window: _Box | None) -> tuple[np.ndarray, np.ndarray]:
        """bool[rows, columns] twice: cells that certainly lie outside of the data, which are the margin, or what no box meets;
        and those that the window cuts or leaves out, so that nothing is known of them."""
        outside, unknown = np.ones(self.shape, bool), np.zeros(self.shape, bool)
        if boxes is None:
            outside[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN] = False
            return outside, unknown
        (x, y), half = self.centres(), self.cell / 2
        for x0, y0, x1, y1 in boxes:
            outside[np.ix_((y + half > y0) & (y - half <= y1), (x + half > x0) & (x - half <= x1))] = False
        if window is not None:
            x0, y0, x1, y1 = window
            unknown[:, (x - half < x0) | (x + half > x1)] = True
            unknown[(y - half < y0) | (y + half > y1)] = True
            unknown &= ~outside  # boxes that are not known lie further than a cell from the window
            outside[:, (x + half < x0 - self.cell) | (x - half > x1 + self.cell)] = False
            outside[(y + half < y0 - self.cell) | (y - half > y1 + self.cell)] = False
        return outside, unknown

    def local(self, box: Bounds) -> tuple[float, float, float, float]:
        """A box in file coordinates in local metres."""
        factor, (x, y) = self.cloud.units.xy, self.cloud.origin[:2]
        return (box[0] - x) * factor, (box[1] - y) * factor, (box[2] - x) * factor, (box[3] - y) * factor

    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """f64[columns], f64[rows]: middles of the cells, local metres."""
        rows, columns = self.shape
        return self.x0 + (np.arange(columns) + 0.5) * self.cell, self.y0 + (np.arange(rows) + 0.5) * self.cell

    def place(self, one: _Found) -> tuple[float, float]:
        """File coordinates of the middle of the first touching cell."""
        x, y = self.centres()
        return self._file(float(x[one.first[1]]), float(y[one.first[0]]))

    def described(self, one: _Found) -> CutObject:
        """An object in file coordinates and metres."""
        x, y = self.centres()
        half = self.cell / 2
        low = self._file(float(x[one.column.min()]) - half, float(y[one.row.min()]) - half)
        high = self._file(float(x[one.column.max()]) + half, float(y[one.row.max()]) + half)
        middle = self._file(float(x[one.column].mean()), float(y[one.row].mean()))
        return CutObject(
            *middle, (*low, *high), len(one.row) * self.cell**2, one.touching * self.cell, one.fall, one.ground
        )

    def _file(self, x: float, y: float) -> tuple[float, float]:
        factor, origin = self.cloud.units.xy, self.cloud.origin
        return float(origin[0]) + x / factor, float(origin[1]) + y / factor


def _surface(frame: _Frame, ground: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """bool[rows, columns], cells with points; f32, the lowest elevation of the candidates in each, infinite without any; and
    bool, whether it is ground. ``ground``: bool[n]."""
    cloud = frame.cloud
    covered, is_ground = np.zeros(frame.shape, bool), np.zeros(frame.shape, bool)
    z = np.full(frame.shape, np.inf, np.float32)
    cell = np.empty(len(cloud), np.int32)
    flat, level, judged = z.reshape(-1), cloud.xyz[:, 2], None if cloud.candidate.all() else cloud.candidate
    for part in pieces(len(cloud)):
        at = frame.cells_of(cloud.xyz[part])
        cell[part] = at
        covered.flat[at if cloud.valid is None else at[cloud.valid[part]]] = True
        if judged is None:
            np.minimum.at(flat, at, level[part])
        else:
            np.minimum.at(flat, at[judged[part]], level[part][judged[part]])
    for part in pieces(len(cloud)):
        lowest = ground[part] & cloud.candidate[part] & (level[part] == flat[cell[part]])
        is_ground.flat[cell[part][lowest]] = True
    return covered, z, is_ground


def _over_square(values: np.ndarray, steps: int, pick: np.ufunc) -> np.ndarray:
    """[rows, columns]: what ``pick``, such as ``np.minimum``, leaves of all that is at most so many rows and columns away."""
    for axis in range(2):
        values = np.moveaxis(values, axis, 0)
        reach = 0
        while reach < steps:
            lag = min(reach + 1, steps - reach)  # so that what lies beyond the array is not missed
            before, values = values, values.copy(order="K")
            pick(values[lag:], before[:-lag], out=values[lag:])
            pick(values[:-lag], before[lag:], out=values[:-lag])
            reach += lag
        values = np.moveaxis(values, 0, axis)
    return values


def _closed(known: np.ndarray) -> np.ndarray:
    """bool[rows, columns]: cells with data, and those between them."""
    return _over_square(_over_square(known, _CLOSED, np.logical_or), _CLOSED, np.logical_and)


def _filled(z: np.ndarray) -> np.ndarray:
    """f32[rows, columns]: cells between cells with an elevation get the lowest beside them."""
    known = np.isfinite(z)
    inside = _closed(known)
    for _ in range(_CLOSED):
        z = np.where(known | ~inside, z, _over_square(z, 1, np.minimum))
        known = np.isfinite(z)
    return z


def _components(cells: np.ndarray, across: np.ndarray, along: np.ndarray) -> np.ndarray:
    """i64[k]: the component of each of the marked ``cells``, bool[rows, columns], row by row, numbered as they appear.

    ``across``: bool[rows, columns - 1], cells that are joined to the next in their row; ``along``: bool[rows - 1, columns], to
    that in the next row.
    """
    begins = cells.copy()
    begins[:, 1:] &= ~across
    run = np.cumsum(begins, dtype=np.int32).reshape(cells.shape) - 1
    one, other = run[:-1][along], run[1:][along]
    new = np.ones(len(one), bool)
    new[1:] = (one[1:] != one[:-1]) | (other[1:] != other[:-1])
    return groups(one[new], other[new], int(run[-1, -1]) + 1)[run[cells]]


def _connected(free: np.ndarray, start: np.ndarray) -> np.ndarray:
    """bool[rows, columns]: the components of ``free`` that hold a cell of ``start``."""
    name = _components(free, free[:, 1:] & free[:, :-1], free[1:] & free[:-1])
    held = np.zeros(len(name) + 1, bool)
    held[name[start[free]]] = True
    out = np.zeros_like(free)
    out[free] = held[name]
    return out


def _standing(z: np.ndarray, outside: np.ndarray, is_ground: np.ndarray, cell: float) -> list[_Found]:
    """The segments that touch the outside and stand above what surrounds them."""
    near = _over_square(outside, math.ceil(REACH / cell), np.logical_or)
    strip = np.isfinite(z) & _over_square(near, 1, np.logical_or)
    if not strip.any():
        return []
    joined, walls = [], np.zeros(z.shape, bool)
    for one, other in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:, :], np.s_[:-1, :])):
        both = strip[one] & strip[other]
        with np.errstate(invalid="ignore"):
            level = both & (np.abs(z[one] - z[other]) < np.float32(STEP * cell))
        joined.append(level)
        walls[one] |= both & ~level
        walls[other] |= both & ~level
    segment = _components(strip, *joined)
    touching = _beside(outside)[strip]
    of = np.bincount(segment, touching)
    deep = np.bincount(segment, ~near[strip])
    cells = np.bincount(segment)
    with np.errstate(invalid="ignore"):
        fall = (z - _over_square(z, 2, np.minimum))[strip]
    wall = walls[strip]
    border = np.bincount(segment, wall)
    falling = np.bincount(segment, wall & (fall > np.float32(DROP)))
    large = (of * cell >= TOUCH) & (cells >= max(_CELLS, AREA / cell**2))
    listed = large & (deep == 0) & (border > 0) & (falling >= DROP_SHARE * border)
    rows, columns = np.nonzero(strip)
    ground = is_ground[strip]
    found = []
    for number in np.flatnonzero(listed).tolist():
        at = np.flatnonzero(segment == number)
        first = at[touching[at]][0]
        found.append(
            _Found(
                rows[at],
                columns[at],
                (int(rows[first]), int(columns[first])),
                int(of[number]),
                float(np.median(fall[at][wall[at]])),
                float(ground[at].mean()),
            )
        )
    return found


def _beside(outside: np.ndarray) -> np.ndarray:
    """bool[rows, columns]: cells that share an edge with a cell of ``outside``."""
    near = np.zeros_like(outside)
    near[1:] |= outside[:-1]
    near[:-1] |= outside[1:]
    near[:, 1:] |= outside[:, :-1]
    near[:, :-1] |= outside[:, 1:]
    return near
