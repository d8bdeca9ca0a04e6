"""Digital terrain models: rasters of the ground surface, and heights above it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import InputError, warn
from ..core.points import canonical_points, has_area
from ..core.result import FilterResult, Progress, silent
from .edge import Edge
from .interpolation import Heights, Linear, inside_hull, nearest_point, surface_through
from .interpolation import Interpolation as Interpolation
from .layer import Layer, Site, grid_of, ground_of
from .levels import WaterRuns, levels_of
from .outline import CELLS_AT_ONCE, blocks_of
from .raster import Raster, RasterGrid


def dtm(
    cloud: PointCloud,
    result: FilterResult | np.ndarray | None = None,
    cell: float = 1.0,
    method: str = "tin",
    *,
    max_gap: float | None = None,
    max_edge: float | None = None,
    fill: bool = False,
    bounds: Iterable[float] | None = None,
    neighbours: int = 12,
    power: float = 2.0,
    level_water: bool = True,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Raster:
    """The terrain under a cloud as a raster of heights at the centres of the cells, through its ground points.

    Everything is in the units of the cloud's own coordinate system, feet included: ``cell``, ``max_gap``, ``bounds`` and
    the heights. The edges of the cells are whole multiples of ``cell`` in that system, so rasters of neighbouring tiles
    and of different filters lie cell on cell. The raster covers all points of the cloud, ground or not. Of ground points
    with the same x and y the lowest counts. Water is level: the bodies that the filter found (OST), and those of points of class
    9. One whose ends differ by less than 0.1 m has one height; others fall along their course (docs/dtm.md). If ``result`` is an
    array and names points of class 40, the bed of waters, the terrain is the bed, and no water is level.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: what is ground: a FilterResult, or bool[n]; by default the cloud's own reference (class 2 of a classified
            file, less withheld points).
        cell: side of a cell.
        method, max_gap, max_edge, fill, neighbours, power, level_water: how heights are found, see :class:`Interpolation`.
        bounds: (xmin, ymin, xmax, ymax) to cover instead of the extent of the cloud, widened to whole cells.
        workers: threads; by default one per core.
        progress: called with the fraction done and the name of the step.

    Returns: Raster with the CRS of the cloud; of a cloud without points, one without heights, and a warning.
    Raises: ParameterError for settings out of range; InputError if there are fewer than three distinct ground positions or
    all lie on a line, if there are no points and no ``bounds``, if labels have the wrong length or dtype, if points lie more
    than 131 km from the corner of the cloud, unless ``bounds`` are given, or if more than 400 million cells would be needed;
    ImportError if startinpy is missing.

    >>> model = jf.dtm(cloud, result, cell=2.0, max_gap=10.0)
    >>> x, y = model.centres()
    >>> terrain = scene.terrain(*np.meshgrid(x, y))
    >>> bool(np.nanmedian(np.abs(model.values - terrain)) < 0.1)
    True
    """
    interpolation = Interpolation(method, max_gap, max_edge, fill, neighbours, power, level_water)
    cloud = as_cloud(cloud)
    ground, grid = ground_of(cloud, result), grid_of(cloud, cell, bounds)
    levels = levels_of(cloud, result, ground) if level_water else None
    site = Site(cloud, ground, grid, None, interpolation, workers, levels=levels, progress=progress or silent)
    values = site.of(Dtm())
    if bounds is not None and len(cloud) and np.isnan(values).all():
        ends = np.stack([cloud.xyz[ground].min(axis=0), cloud.xyz[ground].max(axis=0)])
        low, high = dataclasses.replace(cloud, xyz=ends).coordinates()
        warn(
            f"dtm: no cell has a height: bounds {', '.join(f'{edge:.10g}' for edge in grid.bounds)} are away from the ground "
            f"points, which lie in {', '.join(f'{edge:.10g}' for edge in (*low[:2], *high[:2]))}"
        )
    return Raster(values, grid.transform, cloud.crs)


@dataclasses.dataclass(frozen=True)
class Dtm(Layer):
    """The terrain model: heights of :func:`dtm`."""

    NAME, TITLE, STYLE, MODEL = "dtm", "height of the ground", "gist_earth", True

    def reach(self, side: float) -> float:
        """No farther than the ground under it."""
        return 0.0

    def values(self, site: Site) -> np.ndarray:
        """Heights. Raises: InputError for too few ground points."""
        return interpolated(site)

    def bounded(self, values: np.ndarray, grid: RasterGrid, edge: Edge | None, levels: WaterRuns | None) -> np.ndarray:
        """Heights, but for those beyond the edge, and the level of water."""
        values = values if edge is None else edge.cut(values, grid)
        return values if levels is None else levels.put(values, grid)


def interpolated(site: Site) -> np.ndarray:
    """f32[rows, columns]: the heights of :func:`dtm`, but for the level of water. Raises: as :func:`dtm`."""
    cloud, grid, strict, interpolation = site.cloud, site.grid, site.strict, site.interpolation
    site.progress(0.0, "interpolator")
    points = canonical_points(dataclasses.replace(cloud, candidate=site.ground))
    values = np.full(grid.shape, np.nan, np.float32)
    if not len(cloud) and strict:
        warn("dtm: the cloud has no points, so no cell has a height")
    if not has_area(points.xyz):
        if not (strict and len(cloud)):
            return values
        count = f"{len(points):,} distinct ground points" if len(points) else "no ground point"
        raise InputError(f"dtm: the cloud has {count}; three that do not lie on one line are needed")
    fill, max_gap = interpolation.fill, interpolation.max_gap
    xyz = _lowest(points.xyz)
    surface = surface_through(xyz, interpolation, site.workers)
    inside = inside_hull(xyz) if interpolation.method in ("idw", "kriging") and not fill else None
    nearest = nearest_point(xyz, site.workers) if fill or max_gap is not None else None

    for rows, at in blocks_of(cloud, grid):
        site.progress(rows.start / grid.rows, "heights")
        z = surface(at)
        if isinstance(surface, Linear) and interpolation.ends:
            site.circle[rows] = surface.circles(at)[1].reshape(-1, grid.columns)
        if site.look is not None:
            site.look(at, surface)
        if inside is not None:
            z[~inside(at)] = np.nan
        if nearest is not None:
            distance, index = nearest(at)
            if fill:
                z = np.where(np.isnan(z), xyz[index, 2], z)
            if max_gap is not None:
                z[distance > max_gap * cloud.units.xy] = np.nan
        values[rows] = (cloud.origin[2] + z / cloud.units.z).reshape(-1, grid.columns)
    return values


def height_above_ground(
    cloud: PointCloud,
    result: FilterResult | np.ndarray | None = None,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> np.ndarray:
    """How high every point lies above the ground, linear in the triangles of the ground points.

    Ground points themselves have height 0, unless another ground point lies below at the same position. Outside the hull of
    the ground points the ground is as high as at the nearest of them.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: what is ground, as in :func:`dtm`.
        workers: threads; by default one per core.
        progress: called with the fraction done and the name of the step.

    Returns: f64[n], in the units of Z of the cloud's own coordinate system, for **all** points, whether they were judged or
    not; those without valid coordinates have 0.
    Raises: InputError if no point is ground, or as :func:`dtm` for labels that do not fit.

    >>> height = jf.height_above_ground(cloud, truth)
    >>> bool((height[truth] == 0).all()), bool(np.median(height[~truth]) > 0.5)
    (True, True)
    """
    cloud = as_cloud(cloud)
    ground = ground_of(cloud, result)
    if not len(cloud):
        return np.zeros(0)
    return heights_of(cloud, ground, np.arange(len(cloud)), workers=workers, progress=progress)


def heights_of(
    cloud: PointCloud,
    ground: np.ndarray,
    rows: np.ndarray,
    *,
    workers: int | None,
    progress: Progress | None = None,
    look: Callable[[np.ndarray, Heights], None] | None = None,
) -> np.ndarray:
    """f64[k]: what :func:`height_above_ground` returns for the points ``rows``, i64[k]; ``ground``: bool[n].

    ``look`` is called with some of their positions f64[q, 2], local metres, and the surface that gives their heights, unless
    all ground points lie on a line. Raises: InputError if no point is ground.
    """
    report = progress or silent
    report(0.0, "interpolator")
    points = canonical_points(dataclasses.replace(cloud, candidate=ground))
    if not len(points):
        raise InputError("height_above_ground: no point is ground: classify the cloud first, or pass result=")
    xyz = _lowest(points.xyz)
    surface = surface_through(xyz, Interpolation(), workers) if has_area(points.xyz) else None
    nearest, low, high = nearest_point(xyz, workers), xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    heights = np.zeros(len(rows))
    for start in range(0, len(rows), CELLS_AT_ONCE):
        report(start / len(rows), "heights")
        these = rows[start : start + CELLS_AT_ONCE]
        at = cloud.xyz[these, :2].astype(np.float64)
        z = np.full(len(at), np.nan)
        if surface is not None:
            z = surface(np.clip(at, low - 1.0, high + 1.0))  # stray points may be farther than the lattice of triangles
            if look is not None:
                look(at, surface)
        beyond = np.flatnonzero(np.isnan(z))
        z[beyond] = xyz[nearest(at[beyond])[1], 2]
        heights[start : start + CELLS_AT_ONCE] = (cloud.xyz[these, 2] - z) / cloud.units.z
    if cloud.valid is not None:
        heights[~cloud.valid[rows]] = 0.0
    return heights


def _lowest(xyz: np.ndarray) -> np.ndarray:
    """f32[m, 3]: of points in canonical order the lowest of each position, which comes first."""
    return xyz[np.append(True, (np.diff(xyz[:, :2], axis=0) != 0).any(axis=1))]
