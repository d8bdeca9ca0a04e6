"""Rasters with a place on the map, and GeoTIFF files of them."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyproj

from ..core.cloud import QUANTUM
from ..core.errors import InputError, OutputError, check_positive
from ..core.grid import MAX_CELLS
from ..core.reading import Bounds
from ..core.units import for_outputs, height_datum, horizontal, same_system
from ..files.disk import check_suffix, new_file
from ..files.storage import Place, Remote, place_of

if TYPE_CHECKING:
    import xarray

RASTER_SUFFIXES = (".tif", ".tiff")
NODATA = -9999.0
HEIGHTS = "units of Z"
"""Units of a raster that are those of the heights of its CRS."""
_BLOCK, STRIP = 256, 512
"""Rows and columns of the blocks of a file, and rows that are read of it at a time."""


Transform = tuple[float, float, float, float, float, float]


@dataclasses.dataclass(frozen=True, eq=False)
class Raster:
    """Heights or other values on square cells, north up, in the units of the coordinate system of the cloud they were made from.

    Attributes:
        values: f32[rows, columns]; row 0 is the northern edge; NaN where there is none.
        transform: (a, b, c, d, e, f) with x = a * column + b * row + c and y = d * column + e * row + f at the upper left
            corner of a cell: the first six numbers of ``affine.Affine``, as rasterio has them. Centres lie half a cell on.
        crs: pyproj.CRS or None.
        nodata, kind: what stands for NaN in files, and the type of their values.
        title: what the values are; its first word is the name of the array of :meth:`to_xarray`. units: in which they are.

    >>> model = jf.dtm(cloud, result, cell=5.0)
    >>> model.values.dtype, model.values.shape, model.transform[:3]
    (dtype('float32'), (12, 12), (5.0, 0.0, 512000.0))
    """

    values: np.ndarray
    transform: Transform
    crs: Any = None
    nodata: float = NODATA
    kind: str = "float32"
    title: str = "height of the ground"
    units: str = HEIGHTS

    def __repr__(self) -> str:
        rows, columns = self.values.shape
        place = ", ".join(f"{edge:.10g}" for edge in self.bounds)
        return f"Raster({rows} x {columns} cells of {self.cell:g}, {np.isnan(self.values).sum()} without height, bounds {place})"

    @property
    def cell(self) -> float:
        """Side of a cell.

        >>> jf.dtm(cloud, result, cell=5.0).cell
        5.0
        """
        return self.transform[0]

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(xmin, ymin, xmax, ymax): the outer edges of the outer cells.

        >>> jf.dtm(cloud, result, cell=5.0).bounds
        (512000.0, 5403000.0, 512060.0, 5403060.0)
        """
        a, _, c, _, e, f = self.transform
        rows, columns = self.values.shape
        return c, f + e * rows, c + a * columns, f

    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """x f64[columns], ascending, and y f64[rows], descending, of the centres of the cells.

        >>> x, y = jf.dtm(cloud, result, cell=5.0).centres()
        >>> x[:2].tolist(), y[:2].tolist()
        ([512002.5, 512007.5], [5403057.5, 5403052.5])
        """
        a, _, c, _, e, f = self.transform
        rows, columns = self.values.shape
        return c + a * (np.arange(columns) + 0.5), f + e * (np.arange(rows) + 0.5)

    def to_xarray(self) -> xarray.DataArray:
        """The heights over ``y`` (descending) and ``x``, the centres of the cells, as GDAL, QGIS and rioxarray understand them.

        The CRS and the transform are attributes of the coordinate ``spatial_ref``, by the CF conventions (grid mapping); with
        rioxarray imported, ``.rio`` knows CRS, transform and nodata. Cells without a height are NaN, and ``nodata`` in files.

        >>> heights = jf.dtm(cloud, result, cell=5.0).to_xarray()
        >>> heights.dims, heights.shape
        (('y', 'x'), (12, 12))
        """
        import xarray

        a, b, c, d, e, f = self.transform
        grid: dict[str, Any] = {} if self.crs is None else self.crs.to_cf()
        if "crs_wkt" in grid:
            grid["spatial_ref"] = grid["crs_wkt"]  # the name of GDAL
        grid["GeoTransform"] = " ".join(repr(float(v)) for v in (c, a, b, f, d, e))
        stated = [] if self.crs is None else self.crs.cs_to_cf()
        axes = {axis["axis"].lower(): axis for axis in stated if "axis" in axis}
        x, y = self.centres()
        out = xarray.DataArray(
            self.values,
            dims=("y", "x"),
            coords={"y": ("y", y, axes.get("y", {})), "x": ("x", x, axes.get("x", {})), "spatial_ref": ((), 0, grid)},
            name=self.title.split()[0],
            attrs={"long_name": self.title},
        )
        out.encoding = {"_FillValue": np.float32(self.nodata), "grid_mapping": "spatial_ref"}
        return out

    def write(self, path: str | Path | Remote, *, overwrite: bool = False) -> Path | Remote:
        """Write a GeoTIFF: values of ``kind``, tiled, deflated, cells are areas, with transform, CRS and nodata.

        ``path`` may be a URL that fsspec can write to (``"s3://bucket/dtm.tif"``). The file appears whole or not at all.

        Returns: the path.
        Raises: OutputError (suffix, exists and not ``overwrite``, disk).

        >>> jf.dtm(cloud, result, cell=5.0).write("dtm.tif").name
        'dtm.tif'
        """
        import rasterio

        path = check_suffix(place_of(path), RASTER_SUFFIXES)
        profile = profile_of(self.values.shape, self.transform, self.crs, self.kind, self.nodata)
        band = Band(self.title, self.units, self.crs)
        profile |= {"compress": "deflate", "predictor": 3 if self.kind == "float32" else 2}
        with rasterio.io.MemoryFile() as memory:  # GDAL does not tell why, nor always that, a disk refused
            with memory.open(**profile) as file:
                file.write(packed(self.values, self.kind, self.nodata), 1)
                band.describe(file)
            with new_file(path, overwrite=overwrite) as temporary:
                temporary.write_bytes(memory.getbuffer())
        return path

    @classmethod
    def read(cls, path: str | Path) -> Raster:
        """The first band of a north-up raster file with square cells, for example what :meth:`write` wrote.

        Raises: InputError if it cannot be read or has another layout.

        >>> model = jf.dtm(cloud, result, cell=5.0)
        >>> back = jf.Raster.read(model.write("dtm.tif"))
        >>> bool(np.array_equal(back.values, model.values, equal_nan=True))
        True
        """
        import rasterio

        with Rows.of(path) as (rows, transform, crs):
            values = rows.read(0, rows.number)
            with rasterio.open(path) as file:
                nodata, kind = file.nodata, str(file.dtypes[0])
                words = file.descriptions[0] or cls.title, file.units[0] or cls.units
        kind = kind if nodata is not None and np.can_cast(kind, np.float32) else "float32"
        return cls(values, transform, crs, NODATA if nodata is None else nodata, kind, *words)


