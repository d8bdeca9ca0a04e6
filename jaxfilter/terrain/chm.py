"""How high trees and buildings are."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from ..core.units import Units
from .dsm import Dsm
from .layer import Layer, Site
from .models import Dtm
from .raster import RasterGrid


@dataclasses.dataclass(frozen=True)
class Chm(Dsm):
    """The canopy height model, buildings included: how high the surface of :class:`Dsm` lies above the terrain of :func:`dtm`.

    Heights are in units of Z, and 0 where the surface lies below the terrain. The settings, in metres, are those of :class:`Dsm`.

    >>> heights = jf.chm(cloud, result).values
    >>> bool(np.nanmin(heights) == 0), bool(np.nanmax(heights) > 5)
    (True, True)
    """

    NAME, TITLE = "chm", "height above the ground"

    @property
    def parts(self) -> tuple[Layer, ...]:
        """The surface and the terrain."""
        return Dtm(), Dsm(self.levels, self.gap, self.radius)

    def made_of(self, known: Mapping[Layer, np.ndarray], grid: RasterGrid, units: Units) -> np.ndarray:
        """Heights."""
        terrain, surface = (known[part] for part in self.parts)
        return np.maximum(surface - terrain, np.float32(0))

    def values(self, site: Site) -> np.ndarray:
        """Heights. Raises: InputError for too few ground points."""
        return Layer.values(self, site)
