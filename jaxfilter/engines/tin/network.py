"""From seeds to the network that densification starts from, border points and sheets of blocks included."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ...core.errors import InputError
from ...core.frame import QUANTUM, perturbed
from ...core.points import Points
from ..neighbours import tree_of
from .growth import Network, Outliers

PAD = 0.25
"""Metres between the extent of the points and the simulated border points around it."""
_MOST = 200_000
"""Simulated border points, at most: those every 10 m around 500 km."""
CORNER_GAP = 10.0
"""Metres between the extent of the points and four simulated corner points (Uray & Varlik 2024)."""


def block_count(extent: np.ndarray, size: float) -> tuple[int, int]:
    """Blocks per axis over an extent f64[2] in metres: whole blocks only, the last one absorbs what is left over."""
    return max(1, int(extent[0] // size)), max(1, int(extent[1] // size))


def border_positions(
    low: np.ndarray, high: np.ndarray, size: float, corner: np.ndarray, name: str = "size"
) -> np.ndarray:
    """f32[b, 2]: the nodes of the block grid on the perimeter of the extent, and its corners (Li et al. 2021, Sec. II-D).

    They stand :data:`PAD` outside the extent, on straight lines, so that every point lies inside their hull. The nodes are
    multiples of the size from the anchor; ``corner``, f64[2], metres, says how far the zero of local coordinates is from it.
    Blocks of :func:`block_networks` begin at the lowest point instead.

    Raises: InputError, which calls the size ``name``, where nodes would be more than :data:`_MOST`, or fall together.
    """
    nx, ny = block_count(high - low, size)
    apart = max(8 * QUANTUM, 4 * float(np.spacing(np.float32(high.max()))))
    if nx + ny > _MOST // 2 or (nx + ny > 2 and size < apart):
        width, height = high - low
        raise InputError(
            f"{name}={size:g} m: this puts {2 * (nx + ny):.3g} simulated points around {width:.6g} x {height:.6g} m; "
            f"there may be {_MOST:,} at most, and they must be at least {apart:g} m apart: use a larger value"
        )
    sides = []
    for axis in range(2):
        first, last = (int(turn((end[axis] + corner[axis]) / size)) for turn, end in ((np.floor, low), (np.ceil, high)))
        number = np.arange(first, last + 1)
        along = np.clip(number * size - corner[axis], low[axis], high[axis])
        along[0] -= PAD
        along[-1] += PAD
        for edge, sign in ((low, -1.0), (high, 1.0)):
            side = np.empty((len(along), 2))
            side[:, axis] = along
            side[:, 1 - axis] = edge[1 - axis] + sign * PAD
            sides.append(side if axis == 0 else side[1:-1])  # the corners belong to the first two sides
    return np.concatenate(sides).astype(np.float32)


def corner_positions(low: np.ndarray, high: np.ndarray, gap: float = CORNER_GAP) -> np.ndarray:
    """f32[4, 2]: the corners of the extent f64[2], f64[2] after it has been widened by ``gap`` metres on every side."""
    (west, south), (east, north) = low - gap, high + gap
    return np.array([[west, south], [east, south], [east, north], [west, north]], np.float32)


def with_elevation(border: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """f32[b, 3]: border positions f32[b, 2] with the elevation of the nearest point of f32[s, 3] in the plane."""
    if len(border) == 0:
        return np.zeros((0, 3), np.float32)
    _, nearest = tree_of(perturbed(xyz)).query(border.astype(np.float64))
    return np.column_stack([border, xyz[nearest, 2]]).astype(np.float32)


def one_network(points: Points, seeds: np.ndarray, border: np.ndarray, outliers: Outliers) -> Network:
    """All points in one sheet: ``seeds``, i64[s], are rows of them, ``border``, f32[b, 2], positions around them."""
    sheet = np.arange(len(points)), np.ones(len(points), bool), with_elevation(border, points.xyz[seeds])
    return _join(points, [sheet], seeds, outliers)


def with_nodes(network: Network, xyz: np.ndarray) -> Network:
    """A network of one sheet with more simulated nodes, f32[n, 3], local metres, at positions where it has none."""
    more = (0, len(xyz))
    return dataclasses.replace(
        network,
        xyz=np.concatenate([network.xyz, xyz]),
        sheet=np.pad(network.sheet, more),
        row=np.pad(network.row, more, constant_values=-1),
        seed=np.pad(network.seed, more, constant_values=True),
        open=np.pad(network.open, more),
        late=np.pad(network.late, more),
    )


def _join(
    points: Points, sheets: list[tuple[np.ndarray, np.ndarray, np.ndarray]], seeds: np.ndarray, outliers: Outliers
) -> Network:
    """Sheets, each of points i64[n], ascending, of which some are open, bool[n], and of border nodes f32[b, 3]."""
    xyz, row, opened = [], [], []
    for own, is_open, ring in sheets:
        xyz += [points.xyz[own] if len(own) < len(points) else points.xyz, ring]
        row += [own, np.full(len(ring), -1)]
        opened += [is_open, np.zeros(len(ring), bool)]
    point = _chain(row)
    is_seed = np.zeros(len(points) + 1, bool)
    is_seed[seeds] = is_seed[-1] = True  # the last is for border nodes, whose row is -1
    closed = np.append(outliers.barred & outliers.removed, False)
    return Network(
        points=points,
        xyz=_chain(xyz),
        sheet=np.repeat(np.arange(len(sheets), dtype=np.int32), [len(own) + len(ring) for own, _, ring in sheets]),
        row=point,
        seed=is_seed[point],
        open=_chain(opened) & ~closed[point],
        late=np.append(outliers.late, False)[point],
        outliers=outliers,
    )


def _chain(parts: list[np.ndarray]) -> np.ndarray:
    """The rows of all parts; where they are those of one part, it is not copied."""
    filled = [part for part in parts if len(part) > 0]
    return filled[0] if len(filled) == 1 else np.concatenate(parts)


def block_networks(
    points: Points,
    seeds: np.ndarray,
    border: np.ndarray,
    outliers: Outliers,
    *,
    size: float,
    overlap: float,
    reach: float,
) -> Network:
    """One sheet per square block (Li et al. 2021, Sec. II-D): blocks share seeds, but not what grows from them.

    A block's sheet holds the points within the block widened by ``overlap`` (these are open), and the seeds and border
    points within ``reach`` of the block's centre. Where these do not surround the block, simulated points at the corners of
    the widened block, with the elevation of the nearest seed, complete them. Empty blocks have no sheet. All in metres.
    """
    low, high = points.extent
    shape = block_count(high - low, size)
    edges = [np.append(low[a] + size * np.arange(shape[a]), high[a]) for a in range(2)]
    seed_xyz = points.xyz[seeds]
    virtual = with_elevation(border, seed_xyz)
    sheets = []
    for (column, line), inside in _widen(points, edges, overlap):
        corner = np.array([[edges[0][column], edges[1][line]], [edges[0][column + 1], edges[1][line + 1]]])
        centre = corner.mean(axis=0)
        close = seeds[((seed_xyz[:, :2] - centre) ** 2).sum(axis=1) <= reach**2]
        own = np.union1d(inside, close)
        ring = virtual[((virtual[:, :2] - centre) ** 2).sum(axis=1) <= reach**2]
        around = np.concatenate([points.xyz[close], ring])
        if not _surrounds(around[:, :2], points.xyz[inside, :2]):
            frame = corner_positions(corner[0] - overlap - PAD, corner[1] + overlap + PAD, PAD)[[0, 1, 3, 2]]
            ring = np.concatenate([ring, with_elevation(frame, seed_xyz)])
        sheets.append((own, np.isin(own, inside, assume_unique=True), ring))
    return _join(points, sheets, seeds, outliers)


def _widen(points: Points, edges: list[np.ndarray], overlap: float) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """Column and line of each block that holds points when it is widened, and their rows, i64, ascending.

    ``edges``: of the columns, f64[nx + 1], and of the lines, f64[ny + 1].
    """

    def within(rows: np.ndarray, axis: int, number: int) -> np.ndarray:
        at = points.xyz[rows, axis].astype(np.float64)
        return rows[(at >= edges[axis][number] - overlap) & (at <= edges[axis][number + 1] + overlap)]

    for line in range(len(edges[1]) - 1):
        strip = within(np.arange(len(points)), 1, line)
        for column in range(len(edges[0]) - 1):
            if len(inside := within(strip, 0, column)):
                yield (column, line), inside


def _surrounds(around: np.ndarray, inside: np.ndarray) -> bool:
    """Whether every one of the points ``inside`` lies in the convex hull of the positions ``around``, both f32[., 2]."""
    if len(around) < 3:
        return False
    import shapely  # other methods do without, and this import takes a part of the time of a small file

    hull = shapely.linestrings(around.astype(np.float64)).convex_hull.buffer(-PAD / 2)
    shapely.prepare(hull)
    return bool(shapely.contains_xy(hull, inside.astype(np.float64)).all())
