"""Layers of the terrain: what a raster of a survey shows, cell by cell."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import InputError
from ..core.frame import ends
from ..core.points import check_extent
from ..core.reading import Bounds, check_bounds
from ..core.result import FilterResult, Progress, silent
from ..core.units import Units
from ..files.storage import Place
from .edge import Edge, EdgeRule, Part
from .interpolation import Heights, Interpolation
from .levels import WaterRuns, levels_of
from .outline import count_in
from .raster import HEIGHTS, NODATA, RASTER_SUFFIXES, Raster, RasterGrid


def setting(help: str, default: Any, *, metres: bool = False) -> Any:
    """A field of a layer, and option of its command, with what it says there; ``metres``: a length, which must be positive. What
    has several values may be repeated."""
    return dataclasses.field(default=default, metadata={"help": help, "metres": metres})


@dataclasses.dataclass(frozen=True)
class Layer:
    """What a raster shows. A subclass says how its cells are made, in ``values``; its fields are the settings. Called, it makes
    the raster of a cloud in memory.

    Attributes:
        NAME: of the command and of files, in ``layers.py``.
        TITLE: what the values are; UNITS: in which they are.
        KIND: the type of the values in files, in which ``NODATA`` stands for none. SUFFIXES: of files, the usual one first.
        STYLE: a colour map of Matplotlib, for pictures, or "relief".
        SURFACE: it needs a surface through the ground. MODEL: it shows the terrain model, and what its command says of the
            interpolation of heights counts. OF_RASTER: it can be made of a raster of heights, by :meth:`from_raster`.
    """

    NAME: ClassVar[str] = ""
    TITLE: ClassVar[str] = ""
    UNITS: ClassVar[str] = HEIGHTS
    KIND: ClassVar[str] = "float32"
    NODATA: ClassVar[float] = NODATA
    SUFFIXES: ClassVar[tuple[str, ...]] = RASTER_SUFFIXES
    STYLE: ClassVar[str] = "gray"
    SURFACE: ClassVar[bool] = True
    MODEL: ClassVar[bool] = False
    OF_RASTER: ClassVar[bool] = False

    def reach(self, side: float) -> float:
        """Metres around a cell from which points count, besides the ground under the surface; ``side``: of a cell, metres."""
        return side

    @property
    def cells(self) -> Layer:
        """The layer whose cells are needed: itself, or what it is made of in the end."""
        return self

    @property
    def parts(self) -> tuple[Layer, ...]:
        """The layers without parts that :meth:`made_of` needs, for those that are made of others alone."""
        return ()

    def bounded(self, values: np.ndarray, grid: RasterGrid, edge: Edge | None, levels: WaterRuns | None) -> np.ndarray:
        """f32[rows, columns]: the values of a layer without ``parts``, after what only all tiles together know: where the ground
        ends, and the level of water."""
        return values

    def from_raster(self, source: Path, target: Place, overwrite: bool) -> None:
        """Write what the heights in a raster file give. Raises: InputError, OutputError."""
        raise NotImplementedError

    def made_of(self, known: Mapping[Layer, np.ndarray], grid: RasterGrid, units: Units) -> np.ndarray:
        """f32[rows, columns]: the values, out of those of ``parts``."""
        return known[self]

    def values(self, site: Site) -> np.ndarray:
        """f32[rows, columns], from north; NaN where there is none. Raises: InputError."""
        return self.made_of({part: site.of(part) for part in self.parts}, site.grid, site.cloud.units)

    def replace(self, **settings: Any) -> Self:
        """With other settings. Raises: ParameterError."""
        return dataclasses.replace(self, **settings)

    def __call__(
        self,
        cloud: PointCloud,
        result: FilterResult | np.ndarray | None = None,
        cell: float = 1.0,
        *,
        bounds: Iterable[float] | None = None,
    ) -> Raster:
        """The raster of a cloud in memory; the arguments, and what is raised, are those of :func:`jaxfilter.dtm`."""
        cloud = as_cloud(cloud)
        noise = result.low_noise if isinstance(result, FilterResult) else None
        grid, ground = grid_of(cloud, cell, bounds), ground_of(cloud, result)
        site = Site(cloud, ground, grid, noise=noise, levels=levels_of(cloud, result, ground))
        return Raster(site.of(self), grid.transform, cloud.crs, self.NODATA, self.KIND, self.TITLE, self.UNITS)


@dataclasses.dataclass(eq=False)
class Site:
    """What layers are made of.

    Attributes:
        cloud: n points; ground, noise: bool[n], ground points, and points that are left out of all surfaces.
        grid: the cells. Hillshade looks one cell further, and has other values along the edge of the grid.
        interpolation: how heights between ground points are found.
        workers: threads; by default one per core.
        look: called with the centres of cells, f64[q, 2], local metres, and the surface that gives their heights.
        strict: too few ground points for a surface are an error; else there are no heights.
        levels: of water, which the terrain model has.
        ends: all points are here, so that it is known where the ground ends.
        progress: of the interpolation.
    """

    cloud: PointCloud
    ground: np.ndarray
    grid: RasterGrid
    noise: np.ndarray | None = None
    interpolation: Interpolation = dataclasses.field(default_factory=Interpolation)
    workers: int | None = None
    look: Callable[[np.ndarray, Heights], None] | None = None
    strict: bool = True
    levels: WaterRuns | None = None
    ends: bool = True
    progress: Progress = silent
    _known: dict[Layer, np.ndarray] = dataclasses.field(default_factory=dict, init=False)

    def of(self, layer: Layer) -> np.ndarray:
        """The values of a layer, which are made once. Raises: InputError."""
        if layer not in self._known:
            values = layer.values(self)
            if self.ends and not layer.parts:
                values = layer.bounded(values, self.grid, self.edge, self.levels)
            self._known[layer] = values
        return self._known[layer]

    @functools.cached_property
    def edge(self) -> Edge | None:
        """Where the ground ends, if all points are known."""
        if not self.interpolation.ends or not self.ground.any():
            return None
        rule = EdgeRule(self.grid, self.cloud.units.xy, _box_of(self.cloud), self.interpolation.max_edge)
        part = self.part_of(rule, self.grid, self.grid)
        return rule.find(lambda: [part], self.levels)

    @functools.cached_property
    def circle(self) -> np.ndarray:
        """f32[rows, columns], metres: the radius of the circle through the corners of the triangle of each cell, where there is
        one."""
        return np.zeros(self.grid.shape, np.float32)

    def part_of(self, rule: EdgeRule, own: RasterGrid, wide: RasterGrid) -> Part:
        """What the points say of the edge, of some cells."""
        if not self.interpolation.ends:
            return Part(own, wide, own, np.zeros((0, 0), np.uint8), 0, None)
        around = rule.around(own)
        near = rule.near(self.cloud, self.ground, around, self.workers)
        count = int(count_in(self.cloud, self.ground, own).sum())
        return Part(own, wide, around, near, count, rule.code(self.circle) if "circle" in vars(self) else None)

    @property
    def side(self) -> float:
        """Of a cell, metres."""
        return self.grid.cell * self.cloud.units.xy


def ground_of(cloud: PointCloud, result: FilterResult | np.ndarray | None, name: str = "result") -> np.ndarray:
    """bool[n]: the points that the surface goes through. Raises: InputError with the ``name`` of the argument."""
    if result is None:
        if cloud.reference is None:
            raise InputError(f"the cloud has no reference labels (a label column, or class 2): pass {name}=")
        ground = cloud.reference if cloud.withheld is None else cloud.reference & ~cloud.withheld
    else:
        ground = result.ground if isinstance(result, FilterResult) else np.asarray(result)
    if np.ma.is_masked(result):
        raise InputError(f"{name}: some labels are masked: say of every point whether it is ground")
    if ground.shape != (len(cloud),) or ground.dtype != bool:
        raise InputError(f"{name}: bool[{len(cloud)}] is needed for this cloud, not {ground.dtype}{list(ground.shape)}")
    return ground if cloud.valid is None else ground & cloud.valid


def extent_of(cloud: PointCloud) -> Bounds:
    """xmin, ymin, xmax, ymax of the points, file units. Raises InputError if there are none."""
    xy = cloud.xyz[:, :2] if cloud.valid is None else cloud.xyz[cloud.valid, :2]
    if len(xy) == 0:
        raise InputError("dtm: the cloud has no points, so that the raster has no extent; pass bounds=")
    check_extent(cloud, xy)
    return _box_of(cloud)


def _box_of(cloud: PointCloud) -> Bounds:
    xy = cloud.xyz[:, :2] if cloud.valid is None else cloud.xyz[cloud.valid, :2]
    corners = np.concatenate(ends(xy)).astype(np.float64)
    return tuple((np.tile(cloud.origin[:2], 2) + corners / cloud.units.xy).tolist())


def grid_of(cloud: PointCloud, cell: float, bounds: Iterable[float] | None) -> RasterGrid:
    """The cells over bounds, or over the points. Raises: ParameterError, InputError."""
    return RasterGrid.over(extent_of(cloud) if bounds is None else check_bounds(bounds), cell, cloud.units.xy)
