"""MSF: the slope based filter of Vosselman (2000), with one maximum slope."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp

from ..core.params import Preset, filter_params, param, static
from ..engines.grid.cones import cone_erosion
from ..engines.grid.morphology import erosion
from ..steps.grid_filter import LowOutlierFilter, Surface
from ..steps.surfaces import Cells, cell_for
from .papers import bibtex

MAX_REACH = 100  # cells; the time grows with the square


@filter_params
class MSF(LowOutlierFilter):
    """Maximum slope: a point is ground if no point near it is lower than the slope of the terrain allows.

    G. Vosselman (2000): Slope based filtering of laser altimetry data. Int. Arch. Photogramm. Remote Sens. 33 (B3),
    935-942. In the form that S. Cai, X. Liang, S. Yu (2023), Forests 14, 498, compare with (their Table 2: cell 1 m, window
    10 m, slope 15 degrees, maximum height 3 m).

    A point p is ground if z(p) - z(q) <= min(max_height, initial_distance + slope x distance) for all q within ``window``.
    That is an erosion: the ground is what lies on or below the cloud eroded with the allowance as structuring element. Here
    q runs over the lowest points of square cells, and the erosion is one of a grid.

    The result's ``height`` is metres above the surface eroded with the slope alone, as far as the allowance grows; ``slope``
    is that surface's in degrees, ``margin`` metres above the limit.

    "paper" is the plain rule with the thresholds of Cai et al., who name no tolerance for noise. It has no defence against
    low outliers, each of which clears the ground around it up to the window. "recommended" is the default: clusters of low
    points are barred from the cells' minima, and terrain may rise by 30 degrees and 6 m (15 degrees rejects all of a steeper
    hillside; on steep simulated scenes still more does better, see docs/filters/msf.md).

    Departures (docs/filters/msf.md): minima of cells instead of all points; distances between cell centres; one constant slope
    instead of a function learned from a training area.

    >>> mild, steep = (jf.MSF(slope=slope)(cloud) for slope in (0.2, 0.6))
    >>> bool((mild.ground <= steep.ground).all())
    True
    """

    window: float = static(
        "lower points are sought within this radius, in whole cells", "d_max > 0 m", default=10.0, cells=MAX_REACH
    )
    slope: float = param("terrain rises at most this steeply; 0.577 is 30 degrees", "> 0 rise/run", default=0.577)
    max_height: float = param("terrain rises at most by this within the window", "> 0 m", default=6.0)
    initial_distance: float = param(
        "a point may be this much higher than one beside it, because of noise", ">= 0 m", default=0.3
    )

    BIBTEX: ClassVar[str] = bibtex("vosselman2000slope")
    ORDER_FREE: ClassVar[bool] = True
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset("the default: terrain up to 30 degrees and 6 m, clusters of low points barred"),
        "paper": Preset(
            "as reported by Cai et al. (2023), Table 2 (15 degrees, 3 m, window 10 m), except that the window is a radius "
            "and that 0.3 m of tolerance, which is not reported, is added",
            slope=math.tan(math.radians(15.0)),
            max_height=3.0,
            low_clusters=False,
        ),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """A window as wide as the largest building, and cells of 1 m, or of a quarter of the point spacing, or of a
        hundredth of the window. The largest rise is 0.6 of the window, as by default, so that hillsides stay."""
        cell = cell_for(spacing, 1 / 4)
        if largest_building is None:
            return {"cell": cell}
        window = largest_building / 2
        cell = max(cell, 0.5 * math.ceil(2 * window / MAX_REACH - 1e-6))
        return {"cell": cell, "window": window, "max_height": max(6.0, 0.6 * window)}

    def halo(self) -> float:
        """The window, two cells, and for low clusters twice what the search looks at, since their depressions may be wide
        where points are few; metres."""
        return self.window + 2 * self.cell + 60.0 * self.low_clusters

    @jax.jit
    def surface(self, prepared: Cells) -> Surface:
        """The surface eroded with the slope alone, as far as the allowance grows, and the limits for points. Pure.

        Where the allowance has reached its largest value the structuring element is flat: an erosion with a disk.
        """
        cells, reach = prepared, math.floor(self.window / self.cell + 1e-6)
        slope, highest, tolerance = (jnp.float32(v) for v in (self.slope, self.max_height, self.initial_distance))
        rise = slope * cells.grid.cell
        lowest = jnp.where(cells.seen, cells.lowest, jnp.inf)
        steep = jnp.minimum(jnp.float32(reach), (highest - tolerance) / rise)
        cone = cone_erosion(lowest, rise, steep, reach)
        flat = erosion(lowest, reach, reach) + highest
        limits = jnp.minimum(cone + tolerance, flat), cone - tolerance
        known = jnp.where(cells.valid & jnp.isfinite(cone), cone, 0)
        return Surface.over(cells, known, limits)._replace(z=cone)
