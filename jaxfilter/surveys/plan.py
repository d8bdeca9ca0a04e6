"""Tiles of a collection: which squares are filtered, and which files each of them reads and labels.

Bounds and numbers of points are arrays over all tiles, so that a survey of many files is planned in seconds.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from typing import Any

import numpy as np

from ..core.errors import SIZES, InputError, ParameterError, check_positive
from ..files.disk import Bounds
from .tiles import WHOLE

MOST_TILES, _ROW = 20_000_000, 1 << 32
_LARGEST_SIDE = 100_000.0  # metres
_ROUNDS = 12
_ROUNDED = 0.01
"""Units, and metres, by which bounds in headers may be off."""
POINTS, HALOS = 5_000_000, 6
"""Points of core and halo of a tile, and its width in halos, both sides included, at least: larger tiles save little."""
_SCATTERED, _NEAR = 4.0, 2000.0
"""Unless they lie in a box of more than so many times the area of the files, and larger than a square of so many metres."""


Lists = list[np.ndarray]
"""Numbers of files for each tile, or of tiles for each file, i64, ascending."""


def _lists(owner: np.ndarray, member: np.ndarray, count: int) -> Lists:
    """Of ``count`` owners, from pairs i64[p] of owner and member."""
    order = np.lexsort((member, owner))
    return np.split(member[order], np.searchsorted(owner[order], np.arange(1, count))) if count else []


def _turned(lists: Lists, count: int) -> Lists:
    """Owners by member, for ``count`` members."""
    owner = np.repeat(np.arange(len(lists)), [len(one) for one in lists])
    return _lists(_together(lists), owner, count)


def _together(lists: Lists) -> np.ndarray:
    return np.concatenate([np.zeros(0, np.int64), *lists])


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Tiles: those of :func:`plan_tiles` are numbered from the south-west, row by row.

    Attributes:
        width, height: of the cores, file units; halo: file units around a core that are read as well; lattice: file units;
            windows end at multiples of it.
        cores, windows: f64[t, 4], xmin, ymin, xmax, ymax of the tiles, file units, without and with the halo. Cores that adjoin
            have the same number for their common edge.
        points: f64[t], expected in core and halo, by the densities of the files.
        near: per tile, the files that core and halo may meet; home: those that the core may meet.
        tiles_of: per file, the tiles that label it.
        many: whether cores lie side by side in x, and in y; if in neither, the tile is all there is.
    """

    width: float
    height: float
    halo: float
    lattice: float
    cores: np.ndarray
    windows: np.ndarray
    points: np.ndarray
    near: Lists
    home: Lists
    tiles_of: Lists
    many: tuple[bool, bool]

    def __len__(self) -> int:
        return len(self.cores)

    def core(self, number: int) -> Bounds:
        """(xmin, ymin, xmax, ymax) of a tile, file units."""
        return tuple(self.cores[number].tolist())  # type: ignore[return-value]

    def window(self, number: int) -> Bounds:
        """The core and the halo around it, as far as the lattice."""
        return tuple(self.windows[number].tolist())  # type: ignore[return-value]

    def largest(self) -> tuple[float, float]:
        """Width and height that no window exceeds, file units, those at the edge of the data not counted beyond it."""
        more = 2 * (self.halo + self.lattice)
        return self.width + more * self.many[0], self.height + more * self.many[1]

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


def plan_boxes(bounds: np.ndarray, counts: np.ndarray, boxes: np.ndarray) -> Plan:
    """Tiles that lie anywhere. ``boxes``: f64[t, 2, 4], core and window of each, file units; ``bounds``, ``counts``: of files, as
    in :func:`plan_tiles`."""
    import shapely

    used = np.flatnonzero(counts > 0)
    tree = shapely.STRtree(shapely.box(*(bounds[used] + [-_ROUNDED, -_ROUNDED, _ROUNDED, _ROUNDED]).T))
    cores, windows = boxes[:, 0], boxes[:, 1]
    pairs = [tree.query(shapely.box(*kind.T)) for kind in (cores, windows)]
    home, near = (_lists(tile, used[file], len(boxes)) for tile, file in pairs)
    width, height = (windows[:, 2:] - windows[:, :2]).max(axis=0).tolist()
    points, turned = _expected(bounds, counts, windows, near), _turned(home, len(bounds))
    return Plan(width, height, 0.0, 0.0, cores, windows, points, near, home, turned, (True, True))


