"""SPF: PTD from the seeds of a progressive morphological filter, cleaned on their triangulation (Chen et al. 2023)."""

from __future__ import annotations

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.grid.morphology import raised_cells
from ..engines.grid.spread import fill_from_neighbours
from ..engines.tin.growth import Network
from ..steps.outliers import isolated_low
from ..steps.seed_clusters import clustered_seeds
from ..steps.seeds import lowest_of_cells
from ..steps.surfaces import cell_for, lowest_cells
from ..steps.tin_filter import OutlierFate, TerrainAngle, facet_reach
from . import papers

FILLS = ("neighbours", "zero")
BORDER_SPACING = 10.0  # metres between the simulated points around the seeds
_TAIL = 1e-3
"""Share of the points beyond each end of the histogram of elevations that outliers are counted from."""


@filter_params
class SPF(OutlierFate, TerrainAngle):
    """Seed points filtering: progressive TIN densification from many seeds.

    N. Chen, N. Wang, Y. He, X. Ding, J. Kong (2023): An improved progressive triangular irregular network densification
    filtering algorithm for airborne LiDAR data. Frontiers in Earth Science 10, 1015153. doi:10.3389/feart.2022.1015153

    1. Lowest point per cell; empty cells get the mean of their neighbours (Sec. 2.2 A).
    2. Openings with squares of W_1, W_2, ... cells, each of the surface left by the one before, until W exceeds
       ``window``. Cells that the k-th lowers by more than h_k are objects; the lowest points of the others are potential
       seeds (Sec. 2.2 B, eq. 1 to 3).
    3. On the triangulation of the potential seeds the highest vertex of a facet with a long edge is noise, and facets that
       are narrow and steep cut off clusters of noise (Sec. 2.3, :mod:`jaxfilter.steps.seed_clusters`).
    4. PTD from the seeds that are left and from simulated points around them; all points that pass in a round are added
       together (Sec. 2.4). Lengths in metres, angles in degrees.

    ``info`` counts ``potential_seeds`` and ``removed_seeds``. The paper prints no parameter values. "recommended", the
    default, and "paper" differ in outliers, which are cut from the histogram of elevations and by their height below their
    neighbours in the paper (Sec. 2.1), and in cells that cannot be interpolated, which get elevation 0.

    Departures (docs/fidelity.md): thresholds of "long", "narrow" and of ground clusters are ours; the simulated points
    stand beside the data, not a buffer's width away.

    >>> result = jf.SPF(window=30.0)(cloud)
    >>> result.info["potential_seeds"] > result.info["removed_seeds"]
    True
    """

    cell: float = static(default=2.0, symbol="c", unit="m", gt=0, doc="a grid cell is this wide")
    window: float = static(
        default=60.0, symbol="W", unit="m", gt=0, cells=1000, doc="the largest building is this wide"
    )
    slope: float = param(
        default=0.5, symbol="s", unit="rise/run", ge=0, doc="terrain is at most this steep; thresholds grow with it"
    )
    initial_distance: float = param(
        default=0.3, symbol="h0", unit="m", gt=0, doc="the smallest window has this height threshold"
    )
    max_height: float = param(
        default=2.5, symbol="hmax", unit="m", gt=0, doc="no threshold exceeds this: the height of the lowest building"
    )
    fill: str = static(
        default="neighbours", choices=FILLS, doc="empty cells get the mean of their neighbours, or elevation 0"
    )
    seed_filter: bool = static(default=True, doc="seeds that stand out of their triangulation as noise are removed")
    max_angle: float = param(
        default=25.0, symbol="theta", unit="degrees", gt=0, lt=90, doc="ground has at most this angle to its facet"
    )
    max_distance: float = param(
        default=1.4, symbol="d", unit="m", gt=0, doc="ground is at most this far from the plane of its facet"
    )
    histogram_margin: float = static(
        default=0.0, unit="m", ge=0, doc="an outlier is this far beyond the 0.1 or 99.9 % quantile of z; 0 = off"
    )
    isolated_depth: float = static(
        default=0.0, unit="m", ge=0, doc="an outlier is this far below the lowest of its 8 nearest points; 0 = off"
    )

    BIBTEX: ClassVar[str] = papers.CHEN_2023
    WINDOW: ClassVar[str] = "window"
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: clusters of low points are barred from the seeds, empty cells are filled from their neighbours"
        ),
        "paper": Preset(
            "as printed, except that no value of any parameter is printed (those of the default, and 5 m and 2 m for "
            "outliers, which the authors cut by eye and correct by hand)",
            low_clusters=False,
            fill="zero",
            histogram_margin=5.0,
            isolated_depth=2.0,
            outlier_fate="removed",
        ),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Cells of half a point spacing, in steps of 0.5 m and 1 m at least; on simulated scenes wider ones do no better."""
        return super().from_spacing(spacing, largest_building) | {"cell": cell_for(spacing, 1 / 2)}

    def halo(self) -> float:
        """Reach of the largest opening (those before it add nothing with squares) and of facets over what it removes."""
        return 2 * self.windows()[-1] * self.cell + facet_reach(self.window)

    def windows(self) -> list[int]:
        """Window sizes W_k = 2 k + 1 in cells (eq. 1); the last exceeds the largest building.

        >>> jf.SPF(cell=2.0, window=12.0).windows()
        [3, 5, 7]
        """
        sizes = [3]
        while sizes[-1] * self.cell <= self.window:
            sizes.append(sizes[-1] + 2)
        return sizes

    def thresholds(self) -> list[float]:
        """Height thresholds h_k in metres for the windows (eq. 3): h0 up to three cells, then s (W_k - W_k-1) c + h0, at
        most hmax.

        >>> jf.SPF(cell=2.0, window=12.0, slope=0.5).thresholds()
        [0.3, 2.3, 2.3]
        """
        sizes = self.windows()
        slopes = [self.slope if size > 3 else 0.0 for size in sizes]
        growth = [size - before for size, before in zip(sizes, [1, *sizes], strict=False)]
        rises = [self.initial_distance + s * g * self.cell for s, g in zip(slopes, growth, strict=True)]
        return [min(rise, self.max_height) for rise in rises]

    def lattice(self) -> float:
        """The cells of the openings."""
        return self.cell

    def potential_seeds(self, points: Points, barred: np.ndarray) -> np.ndarray:
        """i64[p], ascending: rows of the lowest points of the cells that no opening marked. ``barred``: bool[m]."""
        cells = lowest_cells(points, self.cell, "SPF(cell)", barred=barred)
        surface, rounds = cells.lowest, sum(cells.lowest.shape)
        if self.fill == "zero":  # one round for the mean of the neighbours, and elevation 0 where there are none
            zero, rounds = -points.cloud.origin[2] * points.cloud.units.z, 1
            surface = jnp.where(cells.seen, surface, np.float32(zero))
        surface, _ = fill_from_neighbours(surface, cells.seen, cells.valid, np.int32(rounds))
        radii = np.array(self.windows(), np.int32) // 2
        heights = np.array(self.thresholds(), np.float32)
        raised = raised_cells(surface, cells.valid, radii, heights, reach=int(radii[-1]), element="square")
        return lowest_of_cells(points, cells, ~raised, barred)

    def outliers(self, points: Points, workers: int | None, **tests: Any) -> tuple[np.ndarray, np.ndarray]:
        """As in the other TIN filters, and the tails of the elevations, and isolated low points of the rest (Sec. 2.1)."""
        barred, late = super().outliers(points, workers, **tests)
        z, found = points.xyz[:, 2], np.zeros(len(points), bool)
        if self.histogram_margin > 0:
            low, high = np.quantile(z, (_TAIL, 1 - _TAIL))
            found = (z < low - self.histogram_margin) | (z > high + self.histogram_margin)
        if self.isolated_depth > 0:
            rest = np.flatnonzero(~found)
            found[rest] = isolated_low(points.xyz[rest], 8, self.isolated_depth, workers=workers)
        return barred | found, late

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        barred, late = self.outliers(points, workers)
        progress(0.0, "openings")
        potential = seeds = self.potential_seeds(points, barred)
        if self.seed_filter:
            progress(0.0, "seeds")
            keep = clustered_seeds(
                points.xyz[potential],
                long_edge=self.window + 2 * self.cell,
                raised=self.max_height,
                workers=workers,
            )
            seeds = potential[keep]
        info = {"potential_seeds": len(potential), "removed_seeds": len(potential) - len(seeds)}
        return self.network(points, seeds, BORDER_SPACING, barred, late, info=info)
