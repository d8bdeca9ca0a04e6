"""Relief: how bright the terrain is in the light of a low sun."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from ..core.errors import ParameterError
from ..core.units import Units
from .layer import Layer
from .models import Dtm
from .raster import Raster, RasterGrid


@dataclasses.dataclass(frozen=True)
class Hillshade(Layer):
    """Make a shaded relief of the terrain model, 1 (dark) to 255, after Horn (1981) as GDAL has it."""

    NAME, TITLE, KIND, NODATA = "hillshade", "hillshade", "uint8", 0
    azimuth: float = 315.0
    altitude: float = 45.0

    def __post_init__(self) -> None:
        if not (0 <= self.azimuth <= 360 and 0 < self.altitude <= 90):
            raise ParameterError(
                f"azimuth={self.azimuth!r}, altitude={self.altitude!r}: must be degrees, 0 to 360 from north, and above 0 up "
                "to 90 from the horizon"
            )

    @property
    def parts(self) -> tuple[Layer, ...]:
        """The terrain."""
        return (Dtm(),)

    def made_of(self, known: Mapping[Layer, np.ndarray], grid: RasterGrid, units: Units) -> np.ndarray:
        """Whole numbers."""
        return self.shade(known[Dtm()], grid.cell, units.z / units.xy)

    def shade(self, z: np.ndarray, cell: float, z_factor: float) -> np.ndarray:
        """f32[rows, columns], of heights f32[rows, columns]."""
        rows, columns = z.shape
        ring = np.pad(z.astype(np.float64) * z_factor, 1, constant_values=np.nan)
        a, b, c, d, e, f, g, h, i = (ring[r : r + rows, k : k + columns] for r in range(3) for k in range(3))
        a, b, c, d, f, g, h, i = (np.where(np.isnan(one), e, one) for one in (a, b, c, d, f, g, h, i))
        east = ((c + 2 * f + i) - (a + 2 * d + g)) / (8 * cell)
        north = ((a + 2 * b + c) - (g + 2 * h + i)) / (8 * cell)
        azimuth, altitude = math.radians(self.azimuth), math.radians(self.altitude)
        along = east * math.sin(azimuth) + north * math.cos(azimuth)  # up, on the way to the sun
        light = (math.sin(altitude) - math.cos(altitude) * along) / np.sqrt(1 + east * east + north * north)
        return np.floor(1.5 + 254 * np.maximum(light, 0.0)).astype(np.float32)


def hillshade(model: Raster, azimuth: float = 315.0, altitude: float = 45.0, z_factor: float = 1.0) -> Raster:
    """The relief of a terrain model, or of any heights, in the light of a sun: gradients after Horn (1981), as in GDAL.

    Args:
        model: heights, for instance of :func:`dtm`.
        azimuth: where the light comes from, degrees from north to east.
        altitude: how high the sun stands, degrees above the horizon.
        z_factor: metres per unit of the heights by metres per unit of X and Y; 1 where both have one unit.

    Returns: Raster of whole numbers from 1 (dark) to 255, in files uint8 with 0 for nothing. A neighbour without height counts as
    high as the cell itself, so that every cell with a height has a value.
    Raises: ParameterError for angles out of range.

    >>> relief = jf.hillshade(jf.dtm(cloud, result))
    >>> bool(1 <= np.nanmin(relief.values) < 100 < np.nanmax(relief.values) <= 255)
    True
    """
    layer = Hillshade(azimuth, altitude)
    values = layer.shade(model.values, model.cell, z_factor)
    return Raster(values, model.transform, model.crs, layer.NODATA, layer.KIND, layer.TITLE)
