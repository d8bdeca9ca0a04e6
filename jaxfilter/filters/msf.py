"""MSF: the slope based filter of Vosselman (2000), with one maximum slope."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..core.filter import Filter, Labels
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..ops.cones import cone_erosion, cone_limits
from ..ops.morphology import erosion
from ..stages.outliers import bar_outliers
from ..stages.surfaces import (
    LowestCells,
    cell_for,
    check_width,
    hold_against,
    labels_between,
    look_up,
    lowest_cells,
    lowest_places,
    steepness,
)
from . import papers

MAX_REACH = 100  # cells; the time grows with the square


@filter_params
class MSF(Filter):
    """Maximum slope: a point is ground if no point near it is lower than the slope of the terrain allows.

    G. Vosselman (2000): Slope based filtering of laser altimetry data. Int. Arch. Photogramm. Remote Sens. 33 (B3),
    935-942. In the form that S. Cai, X. Liang, S. Yu (2023), Forests 14, 498, compare with (their Table 2: cell 1 m, window
    10 m, slope 15 degrees, maximum height 3 m).

    A point p is ground if z(p) - z(q) <= min(max_height, initial_distance + slope x distance) for all q within ``window``.
    That is an erosion: the ground is what lies on or below the cloud eroded with the allowance as structuring element. Here
    q runs over the lowest points of square cells, and the erosion is one of a grid.

    The result's ``height`` is metres above the surface eroded with the slope alone, ``slope`` that surface's in degrees,
    ``margin`` metres above the limit.

    "paper" is the plain rule with the thresholds of Cai et al., who name no tolerance for noise. It has no defence against
    low outliers, each of which clears the ground around it up to the window. "recommended" is the default: clusters of low
    points are barred from the cells' minima, and terrain may rise by 30 degrees and 6 m (15 degrees rejects all of a steeper
    hillside; on steep simulated scenes still more does better, see docs/fidelity.md).

    Departures (docs/fidelity.md): minima of cells instead of all points; distances between cell centres unless
    ``distance`` is "points"; one constant slope instead of a function learned from a training area.
    """

    cell: float = static(default=1.0, unit="m", gt=0, doc="side of a grid cell")
    window: float = static(
        default=10.0, symbol="d_max", unit="m", gt=0, doc="radius in which lower points are looked for"
    )
    slope: float = param(default=0.577, unit="rise/run", gt=0, doc="largest slope of terrain; 0.577 is 30 degrees")
    max_height: float = param(default=6.0, unit="m", gt=0, doc="largest rise of terrain within the window")
    initial_distance: float = param(default=0.3, unit="m", ge=0, doc="tolerance for noise, at no distance")
    distance: str = static(
        default="cells",
        choices=("cells", "points"),
        doc="from cell to cell, or from the point to the lowest point of the cell",
    )
    low_clusters: bool = static(default=True, choices=(True, False), doc="bar clusters of low outliers from the minima")

    BIBTEX: ClassVar[str] = papers.VOSSELMAN_2000
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

    def check(self) -> None:
        """Validate the fields. Raises ParameterError."""
        super().check()
        check_width(self, "window", MAX_REACH)

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
        """The window, two cells, and what the search for low clusters looks at, metres."""
        return self.window + 2 * self.cell + 15.0 * self.low_clusters

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see :class:`jaxfilter.core.filter.Filter` for the call."""
        progress(0.0, "outliers")
        barred, _ = bar_outliers(points, radius=0.0, min_neighbours=1, clusters=self.low_clusters, workers=workers)
        progress(0.3, "lowest point per cell")
        cells = lowest_cells(points.xyz, self.cell, points.offset(self.cell), name="MSF(cell)", barred=barred)
        progress(0.4, "erosion")
        envelope, ceiling = self._erode(cells)
        floor = envelope - np.float32(self.initial_distance)
        slopes = steepness(jnp.where(cells.valid & jnp.isfinite(envelope), envelope, 0), cells.extent, cells.frame[2])
        progress(0.8, "classifying")
        surface, slope, top, bottom = look_up(points.xyz, cells, envelope, slopes, ceiling, floor)
        if self.distance == "points":
            top = self._limits(points.xyz, cells, barred)
        progress(1.0, "done")
        labels = labels_between(points.xyz[:, 2], surface, slope, top, bottom)
        labels.barred = barred
        return labels

    def _erode(self, cells: LowestCells) -> tuple[jax.Array, jax.Array]:
        """The surface eroded with the slope alone, and the limit for points, f32[rows, columns].

        Where the allowance has reached its largest value the structuring element is flat: an erosion with a disk.
        """
        reach = math.floor(self.window / self.cell + 1e-6)
        rise = self.slope * self.cell
        lowest = jnp.where(cells.seen, cells.lowest, jnp.inf)
        steep = min(float(reach), (self.max_height - self.initial_distance) / rise)
        cone = cone_erosion(lowest, np.float32(rise), np.float32(steep), reach)
        flat = erosion(lowest, reach, reach) + np.float32(self.max_height)
        return cone, jnp.minimum(cone + np.float32(self.initial_distance), flat)

    def _limits(self, xyz: np.ndarray, cells: LowestCells, barred: np.ndarray) -> np.ndarray:
        """f32[n]: the limit for every point, by its distances to the lowest points of cells."""
        reach = math.ceil(self.window / self.cell + math.sqrt(2))
        lowest = jnp.where(cells.seen, cells.lowest, jnp.inf)
        place = lowest_places(xyz, cells, barred)
        limits = np.array([self.initial_distance, self.slope, self.max_height, self.window], np.float32)
        return hold_against(
            xyz, lambda chunk: (cone_limits(chunk, lowest, place, cells.frame, cells.extent, limits, reach),)
        )[0]
