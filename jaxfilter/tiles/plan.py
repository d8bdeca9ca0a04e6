"""Tiles of a collection: which squares are filtered, and which files each of them reads and labels.

Everything is arrays over all tiles, so that a survey of a million files is planned in seconds.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math

import numpy as np

from ..core.errors import InputError, ParameterError

MOST_TILES = 20_000_000
_LARGEST_SIDE = 100_000.0  # metres
_ROUNDS = 12


@dataclasses.dataclass(frozen=True, eq=False)
class Lists:
    """A list of file numbers for each of ``len(start) - 1`` tiles, or of tile numbers for each file.

    Attributes:
        start: i64[k + 1]; member: i32[start[-1]], ascending within each list.
    """

    start: np.ndarray
    member: np.ndarray

    def __getitem__(self, number: int) -> np.ndarray:
        return self.member[self.start[number] : self.start[number + 1]]

    def __len__(self) -> int:
        return len(self.start) - 1

    @classmethod
    def of(cls, owner: np.ndarray, member: np.ndarray, count: int) -> Lists:
        """From pairs i64[p], i32[p] of owner and member."""
        order = np.lexsort((member, owner))
        start = np.zeros(count + 1, np.int64)
        np.cumsum(np.bincount(owner, minlength=count), out=start[1:])
        return cls(start, member[order].astype(np.int32))

    def turned(self, count: int) -> Lists:
        """Owners by member, for ``count`` members."""
        owner = np.repeat(np.arange(len(self), dtype=np.int32), np.diff(self.start))
        return Lists.of(self.member.astype(np.int64), owner, count)


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """Tiles, numbered from the south-west, row by row.

    Attributes:
        side: of the cores, file units; a core is [i side, (i + 1) side) in x and y, half open, for whole numbers i.
        halo: file units around a core that are read as well.
        cell: i64[t, 2], the number i of every tile in x and in y.
        points: f64[t], expected in core and halo, by the densities of the files.
        near: per tile, the files that core and halo may meet; home: those that the core may meet.
        tiles_of: per file, the tiles that label it.
    """

    side: float
    halo: float
    cell: np.ndarray
    points: np.ndarray
    near: Lists
    home: Lists
    tiles_of: Lists

    def __len__(self) -> int:
        return len(self.cell)

    def core(self, number: int) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax) of a tile, file units."""
        x, y = (int(v) for v in self.cell[number])
        return x * self.side, y * self.side, (x + 1) * self.side, (y + 1) * self.side

    def window(self, number: int) -> tuple[float, float, float, float]:
        """The core and the halo around it."""
        x0, y0, x1, y1 = self.core(number)
        return x0 - self.halo, y0 - self.halo, x1 + self.halo, y1 + self.halo

    def largest(self, bounds: np.ndarray) -> tuple[float, float]:
        """Width and height of the largest window, as far as the files, f64[n, 4], reach; file units."""
        known = bounds[np.diff(self.tiles_of.start) > 0]
        if not len(known):
            return 0.0, 0.0
        wide = self.side + 2 * self.halo
        return tuple(  # type: ignore[return-value]
            float(min(wide, known[:, axis + 2].max() - known[:, axis].min())) for axis in range(2)
        )

    def digest(self) -> str:
        """Tells this plan from others."""
        found = hashlib.sha256(f"{self.side!r} {self.halo!r} {len(self)}".encode())
        for array in (self.cell, self.home.start, self.home.member, self.near.start, self.near.member):
            found.update(np.ascontiguousarray(array).data)
        return found.hexdigest()


