"""Compiled predicates of a triangulation on an integer lattice: turns, sides of lines and circles, all of them exact.

Twice the area of three positions is an int64. The in-circle determinant is taken in float64 first; with exact differences
its error is less than 8 u P (u = 2^-53, P the sum of the absolute values of all products: seven roundings on the way of
each; compare Shewchuk 1997, Sec. 4.3). Where its sign is in doubt, the determinant itself is less than 16 u P, which is
below 2^63 for positions up to :data:`SPAN` apart, so that unsigned arithmetic modulo 2^64 gives its value (signed overflow
is undefined in compiled code). Ties are broken by a symbolic perturbation that depends on positions only: of four positions
on a circle the last in the order of x, then y, is lifted from the paraboloid (after Devillers & Teillaud 2011), so that the
triangulation is unique; and a position on an edge belongs to the side where it lies after a step of (e, e^2), e infinitely
small.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled

SPAN = 140_000 * 1024
"""Largest distance along an axis, in steps of the lattice, for which the in-circle test is proven."""
_DOUBT = 8 * 2.0**-53


@compiled
def turn(ax, ay, bx, by, cx, cy):
    """Twice the area of a, b, c; positive if they turn to the left."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@compiled
def left_of(ax, ay, bx, by, px, py):
    """Whether p, after its infinitely small step, is to the left of the line from a to b."""
    area = turn(ax, ay, bx, by, px, py)
    if area != 0:
        return area > 0
    return ay > by or (ay == by and ax < bx)


@compiled
def after(ax, ay, bx, by):
    """Whether a comes after b in the order of x, then y."""
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
    if after(ax, ay, bx, by) and after(ax, ay, cx, cy) and after(ax, ay, px, py):
        return turn(px, py, bx, by, cx, cy) > 0
    if after(bx, by, cx, cy) and after(bx, by, px, py):
        return turn(ax, ay, px, py, cx, cy) > 0
    if after(cx, cy, px, py):
        return turn(ax, ay, bx, by, px, py) > 0
    return False
