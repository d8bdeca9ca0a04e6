"""All layers by name, in the order in which a survey has them, and the public ones, which make rasters of clouds in memory."""

from __future__ import annotations

from .breaklines import breaklines as breaklines
from .chm import Chm
from .contours import Contours
from .contours import contours as contours
from .density import Count, Density
from .dsm import Dsm
from .hillshade import Hillshade
from .hillshade import hillshade as hillshade
from .layer import Layer
from .models import Dtm
from .voids import Voids

dsm, chm, density, count, voids = Dsm(), Chm(), Density(), Count(), Voids()
LAYERS: dict[str, Layer] = {
    layer.NAME: layer for layer in (Dtm(), dsm, chm, Hillshade(), density, count, voids, Contours())
}
