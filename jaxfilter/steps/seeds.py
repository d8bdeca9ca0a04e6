"""Initial ground seed points: the lowest points of cells or of sliding windows."""

from __future__ import annotations

import math

import numpy as np
import scipy

from ..core.errors import InputError
from ..core.grid import Grid, lattice_over, most_cells
from ..core.points import Points
from ..engines.grid.cells import lowest_in_cells, lowest_points, padded_shape
from ..engines.grid.sparse import CellSet, ringed
from ..engines.grid.windows import window_layout, window_minima
from .surfaces import Cells, look_up

VEILED, ABOVE = 0.5, 0.5
"""Plants hide the ground where more than this share of the points that are not the lowest of their cell lie so many metres above
the lowest ones, also above those beside them uphill."""
_UPHILL = 3  # of 3 x 3 cells on a face
_LEVEL = 0.3  # metres above a slope that count as on it
_STEPS = 3  # cells to each side of a point that hold those within the radius of :func:`rising`


def lowest_per_window(points: Points, window: float, stride: float, barred: np.ndarray, name: str = "") -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of windows that slide over the cloud (Li et al. 2021, Sec. II-C).

    Args:
        window: side of the square window, metres; stride: its step, metres, at most ``window``.
        barred: bool[m], points that must not be seeds. A window without others has no seed.
        name: of both sizes in messages, such as ``"PTD(seed_cell=60.0)"``.

    Windows start at the multiple of the stride, counted from the cloud's anchor, that lies at or south-west of all points.
    Of equally low points the westernmost is taken, of these the southernmost.
    Raises: ParameterError, InputError if window and stride have too small a common measure for the extent.
    """
    (x0, y0), high = points.lattice_corner(stride), points.extent[1]
    layout = window_layout((float(high[1] - y0), float(high[0] - x0)), window, stride, name)
    if layout.blocks[0] * layout.blocks[1] > most_cells(len(points)):
        rows, columns = layout.blocks
        hint = "use larger ones" if window == stride else "let the stride divide the window"
        raise InputError(
            f"{name or 'window, stride'}: the seeds need {rows} x {columns} cells of {layout.block:g} m over this extent: "
            f"{hint}, or remove stray points far from the rest"
        )
    z = np.where(barred, np.float32(np.inf), points.xyz[:, 2])
    apart = layout.width == layout.stride  # then windows are blocks, the last of which reach to the border
    grid = Grid(x0, y0, layout.block, *(layout.counts if apart else layout.blocks)[::-1]).single()
    shape = padded_shape(grid.shape)
    lowest, first, found = lowest_points(points.xyz, grid.flat(points.xyz, shape[1]), z, shape[0] * shape[1])
    if not apart:
        pair, counts = (lowest.reshape(shape), first.reshape(shape)), np.array(layout.counts, np.int32)
        first = np.unique(np.asarray(window_minima(*pair, counts, layout.width, layout.stride)[1]))
    return np.sort(found[first[first < len(found)]])


def lowest_per_cell(points: Points, cell: float, barred: np.ndarray, name: str = "") -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of square cells of ``cell`` metres that are not ``barred`` (bool[m]).

    Whole cells only; the last of each axis absorbs what is left over, as the blocks of Li et al. (2021), Sec. II-D, do.
    """
    return lowest_per_window(points, cell, cell, barred, name or f"cell={cell!r}")


