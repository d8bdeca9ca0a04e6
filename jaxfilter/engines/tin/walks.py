"""Compiled walks through a triangulation: which triangle holds a position, and what lies around a vertex.

A triangulation is a table of triangles, i32[t, 3] (corners counter-clockwise), and one of neighbours, i32[t, 3] (opposite
each corner), over nodes with positions on the integer lattice, i32[k, 2]. Every edge has two sides: a ghost triangle with
the corner :data:`NOWHERE` lies beyond each edge of the hull. A triangle that was taken out has :data:`DEAD` for its first
corner, and for its first neighbour a triangle that took its place. ``at`` holds for each node a triangle: one of a vertex's
own, and for other nodes one near or around it. ``stamp`` holds when each triangle last changed.

Rows of tables are looked up by unsigned numbers where it matters: then nothing asks whether they count from the end, which
takes an eighth of the time of an insertion.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .predicates import after, left_of, turn

NOWHERE = -1
DEAD = -2
LOOSE = -2
FAR = -2
MANY = 2**31 - 1


@compiled
def ahead(k):
    """The corner after corner ``k``."""
    return k + 1 if k < 2 else 0


@compiled
def behind(k):
    """The corner before corner ``k``."""
    return k - 1 if k > 0 else 2


@compiled
def place(table, t, value):
    """Where a row of triangles or neighbours holds a value that is in it."""
    t = np.uint32(t)
    return 0 if table[t, 0] == value else 1 if table[t, 1] == value else 2


@compiled
def position(xy, node):
    """x and y, int64."""
    node = np.uint32(node)
    return np.int64(xy[node, 0]), np.int64(xy[node, 1])


@compiled
def within(triangles, t, low, high):
    """Whether all corners of a triangle are nodes from ``low`` to ``high``."""
    t = np.uint32(t)
    return min(triangles[t, 0], triangles[t, 1], triangles[t, 2]) >= low and (
        max(triangles[t, 0], triangles[t, 1], triangles[t, 2]) < high
    )


@compiled
def is_ghost(triangles, t):
    """Whether a triangle lies beyond an edge of the hull."""
    t = np.uint32(t)
    return min(triangles[t, 0], triangles[t, 1], triangles[t, 2]) < 0


@compiled
def _beyond(xy, triangles, t, px, py):
    """Of the edge of a ghost: how far to the left of it a position lies, how far along it, and its length; all as areas."""
    k = place(triangles, t, NOWHERE)
    ax, ay = position(xy, triangles[t, ahead(k)])
    bx, by = position(xy, triangles[t, behind(k)])
    along = (px - ax) * (bx - ax) + (py - ay) * (by - ay)
    return turn(ax, ay, bx, by, px, py), along, (bx - ax) ** 2 + (by - ay) ** 2


@compiled
def _nearest_edge(xy, triangles, neighbours, t, px, py, low, high):
    """From a ghost to the one whose edge is nearest to a position outside the hull, of those in sight, or holds it; -1 as in
    ``_walk``. Of two that are nearest with the end that they share, it is the first, clockwise around the triangulation.
    """
    while True:
        k = place(triangles, t, NOWHERE)
        off, along, length = _beyond(xy, triangles, t, px, py)
        if off == 0 and 0 <= along <= length:
            return t
        step = neighbours[t, behind(k)] if along <= 0 else neighbours[t, ahead(k)]
        if not within(triangles, step, low, high):
            return np.int32(-1)
        if off != 0:
            in_sight, further, _ = _beyond(xy, triangles, step, px, py)
            if in_sight <= 0 or 0 < along <= length or (along > 0 and further <= 0):
                return t
        t = step


@compiled
def _walk(xy, triangles, neighbours, t, px, py, low, high):
    """The triangle that contains a position; outside the hull the ghost of the nearest edge in sight.

    -1 if the way leads over a triangle with a corner that is not from ``low`` to ``high``.
    """
    before = np.int32(-1)
    while True:
        if not within(triangles, t, low, high):
            return np.int32(-1)
        row, step = np.uint32(t), np.int32(-1)
        for k in range(3):
            a, b = triangles[row, ahead(k)], triangles[row, behind(k)]
            if a < 0 or b < 0:
                continue
            beyond = neighbours[row, k]
            if beyond != before:
                ax, ay = position(xy, a)
                bx, by = position(xy, b)
                if not left_of(ax, ay, bx, by, px, py):
                    step = beyond
                    break
        if step < 0:
            break
        before, t = t, step
    return _nearest_edge(xy, triangles, neighbours, t, px, py, low, high) if is_ghost(triangles, t) else t


@compiled
def _away(xy, triangles, t, px, py):
    """Square of the distance from a corner of a triangle to a position."""
    x, y = position(xy, triangles[t, 0] if triangles[t, 0] >= 0 else triangles[t, 1])
    return (x - px) ** 2 + (y - py) ** 2


@compiled
def find(xy, triangles, neighbours, own, other, px, py, low, high):
    """The triangle that contains a position, walking from the nearer of two, of which -1 = none; -1: see ``_walk``."""
    if own >= 0:
        while triangles[own, 0] == DEAD:
            own = neighbours[own, 0]
        if other < 0 or _away(xy, triangles, own, px, py) <= _away(xy, triangles, other, px, py):
            return _walk(xy, triangles, neighbours, own, px, py, low, high)
    return _walk(xy, triangles, neighbours, other, px, py, low, high)


@compiled
def locate(xy, triangles, neighbours, at, sheet, nodes, first):
    """Bring ``at`` up to date for nodes, walking from where each was, or from the one before it if that is nearer.

    ``first``: i64[s], a triangle of each sheet, where to begin with nodes that were nowhere yet. Most nodes lie in the triangle
    of the one before them, whose corners are at hand.
    """
    own, t = np.int32(-1), np.int32(-1)
    ax = ay = bx = by = cx = cy = np.int64(0)
    for i in range(len(nodes)):
        node = np.uint64(nodes[i])
        px, py = position(xy, node)
        if sheet[node] != own:
            own, t = sheet[node], np.int32(-1)
            ax = ay = bx = by = cx = cy = np.int64(0)
        if turn(ax, ay, bx, by, px, py) > 0 and turn(bx, by, cx, cy, px, py) > 0 and turn(cx, cy, ax, ay, px, py) > 0:
            at[node] = t
            continue
        if at[node] < 0 and t < 0:
            t = np.int32(first[own])
        at[node] = t = find(xy, triangles, neighbours, at[node], t, px, py, NOWHERE, MANY)
        if is_ghost(triangles, t):
            ax = ay = bx = by = cx = cy = np.int64(0)
        else:
            ax, ay = position(xy, triangles[t, 0])
            bx, by = position(xy, triangles[t, 1])
            cx, cy = position(xy, triangles[t, 2])


@compiled
def locate_positions(xy, triangles, neighbours, start, positions, out):
    """Triangles that contain positions, i32[n, 2], walking from ``start``, or from that of the position before if it is nearer;
    outside -1 - t, t behind an edge in sight."""
    t = np.int32(-1)
    for i in range(len(positions)):
        px, py = position(positions, i)
        t = find(xy, triangles, neighbours, start[i], t, px, py, NOWHERE, MANY)
        out[i] = -1 - neighbours[t, place(triangles, t, NOWHERE)] if is_ghost(triangles, t) else t


@compiled
def vertex_at(xy, triangles, t, px, py):
    """The corner of a triangle that is at a position, or -1."""
    for k in range(3):
        v = triangles[t, k]
        if v >= 0 and xy[v, 0] == px and xy[v, 1] == py:
            return v
    return np.int32(-1)


@compiled
def twins(xy, triangles, at, nodes, out):
    """For located nodes the vertex at the same position, or -1."""
    for i in range(len(nodes)):
        px, py = position(xy, nodes[i])
        out[i] = vertex_at(xy, triangles, at[nodes[i]], px, py)


@compiled
def changed(at, stamp, nodes, now, first, following, out):
    """Write nodes whose triangle has changed ``now`` to ``out``, of these and of those that wait at triangles; how many.

    The rest of ``nodes`` wait at theirs from now on. ``first``: i32[t], one that waits at each triangle, or :data:`NOWHERE`;
    ``following``: i32[k], the next at the same triangle, :data:`NOWHERE` after the last, and :data:`LOOSE` for nodes that do
    not wait.
    """
    count = 0
    for i in range(len(nodes)):
        node = np.uint64(nodes[i])
        if following[node] == LOOSE:
            own = np.uint32(at[node])
            if stamp[own] == now:
                out[count] = node
                count += 1
            else:
                following[node], first[own] = first[own], node
    for t in range(len(first)):
        if stamp[t] == now:
            node, first[t] = first[t], NOWHERE
            while node >= 0:
                out[count] = node
                count += 1
                following[node], node = LOOSE, following[node]
    return count


@compiled
def _corners(triangles, neighbours, t):
    """The corners of a triangle, of a ghost those of the triangle behind it, from its first node on."""
    if is_ghost(triangles, t):
        t = neighbours[t, place(triangles, t, NOWHERE)]
    t = np.uint32(t)
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    if b < a and b < c:
        return b, c, a
    return (c, a, b) if c < a and c < b else (a, b, c)


@compiled
def corners(triangles, neighbours, rows, out):
    """The corners of triangles, i32[n, 3]; see :func:`_corners`."""
    for i in range(len(rows)):
        out[i, 0], out[i, 1], out[i, 2] = _corners(triangles, neighbours, rows[i])


@compiled
def compact(triangles, neighbours, rows, number, out, beside):
    """Write the triangles that are no ghosts by the ``rows``, i32[k], of their nodes, and their neighbours, -1 beyond the hull,
    i32[f, 3] each; to ``number``, i32[t], which of these each triangle is, -1 for ghosts."""
    count = 0
    for t in range(len(triangles)):
        number[t] = -1 if is_ghost(triangles, t) else count
        if number[t] >= 0:
            for k in range(3):
                out[count, k] = rows[np.uint32(triangles[t, k])]
            count += 1
    for t in range(len(triangles)):
        for k in range(3 if number[t] >= 0 else 0):
            beside[np.uint32(number[t]), k] = number[np.uint32(neighbours[t, k])]


@compiled
def planes(xyz, triangles, neighbours, rows, out):
    """The positions of these corners, f32[3, 3, n]: by corners, then axes."""
    for i in range(len(rows)):
        a, b, c = _corners(triangles, neighbours, rows[i])
        for axis in range(3):
            out[0, axis, i], out[1, axis, i] = xyz[np.uint32(a), axis], xyz[np.uint32(b), axis]
            out[2, axis, i] = xyz[np.uint32(c), axis]


@compiled(allocates=True)
def nearest(xy, triangles, neighbours, at, counts, vertices, out):
    """For vertices the nearest other vertex that counts, bool[k] (of equally near the first in order of x, then y), or -1;
    :data:`FAR` where many are nearer that do not.

    The next nearest vertex has an edge to one of those that are nearer, or to the vertex itself.
    """
    known, square = np.empty(128, np.int64), np.empty(128, np.int64)
    for i in range(len(vertices)):
        centre = v = vertices[i]
        cx, cy = position(xy, centre)
        out[i], size, done = -1, 0, 0
        while out[i] < 0 and v >= 0:
            first = t = at[v]
            while True:  # all that have an edge to v
                k = place(triangles, t, v)
                u = triangles[t, ahead(k)]
                new = u >= 0 and u != centre
                for m in range(size):
                    new = new and known[m] != u
                if new and size == len(known):
                    out[i] = FAR
                    break
                if new:
                    x, y = position(xy, u)
                    known[size], square[size] = u, (x - cx) ** 2 + (y - cy) ** 2
                    size += 1
                t = neighbours[t, ahead(k)]
                if t == first:
                    break
            if out[i] == FAR:
                break
            v = np.int64(-1)
            least = done
            for m in range(done, size):  # the first ``done`` have been asked
                u, w = known[m], known[least]
                if square[m] < square[least] or (
                    square[m] == square[least] and after(xy[w, 0], xy[w, 1], xy[u, 0], xy[u, 1])
                ):
                    least = m
            if done < size:
                v = known[least]
                known[least], square[least] = known[done], square[done]
                known[done] = v
                done += 1
                if counts[v]:
                    out[i] = v