def _expected(bounds: np.ndarray, counts: np.ndarray, windows: np.ndarray, near: Lists) -> np.ndarray:
    """f64[t]: points in windows, f64[t, 4], by the densities of the files that are near."""
    tile, member = np.repeat(np.arange(len(near)), [len(one) for one in near]), _together(near)
    file, shares = bounds[member], np.ones(len(tile))
    for low, high in ((0, 2), (1, 3)):
        overlap = np.minimum(file[:, high], windows[tile, high]) - np.maximum(file[:, low], windows[tile, low])
        shares *= np.clip(overlap, 0, None) / np.maximum(file[:, high] - file[:, low], 1e-12)
    return np.bincount(tile, shares * counts[member], minlength=len(near))


def window_around(core: Bounds, halo: float, lattice: float) -> Bounds:
    """A box, ``halo`` around it, and further to multiples of ``lattice``; all in file units."""
    return tuple(_windows(np.array(core), halo, lattice).tolist())  # type: ignore[return-value]


def _windows(cores: np.ndarray, halo: float, lattice: float) -> np.ndarray:
    """f64[..., 4]: :func:`window_around` of each box."""
    low = np.floor((cores[..., :2] - halo) / lattice + 1e-6)
    return np.concatenate([low, np.ceil((cores[..., 2:] + halo) / lattice - 1e-6)], axis=-1) * lattice


def plan_tiles(
    bounds: np.ndarray,
    counts: np.ndarray,
    *,
    metre: float = 1.0,
    halo: float = 0.0,
    lattice: float = 1.0,
    side: float | None = None,
    reach: float | None = None,
) -> Plan:
    """Tiles over files, nearly square, all of one size, so that a whole number of them covers the data.

    Nothing but the files, the halo and the lattice decides on them, so that a run has the same tiles on every machine. Without
    a ``side``, core and halo have about :data:`POINTS` points, by the densities of the files, but are at least
    :data:`HALOS` halos wide; data of :data:`WHOLE` points or fewer are one tile.

    Args:
        bounds: f64[n, 4] of files: xmin, ymin, xmax, ymax, file units, all closed; counts: i64[n], points in each.
        metre: metres per file unit in x and y.
        halo: metres. lattice: metres; windows and cores end at multiples of it.
        side: of cores, metres; then they are squares that end at multiples of it, widened to a multiple of ``lattice``.
        reach: metres around a core in which files are near it, by default the halo.

    Raises: ParameterError for sides and halos that there are not; InputError for too many tiles.
    """
    if not 0 <= halo <= SIZES[1]:
        raise ParameterError(f"halo={halo!r}: must be metres >= 0")
    used = np.flatnonzero(counts > 0)
    units = (halo / metre, lattice / metre, (halo if reach is None else reach) / metre)
    if not len(used):
        return _tiles(bounds, counts, used, (0.0, 0.0), (1.0, 1.0), units)
    low, high = (pick(bounds[used][:, axes], axis=0) for pick, axes in ((np.min, [0, 1]), (np.max, [2, 3])))
    if side is not None:
        check_positive(" of metres", tile=side)
        step = lattice * max(1, math.ceil(side / lattice - 1e-9)) / metre
        return _tiles(bounds, counts, used, tuple(step * np.floor(low / step)), (step, step), units)
    unit = lattice / metre
    origin = unit * np.floor((low - _ROUNDED / metre) / unit)
    extent = (high - origin) * metre + _ROUNDED
    area = float(((bounds[used, 2] - bounds[used, 0]) * (bounds[used, 3] - bounds[used, 1])).sum()) * metre**2
    if counts.sum() <= WHOLE and np.prod(extent) <= max(_SCATTERED * area, _NEAR**2):
        return _tiles(bounds, counts, used, tuple(origin), tuple(unit * np.ceil(extent / lattice + 1e-6)), units)
    density = float(counts[used].sum()) / max(area, 1.0)
    most_points = max(POINTS, density * (HALOS * halo) ** 2)
    least = max(lattice, halo)
    guess = max(least, min(math.sqrt(most_points / density) - 2 * halo, float(extent.max()), _LARGEST_SIDE))
    for _ in range(_ROUNDS):
        sides = unit * np.ceil(extent / np.ceil(extent / guess) / lattice + 1e-6)
        plan = _tiles(bounds, counts, used, tuple(origin), tuple(sides), units)
        most = float(plan.points.max(initial=0.0))
        if most <= most_points or guess <= least:
            break
        guess = max(least, 0.95 * ((guess + 2 * halo) * math.sqrt(most_points / most) - 2 * halo))
    return plan


