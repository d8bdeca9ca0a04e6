"""SMRF: the simple morphological filter of Pingel, Clarke & McBride (2013)."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np

from ..core.filter import Filter, Labels
from ..core.params import Preset, filter_params, param, static
from ..core.points import Points
from ..core.result import Decision, Progress
from ..ops.inpaint import fill_membrane
from ..ops.morphology import opening
from ..stages.surfaces import LowestCells, cell_for, check_width, chunks, cropped, hold_against, lowest_cells, steepness
from . import papers

_SLOPES, _LANES, _SETS = 256, 16, 32
"""In a sweep: slopes that share the openings, terrains filled at a time, sets tested at a time."""
_CELL_BYTES, _POINT_BYTES = 80, 24
"""About so many of memory per cell, and per point, for each terrain of a sweep."""
LOW_SLOPE = 5.0  # rise over run of the pass for low outliers (section 2.2: 500 %)


def _oracle(number: int, slope: float, window: float, threshold: float, scaling: float) -> Preset:
    return Preset(
        f"ISPRS sample {number}: slope {slope:g}, window {window:g} m, {threshold:g} m, scaling {scaling:g}; the authors' "
        "optimum on its labels",
        slope=slope,
        window=window,
        threshold=threshold,
        scaling=scaling,
    )


@filter_params
class SMRF(Filter):
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

    "paper" and "recommended" are the single parameter set for all sites (section 3.2), which is the default. The presets
    "samp11" to "samp71" are the authors' optima per ISPRS sample. They were found with that sample's labels: an upper
    bound for the method, not settings to expect on unseen data.

    Departures from the paper and its MATLAB code: disks are exactly Euclidean (MATLAB approximates them by line
    segments); terrain and slope are interpolated bilinearly at the points instead of by cubic splines, which moves the
    kappa of ISPRS samples 11 to 42 by at most 0.2 points and needs a quarter of the memory accesses; cells are
    centred on the nodes of a lattice that starts at the cloud's lower left corner, or at its anchor, where the authors
    count from zero of the coordinate system (a cloud with anchor (0, 0) is gridded in their way).
    """

    cell: float = static(default=1.0, doc="side of a grid cell", symbol="c", unit="m", gt=0)
    slope: float = param(default=0.15, doc="largest slope of terrain between cells", symbol="s", unit="rise/run", gt=0)
    window: float = static(
        default=18.0,
        doc="radius of the largest disk: half the width of the largest building",
        symbol="w",
        unit="m",
        gt=0,
    )
    threshold: float = param(default=0.5, doc="tolerance on level terrain", symbol="et", unit="m", ge=0)
    scaling: float = param(default=1.25, doc="tolerance added per unit of terrain slope", symbol="es", unit="m", ge=0)
    cut: float = static(default=0.0, doc="spacing of the net that cuts large buildings; 0 = none", unit="m", ge=0)

    BIBTEX: ClassVar[str] = papers.PINGEL_2013
    ORDER_FREE: ClassVar[bool] = True
    PRESETS: ClassVar[dict[str, Preset]] = {
        "paper": Preset(
            "as printed: the authors' single set for all sites, except that heights at the points are bilinear, not splines"
        ),
        "recommended": Preset("the default: the authors' single set for all sites"),
        "samp11": _oracle(11, 0.20, 16.0, 0.45, 1.20),
        "samp12": _oracle(12, 0.18, 12.0, 0.30, 0.95),
        "samp21": _oracle(21, 0.12, 20.0, 0.60, 0.00),
        "samp22": _oracle(22, 0.16, 18.0, 0.35, 1.30),
        "samp23": _oracle(23, 0.27, 13.0, 0.50, 0.90),
        "samp24": _oracle(24, 0.16, 8.0, 0.20, 2.05),
        "samp31": _oracle(31, 0.08, 15.0, 0.25, 1.50),
        "samp41": _oracle(41, 0.22, 16.0, 1.10, 0.00),
        "samp42": _oracle(42, 0.06, 49.0, 1.05, 0.00),
        "samp51": _oracle(51, 0.05, 17.0, 0.35, 0.90),
        "samp52": _oracle(52, 0.13, 13.0, 0.25, 2.20),
        "samp53": _oracle(53, 0.45, 3.0, 0.10, 3.80),
        "samp54": _oracle(54, 0.05, 11.0, 0.15, 2.30),
        "samp61": _oracle(61, 0.28, 5.0, 0.50, 1.45),
        "samp71": _oracle(71, 0.13, 15.0, 0.75, 0.00),
    }

    def check(self) -> None:
        """Validate the fields. Raises ParameterError."""
        super().check()
        for name in ("window", "cut"):
            check_width(self, name, 1000)

    @classmethod
    def from_spacing(cls, spacing: float, largest_building: float | None) -> dict[str, Any]:
        """A cell of 1 m, or of half the point spacing where that is more; a disk as wide as the largest building.

        Cells need not hold a point, since empty ones are filled; half is what does best on simulated scenes.
        """
        own = {} if largest_building is None else {"window": largest_building / 2}
        return own | {"cell": cell_for(spacing, 1 / 2)}

    @property
    def reach(self) -> int:
        """Radius of the largest disk, cells."""
        return math.ceil(self.window / self.cell - 1e-6)

    @property
    def mesh(self) -> int:
        """Spacing of the net, cells; 0 without one."""
        return math.ceil(self.cut / self.cell - 1e-6)

    def halo(self) -> float:
        """Reach of all openings, one after the other, and of the gradient, metres.

        Membranes reach as far as the void they span: a void wider than this at the border of a tile is not covered.
        """
        openings = self.reach * (self.reach + 1) + 8 * self.mesh
        return self.cell * (openings + 3)

    def classify(self, points: Points, *, key: Any, workers: int | None, progress: Progress, trace: bool) -> Labels:
        """Labels of all points; see the class for the steps and :class:`jaxfilter.core.filter.Filter` for the call."""
        progress(0.0, "lowest point per cell")
        cells = self.cells(points)
        extent, frame, valid = cells.extent, cells.frame, cells.valid

        progress(0.1, "filling empty cells")
        surface = fill_membrane(cells.lowest, cells.seen, valid).z
        progress(0.3, "openings")
        rises = np.asarray([self.slope * self.cell, LOW_SLOPE * self.cell], np.float32)
        bare, counts = _bare_cells(surface, cells.seen, valid, rises, self.reach, self.mesh)
        progress(0.6, "filling object cells")
        terrain = fill_membrane(surface, bare, valid).z
        slopes = steepness(terrain, extent, frame[2])

        progress(0.8, "classifying")
        tolerance = np.asarray([self.threshold, self.scaling], np.float32)
        height, slope, margin = hold_against(
            points.xyz, lambda chunk: _test(chunk, terrain, slopes, frame, extent, tolerance)
        )
        ground = margin <= 0
        decision = np.where(ground, Decision.ACCEPTED, np.where(height < 0, Decision.LOW, Decision.SURFACE))
        names = ("cells", "empty_cells", "low_cells", "object_cells")
        info = {name: int(n) for name, n in zip(names, np.asarray(counts), strict=True)}
        progress(1.0, "done")
        return Labels(ground, height=height, slope=slope, margin=margin, decision=decision.astype(np.uint8), info=info)

    def cells(self, points: Points) -> LowestCells:
        """The lowest point per cell; cells are centred on the nodes of the lattice."""
        ox, oy = points.offset(self.cell)
        return lowest_cells(points.xyz, self.cell, (ox - self.cell / 2, oy - self.cell / 2), name="SMRF(cell)")

    def ground_each(
        self, points: Points, sets: Sequence[Self], *, key: Any, workers: int | None, memory: float
    ) -> Iterator[tuple[int, np.ndarray]]:
        """All sets share the grid and the openings; those with one slope share the terrain, and terrains are filled
        several at a time."""
        cells = cropped(self.cells(points))
        surface = fill_membrane(cells.lowest, cells.seen, cells.valid).z
        rise = np.asarray([one.slope * one.cell for one in sets], np.float32)
        rises = np.unique(rise)
        lanes = int(np.clip(memory // (_CELL_BYTES * surface.size + _POINT_BYTES * len(points)), 1, _LANES))
        before: tuple[list[Any], np.ndarray, np.ndarray] = [], np.zeros(0, np.int64), rise
        for first in range(0, len(rises), _SLOPES):
            some = rises[first : first + _SLOPES]
            padded = np.append(some, np.full(_SLOPES - len(some), np.inf, np.float32))
            bare, rank = _bare_below(
                surface, cells.seen, cells.valid, padded, np.float32(LOW_SLOPE * self.cell), self.reach, self.mesh
            )
            turns = -(-len(some) // lanes)
            terrain = jnp.broadcast_to(surface[..., None], (*surface.shape, lanes))
            for turn in range(turns):  # each lane goes through neighbouring slopes
                which = turns * np.arange(lanes) + turn
                mine = np.flatnonzero(np.isin(rise, some[which[which < len(some)]]))
                which = np.minimum(which, len(some) - 1)
                terrain, steep = _terrains(
                    surface, bare, rank, which, cells.valid, cells.extent, cells.frame[2], terrain
                )
                parts = [
                    (_heights(chunk, terrain, steep, cells.frame, cells.extent), rows.stop - rows.start)
                    for rows, chunk, _ in chunks(points.xyz)
                ]
                yield from _labels(*before, sets)  # while the next terrains are being computed
                before = parts, mine, np.searchsorted(some[which], rise)
        yield from _labels(*before, sets)


def _labels(
    parts: list[tuple[tuple[jax.Array, jax.Array], int]], numbers: np.ndarray, lane: np.ndarray, sets: Sequence[SMRF]
) -> Iterator[tuple[int, np.ndarray]]:
    """Number and ground, bool[n], of some sets; ``lane``: i64[sets], where the terrain of each of all sets is."""
    for start in range(0, len(numbers), _SETS):
        some = numbers[start : start + _SETS]
        which, limits = np.zeros(_SETS, np.int32), np.zeros((_SETS, 2), np.float32)
        which[: len(some)] = lane[some]
        limits[: len(some)] = [(sets[i].threshold, sets[i].scaling) for i in some]
        found = [np.asarray(_within(*heights, which, limits))[:, :n] for heights, n in parts]
        ground = np.concatenate(found, axis=1)
        for k, number in enumerate(some):
            yield int(number), ground[k]


@functools.partial(jax.jit, static_argnames=("reach", "mesh"))
def _bare_cells(
    surface: jax.Array, seen: jax.Array, valid: jax.Array, rises: jax.Array, reach: int, mesh: int
) -> tuple[jax.Array, jax.Array]:
    """Cells with points that are neither low outliers nor objects nor net, bool[rows, columns].

    ``rises``, f32[2], are metres per cell of radius, for objects and for low outliers. Second come the numbers of cells,
    empty cells, low outliers and objects (net included), i32[4].
    """

    def open_once(k: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        last, objects = state
        opened = opening(last, k, reach, valid=valid)
        return opened, objects | (valid & (last - opened > rises[0] * k))

    low, net, surface = _low_and_net(surface, valid, rises[1], mesh)
    objects = jax.lax.fori_loop(1, reach + 1, open_once, (surface, net))[1]
    counts = jnp.stack([m.sum(dtype=jnp.int32) for m in (valid, valid & ~seen, low, objects)])
    return seen & ~low & ~objects, counts


@functools.partial(jax.jit, static_argnames=("reach", "mesh"))
def _bare_below(
    surface: jax.Array, seen: jax.Array, valid: jax.Array, rises: jax.Array, low_rise: jax.Array, reach: int, mesh: int
) -> tuple[jax.Array, jax.Array]:
    """Bare cells for many slopes from one series of openings.

    ``rises``: f32[slopes], metres per cell of radius, ascending. Returns bool[rows, columns], cells with points that are
    neither low outliers nor net; and i16, the number of slopes for which a cell is an object, which are the least ones.
    """

    def open_once(k: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        last, rank = state
        opened = opening(last, k, reach, valid=valid)
        exceeded = jnp.searchsorted(rises * k, last - opened, side="left").astype(jnp.int16)
        return opened, jnp.maximum(rank, exceeded)

    low, net, surface = _low_and_net(surface, valid, low_rise, mesh)
    rank = jax.lax.fori_loop(1, reach + 1, open_once, (surface, jnp.zeros(valid.shape, jnp.int16)))[1]
    return seen & ~low & ~net, rank


def _low_and_net(
    surface: jax.Array, valid: jax.Array, low_rise: jax.Array, mesh: int
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Low outliers, the cells of the net, bool[rows, columns] each, and the surface as the net leaves it."""
    low = valid & (-surface - opening(-surface, 1, 1, valid=valid) > low_rise)
    net = jnp.zeros_like(valid)
    if mesh:
        row, column = (jax.lax.broadcasted_iota(jnp.int32, valid.shape, axis) for axis in range(2))
        net = valid & ((row % mesh == 0) | (column % mesh == 0))
        surface = jnp.where(net, opening(surface, 2 * mesh, 2 * mesh, valid=valid), surface)
    return low, net, surface


@jax.jit
def _terrains(
    surface: jax.Array,
    bare: jax.Array,
    rank: jax.Array,
    which: jax.Array,
    valid: jax.Array,
    extent: jax.Array,
    cell: jax.Array,
    guess: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Terrain and its slope, f32[rows, columns, lanes], for the slopes of these numbers, i64[lanes]; ``guess``: that for
    other slopes."""
    known = bare[..., None] & (rank[..., None] <= which)
    terrain = fill_membrane(surface, known, valid, guess=guess).z
    return terrain, jax.vmap(steepness, (2, None, None), 2)(terrain, extent, cell)


@jax.jit
def _heights(
    xyz: jax.Array, terrain: jax.Array, slopes: jax.Array, frame: jax.Array, extent: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Height over each of several terrains f32[rows, columns, lanes], metres, and its slope, f32[lanes, n] each."""
    sample = _sampler(xyz, frame, extent, terrain.shape[1])
    return xyz[:, 2] - sample(terrain).T, sample(slopes).T


@jax.jit
def _within(height: jax.Array, slope: jax.Array, which: jax.Array, limits: jax.Array) -> jax.Array:
    """bool[sets, n]: points within the tolerance of each set, f32[sets, 2], of the terrain in its lane, i32[sets]."""

    def one(lane: jax.Array, tolerance: jax.Array) -> jax.Array:
        return jnp.abs(height[lane]) - (tolerance[0] + tolerance[1] * slope[lane]) <= 0

    return jax.vmap(one)(which, limits)


@jax.jit
def _test(
    xyz: jax.Array, terrain: jax.Array, slopes: jax.Array, frame: jax.Array, extent: jax.Array, tolerance: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Height over the terrain (m), its slope (degrees), and |height| - tolerance (m), f32[n] each."""
    sample = _sampler(xyz, frame, extent, terrain.shape[1])
    height, slope = xyz[:, 2] - sample(terrain), sample(slopes)
    return height, jnp.rad2deg(jnp.arctan(slope)), jnp.abs(height) - (tolerance[0] + tolerance[1] * slope)


def _sampler(xyz: jax.Array, frame: jax.Array, extent: jax.Array, columns: int) -> Callable[[jax.Array], jax.Array]:
    """Bilinear interpolation of grids [rows, columns, ...] at points f32[n, 3]: [n, ...]."""
    last = (extent - 1)[::-1]
    at = jnp.clip((xyz[:, :2] - frame[:2]) / frame[2] - 0.5, 0, last)
    low = jnp.minimum(jnp.floor(at).astype(jnp.int32), jnp.maximum(last - 1, 0))
    (u, v), (column, row) = (at - low).T, low.T
    right, above = jnp.minimum(column + 1, last[0]), jnp.minimum(row + 1, last[1])

    def sample(a: jax.Array) -> jax.Array:
        flat = a.reshape(-1, *a.shape[2:])
        wide = (-1, *(1,) * (a.ndim - 2))
        x, y = u.reshape(wide), v.reshape(wide)
        southern = (1 - x) * flat[row * columns + column] + x * flat[row * columns + right]
        northern = (1 - x) * flat[above * columns + column] + x * flat[above * columns + right]
        return (1 - y) * southern + y * northern

    return sample
