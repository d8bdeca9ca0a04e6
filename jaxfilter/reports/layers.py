"""The maps of a report: rasters of the ground, of heights above it, of doubt and of errors; and places to look at."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import scipy

from ..core.cloud import QUANTUM, PointCloud
from ..core.grid import Grid, grid_over
from ..core.result import Decision, FilterResult
from ..plots.maps import rasterise, shade
from .places import find_suspects, places_of

MOST_PIXELS = 2_000_000
"""Cells of a map, at most."""
_DOUBTFUL = 0.2
"""Share of the points of a decision, those nearest to their threshold, that count as doubtful."""
_PLACES, _PLACE, _SIDE = 12, 20, 20.0
"""Places to look at; the side of one in cells and in metres, at least."""


def map_layers(
    cloud: PointCloud, result: FilterResult, reference: np.ndarray | None
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The maps of a cloud with at least one valid point. ``reference``: i8[n], 1 = ground, 0 = object.

    Returns: plain facts: ``grid``, whose own row 0 is the southern edge; ``low`` and ``step`` of the ``elevation``; ``doubt_of``,
    what doubt is made of: "probability", "margin" or "". And rasters [ny, nx], row 0 being the northern edge; the surface goes
    through all points if none is ground:

    - ``shade``: u8, relief; 0 where there is no surface.
    - ``elevation``: u16; local metres = ``low`` + value * ``step``; 65535 = none.
    - ``height``: u16, centimetres of the highest point above the ground; 65535 = no point.
    - ``doubt``, if there is any: u8, per cent of the most doubtful point; 255 = no point was judged.
    - ``errors``, of a reference: u8; bit 0: ground lost, bit 1: objects accepted.
    """
    real = np.ones(len(cloud), bool) if cloud.valid is None else cloud.valid
    ground = result.ground & real
    xyz = cloud.xyz[real] if not real.all() else cloud.xyz
    width, height = np.maximum(np.ptp(xyz[:, :2], axis=0).astype(np.float64), 1.0).tolist()
    side = math.sqrt(width * height / min(len(xyz), MOST_PIXELS))  # about one point per cell
    cell = max(side, max(width, height) / 8000, 0.05)
    z, grid = rasterise(cloud.xyz[ground] if ground.any() else xyz, cell, over=xyz)
    known = z[np.isfinite(z)]
    low, step = float(known.min()), max(float(np.ptp(known)) / 65534, QUANTUM)
    flat = grid.flat(cloud.xyz)
    above = _keep_highest(cloud.xyz[:, 2] - z.ravel()[flat], flat, grid, real)
    doubt, doubt_of = _rate_doubt(result)
    arrays = {
        "shade": _quantise(shade(z, grid.cell), 1 / 254, np.uint8, low=1),
        "elevation": _quantise(z - low, step, np.uint16),
        "height": _quantise(above, 0.01, np.uint16),
    }
    if doubt_of:
        arrays["doubt"] = _quantise(_keep_highest(doubt, flat, grid, real), 0.01, np.uint8)
    if reference is not None:
        errors = arrays["errors"] = np.zeros(grid.shape, np.uint8)
        for bit, wrong in ((1, (reference == 1) & ~ground), (2, ground & (reference == 0))):
            errors.reshape(-1)[flat[wrong & real]] |= np.uint8(bit)
    facts = {"grid": dataclasses.asdict(grid), "elevation": {"low": low, "step": step}, "doubt_of": doubt_of}
    return facts, {name: values[::-1] for name, values in arrays.items()}


def _rate_doubt(result: FilterResult) -> tuple[np.ndarray, str]:
    """f32[n], 0 (sure) to 1; NaN where nothing is known; and where it comes from.

    A result's own ``doubt``, a probability, counts as it is. Otherwise the margin decides: of the points of each decision
    the fifth that is nearest to its threshold is doubtful, 1 on the threshold. Margins of different decisions have
    different units.
    """
    if result.doubt is not None:
        return np.asarray(result.doubt, np.float32), "probability"
    out = np.full(len(result), np.nan, np.float32)
    if not np.isfinite(result.margin).any():
        return out, ""
    for decision in Decision:
        rows = np.flatnonzero((result.decision == decision) & np.isfinite(result.margin))
        if decision is Decision.SET_ASIDE or not len(rows):
            continue
        distance = np.abs(result.margin[rows])
        limit = float(np.quantile(distance[:: max(1, len(distance) // 100_000)], _DOUBTFUL))
        out[rows] = np.maximum(0.0, 1.0 - distance / max(limit, 1e-9))
    return out, "margin"


def places_to_look_at(
    cloud: PointCloud, found: FilterResult, wrong: np.ndarray | None, cell: float
) -> list[dict[str, Any]]:
    """Where to look first: squares with most errors, ``wrong``, bool[n], or without any known the places of
    :func:`jaxfilter.review`.

    Returns: for each ``x`` and ``y``, local metres, the ``side`` of a square around it, and ``what``: why it is shown.
    """
    least = max(_PLACE * cell, _SIDE)
    if wrong is not None and wrong.any():
        grid = grid_over(cloud.xyz, least, name="side")
        at, count = np.unique(grid.flat(cloud.xyz[wrong]), return_counts=True)
        row, column = np.divmod(at[np.argsort(-count, kind="stable")[:_PLACES]], grid.nx)
        x, y = grid.x0 + (column + 0.5) * least, grid.y0 + (row + 0.5) * least
        shown = [(*xy, least, "errors") for xy in zip(x, y, strict=True)]
    else:
        listed = places_of([find_suspects(cloud, found)], cloud.units.xy)[:_PLACES]
        local = ((np.array([one.x, one.y]) - cloud.origin[:2]) * cloud.units.xy for one in listed)
        shown = [(*xy, max(math.sqrt(one.area), least), one.reason) for xy, one in zip(local, listed, strict=True)]
    return [dict(zip(("x", "y", "side", "what"), one, strict=True)) for one in shown]


def _keep_highest(values: np.ndarray, flat: np.ndarray, grid: Grid, real: np.ndarray) -> np.ndarray:
    """f32[ny, nx]: the largest value of each cell; empty cells take that of their neighbours. NaN counts as no value."""
    known = real & np.isfinite(values)
    out = np.full(grid.ny * grid.nx, -np.inf, np.float32)
    np.maximum.at(out, flat[known], values[known])
    cells = out.reshape(grid.shape)
    filled = np.where(np.isinf(cells), scipy.ndimage.maximum_filter(cells, 3, mode="nearest"), cells)
    return np.where(np.isinf(filled), np.float32(np.nan), filled)


def _quantise(values: np.ndarray, step: float, kind: type, low: int = 0) -> np.ndarray:
    """Values in steps from ``low`` on; 0 stands for NaN, and for no value, or the largest number if ``low`` is 0."""
    most = np.iinfo(kind).max
    none, top = (0, most) if low else (most, most - 1)
    whole = np.clip(np.rint(np.nan_to_num(values) / step) + low, low, top)
    return np.where(np.isnan(values), none, whole).astype(kind)
