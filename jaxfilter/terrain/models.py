"""Digital terrain models: rasters of the ground surface, and how far two of them lie apart."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ..core.cloud import QUANTUM, PointCloud, as_cloud
from ..core.errors import InputError, ParameterError, warn
from ..core.grid import MAX_CELLS
from ..core.points import canonical_points, check_extent
from ..core.result import FilterResult, Progress
from ..files.disk import check_bounds
from .interpolation import METHODS, Heights, inside_hull, interpolator, nearest_point
from .raster import Raster

_CELLS = 1 << 18  # that are interpolated at a time
_SNAP = 2.0**-20  # metres: cell centres are multiples of it, so that a shift of the cloud changes no bit of a height
_FAR = 2.0**20  # metres from the corner: no point is as far, and the lattice of triangulations reaches twice as far


def dtm(
    cloud: PointCloud,
    result: FilterResult | np.ndarray | None = None,
    cell: float = 1.0,
    method: str = "tin",
    *,
    max_gap: float | None = None,
    fill: bool = False,
    bounds: Iterable[float] | None = None,
    neighbours: int = 12,
    power: float = 2.0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Raster:
    """The terrain under a cloud as a raster of heights at the centres of the cells, through its ground points.

    Everything is in the units of the cloud's own coordinate system, feet included: ``cell``, ``max_gap``, ``bounds`` and
    the heights. The edges of the cells are whole multiples of ``cell`` in that system, so rasters of neighbouring tiles
    and of different filters lie cell on cell. The raster covers all points of the cloud, ground or not. Of ground points
    with the same x and y the lowest counts.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: what is ground: a FilterResult, or bool[n]; by default the cloud's own reference (class 2 of a classified
            file, less withheld points).
        cell: side of a cell.
        method: ``"tin"``, linear in the triangles of the Delaunay triangulation; ``"natural"``, natural neighbour (needs
            startinpy); ``"idw"``, inverse distance; ``"kriging"``, ordinary kriging with a linear variogram.
        max_gap: cells whose centre is farther than this from every ground point become NaN; by default none, so that the
            ground is bridged under buildings and water of any size.
        fill: give cells outside the convex hull of the ground points a height too: that of the nearest ground point, or
            what ``"idw"`` and ``"kriging"`` find there; by default they are NaN.
        bounds: (xmin, ymin, xmax, ymax) to cover instead of the extent of the cloud, widened to whole cells.
        neighbours: of ``"idw"`` and ``"kriging"``: number of nearest ground points that decide a height.
        power: of ``"idw"``: weights are distance to the power of -``power``.
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
    check_settings(cell, method, max_gap, neighbours, power)
    cloud = as_cloud(cloud)
    ground = _ground(cloud, result)
    settings: dict[str, Any] = {"max_gap": max_gap, "fill": fill, "neighbours": neighbours, "power": power}
    raster = interpolated(cloud, ground, cell, method, bounds, progress=progress, workers=workers, **settings)
    if bounds is not None and len(cloud) and np.isnan(raster.values).all():
        ends = np.stack([cloud.xyz[ground].min(axis=0), cloud.xyz[ground].max(axis=0)])
        low, high = dataclasses.replace(cloud, xyz=ends).coordinates()
        warn(
            f"dtm: no cell has a height: bounds {', '.join(f'{edge:.10g}' for edge in raster.bounds)} are away from the ground "
            f"points, which lie in {', '.join(f'{edge:.10g}' for edge in (*low[:2], *high[:2]))}"
        )
    return raster


