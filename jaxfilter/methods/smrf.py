"""SMRF: the simple morphological filter of Pingel, Clarke & McBride (2013)."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np

from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..engines.grid.inpaint import fill_membrane
from ..engines.grid.morphology import opening, roomy
from ..steps.grid_filter import GridFilter, Heights, Surface
from ..steps.surfaces import Cells, cell_for, cell_values, check_openings, steepest_drops
from .papers import bibtex

_PER_OCTAVE = 4  # slopes of the series that :func:`jaxfilter.soft_labels` interpolates in
LOW_SLOPE = 5.0  # rise over run of the pass for low outliers (section 2.2: 500 %)


@filter_params
class SMRF(GridFilter):
    """Openings of a grid of lowest elevations with growing disks, then a tolerance that grows with the slope.

    T. J. Pingel, K. C. Clarke, W. A. McBride (2013): An improved simple morphological filter for the terrain classification
    of airborne LIDAR data. ISPRS J. Photogramm. Remote Sens. 77, 21-30. doi:10.1016/j.isprsjprs.2012.12.002

    1. Lowest point per cell; empty cells are filled by a membrane (springs).
    2. Low outliers: cells that one opening of the inverted grid, with a disk of one cell, changes by more than 500 %.
    3. Optional net (``cut``): rows and columns of the grid at this spacing are lowered to its opening with a disk of
       radius 2 ``cut``, so that no building is wider than a mesh.
    4. Openings with disks of 1, 2, ... ceil(window / cell) cells, each of the surface left by the one before. Cells that
       the k-th lowers by more than slope x k x cell are objects.
    5. Provisional terrain: empty, low, object and net cells are filled by a membrane.
    6. Ground are the points within threshold + scaling x (slope of the terrain) of the terrain.

    The result's ``height`` is metres above the terrain, ``slope`` that of the terrain in degrees, ``margin`` |height|
    minus the tolerance in metres; ``info`` counts cells: all, empty, low, objects.

    "paper" and "recommended" are the single parameter set for all sites (section 3.2), which is the default.

    Departures (docs/filters/smrf.md): exactly Euclidean disks; bilinear interpolation at the points. Cells are centred on a
    lattice that counts from the cloud's anchor, which by default is that of the authors.

    >>> result = jf.SMRF(slope=0.2, threshold=0.5)(cloud)
    >>> result.info["object_cells"] > 0
    True
    >>> bool((result.ground == (result.margin <= 0)).all())
    True
    """

    slope: float = param("terrain is at most this steep from cell to cell", "s > 0 rise/run", default=0.15)
    window: float = static("the last disk has this radius: half a building", "w > 0 m", default=18.0, cells=1000)
    threshold: float = param("ground is at most this far from level terrain", "et >= 0 m", default=0.5)
    scaling: float = param("this times the slope of the terrain is added to the threshold", "es >= 0 m", default=1.25)
    cut: float = static(
        "a net of lines this far apart cuts buildings that are larger than the window; 0 = no net",
        ">= 0 m",
        default=0.0,
        cells=1000,
    )

    BIBTEX: ClassVar[str] = bibtex("pingel2013improved")
    ORDER_FREE: ClassVar[bool] = True
    TESTED: ClassVar[tuple[str, ...]] = ("threshold", "scaling")
    CENTRED: ClassVar[bool] = True
    PRESETS: ClassVar[dict[str, Preset]] = {
        "paper": Preset(
            "as printed: the authors' single set for all sites, except that heights at the points are bilinear, not splines"
        ),
        "recommended": Preset("the default: the authors' single set for all sites"),
    }

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """A cell of 1 m, or of half the point spacing where that is more; a disk as wide as the largest building.

        Cells need not hold a point, since empty ones are filled; half is what does best on simulated scenes.
        """
        own = {} if largest_building is None else {"window": largest_building / 2}
        return own | {"cell": cell_for(spacing, 1 / 2)}

    @property
    def reach(self) -> int:
        """Radius of the largest disk, cells.

        >>> jf.SMRF(cell=2.0, window=15.0).reach
        8
        """
        return math.ceil(self.window / self.cell - 1e-6)

    @property
    def mesh(self) -> int:
        """Spacing of the net, cells; 0 without one.

        >>> jf.SMRF(cell=2.0, cut=20.0).mesh
        10
        """
        return math.ceil(self.cut / self.cell - 1e-6)

    def halo(self) -> float:
        """Reach of all openings, one after the other, and of the gradient, metres, but at most five radii of the largest disk:
        openings hardly ever add up to more.

        Membranes reach as far as the void they span: a void wider than this at the border of a tile is not covered.
        """
        all_openings = self.cell * (self.reach * (self.reach + 1) + 8 * self.mesh + 3)
        return min(all_openings, 5.0 * self.window + 8.0 * self.cut)

    def cells(self, points: Points, barred: np.ndarray | None = None) -> Cells:
        """As in the other methods on grids. Raises: InputError also where few points take many openings of many cells."""
        cells = super().cells(points, barred)
        check_openings(cells, self.reach, points, f"SMRF(cell={self.cell:g}, window={self.window:g})")
        return cells

    def prepare(self, cells: Cells) -> CellDrops:
        """Steps 1 to 4, for all slopes at once. Pure."""
        return self._open(cells, _span_membrane(cells.lowest, cells.lowest, cells.seen, cells, math.inf)[0].z)

    def _open(self, cells: Cells, surface: jax.Array) -> CellDrops:
        return _cell_drops(cells, surface, self.reach, most=roomy(self.reach), mesh=self.mesh)

    def surface(self, prepared: CellDrops) -> Surface:
        """Step 5, the provisional terrain. Pure."""
        return self._terrain(prepared, self.slope)

    def _terrain(self, prepared: CellDrops, slope: jax.Array | float) -> Surface:
        """The terrain at a slope, a float or f32[]."""
        cells, surface, steepest, bare, counts = prepared
        # the same program as in prepare(), which is compiled once
        terrain, objects = _span_membrane(surface, steepest, bare, cells, slope)
        return terrain._replace(counts={**counts, "object_cells": objects})

    def _deciding(self, prepared: CellDrops, sets: Sequence[Self]) -> list[Any]:
        """How many cells are left: of slopes between which there is none the terrain is the same."""
        if (type(self).surface, type(self)._terrain) != (SMRF.surface, SMRF._terrain):
            return super()._deciding(prepared, sets)
        drops = np.sort(np.asarray(prepared.steepest)[np.asarray(prepared.bare)])
        limits = np.array([one.slope for one in sets], np.float32) * np.float32(self.cell)
        return np.searchsorted(drops, limits, side="right").tolist()

    def test(self, surface: Surface, xyz: jax.Array | np.ndarray) -> Heights:
        """Step 6, terrain interpolated bilinearly. Pure, and differentiable in ``threshold`` and ``scaling``."""
        return _test_points(surface, xyz, self.threshold, self.scaling)

    def _soft(self, prepared: CellDrops, xyz: jax.Array, width: jax.Array | float) -> jax.Array:
        """A mixture, in every point, of two cases, by how clearly its cell is an object: it is one, and the point is held
        against the terrain without all cells that would be objects at half the slope; or not, and it is held against the
        surface as it is. A terrain changes in jumps. So it is made at two neighbours in a series of slopes, each 19 % larger
        than the one before, and the labels are interpolated. Continuous in ``slope``, ``threshold`` and ``scaling``, and
        differentiable; where half the slope is one of the series the derivative has a jump. f32[n], 0 to 1. Pure."""
        cells, filled, steepest = prepared[:3]
        step = _PER_OCTAVE * jnp.log2(0.5 * jnp.asarray(self.slope, jnp.float32))
        first = jax.lax.stop_gradient(jnp.floor(step))
        slopes = jnp.exp2((first + jnp.arange(2, dtype=jnp.float32)) / _PER_OCTAVE)
        ends = jax.vmap(lambda slope: self._terrain(prepared, slope))(slopes)

        def passed(surface: Surface) -> jax.Array:
            return jax.nn.sigmoid(-self.test(surface, xyz).margin / width)

        below, above = jax.vmap(passed)(ends)
        as_object, as_terrain = below + (step - first) * (above - below), passed(Surface.over(cells, filled))
        drop = cell_values(xyz, (steepest,), cells.grid)[0]
        is_object = jax.nn.sigmoid((jnp.where(jnp.isfinite(drop), drop, 1e6) - self.slope * cells.grid.cell) / width)
        return is_object * as_object + (1 - is_object) * as_terrain


class CellDrops(NamedTuple):
    """What the openings tell of cells, whatever the largest slope of terrain: a pytree.

    Attributes:
        cells: the cells.
        surface: f32[rows, columns], metres, with empty cells filled.
        steepest: f32[rows, columns], metres per cell of radius: at a smaller largest slope a cell is an object.
        bare: bool[rows, columns], cells with points that are neither low outliers nor net.
        counts: numbers of cells, i32[] each.
    """

    cells: Cells
    surface: jax.Array
    steepest: jax.Array
    bare: jax.Array
    counts: dict[str, jax.Array]


@functools.partial(jax.jit, static_argnames=("most", "mesh"))
def _cell_drops(cells: Cells, surface: jax.Array, reach: jax.Array | int, most: int, mesh: int) -> CellDrops:
    """Steps 2 to 4, of the surface without empty cells. ``most``: the largest ``reach`` that this compilation serves."""
    valid, cell = jnp.asarray(cells.valid), cells.grid.cell
    low = valid & (-surface - opening(-surface, 1, 1, valid=valid) > LOW_SLOPE * cell)
    net, cut = jnp.zeros_like(valid), surface
    if mesh:
        row, column = (jax.lax.broadcasted_iota(jnp.int32, valid.shape, axis) for axis in range(2))
        net = valid & ((row % mesh == 0) | (column % mesh == 0))
        cut = jnp.where(net, opening(surface, 2 * mesh, 2 * mesh, valid=valid), surface)
    drops = jnp.where(valid, steepest_drops(cut, valid, reach, most), 0)
    counted = {"cells": valid, "empty_cells": valid & ~cells.seen, "low_cells": low}
    counts = {name: number.sum(dtype=jnp.int32) for name, number in counted.items()}
    return CellDrops(cells, surface, jnp.where(net, jnp.inf, drops), ~low & ~net & cells.seen, counts)


@jax.jit
def _test_points(surface: Surface, xyz: jax.Array, threshold: jax.Array | float, scaling: jax.Array | float) -> Heights:
    height, slope = surface.at(xyz)
    tolerance = threshold + scaling * slope
    return Heights(height, slope, height - tolerance, -height - tolerance)


@jax.jit
def _span_membrane(
    z: jax.Array, steepest: jax.Array, bare: jax.Array, cells: Cells, slope: jax.Array | float
) -> tuple[Surface, jax.Array]:
    """The membrane through the cells that are ``bare`` and no objects, and the number of objects, net included."""
    objects = steepest > slope * cells.grid.cell
    filled = fill_membrane(z, bare & ~objects, cells.valid).z
    return Surface.over(cells, jax.lax.optimization_barrier(filled)), objects.sum(dtype=jnp.int32)
