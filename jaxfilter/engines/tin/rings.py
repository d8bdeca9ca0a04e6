"""Compiled statistics of the vertices of a triangulation among their neighbours in it."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .walks import MANY


@compiled
def _beside(triangles, neighbours, start, node, found):
    """Write the vertices in the triangles at a node and across the edges facing it to ``found``, counter-clockwise: how many,
    -1 if there is no room for them, and at which to begin in an order that only the nodes decide."""
    count, begin, least, t, most = 0, 0, MANY, start, len(found) - 2
    while count <= most:
        row = np.uint32(t)
        k = 0 if triangles[row, 0] == node else 1 if triangles[row, 1] == node else 2
        one, two = (1, 2) if k == 0 else (2, 0) if k == 1 else (0, 1)
        a, b = triangles[row, one], triangles[row, two]
        if a < least:
            least, begin = a, count
        if a >= 0:
            found[np.uint32(count)] = a
            count += 1
            if b >= 0:
                across = np.uint32(neighbours[row, k])
                apex = triangles[across, 0] + triangles[across, 1] + triangles[across, 2] - a - b
                if apex >= 0:
                    found[np.uint32(count)] = apex
                    count += 1
        t = neighbours[row, one]
        if t == start:
            return count, begin
    return -1, 0


@compiled
def residuals(xyz, triangles, neighbours, where, nodes, e):
    """Metres of vertices above the plane of least squares through their neighbours, and those across the facing edges.

    Args:
        xyz: f32[k, 3]; triangles, neighbours, where: as in :class:`jaxfilter.engines.tin.triangulation.Tin`.
        nodes: i64[n], vertices.
        e: f32[k], written to for ``nodes``; zero with fewer than four neighbours, or with all on a line.
    """
    found = np.empty(64, np.int32)
    for node in nodes:
        n, begin = _beside(triangles, neighbours, where[node], node, found)
        while n < 0:
            found = np.empty(2 * len(found), np.int32)
            n, begin = _beside(triangles, neighbours, where[node], node, found)
        e[node] = 0.0
        if n < 4:
            continue
        x0, y0, z0 = np.float64(xyz[node, 0]), np.float64(xyz[node, 1]), np.float64(xyz[node, 2])
        sx = sy = sz = sxx = sxy = syy = sxz = syz = 0.0
        for i in range(begin, begin + n):
            beside = np.uint32(found[np.uint32(i if i < n else i - n)])
            dx, dy, dz = xyz[beside, 0] - x0, xyz[beside, 1] - y0, xyz[beside, 2] - z0
            sx, sy, sz = sx + dx, sy + dy, sz + dz
            sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
            sxz, syz = sxz + dx * dz, syz + dy * dz
        cxx, cxy, cyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        cxz, cyz = sxz - sx * sz / n, syz - sy * sz / n
        det = cxx * cyy - cxy * cxy
        if det <= 1e-6 * cxx * cyy:
            continue
        east, north = (cxz * cyy - cyz * cxy) / det, (cyz * cxx - cxz * cxy) / det
        e[node] = -(sz - east * sx - north * sy) / n


@compiled
def roughness(triangles, neighbours, where, nodes, e, out):
    """Root mean square of ``e``, f32[k], over the same neighbours; f32[k], written for ``nodes``."""
    found = np.empty(64, np.int32)
    for node in nodes:
        n, begin = _beside(triangles, neighbours, where[node], node, found)
        while n < 0:
            found = np.empty(2 * len(found), np.int32)
            n, begin = _beside(triangles, neighbours, where[node], node, found)
        total = 0.0
        for i in range(begin, begin + n):
            total += np.float64(e[np.uint32(found[np.uint32(i if i < n else i - n)])]) ** 2
        out[node] = np.sqrt(total / max(1, n))
