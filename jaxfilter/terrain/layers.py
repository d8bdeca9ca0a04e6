"""The rasters and lines of a survey by name. A new one is a file with a :class:`Layer`, and a line here."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from .layer import Layer


class Entry(NamedTuple):
    """A layer before it is asked for. ``home``: module and class; ``help``: what its command makes, in words."""

    home: str
    help: str

    @property
    def kind(self) -> type[Layer]:
        """The class, which is imported now: it brings JAX and SciPy."""
        module, _, name = self.home.partition(":")
        found: type[Layer] = getattr(import_module(module, __package__), name)
        return found


LAYERS = {
    "dtm": Entry(".models:Dtm", "a terrain model (DTM)"),
    "dsm": Entry(".rasters:Dsm", "a surface model (DSM) from the first echoes, without pits"),
    "chm": Entry(".rasters:Chm", "a canopy height model (CHM): surface less terrain"),
    "hillshade": Entry(".rasters:Hillshade", "a shaded relief of the terrain, 1 to 255, as GDAL does"),
    "density": Entry(".rasters:Density", "a raster of ground points per square metre"),
    "count": Entry(".rasters:Count", "a raster of the number of ground points in a cell"),
    "voids": Entry(".rasters:Voids", "a mask of voids: 1 where no ground point is near, else 0"),
    "contours": Entry(".contours:Contours", "contour lines of the terrain, with their elevation"),
}
"""In the order in which a survey has them."""
