"""Rasters that are made of points or of a terrain model; called, they take a cloud in memory. Breaklines of water."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import ParameterError, check_positive
from ..core.points import canonical_points, has_area
from ..core.result import FilterResult
from ..core.units import Units, vertical
from ..files.disk import check_suffix
from ..files.storage import Place, place_of
from ..files.vectors import VECTOR_SUFFIXES, write_features
from .edge import Edge
from .interpolation import Linear, nearest_point
from .layer import Layer, Site, ground_of, setting
from .levels import WaterRuns, levels_in, outlines
from .models import Dtm, heights_of
from .outline import blocks_of, count_in, occupied, places_of
from .raster import Band, Raster, RasterGrid, metres_per_unit, packed, profile_of, write_mosaic

if TYPE_CHECKING:
    import geopandas

NOISE = (7, 18)
"""ASPRS classes of low and of high noise."""
_CELLS = 1.5
"""``radius`` of :class:`Dsm`, in cells."""


@dataclasses.dataclass(frozen=True)
class Dsm(Layer):
    """The surface on top of a cloud: the highest of trees, roofs and ground, without pits, after Khosravipour et al. (2014).

    First echoes are triangulated once for each of some levels: those that are at least so high above the ground. A cell has the
    highest of these surfaces, so that echoes from inside a crown make no pit. Classes 7 and 18, low outliers of the result, and
    withheld points are left out. docs/fidelity.md says what the paper does otherwise. It is called like :func:`dtm`, and
    ``replace`` gives it other settings.

    Attributes:
        levels: metres above the ground; 0 is one of them, and stands for all first echoes. With 0 alone there are pits.
        gap: metres, radius up to which the circle through the corners of a triangle of all first echoes counts: wider voids, such
            as water, have no height.
        radius: the same for the levels above 0; by default one and a half cells.

    Raises: ParameterError for settings out of range; when called, InputError as :func:`dtm`, and if no point is ground.

    >>> surface, ground = jf.dsm.replace(gap=20.0)(cloud, result, cell=2.0), jf.dtm(cloud, result, cell=2.0)
    >>> bool(np.nanmean(surface.values >= ground.values - 0.5) > 0.95)
    True
    """

    NAME, TITLE, STYLE = "dsm", "height of the surface", "relief"
    levels: tuple[float, ...] = setting(
        "Height above the ground; the echoes above it make one surface.", (0.0, 2.0, 5.0, 10.0, 15.0)
    )
    gap: float = setting(
        "A triangle counts if the circle through its corners has this radius at most; wider voids stay empty.",
        10.0,
        metres=True,
    )
    radius: float | None = setting(
        "The same for the levels above 0.  [default: one and a half cells]", None, metres=True
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", tuple(sorted(float(level) for level in self.levels)))
        check_positive(" of metres", gap=self.gap, radius=self.radius)
        if not self.levels or self.levels[0] != 0 or not math.isfinite(self.levels[-1]):
            raise ParameterError(f"levels={self.levels!r} must be metres above the ground, and 0 among them")

    def reach(self, side: float) -> float:
        """As far as the circles of triangles go."""
        return side + 2 * max(self.gap, self.radius or _CELLS * side)

    def values(self, site: Site) -> np.ndarray:
        cloud, out = site.cloud, np.full(site.grid.shape, -np.inf)
        xyz, height = self._echoes(site)
        for level in self.levels:
            top, limit = (xyz[height >= level], self.radius or _CELLS * site.side) if level else (xyz, self.gap)
            if not has_area(top):
                continue
            cells = occupied(dataclasses.replace(cloud, xyz=top, valid=None), site.grid)
            width = min(2 * math.ceil(2 * limit / site.side) + 3, 2 * max(cells.shape) + 1)
            near = scipy.ndimage.maximum_filter(cells, width, mode="constant")
            surface = Linear(top, site.workers)
            for rows, at in blocks_of(cloud, site.grid):
                some = near[rows].ravel()
                out[rows].reshape(-1)[some] = np.fmax(out[rows].ravel()[some], surface.within(at[some], limit))
        out[np.isinf(out)] = np.nan
        return (cloud.origin[2] + out / cloud.units.z).astype(np.float32)

    def _echoes(self, site: Site) -> tuple[np.ndarray, np.ndarray]:
        """f32[m, 3], local metres: of each position the highest first echo; and f64[m], its metres above the ground."""
        cloud, grid, margin = site.cloud, site.grid, math.ceil(self.reach(site.side) / site.side)
        use = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid.copy()
        for place, count in zip(places_of(cloud, grid), (grid.columns, grid.rows), strict=True):
            use &= (place >= -margin) & (place < count + margin)
        for left_out in (site.noise, cloud.withheld):
            use &= True if left_out is None else ~left_out
        use &= True if cloud.return_number is None else cloud.return_number <= 1
        use &= True if cloud.classification is None else ~np.isin(cloud.classification, NOISE)
        points = canonical_points(dataclasses.replace(cloud, candidate=use))
        top = np.append((np.diff(points.xyz[:, :2], axis=0) != 0).any(axis=1), True)[: len(points)]
        xyz, rows = points.xyz[top], points.gather(np.arange(len(cloud)))[top]
        if len(self.levels) == 1 or not (site.ground.any() or site.strict):
            return xyz, np.full(len(xyz), -np.inf)
        return xyz, heights_of(cloud, site.ground, rows, workers=site.workers, look=site.look) * cloud.units.z


@dataclasses.dataclass(frozen=True)
class Chm(Dsm):
    """The canopy height model, buildings included: how high the surface of :class:`Dsm` lies above the terrain of :func:`dtm`.

    Heights are in units of Z, and 0 where the surface lies below the terrain. The settings, in metres, are those of :class:`Dsm`.

    >>> heights = jf.chm(cloud, result).values
    >>> bool(np.nanmin(heights) == 0), bool(np.nanmax(heights) > 5)
    (True, True)
    """

    NAME, TITLE, STYLE = "chm", "height above the ground", "viridis"

    @property
    def parts(self) -> tuple[Layer, ...]:
        return Dtm(), Dsm(self.levels, self.gap, self.radius)

    def made_of(self, known: Mapping[Layer, np.ndarray], grid: RasterGrid, units: Units) -> np.ndarray:
        terrain, surface = (known[part] for part in self.parts)
        return np.maximum(surface - terrain, np.float32(0))

    def values(self, site: Site) -> np.ndarray:
        return Layer.values(self, site)


@dataclasses.dataclass(frozen=True)
class Hillshade(Layer):
    """The shaded relief of the terrain model, see :func:`hillshade`."""

    NAME, TITLE, UNITS, KIND, NODATA = "hillshade", "hillshade", "1 (dark) to 255", "uint8", 0
    MODEL, OF_RASTER = True, True
    azimuth: float = setting("Where the light comes from, degrees from north to east.", 315.0)
    altitude: float = setting("Degrees of the sun above the horizon.", 45.0)

    def __post_init__(self) -> None:
        if not (0 <= self.azimuth <= 360 and 0 < self.altitude <= 90):
            raise ParameterError(
                f"azimuth={self.azimuth!r}, altitude={self.altitude!r}: must be degrees, 0 to 360 from north, and above 0 up "
                "to 90 from the horizon"
            )

    @property
    def parts(self) -> tuple[Layer, ...]:
        return (Dtm(),)

    def made_of(self, known: Mapping[Layer, np.ndarray], grid: RasterGrid, units: Units) -> np.ndarray:
        return self.shade(known[Dtm()], grid.cell, units.z / units.xy)

    def from_raster(self, source: Path, target: Place, overwrite: bool) -> None:
        """Write the relief, as a Cloud Optimized GeoTIFF. Raises: InputError, OutputError."""
        model = Raster.read(source)
        metre = metres_per_unit(model.crs)
        high = metre if vertical(model.crs) is None else model.crs.axis_info[-1].unit_conversion_factor
        values = packed(self.shade(model.values, model.cell, high / metre), self.KIND, self.NODATA)
        grid = RasterGrid(model.cell, 0, 0, values.shape[1], values.shape[0])
        profile = profile_of(grid.shape, model.transform, model.crs, self.KIND, self.NODATA)
        band = Band(self.TITLE, self.UNITS, model.crs)
        write_mosaic(target, grid, profile, lambda: [(grid, values)], band, overwrite=overwrite)

    def shade(self, z: np.ndarray, cell: float, z_factor: float) -> np.ndarray:
        """f32[rows, columns], of heights f32[rows, columns]."""
        rows, columns = z.shape
        ring = np.pad(z.astype(np.float64) * z_factor, 1, constant_values=np.nan)
        a, b, c, d, e, f, g, h, i = (ring[r : r + rows, k : k + columns] for r in range(3) for k in range(3))
        a, b, c, d, f, g, h, i = (np.where(np.isnan(one), e, one) for one in (a, b, c, d, f, g, h, i))
        east = ((c + 2 * f + i) - (a + 2 * d + g)) / (8 * cell)
        north = ((a + 2 * b + c) - (g + 2 * h + i)) / (8 * cell)
        azimuth, altitude = math.radians(self.azimuth), math.radians(self.altitude)
        along = east * math.sin(azimuth) + north * math.cos(azimuth)  # up, on the way to the sun
        light = (math.sin(altitude) - math.cos(altitude) * along) / np.sqrt(1 + east * east + north * north)
        return np.floor(1.5 + 254 * np.maximum(np.where(np.isnan(e), np.nan, light), 0.0)).astype(np.float32)


def hillshade(model: Raster, azimuth: float = 315.0, altitude: float = 45.0, z_factor: float = 1.0) -> Raster:
    """The relief of a terrain model, or of any heights, in the light of a sun: gradients after Horn (1981), as in GDAL.

    Args:
        model: heights, for instance of :func:`dtm`.
        azimuth: where the light comes from, degrees from north to east.
        altitude: how high the sun stands, degrees above the horizon.
        z_factor: metres per unit of the heights by metres per unit of X and Y; 1 where both have one unit.

    Returns: Raster of whole numbers from 1 (dark) to 255, in files uint8 with 0 for nothing. A neighbour without height counts as
    high as the cell itself, so that every cell with a height has a value.
    Raises: ParameterError for angles out of range, and a factor that is not positive.

    >>> relief = jf.hillshade(jf.dtm(cloud, result))
    >>> bool(1 <= np.nanmin(relief.values) < 100 < np.nanmax(relief.values) <= 255)
    True
    """
    layer = Hillshade(azimuth, altitude)
    check_positive(z_factor=z_factor)
    values = layer.shade(model.values, model.cell, z_factor)
    return Raster(values, model.transform, model.crs, layer.NODATA, layer.KIND, layer.TITLE, layer.UNITS)


@dataclasses.dataclass(frozen=True)
class Count(Layer):
    """How many ground points there are in each of the cells. Points on an eastern or northern edge belong to the next
    one. Cells without any have no value beyond the edge of the ground.

    >>> bounds = (512000, 5403000, 512060, 5403060)
    >>> bool(np.nansum(jf.count(cloud, result, cell=2.0, bounds=bounds).values) == result.ground.sum())
    True
    """

    NAME, TITLE, UNITS, STYLE, SURFACE = "count", "number of ground points", "points", "cividis", False
    KIND = "int32"

    def values(self, site: Site) -> np.ndarray:
        return count_in(site.cloud, site.ground, site.grid).astype(np.float32)

    def bounded(self, values: np.ndarray, grid: RasterGrid, edge: Edge | None, levels: WaterRuns | None) -> np.ndarray:
        """No 0 beyond the edge."""
        return values if edge is None else np.where(edge.beyond(grid) & (values == 0), np.float32(np.nan), values)


@dataclasses.dataclass(frozen=True)
class Density(Layer):
    """How many ground points there are per m2 in each cell, which says how well a terrain model is supported.

    >>> number = jf.count(cloud, result, cell=2.0).values
    >>> bool(np.array_equal(jf.density(cloud, result, cell=2.0).values, number / 4, equal_nan=True))
    True
    """

    NAME, TITLE, UNITS, STYLE, SURFACE = "density", "density of ground points", "points per m2", "cividis", False

    @property
    def parts(self) -> tuple[Layer, ...]:
        return (Count(),)

    def made_of(self, known: Mapping[Layer, np.ndarray], grid: RasterGrid, units: Units) -> np.ndarray:
        return (known[Count()] / (grid.cell * units.xy) ** 2).astype(np.float32)


@dataclasses.dataclass(frozen=True)
class Voids(Layer):
    """A mask, 1 where a cell's centre is so far from every ground point that a terrain model is a guess, and 0 elsewhere;
    no value beyond the edge of the ground.

    Attributes:
        distance: metres.

    Raises: ParameterError for a distance that is not positive.

    >>> near, far = (jf.voids.replace(distance=distance)(cloud, result).values for distance in (1.0, 100.0))
    >>> bool(0 < np.nanmean(near) < 1), bool(np.nanmax(far))
    (True, False)
    """

    NAME, TITLE, UNITS, STYLE, KIND, NODATA, SURFACE = "voids", "void", "0 or 1", "gray_r", "uint8", 255, False
    distance: float = setting("How far the nearest ground point may be.", 5.0, metres=True)

    def __post_init__(self) -> None:
        check_positive(" of metres", distance=self.distance)

    def reach(self, side: float) -> float:
        """As far as a ground point may be."""
        return side + self.distance

    def values(self, site: Site) -> np.ndarray:
        out, ground = np.ones(site.grid.shape, np.float32), site.cloud.xyz[site.ground]
        if len(ground):
            nearest = nearest_point(ground, site.workers, self.distance)
            for rows, at in blocks_of(site.cloud, site.grid):
                out[rows] = np.isinf(nearest(at)[0]).reshape(-1, site.grid.columns)
        return out

    def bounded(self, values: np.ndarray, grid: RasterGrid, edge: Edge | None, levels: WaterRuns | None) -> np.ndarray:
        """Voids in the midst of the ground."""
        return values if edge is None else np.where(edge.beyond(grid), np.float32(np.nan), values)


def breaklines(
    cloud: PointCloud,
    result: FilterResult | np.ndarray | None = None,
    path: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
) -> geopandas.GeoDataFrame:
    """The water bodies of a cloud in memory as polygons: those that the filter found (OST), and those of points of class 9.

    They follow cells of a metre or more, so that voids of water that returns nothing are in them; islands are holes. Corners have
    the height that :func:`jaxfilter.dtm` gives the water: one for all, or, where the two ends differ by more than 0.1 m, heights
    that fall along the course.

    Args:
        cloud: n points.
        result: what is ground, as in :func:`jaxfilter.dtm`.
        path: a GeoPackage (.gpkg, layer ``breaklines``) or GeoJSON (.geojson) to write as well; it appears whole or not at all.
        overwrite: replace an existing file.

    Returns: GeoDataFrame of polygons with Z, in the units and with the CRS of the cloud, and with the columns ``elevation``, the
    median; ``fall``, how much higher the upper end is; and ``area``. Raises: InputError for labels that do not fit; OutputError
    (suffix, exists, disk). Warns: if a file is written and the cloud has no CRS.

    >>> wet = jf.scenes.make(jf.scenes.SceneLayout(lake=30.0, water_echoes=0.8), size=(260, 320), density=1, seed=3)
    >>> lakes = jf.breaklines(wet.cloud, jf.OST.for_cloud(wet.cloud)(wet.cloud))
    >>> set(lakes.geom_type), bool((lakes.area >= 100).all()), bool(lakes.has_z.all())
    ({'Polygon'}, True, True)
    """
    cloud = as_cloud(cloud)
    target = None if path is None else check_suffix(place_of(path), VECTOR_SUFFIXES)
    table = outlines(levels_in(cloud, result, ground_of(cloud, result)), cloud.crs)
    if target is not None:
        write_features(target, [table], "breaklines", overwrite=overwrite)
    return table


dsm, chm, density, count, voids = Dsm(), Chm(), Density(), Count(), Voids()