@dataclasses.dataclass(frozen=True)
class RasterGrid:
    """Cells of a raster: ``left`` and ``bottom`` count whole cells from the zero of the coordinates, whose units ``cell`` has."""

    cell: float
    left: int
    bottom: int
    columns: int
    rows: int

    @classmethod
    def over(cls, bounds: Bounds, cell: float, metre: float = 1.0, most: float = MAX_CELLS) -> RasterGrid:
        """The whole cells over bounds; ``metre``: metres per unit; ``most``: cells that there may be.

        Raises: ParameterError for a cell that has no size, InputError if more cells would be needed.
        """
        check_positive(cell=cell)
        cell = float(cell)  # a float32 would make float32 of all coordinates
        if not all(abs(v / cell) < 2.0**53 for v in bounds):
            raise InputError(f"cell={cell:g} over bounds {bounds}: more cells than can be counted: pass other ones")
        slack = min(QUANTUM / metre / cell, 0.5)  # coordinates are known to a quantum: an edge needs no further cell
        left, bottom = (math.floor(v / cell + slack) for v in bounds[:2])
        right, top = (math.ceil(v / cell - slack) for v in bounds[2:])
        columns, rows = max(1, right - left), max(1, top - bottom)
        if rows * columns > most:
            extent = f"{bounds[2] - bounds[0]:.6g} x {bounds[3] - bounds[1]:.6g}"
            wrong = f"cell={cell:g} over an extent of {extent} needs {rows * columns:,} cells, more than {most:,}"
            raise InputError(f"{wrong}: use larger cells or bounds, or remove stray points far from the rest")
        return cls(cell, left, bottom, columns, rows)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.columns

    @property
    def bounds(self) -> Bounds:
        """(xmin, ymin, xmax, ymax)."""
        left, bottom, cell = self.left, self.bottom, self.cell
        return left * cell, bottom * cell, (left + self.columns) * cell, (bottom + self.rows) * cell

    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """x f64[columns], ascending, and y f64[rows], descending, of the centres of the cells."""
        x = (self.left + 0.5 + np.arange(self.columns)) * self.cell
        y = (self.bottom + self.rows - 0.5 - np.arange(self.rows)) * self.cell
        return x, y

    def part(self, box: Bounds) -> RasterGrid:
        """The cells in a box whose edges are multiples of the cell; rows or columns below 1: there are none."""
        left, bottom = max(self.left, round(box[0] / self.cell)), max(self.bottom, round(box[1] / self.cell))
        right = min(self.left + self.columns, round(box[2] / self.cell))
        top = min(self.bottom + self.rows, round(box[3] / self.cell))
        return RasterGrid(self.cell, left, bottom, right - left, top - bottom)

    def grown(self, ring: int) -> RasterGrid:
        """With so many more cells on all sides."""
        more = 2 * ring
        return RasterGrid(self.cell, self.left - ring, self.bottom - ring, self.columns + more, self.rows + more)

    def slices(self, part: RasterGrid) -> tuple[slice, slice]:
        """Rows, from north, and columns that the cells of a part have."""
        row, column = self.bottom + self.rows - part.bottom - part.rows, part.left - self.left
        return slice(row, row + part.rows), slice(column, column + part.columns)

    @property
    def transform(self) -> Transform:
        """As of a :class:`Raster` on these cells."""
        return self.cell, 0.0, self.left * self.cell, 0.0, -self.cell, (self.bottom + self.rows) * self.cell