def _tiles(
    bounds: np.ndarray,
    counts: np.ndarray,
    used: np.ndarray,
    origin: tuple[float, ...],
    sides: tuple[float, ...],
    widths: tuple[float, float, float],
) -> Plan:
    """The plan of cores of such sides; all lengths in file units. ``used``: i64[k], the files with points; ``widths``: halo,
    lattice, and how far away files are near."""
    halo, lattice, reach = widths
    start, size = np.tile(np.array(origin), 2), np.array(sides)
    slack = min(1e-6 * size.min(), _ROUNDED / 2)
    box = bounds[used] - start + [-slack, -slack, slack, slack]
    key, file = _covered(box, used, size)
    tiles = np.unique(key)
    home = _lists(np.searchsorted(tiles, key), file, len(tiles))
    row = (tiles + _ROW // 2) // _ROW
    cell = np.stack([tiles - row * _ROW, row], axis=1)
    wide = reach + lattice
    key, file = _covered(box + [-wide, -wide, wide, wide], used, size)
    at = np.minimum(np.searchsorted(tiles, key), max(len(tiles) - 1, 0))
    kept = tiles[at] == key if len(tiles) else np.zeros(0, bool)
    near = _lists(at[kept], file[kept], len(tiles))
    cores = start + np.concatenate([cell, cell + 1], axis=1) * np.tile(size, 2)
    points = _expected(bounds, counts, cores + [-halo, -halo, halo, halo], near)
    (width, height), turned = size.tolist(), _turned(home, len(bounds))
    many = tuple((np.ptp(cell, axis=0) > 0).tolist()) if len(cell) else (False, False)
    windows = _windows(cores, halo, lattice)
    return Plan(width, height, halo, lattice, cores, windows, points, near, home, turned, many)


def _covered(box: np.ndarray, used: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """i64[p], i64[p]: all pairs of a cell of f64[2] sides, row times :data:`_ROW` and column, and a file whose box, f64[k, 4], it
    meets; ``used``: its number.

    Raises: InputError for too many pairs.
    """
    low, high = (np.floor(box[:, ends] / size).astype(np.int64) for ends in ([0, 1], [2, 3]))
    wide, tall = (high - low + 1).T
    pairs = wide * tall
    if len(pairs) and (pairs.sum() > 2 * MOST_TILES or max(-low.min(), high.max()) >= _ROW // 2):
        raise InputError(
            f"tiles of {size[0]:g} x {size[1]:g} units make {int(pairs.sum()):,} of them, and one file alone covers "
            f"{int(pairs.max()):,}: pass tile= with more, or remove stray points far from the rest"
        )
    owner = np.repeat(np.arange(len(used)), pairs)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    row, column = np.divmod(step, wide[owner])
    return (low[owner, 1] + row) * _ROW + low[owner, 0] + column, used[owner]
