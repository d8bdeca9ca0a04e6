"""Seeds from a grid whose cells are divided where the terrain is steep (Zheng et al. 2024, Sec. 3.2)."""

from __future__ import annotations

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..core.compilation import bucket
from ..core.errors import InputError
from ..core.grid import Grid, most_cells
from ..core.points import Points, by_position
from ..engines.chunks import padded
from ..engines.grid.cells import block_minima, padded_shape

REMAINDERS = ("absorbed", "own_cells")
"""What lies beyond the last whole cell joins that cell, or makes a smaller cell of its own (the paper's eqs. 1 and 2)."""


MAX_SLOPE = 63.0
"""Rise over run that a single slope counts with at most (89.1 degrees); over points almost above each other it is unbounded."""
_STEPS = 2**16  # slopes are summed as whole multiples of 1 / _STEPS, so that the order of the points changes no sum
_LOW = 2**11  # in two parts, so that sums over two million points stay within 32 bits, whatever their slopes


@dataclasses.dataclass(frozen=True, eq=False)
class AdaptiveSeeds:
    """Seeds of an adaptive grid.

    Attributes:
        rows: i64[s], ascending, the seeds of all levels.
        levels: i64[.] per level, the lowest points of its cells; a cell that is divided gives its lowest point to both.
        divided: per level but the last, how many cells were divided.
        steepest: degrees; the largest mean slope of a cell of any level that holds enough points to be divided; 90 if none does.
    """

    rows: np.ndarray
    levels: list[np.ndarray]
    divided: list[int]
    steepest: float


def lowest_per_adaptive_cell(
    points: Points,
    cell: float,
    barred: np.ndarray,
    *,
    levels: int = 2,
    least_points: int = 5,
    relative_slope: float = 0.06,
    remainder: str = "absorbed",
) -> AdaptiveSeeds:
    """Lowest points of the cells of an adaptive grid (Zheng et al. 2024, Sec. 3.2).

    The cells of each level are quarters of those of the level above. A cell is divided if it holds ``least_points``
    points or more, and its relative slope exceeds ``relative_slope``: the mean less the least of the slopes (rise over
    run) from its lowest point to its others.

    Args:
        cell: side of the cells of the first level, metres.
        barred: bool[m], points that take no part.
        levels: of the grid; with one, nothing is divided.
        remainder: one of :data:`REMAINDERS`.

    Cells count from the cloud's anchor.
    Raises: InputError if the extent needs too many cells.
    """
    (x0, y0), high = points.lattice_corner(cell), points.extent[1]
    cells = (high - np.array([x0, y0])) / cell
    whole = np.floor(cells + 1e-9) if remainder == "absorbed" else np.ceil(cells - 1e-6)
    columns, rows = np.maximum(whole, 1).astype(np.int64)
    finest = 2 ** (levels - 1)
    if int(columns) * int(rows) * finest**2 > most_cells(len(points)):
        raise InputError(
            f"seed_cell={cell:g} m with {levels} grid levels makes {columns * finest} x {rows * finest} cells over this "
            "extent: use larger cells or fewer levels, or remove stray points far from the rest"
        )
    n = bucket(len(points))
    order = by_position(points.xyz)  # of equally low points the first is a seed
    xyz, part = padded(points.xyz[order], n), padded(~barred[order], n)
    found, divided, steepest = [], [], []
    for level in range(levels):
        extent = (int(rows) * 2**level, int(columns) * 2**level)
        shape = padded_shape(extent)
        grid = Grid(x0, y0, cell / 2**level, *extent[::-1])  # halves are exact, so that the levels are nested
        index = grid.single().flat(xyz, shape[1])
        slopes = cell_slopes(index, xyz, part, shape[0] * shape[1])
        number, first, mean, least = (np.asarray(v) for v in slopes)
        found.append(np.sort(order[first[number > 0]]))
        enough = number >= least_points
        steepest += mean[enough].tolist()
        if level < levels - 1:
            split = enough & (mean - least > relative_slope)
            divided.append(int(split.sum()))
            part &= split[index]
    return AdaptiveSeeds(
        rows=np.unique(np.concatenate(found)),
        levels=found,
        divided=divided,
        steepest=float(np.degrees(np.arctan(max(steepest, default=np.inf)))),
    )


class CellSlopes(NamedTuple):
    """What the points of each cell say about it; arrays over cells.

    Attributes:
        number: i32, how many points count.
        first: i32, the lowest of them, the first of equally low ones; ``n`` in empty cells.
        mean, least: f32, mean and minimum of the slopes from the lowest point to the others, rise over run. Points
            straight above the lowest have no slope and do not enter; 0 where no other point is left.
    """

    number: jax.Array
    first: jax.Array
    mean: jax.Array
    least: jax.Array


@functools.partial(jax.jit, static_argnames="cells")
def cell_slopes(index: jax.Array, xyz: jax.Array, counted: jax.Array, cells: int) -> CellSlopes:
    """Slopes per cell (Zheng et al. 2024, eq. 5).

    Args:
        index: i32[n], cell of every point.
        xyz: f32[n, 3], local metres.
        counted: bool[n], the points that count.
        cells: number of cells of the padded grid.

    Returns: CellSlopes of ``cells`` entries, the same for any order of the points but for ``first``. Slopes count as
    multiples of 2^-16, up to :data:`MAX_SLOPE`.
    """
    _, first = block_minima(index, jnp.where(counted, xyz[:, 2], jnp.inf), cells)
    lowest = xyz[jnp.minimum(first, len(xyz) - 1)][index]
    rise, run = xyz[:, 2] - lowest[:, 2], jnp.hypot(xyz[:, 0] - lowest[:, 0], xyz[:, 1] - lowest[:, 1])
    sloped = counted & (run > 0)
    slope = jnp.minimum(jnp.where(sloped, rise / jnp.where(sloped, run, 1.0), 0.0), MAX_SLOPE)
    step = jnp.rint(slope * _STEPS).astype(jnp.uint32)
    zero = jnp.zeros(cells, jnp.uint32)
    low, high, others, number = (
        zero.at[index].add(v.astype(jnp.uint32)) for v in (step % _LOW, step // _LOW, sloped, counted)
    )
    total = (high.astype(jnp.float32) * _LOW + low.astype(jnp.float32)) / _STEPS
    least = jnp.full(cells, MAX_SLOPE, jnp.float32).at[index].min(jnp.where(sloped, step / _STEPS, MAX_SLOPE))
    return CellSlopes(
        number=number.astype(jnp.int32),
        first=first,
        mean=total / jnp.maximum(others, 1).astype(total.dtype),
        least=jnp.where(others > 0, least, 0.0),
    )
