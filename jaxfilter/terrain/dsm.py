"""The surface on top of everything: trees, roofs and ground, without pits."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import scipy

from ..core.errors import ParameterError
from ..core.points import canonical_points, has_area
from .interpolation import Linear
from .layer import Layer, Site
from .models import blocks_of, heights_of
from .outline import occupied, places_of

NOISE = (7, 18)
"""ASPRS classes of low and of high noise."""
_CELLS = 1.5
"""``radius``, in cells."""


@dataclasses.dataclass(frozen=True)
class Dsm(Layer):
    """The surface on top of a cloud: the highest of trees, roofs and ground, without pits, after Khosravipour et al. (2014).

    First echoes are triangulated once for each of some levels: those that are at least so high above the ground. A cell has the
    highest of these surfaces, so that echoes from inside a crown make no pit. Classes 7 and 18, low outliers of the result, and
    withheld points are left out. docs/fidelity.md says what the paper does otherwise. It is called like :func:`dtm`, and
    ``replace`` gives it other settings.

    Attributes:
        levels: metres above the ground; 0 is one of them, and stands for all first echoes. With 0 alone there are pits.
        gap: metres, radius up to which the circle through the corners of a triangle of all first echoes counts: wider voids, such
            as water, have no height.
        radius: the same for the levels above 0; by default one and a half cells.

    Raises: ParameterError for settings out of range; when called, InputError as :func:`dtm`, and if no point is ground.

    >>> surface, ground = jf.dsm.replace(gap=20.0)(cloud, result, cell=2.0), jf.dtm(cloud, result, cell=2.0)
    >>> bool(np.nanmean(surface.values >= ground.values - 0.5) > 0.95)
    True
    """

    NAME, TITLE = "dsm", "height of the surface"
    levels: tuple[float, ...] = (0.0, 2.0, 5.0, 10.0, 15.0)
    gap: float = 10.0
    radius: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", tuple(sorted(float(level) for level in self.levels)))
        for name, value in (("gap", self.gap), ("radius", self.radius)):
            if value is not None and not 0 < value < math.inf:
                raise ParameterError(f"{name}={value!r} must be a positive number of metres")
        if not self.levels or self.levels[0] != 0 or not math.isfinite(self.levels[-1]):
            raise ParameterError(f"levels={self.levels!r} must be metres above the ground, and 0 among them")

    def reach(self, side: float) -> float:
        """As far as the circles of triangles go."""
        return side + 2 * max(self.gap, self.radius or _CELLS * side)

    def values(self, site: Site) -> np.ndarray:
        """Heights. Raises: InputError if no point is ground."""
        cloud, out = site.cloud, np.full(site.grid.shape, -np.inf)
        xyz, height = self._echoes(site)
        for level in self.levels:
            top, limit = (xyz[height >= level], self.radius or _CELLS * site.side) if level else (xyz, self.gap)
            if not has_area(top):
                continue
            cells = occupied(dataclasses.replace(cloud, xyz=top, valid=None), site.grid)
            near = scipy.ndimage.maximum_filter(cells, 2 * math.ceil(2 * limit / site.side) + 3, mode="constant")
            surface = Linear(top, site.workers)
            for rows, at in blocks_of(cloud, site.grid):
                some = near[rows].ravel()
                out[rows].reshape(-1)[some] = np.fmax(out[rows].ravel()[some], surface.within(at[some], limit))
        out[np.isinf(out)] = np.nan
        return (cloud.origin[2] + out / cloud.units.z).astype(np.float32)

    def _echoes(self, site: Site) -> tuple[np.ndarray, np.ndarray]:
        """f32[m, 3], local metres: of each position the highest first echo; and f64[m], its metres above the ground."""
        cloud, grid, margin = site.cloud, site.grid, math.ceil(self.reach(site.side) / site.side)
        use = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid.copy()
        for place, count in zip(places_of(cloud, grid), (grid.columns, grid.rows), strict=True):
            use &= (place >= -margin) & (place < count + margin)
        for left_out in (site.noise, cloud.withheld):
            use &= True if left_out is None else ~left_out
        use &= True if cloud.return_number is None else cloud.return_number <= 1
        use &= True if cloud.classification is None else ~np.isin(cloud.classification, NOISE)
        points = canonical_points(dataclasses.replace(cloud, candidate=use))
        top = np.append((np.diff(points.xyz[:, :2], axis=0) != 0).any(axis=1), True)[: len(points)]
        xyz, rows = points.xyz[top], points.gather(np.arange(len(cloud)))[top]
        if len(self.levels) == 1 or not (site.ground.any() or site.strict):
            return xyz, np.full(len(xyz), -np.inf)
        return xyz, heights_of(cloud, site.ground, rows, workers=site.workers, look=site.look) * cloud.units.z
