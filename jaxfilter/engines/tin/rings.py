"""Compiled statistics of the vertices of a triangulation among their neighbours in it."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .walks import MANY


@compiled
def _beside(triangles, neighbours, start, node, real, found):
    """The vertices with ``real`` in the triangles at a node and across the edges facing it, counter-clockwise: how many, at
    which to begin in an order that only the nodes decide, and ``found`` with them, or a larger array in its place."""
    count, begin, least, t = 0, 0, MANY, start
    while True:
        if count + 4 > len(found):
            found = np.concatenate((found, found))
        k = 0 if triangles[t, 0] == node else 1 if triangles[t, 1] == node else 2
        a, b = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
        if a < least:
            least, begin = a, count
        if a >= 0 and real[a]:
            found[count] = a
            count += 1
        if a >= 0 and b >= 0:
            across = neighbours[t, k]
            for j in range(3):
                apex = triangles[across, j]
                if apex >= 0 and apex != a and apex != b and real[apex]:
                    found[count] = apex
                    count += 1
        t = neighbours[t, (k + 1) % 3]
        if t == start:
            break
    return count, begin, found


@compiled
def residuals(xyz, triangles, neighbours, where, nodes, real, e):
    """Metres of vertices above the plane of least squares through their neighbours, and those across the facing edges.

    Args:
        xyz: f32[k, 3]; triangles, neighbours, where: as in :class:`jaxfilter.engines.tin.triangulation.Tin`.
        nodes: i64[n], vertices; real: bool[k], vertices that count as neighbours.
        e: f32[k], written to for ``nodes``; zero with fewer than four neighbours, or with all on a line.
    """
    found = np.empty(64, np.int64)
    for node in nodes:
        n, begin, found = _beside(triangles, neighbours, where[node], node, real, found)
        e[node] = 0.0
        if n < 4:
            continue
        x0, y0, z0 = np.float64(xyz[node, 0]), np.float64(xyz[node, 1]), np.float64(xyz[node, 2])
        sx = sy = sz = sxx = sxy = syy = sxz = syz = 0.0
        for i in range(begin, begin + n):
            beside = found[i if i < n else i - n]
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
def roughness(triangles, neighbours, where, nodes, real, e, out):
    """Root mean square of ``e``, f32[k], over the same neighbours; f32[k], written for ``nodes``."""
    found = np.empty(64, np.int64)
    for node in nodes:
        n, begin, found = _beside(triangles, neighbours, where[node], node, real, found)
        total = 0.0
        for i in range(begin, begin + n):
            total += np.float64(e[found[i if i < n else i - n]]) ** 2
        out[node] = np.sqrt(total / max(1, n))
