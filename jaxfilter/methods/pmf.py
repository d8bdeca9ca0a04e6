"""PMF: the progressive morphological filter of Zhang et al. (2003)."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from ..core.errors import ParameterError
from ..core.filter import Filter, Labels, ground_each
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Progress
from ..engines.grid.inpaint import fill_nearest
from ..engines.grid.morphology import progressive_opening
from ..steps.grid_filter import GridFilter, LowOutlierFilter, Surface, labels_of
from ..steps.point_boxes import PointBoxes
from ..steps.surfaces import Cells, cell_for, cell_values, look_up, lowest_cells
from .papers import bibtex

Limits = tuple[jax.Array, jax.Array]
"""The highest and the lowest elevation of ground in every cell."""
_PROGRAM = {"last_window": "beyond", "compare": "points", "low_clusters": False}


@filter_params
class PMF(LowOutlierFilter):
    """Openings with ever larger windows; what an opening takes off by more than the terrain's slope allows is no ground.

    K. Zhang, S.-C. Chen, D. Whitman, M.-L. Shyu, J. Yan, C. Zhang (2003): A progressive morphological filter for removing
    nonground measurements from airborne LIDAR data. IEEE Trans. Geosci. Remote Sens. 41 (4), 872-882.
    doi:10.1109/TGRS.2003.810682

    1. Lowest point per cell; empty cells take the value of the nearest cell.
    2. Openings with windows w(k) of 2 x 2^k + 1 cells (``exponential``), or of 4 k + 5 cells, k from 0 on, each of the surface
       that the one before left.
    3. The threshold is h(0) = initial_distance, then
       h(k) = min(max_distance, slope x (w(k) - w(k-1)) x cell + initial_distance).
    4. ``compare`` = "surfaces", as in the paper: cells that the k-th opening lowers by more than h(k) are objects. Ground are
       points in other cells at most initial_distance above the first opening.
       ``compare`` = "points", as programs have it: ground are points at most h(k) above the k-th opening, for every k. As in
       the programs, the rise of h(k) is multiplied by the cell twice.

    ``reading`` = "points" takes no grid: the windows are squares of w(k) x cell metres around each point, over the points
    that are ground so far, at their own elevations.

    The result's ``height`` is metres above the last opening, ``slope`` that surface's in degrees, ``margin`` metres above the
    limit.

    "paper" is the plain method, square windows up to 33 m, without a defence against low outliers, each of which lowers the
    surface around it by a window. "recommended", the default, bars clusters of low points and opens with disks up to 60 m.
    Both take the thresholds of "cai2023" (S. Cai et al. 2023, Forests 14, 498), since the originals are set site by site.

    Departures: docs/filters/pmf.md.

    >>> result = jf.PMF(max_window=33.0)(cloud)
    >>> bool((result.ground == (result.margin <= 0)).all())
    True
    """

    max_window: float = static(
        "the largest window is as wide as the widest building", "w > 0 m", default=60.0, cells=2000
    )
    slope: float = param("terrain rises at most this steeply; 0.268 is 15 degrees", "s > 0 rise/run", default=0.268)
    initial_distance: float = param("the first window has this height threshold", "dh0 >= 0 m", default=0.5)
    max_distance: float = param(
        "no threshold exceeds this: the height of the lowest building", "dhmax > 0 m", default=3.0
    )
    exponential: bool = static(
        "each window is twice as wide as the one before; if false, four cells wider", default=True
    )
    last_window: str = static(
        "the last window is max_window, or the last step within or beyond it",
        default="exact",
        choices=("exact", "within", "beyond"),
    )
    reading: str = static(
        "windows lie on a grid of minima, or around every point", default="grid", choices=("grid", "points")
    )
    compare: str = static(
        "an opening is compared with the last surface or points", default="surfaces", choices=("surfaces", "points")
    )
    element: str = static("windows on the grid have this shape", default="disk", choices=("disk", "square", "diamond"))

    BIBTEX: ClassVar[str] = bibtex("zhang2003progressive")
    ORDER_FREE: ClassVar[bool] = True
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: disks, successive surfaces are compared, clusters of low points are barred"
        ),
        "paper": Preset(
            "as printed, except that values are set site by site there and those of Cai et al. (2023) here, and that points "
            "that are no minima are held against the first opening",
            max_window=33.0, last_window="within", element="square", low_clusters=False,
        ),
        "pdal": Preset(
            "`filters.pmf` of PDAL with its defaults: diamonds on a grid, every point against every opening",
            **_PROGRAM, element="diamond", max_window=33.0, slope=1.0, initial_distance=0.15, max_distance=2.5,
        ),
        "pcl": Preset(
            "`ProgressiveMorphologicalFilter` of PCL with its defaults: squares around every point",
            **_PROGRAM, reading="points", max_window=33.0, slope=0.7, initial_distance=0.15, max_distance=10.0,
        ),
        "cai2023": Preset(
            "PCL as Cai et al. (2023), Table 2, ran it: window 10 m, 15 degrees, 0.5 and 3 m",
            **_PROGRAM, reading="points", max_window=10.0,
        ),
    }  # fmt: skip

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.reading == "points" and self.compare == "surfaces":
            raise ParameterError("PMF(reading='points'): only points can be compared; set compare='points'")

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """A cell of 1 m, or of a quarter of the point spacing where that is more; the largest building as the largest
        window. Over simulated scenes with 0.1 to 1 points per m2 no rule with wider cells does better."""
        own = {} if largest_building is None else {"max_window": largest_building}
        return own | {"cell": cell_for(spacing, 1 / 4)}

    def radii(self) -> list[int]:
        """Radii of the windows, cells: a window is 2 r + 1 cells wide.

        >>> jf.PMF(max_window=33.0).radii()
        [1, 2, 4, 8, 16]
        """
        widest = self.max_window / self.cell
        limit = math.ceil((widest - 1) / 2 - 1e-6)
        steps = (2**k if self.exponential else 2 * (k + 1) for k in itertools.count())
        radii = []
        while (radius := next(steps)) < limit:
            radii.append(radius)
        if self.last_window == "exact":
            return [*radii, max(limit, 1)]
        fits = 2 * radius + 1 <= widest + 1e-6
        return [*radii, radius] if fits or self.last_window == "beyond" or not radii else radii

    def thresholds(self) -> np.ndarray | jax.Array:
        """f32, metres: the threshold of every window.

        >>> jf.PMF(max_window=9.0, slope=0.25).thresholds().tolist()
        [0.5, 1.0, 1.5]
        """
        growth = 2 * np.diff(self.radii()) * self.cell * (self.cell if self.compare == "points" else 1.0)
        fields = self.slope, self.initial_distance, self.max_distance
        slope, initial, most = (jnp.float32(v) if isinstance(v, jax.Array) else np.float32(v) for v in fields)
        grown = slope * np.append(0.0, growth).astype(np.float32) + initial
        return jnp.clip(grown, max=most) if isinstance(most, jax.Array) else grown.clip(max=most)

    def halo(self) -> float:
        """Reach of all openings, one after the other, and what the search for low clusters looks at, metres, but at most one and
        a half of the largest window: openings hardly ever add up to more.

        An empty cell takes the nearest value at any distance: a void wider than this at the border of a tile is not covered.
        """
        all_openings = self.cell * (2 * sum(self.radii()) + len(self.radii()) + 3) + 30.0 * self.low_clusters
        return min(all_openings, 1.5 * self.max_window)

    def prepare(self, cells: Cells) -> tuple[Cells, jax.Array]:
        """Step 1. Pure. Raises: ParameterError if ``reading`` is "points", which takes no grid."""
        if self.reading == "points":
            raise ParameterError("PMF(reading='points'): windows around points take no grid; use reading='grid'")
        return cells, fill_nearest(cells.lowest, cells.seen, cells.valid)

    def surface(self, prepared: tuple[Cells, jax.Array]) -> Surface:
        """Steps 2 to 4. Pure."""
        return self._open(*prepared, self.thresholds())

    @jax.jit
    def _open(self, cells: Cells, surface: jax.Array, thresholds: jax.Array) -> Surface:
        """The last opening; its limits are the elevations between which points of a cell are ground, f32[rows, columns] each.

        The upper limit of an object cell lies below the surface. The lower limit is for barred points: no other lies there.
        """

        def look(k: jax.Array, before: jax.Array, opened: jax.Array, limits: Limits) -> Limits:
            ceiling, floor = limits
            holds = (k == 0) | (self.compare == "points") | (before - opened > thresholds[k])
            ceiling = jnp.where(holds, jnp.minimum(ceiling, opened + thresholds[k]), ceiling)
            return ceiling, jnp.where(k == 0, opened - thresholds[0], floor)

        radii, nothing = jnp.array(self.radii()), jnp.full_like(surface, jnp.inf)
        valid, how = jnp.asarray(cells.valid), {"reach": max(self.radii()), "element": self.element}
        last, limits = progressive_opening(surface, valid, radii, look, (nothing, -nothing), **how)
        return Surface.over(cells, last, limits, {"windows": len(radii)})

    def _soft(self, prepared: tuple[Cells, jax.Array], xyz: jax.Array, width: jax.Array | float) -> jax.Array:
        """Where surfaces are compared, the product over all openings of one minus (how clearly the opening makes the point's
        cell an object) times (how clearly the point is above its limit); else as for :class:`GridFilter`. Continuous, and
        differentiable but for kinks, in all traced fields; f32[n], 0 to 1. Pure."""
        if self.compare == "points":
            return super()._soft(prepared, xyz, width)
        (cells, surface), thresholds, xyz = prepared, jnp.asarray(self.thresholds()), jnp.asarray(xyz)

        def look(k: jax.Array, before: jax.Array, opened: jax.Array, passed: jax.Array) -> jax.Array:
            base, drop = cell_values(xyz, (opened, before - opened), cells.grid)
            height = xyz[:, 2] - base
            is_object = jax.nn.sigmoid((drop - thresholds[k]) / width)
            holds = 1 - is_object * jax.nn.sigmoid((height - thresholds[k]) / width)
            return jnp.where(k == 0, jax.nn.sigmoid((thresholds[0] - jnp.abs(height)) / width), passed * holds)

        radii, start = jnp.array(self.radii()), jnp.ones(len(xyz), jnp.float32)
        return progressive_opening(
            surface, jnp.asarray(cells.valid), radii, look, start, reach=max(self.radii()), element=self.element
        )[1]

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see the class for the steps and :class:`jaxfilter.core.filter.Filter` for the call."""
        if self.reading == "points":
            return self._open_points(points, self._barred(points, workers), progress)
        return super().classify(points, key=key, workers=workers, progress=progress, trace=trace)

    def _open_points(self, points: Points, barred: np.ndarray, progress: Progress) -> Labels:
        """Windows around points; those that failed take no part in further openings."""
        z, widths = points.xyz[:, 2], [(2 * radius + 1) * self.cell for radius in self.radii()]
        boxes = PointBoxes(points, widths[0], widths[-1])
        ceiling = np.full(len(z), np.inf, np.float32)
        for k, (width, threshold) in enumerate(zip(widths, np.asarray(self.thresholds()), strict=True)):
            progress(0.3 + 0.6 * k / len(widths), "openings")
            opened = boxes.opened(z, ~barred & (z <= ceiling), width)
            ceiling = np.minimum(ceiling, opened + threshold)
            if k == 0:
                floor = opened - threshold
        known = np.isfinite(opened)
        left = dataclasses.replace(points, xyz=np.column_stack((points.xyz[:, :2], opened)))
        cells = lowest_cells(left, self.cell, "PMF(cell)", barred=~known)
        last = Surface.over(cells, fill_nearest(cells.lowest, cells.seen, cells.valid))
        surface, slope = look_up(points.xyz, cells, last.z, last.slope)
        labels = labels_of(z - np.where(known, opened, surface), slope, z - ceiling, floor - z)
        labels.barred, labels.info = barred, {"windows": len(widths)}
        return labels


@ground_each.register(PMF)
def _ground_each(filter_: PMF, *arguments: Any, **options: Any) -> Iterator[tuple[int, np.ndarray]]:
    """All sets share the grid and its openings; around points, what is opened depends on the thresholds."""
    return ground_each.dispatch(GridFilter if filter_.reading == "grid" else Filter)(filter_, *arguments, **options)
