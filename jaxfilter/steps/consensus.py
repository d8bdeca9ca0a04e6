"""Planes through many cells of points at once, by random sample consensus (Fischler & Bolles 1981)."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..core.compilation import bucket
from .planes import Planes, gradients

ROW_LENGTH = 64  # points per row: cells are cut into rows of this many, so that full and sparse cells share one shape
_Best = tuple[jax.Array, jax.Array, jax.Array]  # score, point and normal of the best plane of every cell


class CellRows(NamedTuple):
    """Points sorted by cell, and cut into rows of :data:`ROW_LENGTH`; padded to few sizes.

    Attributes:
        xyz: f32[rows, ROW_LENGTH, 3], metres from the first point of the cell.
        mask: bool[rows, ROW_LENGTH], False for padding.
        cell: i32[rows], the cell of every row.
        row: i32[cells], the first row of every cell.
        points: i32[cells], points per cell; 0 for padding.
    """

    xyz: np.ndarray | jax.Array
    mask: np.ndarray | jax.Array
    cell: np.ndarray | jax.Array
    row: np.ndarray | jax.Array
    points: np.ndarray | jax.Array


class Consensus(NamedTuple):
    """The best plane of every cell.

    Attributes:
        centre: f32[cells, 3], a point of the plane, metres from the first point of the cell.
        normal: f32[cells, 3], unit normals, pointing upward.
        inliers: i32[cells], points within the inlier distance; 0 where no hypothesis made a plane.
        below: f32[cells], distance of the farthest point below the plane, metres; 0 if there is none.
    """

    centre: jax.Array
    normal: jax.Array
    inliers: jax.Array
    below: jax.Array


def rows_of(points: int) -> int:
    """How many rows to compute at a time in a cloud of so many points."""
    return min(bucket(2 * points // ROW_LENGTH, 64), 4096)


def batches(start: np.ndarray, rows: int) -> list[slice]:
    """Cells cut into runs of at most ``rows`` rows each; a larger cell stands alone. ``start``: i64[cells + 1]."""
    last = np.cumsum(-(-np.diff(start) // ROW_LENGTH))
    cuts = [0]
    while cuts[-1] < len(last):
        before = last[cuts[-1] - 1] if cuts[-1] else 0
        cuts.append(max(int(np.searchsorted(last, before + rows, side="right")), cuts[-1] + 1))
    return [slice(*ends) for ends in itertools.pairwise(cuts)]


def cells_of(xyz: np.ndarray, start: np.ndarray, rows: int) -> CellRows:
    """Cells of points f32[n, 3] in local metres, padded to ``rows`` rows, or to more in steps of powers of two.

    The points of cell i are start[i] to start[i + 1], i64[cells + 1]; no cell is empty.
    """
    count = np.diff(start)
    own = -(-count // ROW_LENGTH)
    row = np.cumsum(own) - own
    cell = np.repeat(np.arange(len(count)), own)
    first = start[cell] + ROW_LENGTH * (np.arange(len(cell)) - row[cell])
    at = first[:, None] + np.arange(ROW_LENGTH)
    size = bucket(len(cell), rows)
    mask = np.zeros((size, ROW_LENGTH), bool)
    mask[: len(cell)] = at < start[cell + 1][:, None]
    local = np.zeros((size, ROW_LENGTH, 3), np.float32)
    local[: len(cell)] = xyz[np.minimum(at, len(xyz) - 1)] - xyz[start[cell]][:, None]
    rows_cell = np.full(size, size - 1, np.int32)
    first_row, points = np.zeros(size, np.int32), np.zeros(size, np.int32)
    rows_cell[: len(cell)], first_row[: len(row)], points[: len(count)] = cell, row, count
    return CellRows(local, mask, rows_cell, first_row, points)


@jax.jit
def consensus_planes(
    cells: CellRows,
    draws: jax.Array,
    distance: jax.Array | float,
    max_slope: jax.Array | float,
) -> Consensus:
    """The plane with most points of its cell within ``distance``, then fitted to these by least squares.

    Every hypothesis is the plane through three points of the cell. Hypotheses go one after the other over all cells, so
    memory does not grow with their number; of equally good ones the first is kept.

    Args:
        draws: f32[hypotheses, 3] in [0, 1): which points of its cell each hypothesis takes. All cells share the draws,
            so the planes of a cell depend on the order of its own points alone.
        distance: metres, at most, from a plane to its inliers.
        max_slope: degrees; steeper hypotheses are dropped.

    Returns: Consensus for every cell of the padded ``cells``.
    """
    xyz, mask, cell, row, points = cells
    size = len(points)

    def total(values: jax.Array) -> jax.Array:
        return jax.ops.segment_sum(values, cell, size, indices_are_sorted=True)

    def residuals(centre: jax.Array, normal: jax.Array) -> jax.Array:
        return jnp.einsum("rwi,ri->rw", xyz - centre[cell][:, None], normal[cell], precision="highest")

    def near_plane(centre: jax.Array, normal: jax.Array) -> jax.Array:
        return jnp.logical_and(mask, jnp.abs(residuals(centre, normal)) <= distance)

    def hypothesis(best: _Best, draw: jax.Array) -> tuple[_Best, None]:
        pick = jnp.minimum((draw[None] * points[:, None].astype(draw.dtype)).astype(jnp.int32), points[:, None] - 1)
        a, b, c = jnp.moveaxis(xyz[row[:, None] + pick // ROW_LENGTH, pick % ROW_LENGTH], 1, 0)
        normal = jnp.cross(b - a, c - a)
        length = jnp.linalg.norm(normal, axis=1)
        normal = normal * (jnp.sign(normal[:, 2]) / jnp.maximum(length, 1e-9))[:, None]
        usable = (normal[:, 2] > 0) & (normal[:, 2] >= jnp.cos(jnp.deg2rad(max_slope)))
        score = jnp.where(usable, total(near_plane(a, normal).sum(axis=1, dtype=jnp.int32)), -1)
        better = score > best[0]
        kept = jnp.where(better[None, :, None], jnp.stack([a, normal]), jnp.stack(best[1:]))
        return (jnp.maximum(score, best[0]), kept[0], kept[1]), None

    up = jnp.zeros((size, 3), jnp.float32).at[:, 2].set(1)
    start = (jnp.zeros(size, jnp.int32), jnp.zeros((size, 3), jnp.float32), up)
    (score, centre, normal), _ = lax.scan(hypothesis, start, draws)

    near = near_plane(centre, normal)
    inliers = total(near.sum(axis=1, dtype=jnp.int32))
    weight = near.astype(xyz.dtype)[..., None]
    mean = total((xyz * weight).sum(axis=1)) / jnp.maximum(inliers, 1)[:, None].astype(xyz.dtype)
    x, y, z = jnp.moveaxis((xyz - mean[cell][:, None]) * weight, -1, 0)
    gradient, fitted = gradients(x, y, z, inliers, lambda values: total(values.sum(axis=1)))
    plane = Planes(mean, gradient, fitted)
    centre = jnp.where(fitted[:, None], mean, centre)
    normal = jnp.where(fitted[:, None], plane.normal, normal)
    inliers = total(near_plane(centre, normal).sum(axis=1, dtype=jnp.int32))
    lowest = jnp.where(mask, residuals(centre, normal), 0).min(axis=1)
    below = -jnp.minimum(jax.ops.segment_min(lowest, cell, size, indices_are_sorted=True), 0)
    return Consensus(centre, normal, jnp.where(score > 0, inliers, 0), below)
