"""SPF: PTD from the seeds of a progressive morphological filter, cleaned on their triangulation (Chen et al. 2023)."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from ..core.filter import stage
from ..core.grid import period
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.grid.morphology import raised_cells
from ..engines.grid.spread import fill_from_neighbours
from ..engines.tin.growth import Network, Outliers
from ..engines.tin.network import with_nodes
from ..steps.outlier_filter import OutlierFate
from ..steps.outliers import isolated_low
from ..steps.seed_clusters import clustered_seeds
from ..steps.seeds import lowest_of_cells
from ..steps.surfaces import cell_for, lowest_cells
from ..steps.tin_filter import TerrainAngle, surrounded
from .papers import bibtex

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
    neighbours in the paper (Sec. 2.1), and in empty cells: those that can be interpolated are vertices until the end (Sec.
    2.4), and the others get elevation 0.

    Departures (docs/filters/spf.md): thresholds of "long", "narrow" and of ground clusters are ours; the simulated points
    stand beside the data, not a buffer's width away.

    >>> result = jf.SPF(window=30.0)(cloud)
    >>> result.info["potential_seeds"] > result.info["removed_seeds"]
    True
    """

    cell: float = static("a grid cell is this wide", "c > 0 m", default=2.0)
    window: float = static("the largest building is this wide", "W > 0 m", default=60.0, cells=1000)
    slope: float = param("terrain is at most this steep; thresholds grow with it", "s >= 0 rise/run", default=0.5)
    initial_distance: float = param("the smallest window has this height threshold", "h0 > 0 m", default=0.3)
    max_height: float = param("no threshold exceeds this: the height of the lowest building", "hmax > 0 m", default=2.5)
    fill: str = static(
        "empty cells get the mean of their neighbours, or elevation 0", default="neighbours", choices=FILLS
    )
    interpolated: bool = static(
        "an empty cell beside cells with points has a vertex at its centre, at their mean elevation", default=False
    )
    seed_filter: bool = static("seeds that stand out of their triangulation as noise are removed", default=True)
    max_angle: float = param("ground has at most this angle to its facet", "theta > 0 and < 90 degrees", default=25.0)
    max_distance: float = param("ground is at most this far from the plane of its facet", "d > 0 m", default=1.4)
    histogram_margin: float = static(
        "an outlier is this far beyond the 0.1 or 99.9 % quantile of z; 0 = off", ">= 0 m", default=0.0
    )
    isolated_depth: float = static(
        "an outlier is this far below the lowest of its 8 nearest points; 0 = off", ">= 0 m", default=0.0
    )

    BIBTEX: ClassVar[str] = bibtex("chen2023improved")
    WINDOW: ClassVar[str] = "window"
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: clusters of low points are barred from the seeds, empty cells are filled from their neighbours"
        ),
        "paper": Preset(
            "as printed, except that no value of any parameter is printed (those of the default, and 5 m and 2 m for "
            "outliers, which the authors cut by eye and correct by hand), and that cells of elevation 0 are no vertices",
            low_clusters=False,
            fill="zero",
            interpolated=True,
            histogram_margin=5.0,
            isolated_depth=2.0,
            outlier_fate="removed",
        ),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """Cells of half a point spacing, in steps of 0.5 m and 1 m at least; on simulated scenes wider ones do no better."""
        return super().from_spacing(spacing, largest_building) | {"cell": cell_for(spacing, 1 / 2)}

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
        """Whole cells of the openings, and whole steps between simulated border points."""
        return period(self.cell, BORDER_SPACING)

    def potential_seeds(self, points: Points, barred: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the cells that no opening marked. ``barred``: bool[m].

        Returns: i64[p], ascending, rows of their lowest points; with ``interpolated`` f32[i, 3], local metres, the centres of
        empty ones beside cells with points, else f32[0, 3].
        """
        cells = lowest_cells(points, self.cell, "SPF(cell)", barred=barred)
        surface, rounds = cells.lowest, sum(cells.lowest.shape)
        if self.fill == "zero":  # one round for the mean of the neighbours, and elevation 0 where there are none
            zero, rounds = -points.cloud.origin[2] * points.cloud.units.z, 1
            surface = jnp.where(cells.seen, surface, np.float32(zero))
        surface, _ = fill_from_neighbours(surface, cells.seen, cells.valid, np.int32(rounds))
        radii = np.array(self.windows(), np.int32) // 2
        heights = np.array(self.thresholds(), np.float32)
        raised = raised_cells(surface, cells.valid, radii, heights, reach=int(radii[-1]), element="square")
        chosen = np.logical_not(raised)
        seeds = lowest_of_cells(points, cells, chosen, barred)
        if not self.interpolated:
            return seeds, np.zeros((0, 3), np.float32)
        _, beside = fill_from_neighbours(cells.lowest, cells.seen, cells.valid, np.int32(1))
        row, column = np.nonzero(chosen & np.asarray(beside) & ~np.asarray(cells.seen))
        x, y = cells.grid.x0 + (column + 0.5) * self.cell, cells.grid.y0 + (row + 0.5) * self.cell
        centre = np.clip(np.column_stack([x, y]), *points.extent)  # where no simulated point around the cloud stands
        return seeds, np.column_stack([centre, np.asarray(surface)[row, column]]).astype(np.float32)

    @stage
    def outliers(self, points: Points, workers: int | None) -> Outliers:
        """As in the other TIN filters, and the tails of the elevations, and isolated low points of the rest (Sec. 2.1)."""
        known = super().outliers(points, workers)
        z, found = points.xyz[:, 2], np.zeros(len(points), bool)
        if self.histogram_margin > 0:
            low, high = np.quantile(z, (_TAIL, 1 - _TAIL))
            found = (z < low - self.histogram_margin) | (z > high + self.histogram_margin)
        if self.isolated_depth > 0:
            rest = np.flatnonzero(~found)
            found[rest] = isolated_low(points.xyz[rest], 8, self.isolated_depth, workers=workers)
        return known._replace(barred=known.barred | found)

    def start(self, points: Points, workers: int | None, progress: Progress, trace: bool = False) -> Network:
        progress(0.0, "outliers")
        outliers = self.outliers(points, workers)
        progress(0.0, "openings")
        seeds, nodes = self.potential_seeds(points, outliers.barred)
        potential = len(seeds)
        if self.seed_filter:
            progress(0.0, "seeds")
            keep = clustered_seeds(
                np.concatenate([points.xyz[seeds], nodes]),
                long_edge=self.window + 2 * self.cell,
                raised=self.max_height,
                workers=workers,
                triangulation=self.triangulation,
            )
            seeds, nodes = seeds[keep[:potential]], nodes[keep[potential:]]
        info = {"potential_seeds": potential, "removed_seeds": potential - len(seeds), "interpolated_nodes": len(nodes)}
        network = surrounded(self, points, seeds, outliers, BORDER_SPACING)
        return dataclasses.replace(with_nodes(network, nodes) if len(nodes) else network, info=info)
