"""Compiled steps of a Delaunay triangulation that changes in place: locate, insert, remove, by walks and edge flips.

A triangulation is a table of triangles, i32[t, 3] (corners counter-clockwise), and one of neighbours, i32[t, 3] (opposite
each corner), over nodes with positions on the integer lattice, i32[k, 2]. Every edge has two sides: a ghost triangle with
the corner :data:`NOWHERE` lies beyond each edge of the hull. A triangle that was taken out has :data:`DEAD` for its first
corner, and for its first neighbour a triangle that took its place. ``at`` holds for each node a triangle: one of a vertex's
own, and for other nodes one near or around it. ``stamp`` holds when each triangle last changed.

Everything is exact. Twice the area of three positions is an int64. The in-circle determinant is taken in float64 first;
with exact differences its error is less than 8 u P (u = 2^-53, P the sum of the absolute values of all products: seven
roundings on the way of each; compare Shewchuk 1997, Sec. 4.3). Where its sign is in doubt, the determinant itself is
less than 16 u P, which is below 2^63 for positions up to :data:`SPAN` apart, so that unsigned arithmetic modulo 2^64 gives
its value (signed overflow is undefined in compiled code). Ties are broken by a symbolic perturbation that depends on
positions only: of four positions on a circle the last in the order of x, then y, is lifted from the paraboloid (after
Devillers & Teillaud 2011), so that the triangulation is unique; and a position on an edge belongs to the side where it
lies after a step of (e, e^2), e infinitely small.
"""

from __future__ import annotations

import numpy as np

from .compiled import compiled

NOWHERE = -1
DEAD = -2
MANY = 2**31 - 1
SPAN = 140_000 * 1024
"""Largest distance along an axis, in steps of the lattice, for which the in-circle test is proven."""
_DOUBT = 8 * 2.0**-53


