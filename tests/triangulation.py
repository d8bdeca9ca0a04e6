"""The triangulation that networks must have, made anew from integer positions: by a sweep, then flips in Python's integers.

It is the Delaunay triangulation of positions on a lattice. Of four positions on a circle the last, in order of x, then y,
counts as lifted off the paraboloid, that is as outside the circle of the other three; so the triangulation is unique.
"""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial import cKDTree

from experiments.bench.triangulation import Position, power, turn


def in_circle(a: Position, b: Position, c: Position, p: Position) -> bool:
    """Whether p lies inside the circle through a, b, c, which turn to the left, with the tie rule."""
    value = power(a, b, c, p)
    if value != 0:
        return value > 0
    last = max(a, b, c, p)
    if last == p:
        return False
    one, two = (q for q in (a, b, c) if q != last)
    return turn(one, two, p) * turn(one, two, last) > 0  # else p is the one across from it, and stays outside


def triangulation(xy: np.ndarray) -> np.ndarray:
    """i64[t, 3]: the triangles of integer positions [n, 2], distinct and not on a line, counter-clockwise.

    Each begins with its first corner; they are in order of their corners.
    """
    xy = np.asarray(xy, np.int64)
    p = [(x, y) for x, y in xy.tolist()]
    triangles = _flipped(p, np.array(_sweep(p)))
    first = (triangles.argmin(axis=1)[:, None] + np.arange(3)) % 3
    triangles = np.take_along_axis(triangles, first, axis=1)
    return triangles[np.lexsort(triangles.T[::-1])]


def _sweep(p: list[Position]) -> list[tuple[int, int, int]]:
    """Some triangulation: positions from west to east, each joined to what it sees of the hull of those before it."""
    order = sorted(range(len(p)), key=p.__getitem__)
    k = next(k for k in range(2, len(p)) if turn(p[order[0]], p[order[1]], p[order[k]]) != 0)
    run, tip = order[:k], order[k]
    if turn(p[run[0]], p[run[1]], p[tip]) < 0:
        run = run[::-1]
    out, ring = [(a, b, tip) for a, b in itertools.pairwise(run)], [*run, tip]
    for q in order[k + 1 :]:
        seen = [turn(p[a], p[b], p[q]) < 0 for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        first = next(i for i in range(len(ring)) if seen[i] and not seen[i - 1])
        ring, many = ring[first:] + ring[:first], sum(seen)
        ring.append(ring[0])
        out += [(b, a, q) for a, b in itertools.pairwise(ring[: many + 1])]
        ring = [ring[0], q, *ring[many:-1]]
    return out


def _flipped(p: list[Position], triangles: np.ndarray) -> np.ndarray:
    """The triangles after flips of edges until each is right."""
    apex = {edge: t[k] for t in triangles.tolist() for k, edge in enumerate(((t[1], t[2]), (t[2], t[0]), (t[0], t[1])))}
    todo = [(a, b) for a, b in apex if a < b]
    while todo:
        a, b = todo.pop()
        if (a, b) not in apex or (b, a) not in apex:
            continue
        c, d = apex[a, b], apex[b, a]
        if in_circle(p[a], p[b], p[c], p[d]):
            del apex[a, b], apex[b, a]
            for one, two, three in ((a, d, c), (d, b, c)):
                apex[one, two], apex[two, three], apex[three, one] = three, one, two
            todo += [(a, d), (d, b), (b, c), (c, a)]
    return np.array([(a, b, c) for (a, b), c in apex.items() if a < c and b < c])


class Mesh:
    """The triangulation of integer positions [n, 2], and where positions lie in it.

    Attributes: xy: i64[n, 2]; triangles: i64[t, 3]; neighbours: i64[t, 3], opposite each corner, -1 outside.
    """

    def __init__(self, xy: np.ndarray) -> None:
        self.xy, self.triangles = np.asarray(xy, np.int64), triangulation(xy)
        edge = {}
        for row, (a, b, c) in enumerate(self.triangles.tolist()):
            edge[b, c] = edge[c, a] = edge[a, b] = row
        self.neighbours = np.array(
            [[edge.get(e, -1) for e in ((c, b), (a, c), (b, a))] for a, b, c in self.triangles.tolist()]
        )

    def find(self, at: np.ndarray) -> np.ndarray:
        """i64[q]: the triangle in which integer positions [q, 2] lie after a step of (e, e^2), e infinitely small; -1 = none."""
        own = np.zeros(len(self.xy), np.int64)
        own[self.triangles] = np.arange(len(self.triangles))[:, None]
        tri = own[cKDTree(self.xy).query(at)[1]]
        active = np.arange(len(at))
        while len(active):
            corner = self.xy[self.triangles[tri[active]]]
            tail, (x, y) = corner[:, [1, 2, 0]], np.moveaxis(corner[:, [2, 0, 1]] - corner[:, [1, 2, 0]], 2, 0)
            gap = at[active][:, None] - tail
            side = x * gap[..., 1] - y * gap[..., 0]  # of a position after its step: side - e y + e^2 x
            beyond = np.where(side != 0, side, np.where(y != 0, -y, x)) < 0
            out = beyond.any(axis=1)
            active = active[out]
            tri[active] = self.neighbours[tri[active], beyond[out].argmax(axis=1)]
            active = active[tri[active] >= 0]
        return tri
