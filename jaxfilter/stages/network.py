"""From seeds to the network that densification starts from, border points and sheets of blocks included, and back to labels."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from ..core.filter import Labels
from ..core.points import Points
from ..core.result import Decision, Status
from ..host.neighbours import perturbed
from .densify import Densification
from .growth import Network

PAD = 0.25
"""Metres between the extent of the points and the simulated border points around it."""
_BULGE = 0.05
CORNER_GAP = 10.0
"""Metres between the extent of the points and four simulated corner points (Uray & Varlik 2024)."""


def block_count(extent: np.ndarray, size: float) -> tuple[int, int]:
    """Blocks per axis over an extent f64[2] in metres: whole blocks only, the last one absorbs what is left over."""
    return max(1, int(extent[0] // size)), max(1, int(extent[1] // size))


def border_positions(low: np.ndarray, high: np.ndarray, size: float, corner: np.ndarray | None = None) -> np.ndarray:
    """f32[2 (nx + ny), 2]: the nodes of the block grid on the perimeter of the extent (Li et al. 2021, Sec. II-D).

    They stand :data:`PAD` outside the extent, and the sides bulge by a few centimetres, so that no three are collinear
    and every point lies inside their hull. Blocks begin at the lower corner of the extent, or at multiples of their size
    from the anchor, when ``corner``, f64[2], metres, says how far the zero of local coordinates is from it.
    """
    nx, ny = block_count(high - low, size)
    sides = []
    for axis, n in ((0, nx), (1, ny)):
        if corner is None:
            along = low[axis] + size * np.arange(n + 1)
            along[-1] = high[axis]
            t = (along - low[axis]) / max(float(high[axis] - low[axis]), 1e-9)
            bulge = PAD + _BULGE * 4.0 * t * (1.0 - t)
        else:
            first, last = (
                int(turn((end[axis] + corner[axis]) / size)) for turn, end in ((np.floor, low), (np.ceil, high))
            )
            number = np.arange(first, last + 1)
            bulge = PAD + _BULGE * np.array([0.0, 0.4, 1.0])[number % 3]
            along = np.clip(number * size - corner[axis], low[axis], high[axis])
        along[0] -= PAD
        along[-1] += PAD
        for edge, sign in ((low, -1.0), (high, 1.0)):
            side = np.empty((len(along), 2))
            side[:, axis] = along
            side[:, 1 - axis] = edge[1 - axis] + sign * bulge
            sides.append(side if axis == 0 else side[1:-1])  # the corners belong to the first two sides
    return np.concatenate(sides).astype(np.float32)


def corner_positions(low: np.ndarray, high: np.ndarray, gap: float = CORNER_GAP) -> np.ndarray:
    """f32[4, 2]: the corners of the extent f64[2], f64[2] after it has been widened by ``gap`` metres on every side."""
    (west, south), (east, north) = low - gap, high + gap
    return np.array([[west, south], [east, south], [east, north], [west, north]], np.float32)


def with_elevation(border: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """f32[b, 3]: border positions f32[b, 2] with the elevation of the nearest point of f32[s, 3] in the plane."""
    _, nearest = cKDTree(perturbed(xyz)).query(border.astype(np.float64))
    return np.column_stack([border, xyz[nearest, 2]]).astype(np.float32)


def one_network(
    points: Points, seeds: np.ndarray, border: np.ndarray, barred: np.ndarray, late: np.ndarray, **more: Any
) -> Network:
    """All points in one sheet.

    Args:
        seeds: i64[s], rows of ``points``; border: f32[b, 2] positions; barred, late: bool[m], see :class:`Network`.
        more: further fields of it.
    """
    m, b = len(points), len(border)
    virtual = with_elevation(border, points.xyz[seeds])
    seed = np.zeros(m + b, bool)
    seed[seeds] = True
    seed[m:] = True
    return Network(
        points=points,
        xyz=np.concatenate([points.xyz, virtual]),
        sheet=np.zeros(m + b, np.int32),
        row=np.concatenate([np.arange(m), np.full(b, -1)]),
        seed=seed,
        open=np.arange(m + b) < m,
        late=np.concatenate([late, np.zeros(b, bool)]),
        barred=barred,
        **more,
    )


def block_networks(
    points: Points,
    seeds: np.ndarray,
    border: np.ndarray,
    barred: np.ndarray,
    late: np.ndarray,
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
    xy = points.xyz[:, :2].astype(np.float64)
    low, high = points.extent
    nx, ny = block_count(high - low, size)
    edges = [np.append(low[a] + size * np.arange(n), high[a]) for a, n in enumerate((nx, ny))]
    home = [np.clip(np.searchsorted(edges[a][1:-1], xy[:, a], side="right"), 0, n - 1) for a, n in enumerate((nx, ny))]
    rows, blocks = [], []
    near = max(1, int(np.ceil(overlap / size)))
    for dx in range(-near, near + 1):
        for dy in range(-near, near + 1):
            bx, by = home[0] + dx, home[1] + dy
            ok = (bx >= 0) & (bx < nx) & (by >= 0) & (by < ny)
            for b, edge, v in ((bx, edges[0], xy[:, 0]), (by, edges[1], xy[:, 1])):
                b = np.clip(b, 0, len(edge) - 2)
                ok &= (v >= edge[b] - overlap) & (v <= edge[b + 1] + overlap)
            rows.append(np.flatnonzero(ok))
            blocks.append((by * nx + bx)[ok])
    row, block = np.concatenate(rows), np.concatenate(blocks)
    order = np.lexsort((row, block))
    row, block = row[order], block[order]
    is_seed = np.zeros(len(points), bool)
    is_seed[seeds] = True
    seed_xyz = points.xyz[seeds]
    virtual = with_elevation(border, seed_xyz)
    parts: list[tuple[np.ndarray, ...]] = []
    for sheet, (number, start) in enumerate(zip(*np.unique(block, return_index=True), strict=True)):
        stop = np.searchsorted(block, number, side="right")
        inside = row[start:stop]
        corner = np.array(
            [[edges[0][number % nx], edges[1][number // nx]], [edges[0][number % nx + 1], edges[1][number // nx + 1]]]
        )
        centre = corner.mean(axis=0)
        close = ((seed_xyz[:, :2] - centre) ** 2).sum(axis=1) <= reach**2
        outside = np.setdiff1d(seeds[close], inside, assume_unique=True)
        own = np.union1d(inside, outside)
        ring = virtual[((virtual[:, :2] - centre) ** 2).sum(axis=1) <= reach**2]
        around = np.concatenate([points.xyz[seeds[close]], ring])
        if not _surrounds(around[:, :2], corner[0] - overlap, corner[1] + overlap, points.xyz[inside, :2]):
            frame = border_positions(corner[0] - overlap - PAD, corner[1] + overlap + PAD, 1e9)
            ring = np.concatenate([ring, with_elevation(frame, seed_xyz)])
        parts.append(
            (
                np.concatenate([points.xyz[own], ring]),
                np.full(len(own) + len(ring), sheet, np.int32),
                np.concatenate([own, np.full(len(ring), -1)]),
                np.concatenate([is_seed[own], np.ones(len(ring), bool)]),
                np.concatenate([np.isin(own, inside, assume_unique=True), np.zeros(len(ring), bool)]),
                np.concatenate([late[own], np.zeros(len(ring), bool)]),
            )
        )
    xyz, sheets, row, seed, opened, lates = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Network(points, xyz, sheets, row, seed, opened, lates, barred)


def _surrounds(around: np.ndarray, low: np.ndarray, high: np.ndarray, inside: np.ndarray) -> bool:
    """Whether every one of the points ``inside`` lies in the convex hull of the positions ``around``, both f32[., 2]."""
    if len(around) < 3:
        return False
    try:
        hull = ConvexHull(around.astype(np.float64))
    except QhullError:
        return False
    corners = np.array([[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]])
    normal, offset = hull.equations[:, :2], hull.equations[:, 2]
    if (normal @ corners.T + offset[:, None] < -PAD / 2).all():
        return True
    return bool((normal @ inside.astype(np.float64).T + offset[:, None] < -PAD / 2).all())


def labels_of(network: Network, out: Densification, keep_labels: bool) -> Labels:
    """From nodes back to points: ground where any sheet accepts it; quantities from a sheet that does, else from any."""
    points, barred = network.points, network.barred
    barred = np.zeros(len(points), bool) if barred is None else barred
    real = np.flatnonzero(network.row >= 0)
    order = real
    if network.sheet[-1] > 0:  # accepting sheets last, so that they prevail
        order = real[np.argsort(out.ground[real], kind="stable")]
    row = network.row[order]

    def gather(values: np.ndarray) -> np.ndarray:
        spread = np.zeros(len(points), values.dtype)
        spread[row] = values[order]
        return spread

    names = ("ground", "height", "slope", "angle", "elevation", "margin", "decision")
    found = {name: gather(getattr(out, name)) for name in names}
    trace = out.trace
    if network.before is not None:
        before, trace = network.before, network.before.trace + trace
        assert before.decision is not None
        earlier = before.ground & (before.decision != Decision.SEED)
        for name in ("angle", "elevation", "margin", "decision"):
            found[name][earlier] = getattr(before, name)[earlier]
    if keep_labels:
        for step in out.trace:
            any_sheet = np.zeros(len(points), bool)
            any_sheet[row[step["ground"][order]]] = True
            step["ground"] = any_sheet
    late, seeds = np.zeros(len(points), bool), np.zeros(len(points), bool)
    late[network.row[real[network.late[real]]]] = True
    seeds[network.row[real[network.seed[real]]]] = True
    return Labels(
        **found,
        barred=barred,
        status=Status.CONVERGED if out.converged else Status.ROUND_LIMIT,
        info={
            "sheets": int(network.sheet[-1]) + 1,
            "seeds": int(seeds.sum()),
            "border_points": len(network.virtual),
            "rounds": len(out.trace),
            "facets": len(out.tin),
            "vertices": int(out.tin.vertex.sum()),
            "barred": int(points.weight[barred].sum()),
            "barred_low_clusters": int(points.weight[late].sum()),
            "barred_then_ground": int(points.weight[barred & found["ground"]].sum()),
            **network.info,
        },
        trace=trace,
    )
