"""How many ground points there are, cell by cell."""

from __future__ import annotations

import dataclasses

import numpy as np

from .layer import Layer, Site
from .outline import places_of


@dataclasses.dataclass(frozen=True)
class Count(Layer):
    """How many ground points there are in each of the cells. Points on an eastern or northern edge belong to the next one.

    >>> bounds = (512000, 5403000, 512060, 5403060)
    >>> bool(jf.count(cloud, result, cell=2.0, bounds=bounds).values.sum() == result.ground.sum())
    True
    """

    NAME, TITLE, SURFACE = "count", "number of ground points", False

    def values(self, site: Site) -> np.ndarray:
        """Whole numbers."""
        grid = site.grid
        columns, rows = (place[site.ground] for place in places_of(site.cloud, grid))
        own = (columns >= 0) & (columns < grid.columns) & (rows >= 0) & (rows < grid.rows)
        cells = rows[own] * grid.columns + columns[own]
        return np.bincount(cells, minlength=grid.rows * grid.columns).reshape(grid.shape).astype(np.float32)


@dataclasses.dataclass(frozen=True)
class Density(Layer):
    """How many ground points there are per m2 in each cell, which says how well a terrain model is supported.

    >>> number = jf.count(cloud, result, cell=2.0).values
    >>> bool((jf.density(cloud, result, cell=2.0).values == number / 4).all())
    True
    """

    NAME, TITLE, SURFACE = "density", "density of ground points, per square metre", False

    def values(self, site: Site) -> np.ndarray:
        """Points per m2."""
        return (site.of(Count()) / site.side**2).astype(np.float32)
