"""Least-squares planes through padded blocks of points and their residuals."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from ..core.arrays import operation
from ..engines.plane_sums import slopes_by_sums

_DEGENERATE = 1e-6  # share of the squared spread below which positions count as lying on a line


class Planes(NamedTuple):
    """One plane z = z0 + a (x - x0) + b (y - y0) per block.

    Attributes:
        centre: f32[B, 3], mean of the points, metres.
        gradient: f32[B, 2], a and b; zero for blocks that determine no plane.
        determined: bool[B], False with fewer than three points or with all of them on a vertical plane.

    >>> from jaxfilter.steps import planes
    >>> xyz = jnp.array([[[0.0, 0.0, 1.0], [2.0, 0.0, 2.0], [0.0, 2.0, 1.0], [2.0, 2.0, 2.0]]])
    >>> fitted = planes.fit_planes(xyz, jnp.ones((1, 4), bool))
    >>> fitted.centre.tolist(), fitted.determined.tolist()
    ([[1.0, 1.0, 1.5]], [True])
    """

    centre: jax.Array
    gradient: jax.Array
    determined: jax.Array

    @property
    def normal(self) -> jax.Array:
        """f32[B, 3], unit normals, pointing upward."""
        up = jnp.concatenate([-self.gradient, jnp.ones_like(self.gradient[..., :1])], axis=-1)
        return up / jnp.linalg.norm(up, axis=-1, keepdims=True)

    @property
    def slope(self) -> jax.Array:
        """f32[B], degrees."""
        return jnp.rad2deg(jnp.arctan(jnp.linalg.norm(self.gradient, axis=-1)))


def gradients(
    x: jax.Array, y: jax.Array, z: jax.Array, count: jax.Array, total: Callable[[jax.Array], jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """f32[B, 2]: gradients of planes through points; bool[B]: whether these determine one. The gradient is zero where they do
    not: fewer than three points, or all on one line in x and y.

    Args:
        x, y, z: coordinates of points about the mean of their block; zero for those that do not count.
        count: points of each block, [B]. total: sums over blocks, [B], of what points have.
    """
    xx, xy, yy, xz, yz = (total(p * q) for p, q in ((x, x), (x, y), (y, y), (x, z), (y, z)))
    along_x, along_y, determinant = slopes_by_sums(xx, xy, yy, xz, yz)
    determined = (determinant > _DEGENERATE * (xx + yy) ** 2) & (count >= 3)
    scaled = jnp.stack([along_x, along_y], axis=-1)
    return jnp.where(determined[:, None], scaled / jnp.where(determined, determinant, 1)[:, None], 0), determined


@operation(xyz="f32[B, N, 3]", mask="bool[B, N]")
def fit_planes(xyz: jax.Array, mask: jax.Array) -> Planes:
    """Planes with the least sum of squared vertical residuals, in closed form about the mean of each block.

    Args:
        xyz: f32[B, N, 3], local metres.
        mask: bool[B, N], the points that count; the others (padding) may hold any finite value. No block is empty.

    >>> from jaxfilter.steps import planes
    >>> xyz = jnp.array([[[0.0, 0.0, 1.0], [2.0, 0.0, 2.0], [0.0, 2.0, 1.0], [2.0, 2.0, 2.0]]])
    >>> fitted = planes.fit_planes(xyz, jnp.ones((1, 4), bool))
    >>> fitted.gradient.round(3).tolist()
    [[0.5, 0.0]]
    """
    weight = mask.astype(xyz.dtype)[..., None]
    count = jnp.maximum(weight.sum(axis=1), 1)
    origin = jnp.take_along_axis(xyz, jnp.argmax(mask, axis=1)[:, None, None], axis=1)
    mean = ((xyz - origin) * weight).sum(axis=1) / count
    centre = origin[:, 0] + mean
    x, y, z = jnp.moveaxis((xyz - origin - mean[:, None]) * weight, -1, 0)
    return Planes(centre, *gradients(x, y, z, weight[..., 0].sum(axis=1), lambda values: values.sum(axis=1)))


@operation(xyz="f32[B, N, 3]")
def plane_residuals(planes: Planes, xyz: jax.Array) -> jax.Array:
    """f32[B, N], signed distance of points f32[B, N, 3] to the plane of their block, metres along the normal, up > 0.

    >>> from jaxfilter.steps import planes
    >>> xyz = jnp.array([[[0.0, 0.0, 1.0], [2.0, 0.0, 2.0], [0.0, 2.0, 1.0], [2.0, 2.0, 2.0]]])
    >>> fitted = planes.fit_planes(xyz, jnp.ones((1, 4), bool))
    >>> bool(jnp.allclose(planes.plane_residuals(fitted, xyz), 0, atol=1e-6))
    True
    """
    return jnp.einsum("bni,bi->bn", xyz - planes.centre[:, None], planes.normal, precision="highest")
