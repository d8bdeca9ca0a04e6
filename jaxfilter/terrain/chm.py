"""How high trees and buildings are."""

from __future__ import annotations

import dataclasses

import numpy as np

from .dsm import Dsm
from .layer import Site
from .models import Dtm


@dataclasses.dataclass(frozen=True)
class Chm(Dsm):
    """The canopy height model, buildings included: how high the surface of :class:`Dsm` lies above the terrain of :func:`dtm`.

    Heights are in units of Z, and 0 where the surface lies below the terrain. The settings, in metres, are those of :class:`Dsm`.

    >>> heights = jf.chm(cloud, result).values
    >>> bool(np.nanmin(heights) == 0), bool(np.nanmax(heights) > 5)
    (True, True)
    """

    NAME, TITLE = "chm", "height above the ground"

    def values(self, site: Site) -> np.ndarray:
        """Heights. Raises: InputError for too few ground points."""
        surface = site.of(Dsm(self.levels, self.gap, self.radius))
        return np.maximum(surface - site.of(Dtm()), np.float32(0))
