"""Where there is no ground point far and wide, so that a terrain model is a guess."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ..core.errors import ParameterError
from .interpolation import nearest_point
from .layer import Layer, Site
from .models import blocks_of


@dataclasses.dataclass(frozen=True)
class Voids(Layer):
    """A mask, 1 where a cell's centre is so far from every ground point that a terrain model is a guess, and 0 elsewhere.

    Attributes:
        distance: metres.

    Raises: ParameterError for a distance that is not positive.

    >>> near, far = (jf.voids.replace(distance=distance)(cloud, result).values for distance in (1.0, 100.0))
    >>> bool(0 < near.mean() < 1), bool(far.any())
    (True, False)
    """

    NAME, TITLE, KIND, NODATA, SURFACE = "voids", "void", "uint8", 255, False
    distance: float = 5.0

    def __post_init__(self) -> None:
        if not 0 < self.distance < math.inf:
            raise ParameterError(f"distance={self.distance!r} must be a positive number of metres")

    def reach(self, side: float) -> float:
        """As far as a ground point may be."""
        return side + self.distance

    def values(self, site: Site) -> np.ndarray:
        """0 or 1."""
        out, ground = np.ones(site.grid.shape, np.float32), site.cloud.xyz[site.ground]
        if len(ground):
            nearest = nearest_point(ground, site.workers, self.distance)
            for rows, at in blocks_of(site.cloud, site.grid):
                out[rows] = np.isinf(nearest(at)[0]).reshape(-1, site.grid.columns)
        return out
