"""Initial ground seed points."""

from __future__ import annotations

import numpy as np

from ..core.points import Points


def lowest_per_window(points, window, stride, barred):
    ok = np.flatnonzero(~barred)
    xyz = points.xyz[ok].astype(np.float64)
    low, high = points.xyz[:, :2].min(0).astype(float), points.xyz[:, :2].max(0).astype(float)
    m = max(1, round(window / stride))
    n = [max(1, int(np.floor((high[a] - low[a] - window) / stride)) + 1) for a in range(2)]
    nc = [max(1, int(np.ceil((high[a] - low[a]) / stride))) for a in range(2)]
    c = [np.clip(((xyz[:, a] - low[a]) // stride).astype(int), 0, nc[a] - 1) for a in range(2)]
    cell = c[1] * nc[0] + c[0]
    order = np.lexsort((ok, xyz[:, 2], cell))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(cell[order]) != 0
    pick = order[first]
    rk = np.lexsort((ok[pick], xyz[pick, 2]))
    big = len(pick)
    g = np.full((nc[1], nc[0]), big)
    g.ravel()[cell[pick[rk]]] = np.arange(big)
    out = []
    for iy in range(n[1]):
        y1 = nc[1] if iy == n[1] - 1 else iy + m
        for ix in range(n[0]):
            x1 = nc[0] if ix == n[0] - 1 else ix + m
            v = g[iy:y1, ix:x1].min()
            if v < big:
                out.append(v)
    return np.sort(ok[pick[rk[np.unique(out)]]])


def lowest_per_cell(points, cell, barred):
    return lowest_per_window(points, cell, cell, barred)
