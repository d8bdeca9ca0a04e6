"""Tiles of a collection: which boxes are filtered, and which files each of them reads and labels.

Tiles follow the points: small where these lie dense, large where they are few, and none where there are none.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.cloud import QUANTUM
from ..core.errors import SIZES, InputError, ParameterError, check_positive
from ..core.reading import Bounds
from ..files.sources import SCATTERED, SQUARE, WHOLE, Squares, square_keys, squares_of
from .collection import Collection
from .product import Cut

TILE_POINTS = 7_000_000
"""Points of core and halo of a tile, at most, unless halos hold too many of them."""
MOST_READ = 2.5
"""Times that a tile may be read in parts instead of in one piece, halos included, so that each part has fewer points."""
MOST_TILES, _MOST_SQUARES = 20_000_000, 1_000_000
_NEAR = 1500.0
"""Metres: points in a square of this side are not scattered."""
_ROUNDED = 0.01
"""Units by which bounds in headers may be off."""

Lists = list[np.ndarray]
"""Numbers of files for each tile, or of tiles for each file, i64, ascending."""


@dataclasses.dataclass(frozen=True, eq=False)
class Where:
    """Where the points of n files lie, by squares that hold some.

    Attributes:
        bounds: f64[n, 4], xmin, ymin, xmax, ymax of files, file units, all closed; counts: i64[n], points in each.
        metre: metres per file unit in x and y.
        low, high: f64[m, 2], corners of the squares, file units, as far as there are files. points: f64[m], about, in each.
    """

    bounds: np.ndarray
    counts: np.ndarray
    metre: float
    low: np.ndarray
    high: np.ndarray
    points: np.ndarray

    @classmethod
    def from_files(
        cls, bounds: np.ndarray, counts: np.ndarray, metre: float = 1.0, found: Mapping[int, Squares] | None = None
    ) -> Where:
        """``found``: squares of those files that are not filled by their points; others are taken to be filled evenly.

        Raises: InputError for an extent that is too large.
        """
        known = found or {}
        used = np.array([n for n in np.flatnonzero(counts > 0).tolist() if n not in known], np.int64)
        slack = QUANTUM / metre * np.array([-1, -1, 1, 1])  # coordinates are rounded
        box = bounds[used] + slack
        area = float((box[:, 2:] - box[:, :2]).prod(axis=1).sum()) * metre**2
        larger = 2 ** max(0, math.ceil(math.log2(max(math.sqrt(area / _MOST_SQUARES) / SQUARE, 1.0))))
        side = larger * SQUARE / metre
        owner, square = _covered(box, np.array([side, side]))
        corner = square * side
        overlap = np.minimum(box[owner, 2:], corner + side) - np.maximum(box[owner, :2], corner)
        held = (overlap / (box[owner, 2:] - box[owner, :2])).prod(axis=1) * counts[used[owner]]
        parts = [(square, held), *((places // larger, points) for places, points in known.values())]
        square = np.concatenate([one for one, _ in parts])
        held = np.concatenate([points for _, points in parts])
        first, member = np.unique(square_keys(square), return_index=True, return_inverse=True)[1:]
        low = square[first] * side
        filled = counts > 0
        limits = np.array([-np.inf] * 4)
        if filled.any():
            limits = np.append(bounds[filled, :2].min(axis=0), bounds[filled, 2:].max(axis=0)) + slack
        low, high = np.maximum(low + slack[:2], limits[:2]), np.minimum(low + side + slack[2:], limits[2:])
        there = (low < high).all(axis=1)
        return cls(bounds, counts, metre, low[there], high[there], np.bincount(member, held, len(first))[there])

    def meeting(self, box: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Those of the squares i64[k] that a box, f64[4], meets."""
        low, high = self.low[rows], self.high[rows]
        return rows[((low < box[2:]) & (high > box[:2])).all(axis=1)]

    def held(self, box: np.ndarray, rows: np.ndarray) -> float:
        """Points, about, that the squares i64[k] have in a box, f64[4]."""
        low, high = self.low[rows], self.high[rows]
        share = (np.minimum(high, box[2:]) - np.maximum(low, box[:2])) / (high - low)
        return float(self.points[rows] @ np.clip(share, 0, 1).prod(axis=1))

    @property
    def spacing(self) -> float | None:
        """Mean distance of points, metres, about; None if there are none."""
        area = float((self.high - self.low).prod(axis=1).sum()) * self.metre**2
        return math.sqrt(area / self.points.sum()) if area and self.points.any() else None

    @property
    def fills(self) -> bool:
        """Whether the points fill their extent so far that they can be one tile, if they are few enough."""
        return not len(self.points) or self.fill(np.arange(len(self.points)))

    def fill(self, rows: np.ndarray) -> bool:
        """Whether the squares i64[k] are a good part of the box around them, or this is small."""
        low, high = self.low[rows], self.high[rows]
        extent, squares = (high.max(axis=0) - low.min(axis=0)).prod(), (high - low).prod(axis=1).sum()
        return bool(extent * self.metre**2 <= max(_NEAR**2, SCATTERED * squares * self.metre**2))