def lowest_on_grid(points: Points, grid: Grid, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of the cells of a grid that are not ``barred`` (bool[m]).

    Cells at the upper edges may reach beyond the cloud. Of equally low points the westernmost is taken.
    """
    z = np.where(barred, np.float32(np.inf), points.xyz[:, 2])
    _, first, found = lowest_points(points.xyz, grid.flat(points.xyz), z, grid.nx * grid.ny)
    return np.sort(found[first[first < len(found)]])


def lowest_of_cells(points: Points, cells: Cells, chosen: np.ndarray, barred: np.ndarray) -> np.ndarray:
    """i64[s], ascending: rows of the lowest points of the ``chosen`` cells, bool[rows, columns].

    ``barred``: bool[m], the points that were left out when ``cells`` were made, and are here. Of equally low points the
    westernmost is taken.
    """
    return lowest_on_grid(points, cells.grid, barred | ~look_up(points.xyz, cells, chosen)[0])


def lowest_seeds(points: Points, grid: Grid, seed: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """bool[m]: the lowest seed of every cell that has seeds, and the lowest of the points ``counted`` of the others.

    Of equally low points the westernmost is taken. ``seed``, ``counted``: bool[m].
    """
    at = grid.flat(points.xyz)
    seeded = np.zeros(grid.nx * grid.ny, bool)
    seeded[at[seed]] = True
    found = np.zeros(len(points), bool)
    found[lowest_on_grid(points, grid, ~(seed | (counted & ~seeded[at])))] = True
    return found


def under_canopy(xyz: np.ndarray, counted: np.ndarray, grid: Grid, height: float) -> np.ndarray:
    """bool[m]: points less than ``height`` above the lowest point of their cell, of those ``counted``, bool[m].

    Cai et al. (2023), eq. 1.
    """
    at = grid.flat(xyz)
    lowest, _ = lowest_in_cells(at, np.where(counted, xyz[:, 2], np.float32(np.inf)), grid.nx * grid.ny, rows=False)
    return xyz[:, 2] - lowest[at] < height


def standing(points: Points, cells: Cells, height: float = ABOVE) -> np.ndarray:
    """bool[m]: points ``height`` metres above the lowest of their cell, and above the third highest of the lowest points of 3 x 3
    cells, which is as high as a plane face rises within a cell. ``points``: those of which ``cells`` are."""
    (rows, columns), at = cells.grid.shape, cells.grid.flat(points.xyz)
    lowest, seen = (np.asarray(values)[:rows, :columns] for values in (cells.lowest, cells.seen))
    uphill = scipy.ndimage.rank_filter(np.where(seen, lowest, np.float32(-np.inf)), -_UPHILL, 3)
    return points.xyz[:, 2] > (np.maximum(lowest, uphill).ravel() + np.float32(height))[at]


def veiled(points: Points, cells: Cells, around: float, high: np.ndarray) -> np.ndarray:
    """bool[rows, columns], of the shape of ``cells``: where plants hide the ground, by the points within ``around`` metres along
    both axes.

    See :data:`VEILED`; ``high``: bool[m], points that stand above others, see :func:`standing`. There must be two points to a
    cell in the mean: fewer on steep rock look the same. ``points``: those of which ``cells`` are; those of weight zero do not
    count.
    """
    (rows, columns), at = cells.grid.shape, cells.grid.flat(points.xyz)
    seen = np.asarray(cells.seen)[:rows, :columns]
    above, number = (
        np.where(seen, np.bincount(at, weight, rows * columns).reshape(rows, columns), 0)
        for weight in (points.weight * high, points.weight)
    )
    ones = np.ones(2 * math.ceil(around / float(cells.grid.cell) - 1e-6) + 1)

    def total(values: np.ndarray) -> np.ndarray:
        """Exact, since the values are halves of whole numbers."""
        for axis in range(2):
            values = scipy.ndimage.correlate1d(values, ones, axis, mode="constant")
        return values

    found = np.zeros(cells.seen.shape, bool)
    found[:rows, :columns] = (total(above - VEILED * (number - seen)) > 0) & (total(number - 2.0 * seen) >= 0)
    return found


def rising(
    xyz: np.ndarray, rows: np.ndarray, others: np.ndarray, beside: float, steepest: float, sides: int = 1
) -> np.ndarray:
    """bool[k]: which of the points ``rows``, i64[k], lie more than 0.3 m above a slope of ``steepest``, rise over run, from one
    of the points ``others``, i64[j], within ``beside`` metres; in ``sides`` at least of the four quadrants around them. ``xyz``:
    f32[m, 3], metres."""
    from ..engines.below import rising as mark  # imports Numba

    found = np.zeros(len(rows), bool)
    if len(rows) > 0 and len(others) > 0:
        grid = lattice_over(xyz[np.concatenate([rows, others])], 1.001 * beside / _STEPS)  # rounding counts
        cells, at = CellSet.of(grid, xyz[others])
        place = ringed(*grid.places(xyz[rows]), cells.wide)
        mark(found, xyz[others], at, cells.key, cells.wide, _STEPS, xyz[rows], place, beside, steepest, _LEVEL, sides)
    return found