@compiled
def _turn(ax, ay, bx, by, cx, cy):
    """Twice the area of a, b, c; positive if they turn to the left."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@compiled
def _left(ax, ay, bx, by, px, py):
    """Whether p, after its infinitely small step, is to the left of the line from a to b."""
    turn = _turn(ax, ay, bx, by, px, py)
    if turn != 0:
        return turn > 0
    return ay > by or (ay == by and ax < bx)


@compiled
def _after(ax, ay, bx, by):
    return ax > bx or (ax == bx and ay > by)


@compiled
def in_circle(ax, ay, bx, by, cx, cy, px, py):
    """Whether p lies in the circle through a, b, c, which turn to the left; all int64."""
    adx, ady, bdx, bdy, cdx, cdy = ax - px, ay - py, bx - px, by - py, cx - px, cy - py
    fax, fay, fbx, fby, fcx, fcy = float(adx), float(ady), float(bdx), float(bdy), float(cdx), float(cdy)
    a, b, c = fax * fax + fay * fay, fbx * fbx + fby * fby, fcx * fcx + fcy * fcy
    bc, cb, ca, ac, ab, ba = fbx * fcy, fcx * fby, fcx * fay, fax * fcy, fax * fby, fbx * fay
    value = a * (bc - cb) + b * (ca - ac) + c * (ab - ba)
    doubt = _DOUBT * (a * (abs(bc) + abs(cb)) + b * (abs(ca) + abs(ac)) + c * (abs(ab) + abs(ba)))
    if value > doubt:
        return True
    if value < -doubt:
        return False
    exact = np.int64(
        np.uint64(adx * adx + ady * ady) * np.uint64(bdx * cdy - cdx * bdy)
        + np.uint64(bdx * bdx + bdy * bdy) * np.uint64(cdx * ady - adx * cdy)
        + np.uint64(cdx * cdx + cdy * cdy) * np.uint64(adx * bdy - bdx * ady)
    )
    if exact != 0:
        return exact > 0
    if _after(ax, ay, bx, by) and _after(ax, ay, cx, cy) and _after(ax, ay, px, py):
        return _turn(px, py, bx, by, cx, cy) > 0
    if _after(bx, by, cx, cy) and _after(bx, by, px, py):
        return _turn(ax, ay, px, py, cx, cy) > 0
    if _after(cx, cy, px, py):
        return _turn(ax, ay, bx, by, px, py) > 0
    return False


@compiled
def _conflict(xy, triangles, t, node):
    """Whether a node lies in the circle of a triangle: beyond the edge, or on it, if that is a ghost."""
    a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    if a < 0:
        a, b, c = b, c, a
    elif b < 0:
        a, b, c = c, a, b
    ax, ay = np.int64(xy[a, 0]), np.int64(xy[a, 1])
    bx, by = np.int64(xy[b, 0]), np.int64(xy[b, 1])
    px, py = np.int64(xy[node, 0]), np.int64(xy[node, 1])
    if c < 0:
        turn = _turn(ax, ay, bx, by, px, py)
        return turn > 0 or (turn == 0 and (ax - px) * (bx - px) + (ay - py) * (by - py) < 0)
    return in_circle(ax, ay, bx, by, np.int64(xy[c, 0]), np.int64(xy[c, 1]), px, py)


@compiled
def _within(triangles, t, low, high):
    """Whether all corners of a triangle are nodes from ``low`` to ``high``."""
    return min(triangles[t, 0], triangles[t, 1], triangles[t, 2]) >= low and (
        max(triangles[t, 0], triangles[t, 1], triangles[t, 2]) < high
    )


@compiled
def _walk(xy, triangles, neighbours, t, px, py, low, high):
    """The triangle that contains a position; outside the hull a ghost whose edge is in sight, or holds the position.

    -1 if the way leads over a triangle with a corner that is not from ``low`` to ``high``.
    """
    before = np.int32(-1)
    while True:
        if not _within(triangles, t, low, high):
            return np.int32(-1)
        step = np.int32(-1)
        for k in range(3):
            a, b = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
            if a < 0 or b < 0:
                continue
            beyond = neighbours[t, k]
            if beyond != before and not _left(
                np.int64(xy[a, 0]), np.int64(xy[a, 1]), np.int64(xy[b, 0]), np.int64(xy[b, 1]), px, py
            ):
                step = beyond
                break
        if step < 0:
            break
        before, t = t, step
    # from a ghost on the line of whose edge the position lies to the one that holds it, or sees it
    while min(triangles[t, 0], triangles[t, 1], triangles[t, 2]) < 0:
        k = 0 if triangles[t, 0] < 0 else 1 if triangles[t, 1] < 0 else 2
        a, b = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
        ax, ay, bx, by = np.int64(xy[a, 0]), np.int64(xy[a, 1]), np.int64(xy[b, 0]), np.int64(xy[b, 1])
        along = (px - ax) * (bx - ax) + (py - ay) * (by - ay)
        if _turn(ax, ay, bx, by, px, py) != 0 or 0 <= along <= (bx - ax) ** 2 + (by - ay) ** 2:
            break
        t = neighbours[t, (k + 2) % 3 if along < 0 else (k + 1) % 3]
    return t


@compiled
def _away(xy, triangles, t, px, py):
    """Square of the distance from a corner of a triangle to a position."""
    v = triangles[t, 0] if triangles[t, 0] >= 0 else triangles[t, 1]
    return (xy[v, 0] - px) ** 2 + (xy[v, 1] - py) ** 2


@compiled
def _find(xy, triangles, neighbours, own, other, px, py, low, high):
    """The triangle that contains a position, walking from the nearer of two, of which -1 = none."""
    if own >= 0:
        while triangles[own, 0] == DEAD:
            own = neighbours[own, 0]
        if other < 0 or _away(xy, triangles, own, px, py) <= _away(xy, triangles, other, px, py):
            return _walk(xy, triangles, neighbours, own, px, py, low, high)
    return _walk(xy, triangles, neighbours, other, px, py, low, high)


@compiled
def locate(xy, triangles, neighbours, at, sheet, nodes, first):
    """Bring ``at`` up to date for nodes, walking from where each was, or from the one before it if that is nearer.

    ``first``: i64[s], a triangle of each sheet, where to begin with nodes that were nowhere yet.
    """
    for i in range(len(nodes)):
        node = nodes[i]
        before = at[nodes[i - 1]] if i > 0 and sheet[nodes[i - 1]] == sheet[node] else np.int32(-1)
        if at[node] < 0 and before < 0:
            before = np.int32(first[sheet[node]])
        px, py = np.int64(xy[node, 0]), np.int64(xy[node, 1])
        at[node] = _find(xy, triangles, neighbours, at[node], before, px, py, NOWHERE, MANY)


@compiled
def locate_positions(xy, triangles, neighbours, start, positions, out):
    """Triangles that contain positions, i32[n, 2], walking from ``start``; outside -1 - t, t behind an edge in sight."""
    for i in range(len(positions)):
        t = np.int32(start[i])
        px, py = np.int64(positions[i, 0]), np.int64(positions[i, 1])
        t = _find(xy, triangles, neighbours, t, np.int32(-1), px, py, NOWHERE, MANY)
        for k in range(3):
            if triangles[t, k] == NOWHERE:
                t = np.int32(-1 - neighbours[t, k])
                break
        out[i] = t


@compiled
def _relink(neighbours, t, old, new):
    """Triangle ``t`` has ``new`` where it had ``old`` for a neighbour."""
    for k in range(3):
        if neighbours[t, k] == old:
            neighbours[t, k] = new


@compiled
def _write(triangles, neighbours, t, a, b, c, na, nb, nc):
    triangles[t, 0], triangles[t, 1], triangles[t, 2] = a, b, c
    neighbours[t, 0], neighbours[t, 1], neighbours[t, 2] = na, nb, nc


@compiled
def _flip(triangles, neighbours, at, s, k):
    """Turn the edge of triangle ``s`` opposite its corner ``k``; afterwards that is the first corner of both."""
    p, b, c = triangles[s, k], triangles[s, (k + 1) % 3], triangles[s, (k + 2) % 3]
    o, after, before = neighbours[s, k], neighbours[s, (k + 1) % 3], neighbours[s, (k + 2) % 3]
    j = 0 if neighbours[o, 0] == s else 1 if neighbours[o, 1] == s else 2
    d, db, dc = triangles[o, j], neighbours[o, (j + 1) % 3], neighbours[o, (j + 2) % 3]
    _write(triangles, neighbours, s, p, b, d, db, o, before)
    _write(triangles, neighbours, o, p, d, c, dc, after, s)
    _relink(neighbours, db, o, s)
    _relink(neighbours, after, s, o)
    if b >= 0:
        at[b] = s
    if c >= 0:
        at[c] = o
    return o


@compiled
def insert(xy, triangles, neighbours, at, stamp, sheet, hull, nodes, relied, fresh, left, low, high, start, now, most):
    """Make nodes vertices, from ``nodes[start]`` on: the triangles whose circle holds one give way to a fan around it.

    The fan of the i-th has the numbers of those, and ``fresh[2 i]`` and ``fresh[2 i + 1]``. A node is left out, and
    ``left[i]`` set, if one of the triangles ``relied[i]`` (i32[n, 2], -1 = none; may be empty) has changed ``now``, or if a
    triangle that would be read or written has a corner that is not from ``low`` to ``high``: threads with ranges apart do
    not meet, since of two triangles beside each other not one can be in one range and the other in another. ``hull``,
    i64[s], counts the ghosts of each sheet. Returns how many are done when all are or ``most`` triangles are made, and
    -1 - i if the position of the i-th is taken.
    """
    stack, rim = np.empty((64, 2), np.int32), np.empty((64, 4), np.int32)  # edges; rim: inner, outer, its side, node
    gone = np.empty(64, np.int32)
    made = 0
    for i in range(start, len(nodes)):
        if made > most:
            return i
        p = nodes[i]
        if len(relied) > 0:
            one, two = relied[i, 0], relied[i, 1]
            if stamp[one] == now or (two >= 0 and stamp[two] == now):
                left[i] = True
                continue
        px, py = np.int64(xy[p, 0]), np.int64(xy[p, 1])
        beside = i > start and not left[i - 1] and sheet[nodes[i - 1]] == sheet[p]
        last = at[nodes[i - 1]] if beside else np.int32(-1)
        t = _find(xy, triangles, neighbours, at[p], last, px, py, low, high)
        left[i] = t < 0
        if t < 0:
            continue
        for k in range(3):
            v = triangles[t, k]
            if v >= 0 and xy[v, 0] == xy[p, 0] and xy[v, 1] == xy[p, 1]:
                return -1 - i
        top, edges, count, hidden = 3, 0, 1, 0 if _within(triangles, t, 0, MANY) else 1
        gone[0] = t
        for k in range(3):
            stack[k, 0], stack[k, 1] = t, 2 - k
        while top > 0:  # the rim comes in order, counter-clockwise
            top -= 1
            s, k = stack[top, 0], stack[top, 1]
            o = neighbours[s, k]
            if not _within(triangles, o, low, high):
                left[i] = True
                break
            j = 0 if neighbours[o, 0] == s else 1 if neighbours[o, 1] == s else 2
            if max(top + 2, edges + 1, count + 1) > len(gone):
                stack, rim = np.concatenate((stack, np.empty_like(stack))), np.concatenate((rim, np.empty_like(rim)))
                gone = np.concatenate((gone, np.empty_like(gone)))
            if _conflict(xy, triangles, o, p):
                gone[count] = o
                count += 1
                hidden += 0 if _within(triangles, o, 0, MANY) else 1
                stack[top, 0], stack[top, 1] = o, (j + 2) % 3
                stack[top + 1, 0], stack[top + 1, 1] = o, (j + 1) % 3
                top += 2
            else:
                rim[edges, 0], rim[edges, 1], rim[edges, 2], rim[edges, 3] = s, o, j, triangles[s, (k + 1) % 3]
                edges += 1
        if left[i]:
            continue
        gone[count], gone[count + 1] = fresh[2 * i], fresh[2 * i + 1]  # as many as there are edges
        for e in range(edges):
            t, ahead, behind = gone[e], gone[e + 1 if e + 1 < edges else 0], gone[e - 1 if e > 0 else edges - 1]
            a, b = rim[e, 3], rim[e + 1 if e + 1 < edges else 0, 3]
            _write(triangles, neighbours, t, p, a, b, rim[e, 1], ahead, behind)
            neighbours[rim[e, 1], rim[e, 2]] = t
            stamp[t] = now
            if a >= 0:
                at[a] = t
        at[p] = t
        if hidden > 0:
            hull[sheet[p]] += 2 - hidden
        made += edges
    return len(nodes)


@compiled
def legalise(xy, triangles, neighbours, at, stamp, rows, now):
    """Flip edges of the triangles ``rows``, and of what flips make of them, until each has an empty circle."""
    stack, top = rows.copy(), len(rows)
    while top > 0:
        top -= 1
        s = stack[top]
        for k in range(3):
            o = neighbours[s, k]
            j = 0 if neighbours[o, 0] == s else 1 if neighbours[o, 1] == s else 2
            apex = triangles[o, j]
            bad = _conflict(xy, triangles, o, triangles[s, k]) if apex < 0 else _conflict(xy, triangles, s, apex)
            if bad:
                _flip(triangles, neighbours, at, s, k)
                stamp[s], stamp[o] = now, now
                if top + 2 > len(stack):
                    stack = np.concatenate((stack, np.empty(top + 2, np.int32)))
                stack[top], stack[top + 1] = s, o
                top += 2
                break


@compiled
def remove(xy, triangles, neighbours, at, stamp, nodes, freed, now):
    """Take vertices out that are not on the hull; each frees two triangles, whose numbers go to ``freed``.

    The edges of a vertex are flipped away, so that it stays in a polygon all of which it sees, until three are left; then
    the triangles in the polygon are made Delaunay triangles. Returns how many are done: all, or those before one on the hull.
    """
    star = np.empty(64, np.int32)
    for i in range(len(nodes)):
        v = nodes[i]
        degree, s = 0, at[v]
        while degree == 0 or s != star[0]:
            k = 0 if triangles[s, 0] == v else 1 if triangles[s, 1] == v else 2
            b, c = triangles[s, (k + 1) % 3], triangles[s, (k + 2) % 3]
            if b < 0 or c < 0:
                return i
            _write(
                triangles,
                neighbours,
                s,
                v,
                b,
                c,
                neighbours[s, k],
                neighbours[s, (k + 1) % 3],
                neighbours[s, (k + 2) % 3],
            )
            if degree == len(star):
                star = np.concatenate((star, np.empty(degree, np.int32)))
            star[degree] = s
            stamp[s] = now
            degree += 1
            s = neighbours[s, 1]
        hole = star[:degree].copy()
        while degree > 3:
            ahead = neighbours[s, 1]
            b, c, e = triangles[s, 1], triangles[s, 2], triangles[ahead, 2]
            bx, by, ex, ey = np.int64(xy[b, 0]), np.int64(xy[b, 1]), np.int64(xy[e, 0]), np.int64(xy[e, 1])
            convex = _turn(bx, by, np.int64(xy[c, 0]), np.int64(xy[c, 1]), ex, ey) > 0
            if convex and _turn(bx, by, ex, ey, np.int64(xy[v, 0]), np.int64(xy[v, 1])) >= 0:
                outer_s, outer_a, beyond, behind = (
                    neighbours[s, 0],
                    neighbours[ahead, 0],
                    neighbours[ahead, 1],
                    neighbours[s, 2],
                )
                _write(triangles, neighbours, s, v, b, e, ahead, beyond, behind)
                _write(triangles, neighbours, ahead, c, e, b, s, outer_s, outer_a)
                _relink(neighbours, outer_s, s, ahead)
                _relink(neighbours, beyond, ahead, s)
                at[c], at[b], at[e] = ahead, ahead, ahead
                degree -= 1
            else:
                s = ahead
        one, two = neighbours[s, 1], neighbours[s, 2]
        a, b, c = triangles[s, 1], triangles[s, 2], triangles[one, 2]
        oa, ob, oc = neighbours[one, 0], neighbours[two, 0], neighbours[s, 0]
        _write(triangles, neighbours, s, a, b, c, oa, ob, oc)
        _relink(neighbours, oa, one, s)
        _relink(neighbours, ob, two, s)
        at[a], at[b], at[c], at[v] = s, s, s, s
        for dead, k in ((one, 0), (two, 1)):
            _write(triangles, neighbours, dead, DEAD, DEAD, DEAD, s, s, s)
            freed[2 * i + k] = dead
        legalise(xy, triangles, neighbours, at, stamp, hole[(hole != one) & (hole != two)], now)
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
            k = 0 if triangles[t, 0] == v else 1 if triangles[t, 1] == v else 2
            t = neighbours[t, (k + 1) % 3]
            if t == first:
                break


@compiled
def nearest(xy, triangles, neighbours, at, counts, vertices, out):
    """For vertices the nearest other vertex that counts, bool[k] (of equally near the first in order of x, then y), or -1.

    The next nearest vertex has an edge to one of those that are nearer, or to the vertex itself.
    """
    known, square = np.empty(64, np.int64), np.empty(64, np.int64)
    for i in range(len(vertices)):
        centre = v = vertices[i]
        out[i], size, done = -1, 0, 0
        while out[i] < 0 and v >= 0:
            first = t = at[v]
            while True:  # all that have an edge to v
                k = 0 if triangles[t, 0] == v else 1 if triangles[t, 1] == v else 2
                u = triangles[t, (k + 1) % 3]
                new = u >= 0 and u != centre
                for m in range(size):
                    new = new and known[m] != u
                if new:
                    if size == len(known):
                        known, square = np.concatenate((known, known)), np.concatenate((square, square))
                    dx, dy = np.int64(xy[u, 0]) - xy[centre, 0], np.int64(xy[u, 1]) - xy[centre, 1]
                    known[size], square[size] = u, dx * dx + dy * dy
                    size += 1
                t = neighbours[t, (k + 1) % 3]
                if t == first:
                    break
            v = np.int64(-1)
            least = done
            for m in range(done, size):  # the first ``done`` have been asked
                u, w = known[m], known[least]
                if square[m] < square[least] or (
                    square[m] == square[least] and _after(xy[w, 0], xy[w, 1], xy[u, 0], xy[u, 1])
                ):
                    least = m
            if done < size:
                v = known[least]
                known[least], square[least] = known[done], square[done]
                known[done] = v
                done += 1
                if counts[v]:
                    out[i] = v


@compiled
def corners(triangles, neighbours, rows, out):
    """The corners of triangles, of ghosts those of the triangle behind them, each from its first node on."""
    for i in range(len(rows)):
        t = rows[i]
        for k in range(3):
            if triangles[t, k] == NOWHERE:
                t = neighbours[t, k]
                break
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        if b < a and b < c:
            a, b, c = b, c, a
        elif c < a and c < b:
            a, b, c = c, a, b
        out[i, 0], out[i, 1], out[i, 2] = a, b, c


@compiled
def twins(xy, triangles, at, nodes, out):
    """For located nodes the vertex at the same position, or -1."""
    for i in range(len(nodes)):
        out[i] = -1
        for k in range(3):
            v = triangles[at[nodes[i]], k]
            if v >= 0 and xy[v, 0] == xy[nodes[i], 0] and xy[v, 1] == xy[nodes[i], 1]:
                out[i] = v


@compiled
def changed(at, stamp, nodes, image, now, out):
    """Which nodes, or their images (``image``, i32[k], -1 = none), lie in a triangle that has changed ``now``."""
    for i in range(len(nodes)):
        t = image[nodes[i]]
        out[i] = stamp[at[nodes[i]]] == now or (t >= 0 and stamp[t] == now)
