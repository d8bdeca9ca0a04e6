"""The plane of least squares by sums of products, in NumPy, JAX and compiled code alike."""

from __future__ import annotations

from typing import Any


def slopes_by_sums(xx: Any, xy: Any, yy: Any, xz: Any, yz: Any) -> tuple[Any, Any, Any]:
    """Slopes of the plane along x and y, each times the determinant of the normal equations, and this determinant.

    Points on one line have a determinant near zero, and no plane: each caller says how near. Arguments: sums of products of
    coordinates about their mean, numbers or arrays.
    """
    return yy * xz - xy * yz, xx * yz - xy * xz, xx * yy - xy * xy
