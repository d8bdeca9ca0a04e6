"""Seeds from a grid whose cells are divided where the terrain is steep (Zheng et al. 2024, Sec. 3.2)."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..core.compilation import bucket
from ..core.errors import InputError
from ..core.grid import most_cells
from ..core.points import Points
from ..engines.chunks import padded
from ..engines.grid.cells import cell_index, padded_shape
from .refinement import cell_slopes

REMAINDERS = ("absorbed", "own_cells")
"""What lies beyond the last whole cell joins that cell, or makes a smaller cell of its own (the paper's eqs. 1 and 2)."""


@dataclasses.dataclass(frozen=True, eq=False)
class AdaptiveSeeds:
    """Seeds of an adaptive grid.

    Attributes:
        rows: i64[s], ascending, the seeds of all levels.
        levels: i64[.] per level, the lowest points of its cells; a cell that is divided gives its lowest point to both.
        divided: per level but the last, how many cells were divided.
        steepest: degrees; the largest mean slope of a cell that holds enough points to be divided, 0 if none does.
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
    corner, high = np.array(points.lattice_corner(cell)), points.extent[1]
    cells = (high - corner) / cell
    whole = np.floor(cells + 1e-9) if remainder == "absorbed" else np.ceil(cells - 1e-6)
    columns, rows = np.maximum(whole, 1).astype(np.int64)
    finest = 2 ** (levels - 1)
    if columns * rows * finest**2 > most_cells(len(points)):
        raise InputError(
            f"seed_cell={cell:g} m with {levels} grid levels makes {columns * finest} x {rows * finest} cells over this "
            "extent: use larger cells or fewer levels, or remove stray points far from the rest"
        )
    n = bucket(len(points))
    xyz, part = padded(points.xyz, n), padded(~barred, n)
    found, divided, steepest = [], [], 0.0
    for level in range(levels):
        extent = (int(rows) * 2**level, int(columns) * 2**level)
        shape = padded_shape(extent, points.least_shape(cell / 2**level))
        index = cell_index(
            xyz,
            np.float32(corner),
            np.float32(cell / 2**level),  # halves are exact, so that the levels are nested
            np.array(extent, np.int32),
            shape[1],
        )
        slopes = cell_slopes(index, xyz, part, shape[0] * shape[1])
        number, first, mean, least = (np.asarray(v) for v in slopes)
        found.append(np.sort(first[number > 0]).astype(np.int64))
        enough = number >= least_points
        steepest = max(steepest, float(mean[enough].max(initial=0.0)))
        if level < levels - 1:
            split = enough & (mean - least > relative_slope)
            divided.append(int(split.sum()))
            part &= split[np.asarray(index)]
    return AdaptiveSeeds(
        rows=np.unique(np.concatenate(found)),
        levels=found,
        divided=divided,
        steepest=float(np.degrees(np.arctan(steepest))),
    )