def plan_tiles(
    bounds: np.ndarray,
    counts: np.ndarray,
    *,
    metre: float,
    halo: float,
    lattice: float = 1.0,
    most_points: float = math.inf,
    side: float | None = None,
) -> Plan:
    """Square tiles over files.

    Args:
        bounds: f64[n, 4] of files: xmin, ymin, xmax, ymax, file units, all closed; counts: i64[n], points in each.
        metre: metres per file unit in x and y.
        halo: metres; widened to a multiple of ``lattice``, metres, as the sides of cores are.
        most_points: in core and halo, as the densities of the files have it; decides the side, unless that is given.
        side: of cores, metres; widened to a multiple of ``lattice``.

    Raises: ParameterError if a core as wide as its halo has too many points; InputError for too many tiles.
    """
    used = np.flatnonzero(counts > 0)
    wide = lattice * math.ceil(halo / lattice - 1e-9)
    if side is not None:
        if not side > 0:
            raise ParameterError(f"tile={side!r}: must be > 0 metres")
        return _tiles(bounds, counts, used, lattice * math.ceil(side / lattice - 1e-9) / metre, wide / metre)
    area = (bounds[used, 2] - bounds[used, 0]) * (bounds[used, 3] - bounds[used, 1]) * metre**2
    total = float(np.sum(counts[used]))
    density = total / max(float(area.sum()), 1.0)
    least = max(lattice, 2 * wide)
    room = math.sqrt(most_points / density) - 2 * wide if density > 0 and math.isfinite(most_points) else math.inf
    spread = float(max(np.ptp(bounds[used][:, [0, 2]]), np.ptp(bounds[used][:, [1, 3]]))) * metre if len(used) else 0.0
    guess = min(room, spread + lattice, _LARGEST_SIDE)
    for _ in range(_ROUNDS):
        cells = max(1, math.floor(max(guess, least) / lattice + 1e-9))
        plan = _tiles(bounds, counts, used, cells * lattice / metre, wide / metre)
        most = float(plan.points.max(initial=0.0))
        if most <= most_points:
            return plan
        if guess <= least:
            break
        guess = max(least, 0.95 * ((guess + 2 * wide) * math.sqrt(most_points / most) - 2 * wide))
    raise ParameterError(
        f"a tile of {plan.side * metre:g} m with a halo of {wide:g} m holds about {most:,.0f} points, more than the "
        f"{most_points:,.0f} that the memory is good for: pass a smaller halo=, more memory=, or fewer workers="
    )


def _tiles(bounds: np.ndarray, counts: np.ndarray, used: np.ndarray, side: float, halo: float) -> Plan:
    """The plan of cores ``side`` wide with a ``halo``, both in file units; ``used``: i64[k], the files with points."""
    slack = 1e-6 * side  # headers round
    box = bounds[used] + [-slack, -slack, slack, slack]
    key, file, width = _covered(box, used, side)
    tiles = np.unique(key)
    home = Lists.of(np.searchsorted(tiles, key), file, len(tiles))
    cell = np.stack([tiles % width.columns + width.west, tiles // width.columns + width.south], axis=1)
    if halo > 0:
        key, file, _ = _covered(box + [-halo, -halo, halo, halo], used, side, width)
        at = np.minimum(np.searchsorted(tiles, key), max(len(tiles) - 1, 0))
        kept = tiles[at] == key if len(tiles) else np.zeros(0, bool)
        near = Lists.of(at[kept], file[kept], len(tiles))
    else:
        near = home
    tile = np.repeat(np.arange(len(tiles)), np.diff(near.start))
    shares = np.ones(len(tile))
    for axis in range(2):
        low, high = bounds[near.member, axis], bounds[near.member, axis + 2]
        west = cell[tile, axis] * side - halo
        overlap = np.minimum(high, west + side + 2 * halo) - np.maximum(low, west)
        shares *= np.clip(overlap, 0, None) / np.maximum(high - low, 1e-12) if len(tile) else 1.0
    points = np.bincount(tile, np.minimum(shares, 1.0) * counts[near.member], minlength=len(tiles))
    return Plan(side, halo, cell, points, near, home, home.turned(len(bounds)))


@dataclasses.dataclass(frozen=True)
class _Frame:
    """The cells that the keys of tiles count: ``columns`` to a row, from (``west``, ``south``)."""

    west: int
    south: int
    columns: int


def _covered(
    box: np.ndarray, used: np.ndarray, side: float, frame: _Frame | None = None
) -> tuple[np.ndarray, np.ndarray, _Frame]:
    """i64[p], i32[p]: all pairs of a cell ``side`` wide and a file whose box, f64[k, 4], it meets; ``used``: its number.

    Raises: InputError for too many pairs.
    """
    low, high = (np.floor(box[:, ends] / side).astype(np.int64) for ends in ([0, 1], [2, 3]))
    if frame is None:
        west, south = (int(low[:, axis].min(initial=2**62)) if len(low) else 0 for axis in range(2))
        frame = _Frame(west - 1, south - 1, (int(high[:, 0].max()) if len(high) else 0) - west + 3)
    first, last = frame.west, frame.west + frame.columns - 1
    low[:, 0], high[:, 0] = np.clip(low[:, 0], first, last), np.clip(high[:, 0], first, last)
    wide, tall = (high - low + 1).T
    pairs = wide * tall
    if len(pairs) and pairs.sum() > 2 * MOST_TILES:
        worst = int(used[int(np.argmax(pairs))])
        raise InputError(
            f"tiles of {side:g} units make {int(pairs.sum()):,} of them; file number {worst} covers {int(pairs.max()):,}: pass "
            "a larger tile=, or remove stray points far from the rest"
        )
    owner = np.repeat(np.arange(len(used)), pairs)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
    row, column = np.divmod(step, wide[owner])
    key = (low[owner, 1] + row - frame.south) * frame.columns + low[owner, 0] + column - frame.west
    return key, used[owner].astype(np.int32), frame
