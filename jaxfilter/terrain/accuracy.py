"""How far the terrain model of a labelling lies from that of a reference, along the border of the data and inside."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np

from ..core.cloud import PointCloud, as_cloud
from ..core.errors import check_positive
from ..core.result import FilterResult
from .interpolation import Interpolation
from .layer import Site, grid_of, ground_of
from .models import interpolated
from .outline import inward, occupied
from .raster import RasterGrid

OFF, FAR_OFF = 0.5, 1.0
"""Metres from which on a cell counts as off, and as far off."""


@dataclasses.dataclass(frozen=True)
class HeightErrors:
    """How far one terrain model lies from another, over the cells where both have a height. NaN if there are none.

    Attributes:
        rmse: root of the mean squared difference, metres (Uray and Varlik 2024, eq. 4).
        mean: mean difference, metres; positive: the model lies above the reference.
        p95: 95th percentile of the absolute difference, metres.
        largest: largest absolute difference, metres.
        high, low: percent of the cells where the model is more than 0.5 m too high, and too low.
        high_1m, low_1m: the same by more than 1 m.
        cells: number of cells compared.
        missing: number of cells where only the reference has a height.
        border: the same figures for the cells along the border of the data.
        inside: for all others. These two have None in the place of further parts.

    >>> errors = jf.dtm_rmse(cloud, result)
    >>> errors.cells == errors.border.cells + errors.inside.cells, errors.high + errors.low == errors.off
    (True, True)
    """

    rmse: float
    mean: float
    p95: float
    largest: float
    high: float
    low: float
    high_1m: float
    low_1m: float
    cells: int
    missing: int
    border: HeightErrors | None = None
    inside: HeightErrors | None = None

    @property
    def off(self) -> float:
        """Percent of the cells that are off by more than 0.5 m.

        >>> jf.dtm_rmse(cloud, truth).off
        0.0
        """
        return self.high + self.low

    @property
    def off_1m(self) -> float:
        """Percent of the cells that are off by more than 1 m.

        >>> jf.dtm_rmse(cloud, truth).off_1m
        0.0
        """
        return self.high_1m + self.low_1m

    def as_dict(self) -> dict[str, Any]:
        """All figures by name, those of ``border`` and ``inside`` with that word before theirs: ``"border_off"``.

        >>> jf.dtm_rmse(cloud, truth).as_dict()["border_off_1m"]
        0.0
        """
        names = [f.name for f in dataclasses.fields(self)[:-2]]
        own = {name: getattr(self, name) for name in (*names, "off", "off_1m")}
        parts = (("border_", self.border), ("inside_", self.inside))
        return own | {word + key: value for word, part in parts if part for key, value in part.as_dict().items()}


_NONE = HeightErrors(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, cells=0, missing=0)
FIGURES = tuple(dataclasses.replace(_NONE, border=_NONE, inside=_NONE).as_dict())
"""Keys of :meth:`HeightErrors.as_dict`."""


class Differences(NamedTuple):
    """Two terrain models, cell by cell, arrays [rows, columns], row 0 in the north.

    ``metres``: f64, model less reference, NaN where one of them has no height; ``missing``: bool, where only the reference has;
    ``border``: bool, along the border of the data; ``grid``: the cells.
    """

    metres: np.ndarray
    missing: np.ndarray
    border: np.ndarray
    grid: RasterGrid

    def errors(self, where: np.ndarray | bool = True) -> HeightErrors:
        """Figures of the cells ``where``, bool[rows, columns], without parts."""
        d = self.metres[np.isfinite(self.metres) & where]
        missing = int((self.missing & where).sum())
        if not len(d):
            return dataclasses.replace(_NONE, missing=missing)
        high, low, high_1m, low_1m = (100 * float((v > limit).mean()) for limit in (OFF, FAR_OFF) for v in (d, -d))
        size = np.abs(d)
        rmse, p95, largest = math.sqrt(np.mean(d * d)), float(np.percentile(size, 95)), float(size.max())
        return HeightErrors(rmse, float(d.mean()), p95, largest, high, low, high_1m, low_1m, len(d), missing)


def dtm_rmse(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    reference: np.ndarray | None = None,
    cell: float = 1.0,
    interpolation: Interpolation = Interpolation(),  # noqa: B008
    *,
    near: float | None = 3.0,
    rim: float = 20.0,
) -> HeightErrors:
    """The vertical error of the terrain model that follows from a labelling, against the one from reference labels.

    Both models are made alike, by :func:`dtm`. The border of the data is their outline, not that of the bounding box: lakes and
    other voids in the midst of them do not count, nor do inlets of less than 20 m. Uray and Varlik (2024) compare models of 1 m
    made by kriging; they do not state the variogram, nor how far cells outside the ground points count.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: FilterResult, or bool[n] with True = ground.
        reference: bool[n] with True = ground; by default the cloud's own reference.
        cell: side of a cell, in the units of the cloud's coordinate system.
        interpolation: how heights between ground points are found. With ``fill`` no cell is missing.
        near: only cells whose centre is at most so many metres from a ground point of the reference count; None: all cells.
        rim: metres along the border of the data that ``border`` is about.

    Returns: HeightErrors, in metres whatever the units of the cloud.
    Raises: ParameterError for a distance that is not positive, and what :func:`dtm` raises.

    >>> errors = jf.dtm_rmse(cloud, result, cell=2.0)
    >>> round(jf.dtm_rmse(cloud, truth, cell=2.0).rmse, 6), errors.rmse < 1.0
    (0.0, True)
    """
    found = differences(as_cloud(cloud), result, reference, cell, interpolation, near=near, rim=rim)
    parts = found.errors(found.border), found.errors(~found.border)
    return dataclasses.replace(found.errors(), border=parts[0], inside=parts[1])


def differences(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    reference: np.ndarray | None,
    cell: float,
    interpolation: Interpolation,
    *,
    near: float | None,
    rim: float,
) -> Differences:
    """The models that :func:`dtm_rmse` compares, with its arguments."""
    check_positive(" of metres", near=near, rim=rim)
    grid = grid_of(cloud, cell, None)
    gaps = (interpolation.max_gap, near and near / cloud.units.xy)
    known = dataclasses.replace(interpolation, max_gap=min((gap for gap in gaps if gap is not None), default=None))
    truth = interpolated(Site(cloud, ground_of(cloud, reference, "reference"), grid, interpolation=known))
    model = interpolated(Site(cloud, ground_of(cloud, result), grid, interpolation=interpolation))
    metres = (model.astype(np.float64) - truth) * cloud.units.z
    border = inward(occupied(cloud, grid), cell * cloud.units.xy) <= rim
    return Differences(metres, np.isfinite(truth) & ~np.isfinite(model), border, grid)