def write_mosaic(
    path: Place,
    grid: RasterGrid,
    profile: dict[str, Any],
    parts: Callable[[], Iterable[tuple[RasterGrid, np.ndarray]]],
    band: Band,
    *,
    overwrite: bool = False,
    check: Callable[[int], None] = lambda known: None,
) -> int:
    """Write a Cloud Optimized GeoTIFF out of parts, none of which is held longer than needed: overviews, deflated, BigTIFF
    where it has to be.

    Args:
        grid: all cells; profile: of the file, see :func:`profile_of`.
        parts: gives, each time it is called, cells and their values, see :func:`packed`, of parts that do not overlap. What no
            part covers has no value. band: what they are.
        check: called with the number of cells that have a value, before the file appears, which it does not if this raises.

    Returns: how many cells have a value.
    Raises: OutputError (exists and not ``overwrite``, disk; the file is read back).
    """
    import rasterio
    from rasterio.shutil import copy
    from rasterio.windows import Window

    def windows() -> Iterator[tuple[Window, np.ndarray]]:
        return ((Window.from_slices(*grid.slices(part)), values) for part, values in parts())

    known = 0
    with new_file(path, overwrite=overwrite) as temporary:
        plain = temporary.with_name("plain.tif")
        try:
            with rasterio.open(plain, "w", **profile) as file:
                for window, values in windows():
                    file.write(values, 1, window=window)
                band.describe(file)
            copy(
                plain, temporary, driver="COG", compress="deflate", predictor="yes", overviews="ignore_existing",
                resampling="average", bigtiff="if_safer",
            )  # fmt: skip
            plain.unlink()
            with rasterio.open(temporary) as file:  # GDAL does not always tell that a disk refused
                for window, values in windows():
                    known += int(np.count_nonzero(values != profile["nodata"]))
                    if not np.array_equal(file.read(1, window=window), values):
                        raise OutputError(f"{path}: cannot be written: it reads back otherwise; is the disk full?")
        except rasterio.errors.RasterioError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from error
        check(known)
    return known


