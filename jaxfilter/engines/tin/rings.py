"""Compiled statistics of the vertices of a triangulation among their neighbours in it."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from ..plane_sums import slopes_by_sums
from .walks import ahead, behind, place

_slopes = compiled(slopes_by_sums)


@compiled
def _beside(triangles, neighbours, t, node):
    """Of a triangle at a node: the vertex after the node, the one across the edge facing it (-1: none), and the next triangle."""
    row = np.uint32(t)
    k = place(triangles, t, node)
    a, b, apex = triangles[row, ahead(k)], triangles[row, behind(k)], np.int32(-1)
    if a >= 0 and b >= 0:
        across = np.uint32(neighbours[row, k])
        apex = np.int32(triangles[across, 0] + triangles[across, 1] + triangles[across, 2] - a - b)
    return a, apex, neighbours[row, ahead(k)]


@compiled
def _first(triangles, neighbours, start, node):
    """The triangle at a node to begin with, in an order that only the nodes decide: that whose next vertex is the first."""
    first = t = start
    least, _, t = _beside(triangles, neighbours, t, node)
    while t != start:
        here = t
        a, _, t = _beside(triangles, neighbours, t, node)
        if a < least:
            least, first = a, here
    return first


@compiled
def residuals(xyz, triangles, neighbours, where, nodes, e):
    """Metres of vertices above the plane of least squares through their neighbours, and those across the facing edges.

    Sums of products are exact for coordinates in steps of a quantum, so that the order of neighbours decides nothing.

    Args:
        xyz: f32[k, 3]; triangles, neighbours, where: as in :class:`jaxfilter.engines.tin.triangulation.Tin`.
        nodes: i64[n], vertices.
        e: f32[k], written to for ``nodes``; zero with fewer than four neighbours, or with all on a line.
    """
    for node in nodes:
        x0, y0, z0 = np.float64(xyz[node, 0]), np.float64(xyz[node, 1]), np.float64(xyz[node, 2])
        sx = sy = sz = sxx = sxy = syy = sxz = syz = 0.0
        n, t = 0, where[node]
        while True:
            a, apex, t = _beside(triangles, neighbours, t, node)
            for beside in (a, apex):
                if beside >= 0:
                    row = np.uint32(beside)
                    dx, dy, dz = xyz[row, 0] - x0, xyz[row, 1] - y0, xyz[row, 2] - z0
                    sx, sy, sz = sx + dx, sy + dy, sz + dz
                    sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
                    sxz, syz = sxz + dx * dz, syz + dy * dz
                    n += 1
            if t == where[node]:
                break
        e[node] = 0.0
        if n < 4:
            continue
        cxx, cxy, cyy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
        east, north, det = _slopes(cxx, cxy, cyy, sxz - sx * sz / n, syz - sy * sz / n)
        if det > 1e-6 * cxx * cyy:
            e[node] = -(sz - east / det * sx - north / det * sy) / n


@compiled
def roughness(triangles, neighbours, where, nodes, e, out):
    """Root mean square of ``e``, f32[k], over the same neighbours; f32[k], written for ``nodes``."""
    for node in nodes:
        n, total = 0, 0.0
        first = t = _first(triangles, neighbours, where[node], node)
        while True:
            a, apex, t = _beside(triangles, neighbours, t, node)
            for beside in (a, apex):
                if beside >= 0:
                    total += np.float64(e[np.uint32(beside)]) ** 2
                    n += 1
            if t == first:
                break
        out[node] = np.sqrt(total / max(n, 1))