def where_of(files: Collection) -> Where:
    """Where the points of a collection lie. Raises: InputError if its files differ in units."""
    found = {n: squares for n, source in enumerate(files) if (squares := squares_of(source)) is not None}
    return Where.from_files(files.footprints, files.counts, files.metre, found)


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Tiles, from the south to the north.

    Attributes:
        halo: metres around a core that are read as well.
        cores, windows: f64[t, 4], xmin, ymin, xmax, ymax of the tiles, file units, without and with the halo. Cores that adjoin
            have the same number for their common edge.
        points: f64[t], expected in core and halo.
        near: per tile, the files that core and halo may meet; home: those that the core may meet.
        tiles_of: per file, the tiles that label it.
        whole: whether the only tile is all there is.
    """

    halo: float
    cores: np.ndarray
    windows: np.ndarray
    points: np.ndarray
    near: Lists
    home: Lists
    tiles_of: Lists
    whole: bool

    def __len__(self) -> int:
        return len(self.cores)

    def core(self, number: int) -> Bounds:
        """(xmin, ymin, xmax, ymax) of a tile, file units."""
        return tuple(self.cores[number].tolist())  # type: ignore[return-value]

    def window(self, number: int) -> Bounds:
        """The core and the halo around it, as far as the lattice."""
        return tuple(self.windows[number].tolist())  # type: ignore[return-value]

    def part(self, rows: np.ndarray) -> Plan:
        """With some of the tiles only, i64[k], ascending."""
        parts: dict[str, Any] = {name: getattr(self, name)[rows] for name in ("cores", "windows", "points")}
        parts |= {name: [getattr(self, name)[row] for row in rows.tolist()] for name in ("near", "home")}
        return dataclasses.replace(self, **parts, tiles_of=_turned(parts["home"], len(self.tiles_of)))

    def times_read(self, count: int) -> float:
        """How many times each of ``count`` points is read, halos included; 1 without any."""
        return float(self.points.sum()) / count if count else 1.0

    def digest(self) -> str:
        """Tells this plan from others."""
        found = hashlib.sha256()
        for array in (self.cores, self.windows, *(part for lists in (self.home, self.near) for part in lists)):
            found.update(np.ascontiguousarray(array).tobytes() + b";")
        return found.hexdigest()


def plan_tiles(where: Where, cut: Cut, side: float | None = None) -> Plan:
    """Tiles over files. Nothing but where the points lie, the halo and the lattice decides on them, so that a run has the same
    tiles on every machine.

    Without a ``side``, a tile is halved until core and halo have at most :data:`TILE_POINTS` points, unless its parts would be
    read :data:`MOST_READ` times; and until its points fill a part of 1 / :data:`SCATTERED` of it. Data of at most :data:`WHOLE`
    points that fill their extent are one tile. ``side``: of cores, metres; then they are squares that end at multiples of it,
    widened to a multiple of the lattice.

    Raises: ParameterError for sides and halos that there are not; InputError for too many tiles.
    """
    if not 0 <= cut.halo <= SIZES[1]:
        raise ParameterError(f"halo={cut.halo!r}: must be metres >= 0")
    if cut.boxes is not None:
        return _plan(where, cut, cut.boxes[:, 0], cut.boxes[:, 1])
    if side is not None:
        check_positive(" of metres", tile=side)
    if not len(where.points):
        cores = np.zeros((0, 4))
    else:
        cores = _halved(where, cut) if side is None else _squares_of(where, cut, side)
    return _plan(where, cut, cores, _windows(cores, cut.halo / where.metre, cut.lattice / where.metre))


def _plan(where: Where, cut: Cut, cores: np.ndarray, windows: np.ndarray) -> Plan:
    """The plan of such cores that meet a file, f64[t, 4], and windows."""
    import shapely

    used = np.flatnonzero(where.counts > 0)
    files = shapely.STRtree(shapely.box(*(where.bounds[used] + [-_ROUNDED, -_ROUNDED, _ROUNDED, _ROUNDED]).T))
    squares = shapely.STRtree(shapely.box(*where.low.T, *where.high.T))

    def meeting(boxes: np.ndarray, tree: shapely.STRtree, numbers: np.ndarray) -> Lists:
        tile, member = tree.query(shapely.box(*boxes.T))
        return _lists(tile, numbers[member], len(boxes))

    home = meeting(cores, files, used)
    if cut.boxes is None and not all(map(len, home)):
        kept = np.array([len(one) > 0 for one in home])
        cores, windows, home = cores[kept], windows[kept], [one for one in home if len(one)]
    more = 0.0 if cut.reach is None else max(0.0, cut.reach - cut.halo) / where.metre
    near = meeting(windows + [-more, -more, more, more], files, used)
    inside = meeting(windows, squares, np.arange(len(where.points)))
    points = np.array([where.held(window, rows) for window, rows in zip(windows, inside, strict=True)], np.float64)
    one = len(cores) == 1 and cut.boxes is None
    return Plan(cut.halo, cores, windows, points, near, home, _turned(home, len(where.bounds)), one)


def _squares_of(where: Where, cut: Cut, side: float) -> np.ndarray:
    """f64[t, 4]: cores of one size, in rows. Raises: InputError for too many."""
    step = cut.lattice * max(1, math.ceil(side / cut.lattice - 1e-9)) / where.metre
    beyond = cut.beyond / where.metre
    low, high = where.low, where.high  # nothing is made beyond all of them
    low, high = np.maximum(low - beyond, low.min(axis=0)), np.minimum(high + beyond, high.max(axis=0))
    square = _covered(np.concatenate([low, high], axis=1), np.array([step, step]))[1]
    column, row = square[np.unique(square_keys(square), return_index=True)[1]].T
    return np.stack([column, row, column + 1, row + 1], axis=1) * step


def _halved(where: Where, cut: Cut) -> np.ndarray:
    """f64[t, 4]: cores that are cut where their points are too many, or scattered."""
    halo, lattice, beyond = (length / where.metre for length in (cut.halo, cut.lattice, cut.beyond))
    few, cores = where.counts.sum() <= WHOLE, []
    everything = np.append(where.low.min(axis=0), where.high.max(axis=0))
    parts = [(_windows(everything, 0.0, lattice), np.arange(len(where.points)))]
    while parts:
        core, rows = parts.pop()
        own = where.meeting(core + np.array([-beyond, -beyond, beyond, beyond]), rows)
        if not len(own):
            continue
        ends = np.append(where.low[own].min(axis=0) - beyond, where.high[own].max(axis=0) + beyond)
        ends = np.append(np.floor(ends[:2] / lattice), np.ceil(ends[2:] / lattice)) * lattice
        core = np.append(np.maximum(core[:2], ends[:2]), np.minimum(core[2:], ends[2:]))
        window = _windows(core, halo, lattice)
        near = where.meeting(window, rows)
        held, fills = where.held(window, near), where.fill(near)
        dense = held > TILE_POINTS and not few
        halves, read = [], math.inf
        for axis in (0, 1) if dense or not fills else ():
            pair = _halves(where, core, own, axis, (halo, lattice, math.ceil(held / TILE_POINTS) if dense else 0))
            windows = _windows(np.array(pair).reshape(-1, 4), halo, lattice)
            times = sum(where.held(one, where.meeting(one, near)) for one in windows)
            if pair and times < read and (not fills or times <= MOST_READ * where.held(core, own)):
                halves, read = pair, times
        if halves:
            wide = max(beyond, halo + lattice)
            parts += [(half, where.meeting(core + np.array([-wide, -wide, wide, wide]), rows)) for half in halves]
        else:
            cores.append(core)
    found = np.array(cores)
    return found[np.lexsort((found[:, 0], found[:, 1]))]


def _halves(
    where: Where, core: np.ndarray, own: np.ndarray, axis: int, how: tuple[float, float, int]
) -> list[np.ndarray]:
    """Two parts of a core, f64[4], that is cut across an axis: in the middle of the widest gap where this is wider than two
    halos, else so that ``parts`` of as many points become of it, or, for 0, in the middle. None for a core that is too small.
    ``how``: halo, lattice, parts."""
    halo, lattice, parts = how
    order = np.argsort(where.low[own, axis], kind="stable")
    low, high = where.low[own[order], axis], np.maximum.accumulate(where.high[own[order], axis])
    gaps, side = low[1:] - high[:-1], core[axis + 2] - core[axis]
    if len(gaps) and gaps.max() > 2 * (halo + lattice):
        at, least = (low[1:] + high[:-1])[gaps.argmax()] / 2, lattice
    elif parts:
        sums = where.points[own[order]].cumsum()
        at, least = low[np.searchsorted(sums, sums[-1] * (parts // 2 / parts))], max(lattice, 2 * halo)
    else:
        at, least = core[axis] + side / 2, max(lattice, 2 * halo)
    if side < 2 * least:
        return []
    before, after = core.copy(), core.copy()
    before[axis + 2] = after[axis] = lattice * round(min(max(at, core[axis] + least), core[axis + 2] - least) / lattice)
    return [before, after]


def window_around(core: Bounds, halo: float, lattice: float) -> Bounds:
    """A box, ``halo`` around it, and further to multiples of ``lattice``; all in file units."""
    return tuple(_windows(np.array(core), halo, lattice).tolist())  # type: ignore[return-value]


def _windows(cores: np.ndarray, halo: float, lattice: float) -> np.ndarray:
    """f64[..., 4]: :func:`window_around` of each box."""
    low = np.floor((cores[..., :2] - halo) / lattice + 1e-6)
    return np.concatenate([low, np.ceil((cores[..., 2:] + halo) / lattice - 1e-6)], axis=-1) * lattice


def _covered(box: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """i64[p], i64[p, 2]: all pairs of a box f64[k, 4] and a square of such sides that it meets, by column and row.

    Raises: InputError for too many.
    """
    low, high = np.floor(box[:, :2] / side), np.floor(box[:, 2:] / side)
    pairs = (high - low + 1).prod(axis=1)
    if len(pairs) and pairs.sum() > 2 * MOST_TILES:
        raise InputError(
            f"tiles of {side[0]:g} x {side[1]:g} units make {int(pairs.sum()):,} of them, and one file alone covers "
            f"{int(pairs.max()):,}: pass tile= with more, or remove stray points far from the rest"
        )
    wide, count = (high - low + 1)[:, 0].astype(np.int64), pairs.astype(np.int64)
    owner = np.repeat(np.arange(len(box)), count)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(step, wide[owner])
    return owner, low[owner].astype(np.int64) + np.stack([column, row], axis=1)


def _lists(owner: np.ndarray, member: np.ndarray, count: int) -> Lists:
    """Of ``count`` owners, from pairs i64[p] of owner and member."""
    order = np.lexsort((member, owner))
    return np.split(member[order], np.searchsorted(owner[order], np.arange(1, count))) if count else []


def _turned(lists: Lists, count: int) -> Lists:
    """Owners by member, for ``count`` members."""
    owner = np.repeat(np.arange(len(lists)), [len(one) for one in lists])
    return _lists(np.concatenate([np.zeros(0, np.int64), *lists]), owner, count)