class Rows(NamedTuple):
    """Heights of a raster that need not be in memory: ``number``, ``columns``: its shape; ``read``: f32[r, columns], rows
    from one to before another, NaN where there are none."""

    number: int
    columns: int
    read: Callable[[int, int], np.ndarray]

    @classmethod
    @contextlib.contextmanager
    def of(cls, path: str | Path) -> Iterator[tuple[Rows, Transform, Any]]:
        """The first band of a file, which is open as long as the block, its transform and its CRS. Raises: InputError."""
        import rasterio

        try:
            with rasterio.open(path) as file:
                transform = tuple(file.transform)[:6]
                if transform[1] or transform[3] or transform[0] <= 0 or transform[0] != -transform[4]:
                    words = f"only north-up rasters with square cells are read, not transform {transform}"
                    raise InputError(f"{path}: {words}")

                def read(top: int, stop: int) -> np.ndarray:
                    window = rasterio.windows.Window(0, top, file.width, stop - top)
                    return np.asarray(file.read(1, window=window, masked=True).astype(np.float32).filled(np.nan))

                crs = None if file.crs is None else pyproj.CRS.from_wkt(file.crs.to_wkt())
                yield cls(file.height, file.width, read), transform, crs
        except rasterio.errors.RasterioError as error:
            raise InputError(f"{path}: cannot be read as a raster: {error}") from error


def metres_per_unit(crs: Any) -> float:
    """Of X and Y; 1 without a CRS, and for degrees that of latitude."""
    if crs is None:
        return 1.0
    plane = horizontal(pyproj.CRS(crs))
    return 111_320.0 if plane.is_geographic else float(plane.axis_info[0].unit_conversion_factor)


class Band(NamedTuple):
    """What the values of a raster are: ``title`` and ``units``, as of a :class:`Raster`; ``crs``: of the raster."""

    title: str
    units: str
    crs: Any

    def describe(self, file: Any) -> None:
        """Say it in a file that is open: description and unit of the band, and what heights count from as VERTICAL_DATUM."""
        file.set_band_description(1, self.title)
        crs = None if self.crs is None else pyproj.CRS(self.crs)
        if self.units != HEIGHTS:
            file.set_band_unit(1, self.units)
        elif crs is not None:
            file.set_band_unit(1, crs.axis_info[-1].unit_name)
        if self.title.startswith("height of"):
            file.update_tags(VERTICAL_DATUM=(crs and height_datum(crs)) or "unknown")


def grid_like(path: str | Path, crs: Any) -> RasterGrid:
    """The cells of a raster file, for others in a ``crs``. Raises: InputError if it has another CRS, or if its cells do not end
    at whole multiples of their side."""
    with Rows.of(path) as (rows, transform, own):
        cell, _, left, _, _, top = transform
        if crs is not None and own is not None and not same_system(horizontal(own), horizontal(crs)):
            raise InputError(f"{path}: is in {own.name}, and the points are in {crs.name}: name a raster in their CRS")
        first, last = left / cell, top / cell
        if max(abs(first - round(first)), abs(last - round(last))) > 1e-4:
            raise InputError(f"{path}: its cells do not end at multiples of their side, {cell:g}: name another raster")
        return RasterGrid(cell, round(first), round(last) - rows.number, rows.columns, rows.number)


def packed(values: np.ndarray, kind: str, nodata: float) -> np.ndarray:
    """[rows, columns], values f32[rows, columns] as a file has them."""
    return np.where(np.isnan(values), np.float32(nodata), values).astype(kind)


def profile_of(
    shape: tuple[int, ...], transform: Iterable[float], crs: Any, kind: str, nodata: float
) -> dict[str, Any]:
    """How a GeoTIFF file is made, for rasterio; the arguments are those of a :class:`Raster`."""
    import rasterio

    crs = for_outputs(crs)
    return {
        "driver": "GTiff", "dtype": kind, "count": 1, "height": shape[0], "width": shape[1],
        "crs": None if crs is None else rasterio.crs.CRS.from_wkt(crs.to_wkt()), "transform": rasterio.Affine(*transform),
        "nodata": nodata, "tiled": True, "blockxsize": _BLOCK, "blockysize": _BLOCK, "bigtiff": "if_safer",
    }  # fmt: skip
