"""Compiled changes of a Delaunay triangulation in place: vertices come by walks and fans, and go by edge flips.

The tables are those of :mod:`jaxfilter.engines.tin.walks`, the predicates, which are exact, of
:mod:`jaxfilter.engines.tin.predicates`.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .predicates import in_circle, turn
from .walks import DEAD, ahead, behind, find, is_ghost, place, position, vertex_at, within


@compiled
def _conflict(xy, triangles, t, node):
    """Whether a node lies in the circle of a triangle: beyond the edge, or on it, if that is a ghost."""
    t = np.uint32(t)
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    if a < 0:
        a, b, c = b, c, a
    elif b < 0:
        a, b, c = c, a, b
    ax, ay = position(xy, a)
    bx, by = position(xy, b)
    px, py = position(xy, node)
    if c < 0:
        area = turn(ax, ay, bx, by, px, py)
        return area > 0 or (area == 0 and (ax - px) * (bx - px) + (ay - py) * (by - py) < 0)
    cx, cy = position(xy, c)
    return in_circle(ax, ay, bx, by, cx, cy, px, py)


@compiled
def _write(triangles, neighbours, t, a, b, c, na, nb, nc):
    t = np.uint32(t)
    triangles[t, 0], triangles[t, 1], triangles[t, 2] = a, b, c
    neighbours[t, 0], neighbours[t, 1], neighbours[t, 2] = na, nb, nc


@compiled
def _flip(triangles, neighbours, at, s, k):
    """Turn the edge of triangle ``s`` opposite its corner ``k``; afterwards that is the first corner of both.

    The end that comes first after the corner stays in ``s``, the other is in the triangle that was beyond the edge.
    """
    p, b, c = triangles[s, k], triangles[s, ahead(k)], triangles[s, behind(k)]
    o, beyond_b, beyond_c = neighbours[s, k], neighbours[s, ahead(k)], neighbours[s, behind(k)]
    j = place(neighbours, o, s)
    d, far_b, far_c = triangles[o, j], neighbours[o, ahead(j)], neighbours[o, behind(j)]
    _write(triangles, neighbours, s, p, b, d, far_b, o, beyond_c)
    _write(triangles, neighbours, o, p, d, c, far_c, beyond_b, s)
    neighbours[far_b, place(neighbours, far_b, o)] = s
    neighbours[beyond_b, place(neighbours, beyond_b, s)] = o
    if b >= 0:
        at[b] = s
    if c >= 0:
        at[c] = o


@compiled
def insert(xy, triangles, neighbours, at, stamp, sheet, hull, nodes, fresh, left, low, high, start, now, most, room):
    """Make nodes vertices, from ``nodes[start]`` on: the triangles whose circle holds one give way to a fan around it.

    The fan of the i-th has the numbers of those, and the two of ``fresh[i]``. A node is left out, and ``left[i]`` set, if
    a triangle that would be read or written has a corner that is not from ``low`` to ``high``: threads with ranges apart do
    not meet, since of two triangles beside each other not one can be in one range and the other in another. ``hull``,
    i64[s], counts the ghosts of each sheet. Returns how many are done when all are, when ``most`` triangles are made, or when
    the next one has more edges around it than ``room``, i32[n, 7], has rows; and -1 - i if the position of the i-th is taken.
    """
    stack, rim, gone = room[:, :2], room[:, 2:6], room[:, 6]  # edges; rim: inner, outer, its side, node
    made = 0
    for i in range(start, len(nodes)):
        if made > most:
            return i
        p = nodes[i]
        px, py = position(xy, p)
        beside = i > start and not left[i - 1] and sheet[nodes[i - 1]] == sheet[p]
        last = at[nodes[i - 1]] if beside else np.int32(-1)
        t = find(xy, triangles, neighbours, at[p], last, px, py, low, high)
        if t < 0:
            left[i] = True
            continue
        if vertex_at(xy, triangles, t, px, py) >= 0:
            return -1 - i
        top, edges, count, ghosts = 3, 0, 1, 1 if is_ghost(triangles, t) else 0
        gone[0] = t
        for k in range(3):
            stack[k, 0], stack[k, 1] = t, 2 - k
        while top > 0:  # the rim comes in order, counter-clockwise
            top -= 1
            s, k = stack[top, 0], stack[top, 1]
            o = neighbours[s, k]
            if not within(triangles, o, low, high):
                left[i] = True
                break
            j = place(neighbours, o, s)
            if max(top + 2, edges + 1, count + 1) > len(gone):
                return i
            if _conflict(xy, triangles, o, p):
                gone[count] = o
                count += 1
                ghosts += 1 if is_ghost(triangles, o) else 0
                stack[top, 0], stack[top, 1] = o, behind(j)
                stack[top + 1, 0], stack[top + 1, 1] = o, ahead(j)
                top += 2
            else:
                rim[edges, 0], rim[edges, 1], rim[edges, 2], rim[edges, 3] = s, o, j, triangles[s, ahead(k)]
                edges += 1
        if left[i]:
            continue
        gone[count], gone[count + 1] = fresh[i, 0], fresh[i, 1]  # as many as there are edges
        for e in range(edges):
            one, two = e + 1 if e + 1 < edges else 0, e - 1 if e > 0 else edges - 1
            t, a = gone[e], rim[e, 3]
            _write(triangles, neighbours, t, p, a, rim[one, 3], rim[e, 1], gone[one], gone[two])
            neighbours[rim[e, 1], rim[e, 2]] = t
            stamp[t] = now
            if a >= 0:
                at[a] = t
        at[p] = t
        if ghosts > 0:
            hull[sheet[p]] += 2 - ghosts
        made += edges
    return len(nodes)


@compiled(allocates=True)
def _legalise(xy, triangles, neighbours, at, stamp, rows, now):
    """Flip edges of the triangles ``rows``, and of what flips make of them, until each has an empty circle."""
    stack, top = rows.copy(), len(rows)
    while top > 0:
        top -= 1
        s = stack[top]
        for k in range(3):
            o = neighbours[s, k]
            apex = triangles[o, place(neighbours, o, s)]
            bad = _conflict(xy, triangles, o, triangles[s, k]) if apex < 0 else _conflict(xy, triangles, s, apex)
            if bad:
                _flip(triangles, neighbours, at, s, k)
                stamp[s], stamp[o] = now, now
                if top + 2 > len(stack):
                    stack = np.concatenate((stack, np.empty(top + 2, np.int32)))
                stack[top], stack[top + 1] = s, o
                top += 2
                break


@compiled(allocates=True)
def remove(xy, triangles, neighbours, at, stamp, nodes, freed, now):
    """Take vertices out that are not on the hull; each frees two triangles, whose numbers go to ``freed``, i32[n, 2].

    The edges of a vertex are flipped away, so that it stays in a polygon all of which it sees, until three are left; then
    the triangles in the polygon are made Delaunay triangles. Returns how many are done: all, or those before one on the hull.
    """
    star = np.empty(64, np.int32)
    for i in range(len(nodes)):
        v = nodes[i]
        degree, s = 0, at[v]
        while degree == 0 or s != star[0]:
            if is_ghost(triangles, s):
                return i
            if degree == len(star):
                star = np.concatenate((star, np.empty(degree, np.int32)))
            star[degree] = s
            degree += 1
            s = neighbours[s, ahead(place(triangles, s, v))]
        polygon = star[:degree].copy()
        while degree > 3:
            k = place(triangles, s, v)
            ahead_s, behind_s = neighbours[s, ahead(k)], neighbours[s, behind(k)]
            j = place(neighbours, ahead_s, s)
            b, c, e = triangles[s, ahead(k)], triangles[s, behind(k)], triangles[ahead_s, j]
            bx, by = position(xy, b)
            cx, cy = position(xy, c)
            ex, ey = position(xy, e)
            vx, vy = position(xy, v)
            if turn(bx, by, cx, cy, ex, ey) > 0 and turn(bx, by, ex, ey, vx, vy) >= 0:
                beyond_s, beyond_a = neighbours[s, k], neighbours[ahead_s, ahead(j)]
                further = neighbours[ahead_s, behind(j)]
                _write(triangles, neighbours, s, v, b, e, ahead_s, further, behind_s)
                _write(triangles, neighbours, ahead_s, c, e, b, s, beyond_s, beyond_a)
                neighbours[beyond_s, place(neighbours, beyond_s, s)] = ahead_s
                neighbours[further, place(neighbours, further, ahead_s)] = s
                at[c], at[b], at[e] = ahead_s, ahead_s, ahead_s
                degree -= 1
            else:
                s = ahead_s
        k = place(triangles, s, v)
        one, two = neighbours[s, ahead(k)], neighbours[s, behind(k)]
        a, b, c = triangles[s, ahead(k)], triangles[s, behind(k)], triangles[one, place(neighbours, one, s)]
        beyond_one, beyond_two = neighbours[one, place(triangles, one, v)], neighbours[two, place(triangles, two, v)]
        _write(triangles, neighbours, s, a, b, c, beyond_one, beyond_two, neighbours[s, k])
        neighbours[beyond_one, place(neighbours, beyond_one, one)] = s
        neighbours[beyond_two, place(neighbours, beyond_two, two)] = s
        at[a], at[b], at[c], at[v] = s, s, s, s
        for m, dead in enumerate((one, two)):
            _write(triangles, neighbours, dead, DEAD, DEAD, DEAD, s, s, s)
            freed[i, m] = dead
        stamp[polygon] = now
        _legalise(xy, triangles, neighbours, at, stamp, polygon[(polygon != one) & (polygon != two)], now)
    return len(nodes)


@compiled
def leave(triangles, neighbours, at):
    """Bring ``at`` from triangles that were taken out to those that took their place."""
    for node in range(len(at)):
        while triangles[at[node], 0] == DEAD:
            at[node] = neighbours[at[node], 0]


@compiled
def touch(triangles, neighbours, at, stamp, vertices, now):
    """Stamp all triangles at vertices."""
    for i in range(len(vertices)):
        v = vertices[i]
        first = t = at[v]
        while True:
            stamp[t] = now
            t = neighbours[t, ahead(place(triangles, t, v))]
            if t == first:
                break