def interpolated(
    cloud: PointCloud,
    ground: np.ndarray,
    cell: float,
    method: str,
    bounds: Iterable[float] | None,
    *,
    max_gap: float | None,
    fill: bool,
    neighbours: int,
    power: float,
    workers: int | None,
    progress: Progress | None = None,
    look: Callable[[np.ndarray, Heights], None] | None = None,
) -> Raster:
    """The raster of :func:`dtm` with checked settings; ``ground``: bool[n].

    ``look`` is called with the centres f64[q, 2], local metres, of the cells of some rows, and the surface that gives their
    heights.
    """
    corner, shape = _extent(cloud, cell, bounds)
    report = progress or (lambda fraction, step: None)
    report(0.0, "interpolator")
    points = canonical_points(dataclasses.replace(cloud, candidate=ground))
    north = (corner[1] + shape[0]) * cell
    transform = (cell, 0.0, corner[0] * cell, 0.0, -cell, north)
    if not len(cloud):
        warn("dtm: the cloud has no points, so no cell has a height")
        return Raster(np.full(shape, np.nan, np.float32), transform, cloud.crs)
    if not points.has_area():
        count = f"{len(points):,} distinct ground points" if len(points) else "no ground point"
        raise InputError(f"dtm: the cloud has {count}; three that do not lie on one line are needed")
    xyz = _lowest(points.xyz)
    surface = interpolator(method, xyz, neighbours=neighbours, power=power, workers=workers)
    inside = inside_hull(xyz) if method in ("idw", "kriging") and not fill else None
    nearest = nearest_point(xyz, workers) if fill or max_gap is not None else None

    x, y = (_local(cloud, axis, corner[axis], count, cell) for axis, count in ((0, shape[1]), (1, shape[0])))
    values = np.empty(shape, np.float32)
    step = max(1, _CELLS // shape[1])
    for top in range(0, shape[0], step):
        report(top / shape[0], "heights")
        rows = y[::-1][top : top + step]
        at = np.column_stack([np.tile(x, len(rows)), np.repeat(rows, len(x))])
        z = surface(at)
        if look is not None:
            look(at, surface)
        if inside is not None:
            z[~inside(at)] = np.nan
        if nearest is not None:
            distance, index = nearest(at)
            if fill:
                z = np.where(np.isnan(z), xyz[index, 2], z)
            if max_gap is not None:
                z[distance > max_gap * cloud.units.xy] = np.nan
        values[top : top + step] = (cloud.origin[2] + z / cloud.units.z).reshape(len(rows), -1)
    return Raster(values, transform, cloud.crs)


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
    ground = _ground(cloud, result)
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
    report = progress or (lambda fraction, step: None)
    report(0.0, "interpolator")
    points = canonical_points(dataclasses.replace(cloud, candidate=ground))
    if not len(points):
        raise InputError("height_above_ground: no point is ground: classify the cloud first, or pass result=")
    xyz = _lowest(points.xyz)
    surface = interpolator("tin", xyz, workers=workers) if points.has_area() else None
    nearest, low, high = nearest_point(xyz, workers), xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    heights = np.zeros(len(rows))
    for start in range(0, len(rows), _CELLS):
        report(start / len(rows), "heights")
        these = rows[start : start + _CELLS]
        at = cloud.xyz[these, :2].astype(np.float64)
        z = np.full(len(at), np.nan)
        if surface is not None:
            z = surface(np.clip(at, low - 1.0, high + 1.0))  # stray points may be farther than the lattice of triangles
            if look is not None:
                look(at, surface)
        beyond = np.flatnonzero(np.isnan(z))
        z[beyond] = xyz[nearest(at[beyond])[1], 2]
        heights[start : start + _CELLS] = (cloud.xyz[these, 2] - z) / cloud.units.z
    if cloud.valid is not None:
        heights[~cloud.valid[rows]] = 0.0
    return heights


@dataclasses.dataclass(frozen=True)
class HeightErrors:
    """How far one terrain model lies from another, over the cells where both have a height. NaN if there are none.

    Attributes:
        rmse: root of the mean squared difference, metres (Uray and Varlik 2024, eq. 4).
        mean: mean difference, metres; positive: the model lies above the reference.
        largest: largest absolute difference, metres.
        cells: number of cells compared.
        missing: number of cells where only one of the two has a height.
    """

    rmse: float
    mean: float
    largest: float
    cells: int
    missing: int


def dtm_rmse(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    reference: np.ndarray | None = None,
    cell: float = 1.0,
    method: str = "tin",
    **settings: Any,
) -> HeightErrors:
    """The vertical error of the terrain model that follows from a labelling, against the one from reference labels.

    Both models are made alike, by :func:`dtm`. Uray and Varlik (2024) compare models of 1 m made by kriging; they do not
    state the variogram, nor how far cells outside the ground points count.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: FilterResult, or bool[n] with True = ground.
        reference: bool[n] with True = ground; by default the cloud's own reference.
        cell, method, settings: as in :func:`dtm`; ``cell`` in the units of the cloud's coordinate system.

    Returns: HeightErrors, in metres whatever the units of the cloud.
    Raises: what :func:`dtm` raises.

    >>> errors = jf.dtm_rmse(cloud, result, cell=2.0)
    >>> round(jf.dtm_rmse(cloud, truth, cell=2.0).rmse, 6), errors.rmse < 1.0
    (0.0, True)
    """
    cloud = as_cloud(cloud)
    model, truth = (dtm(cloud, labels, cell, method, **settings).values for labels in (result, reference))
    difference = (model.astype(np.float64) - truth) * cloud.units.z
    both = np.isfinite(difference)
    missing = int((np.isfinite(model) != np.isfinite(truth)).sum())
    if not both.any():
        return HeightErrors(math.nan, math.nan, math.nan, 0, missing)
    d = difference[both]
    return HeightErrors(math.sqrt(np.mean(d * d)), float(d.mean()), float(np.abs(d).max()), len(d), missing)


def check_settings(cell: float, method: str, max_gap: float | None, neighbours: int, power: float) -> None:
    """Raises ParameterError for settings that :func:`dtm` cannot use, whatever the cloud."""
    if method not in METHODS:
        raise ParameterError(f"method={method!r}: choose one of {', '.join(METHODS)}")
    for name, value in (("cell", cell), ("max_gap", max_gap), ("power", power)):
        if value is not None and not 0 < value < math.inf:
            raise ParameterError(f"{name}={value!r} must be a positive number")
    if neighbours < 1:
        raise ParameterError(f"neighbours={neighbours!r} must be at least 1")


def _lowest(xyz: np.ndarray) -> np.ndarray:
    """f32[m, 3]: of points in canonical order the lowest of each position, which comes first."""
    return xyz[np.append(True, (np.diff(xyz[:, :2], axis=0) != 0).any(axis=1))]


def _ground(cloud: PointCloud, result: FilterResult | np.ndarray | None) -> np.ndarray:
    """bool[n]: the points that the surface goes through."""
    if result is None:
        if cloud.reference is None:
            raise InputError("the cloud has no reference labels (a label column, or class 2): pass result=")
        ground = cloud.reference if cloud.withheld is None else cloud.reference & ~cloud.withheld
    else:
        ground = result.ground if isinstance(result, FilterResult) else np.asarray(result)
    if ground.shape != (len(cloud),) or ground.dtype != bool:
        raise InputError(f"result: bool[{len(cloud)}] is needed for this cloud, not {ground.dtype}{list(ground.shape)}")
    return ground if cloud.valid is None else ground & cloud.valid


def _extent(cloud: PointCloud, cell: float, bounds: Iterable[float] | None) -> tuple[tuple[int, int], tuple[int, int]]:
    """The lower left corner of the raster in whole cells from the zero of the coordinates, and (rows, columns)."""
    if bounds is not None:
        edges = np.array(check_bounds(bounds))
    else:
        xy = cloud.xyz[:, :2] if cloud.valid is None else cloud.xyz[cloud.valid, :2]
        if len(xy) == 0:
            raise InputError("dtm: the cloud has no points, so that the raster has no extent; pass bounds=")
        check_extent(cloud, xy)
        ends = np.concatenate([xy.min(axis=0), xy.max(axis=0)]).astype(np.float64)
        edges = np.tile(cloud.origin[:2], 2) + ends / cloud.units.xy
    slack = QUANTUM / cloud.units.xy / cell  # coordinates are known to a quantum: an edge needs no further cell
    left, bottom = (math.floor(v / cell + min(slack, 0.5)) for v in edges[:2])
    right, top = (math.ceil(v / cell - min(slack, 0.5)) for v in edges[2:])
    columns, rows = max(1, right - left), max(1, top - bottom)
    if rows * columns > MAX_CELLS:
        width, height = edges[2:] - edges[:2]
        raise InputError(
            f"cell={cell:g} over an extent of {width:.6g} x {height:.6g} needs {rows * columns:,} cells, more than "
            f"{MAX_CELLS:,}: use larger cells or bounds, or remove stray points far from the rest"
        )
    return (left, bottom), (rows, columns)


def _local(cloud: PointCloud, axis: int, first: int, count: int, cell: float) -> np.ndarray:
    """f64[count]: the centres of the cells along an axis, local metres; those farther than any point as :data:`_FAR`."""
    centre = (first + np.arange(count) + 0.5) * cell
    local = np.rint((centre - cloud.origin[axis]) * (cloud.units.xy / _SNAP)) * _SNAP
    return np.clip(local, -_FAR, _FAR)
