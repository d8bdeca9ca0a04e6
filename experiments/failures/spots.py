"""Places that are named where terrain may be wrong, against where it is; and the weights behind them, fitted anew."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

import jaxfilter as jf
from experiments.defaults.clouds import Known
from experiments.report import Row
from jaxfilter.reports import places as named
from jaxfilter.terrain.accuracy import OFF, Differences, differences
from jaxfilter.terrain.layer import extent_of
from jaxfilter.terrain.raster import RasterGrid

FILLED = jf.Interpolation(fill=True)
PER_CLOUD, RIDGE = 4000, 1e-3
"""Cells that a cloud has in the fit, drawn at random; they count as the root of how many they stand for."""


def differences_of(known: Known, result: jf.FilterResult) -> Differences:
    """Of terrain models on 1 m cells within 3 m of reference ground."""
    return differences(known.cloud, result, known.ground, 1.0 / known.cloud.units.xy, FILLED, near=3.0, rim=20.0)


def rows(known: Known, method: str) -> list[Row]:
    """What the places of a cloud hold. A place is right if some cell of 1 m in it is off by more than half a metre; those of
    which no cell is near reference ground are not judged."""
    cloud = known.cloud
    filter_ = jf.default_filter(cloud) if method == "ost" else jf.FILTERS[method].for_cloud(cloud)
    result = filter_(cloud)
    places = named.places_of(named.suspects(cloud, result), cloud.units.xy)
    row: Row = {"cloud": known.name, "kind": known.group, "method": method}
    return [row | scored(places, differences_of(known, result), named.SIDE / cloud.units.xy)]


def scored(places: list[named.Place], found: Differences, side: float) -> Row:
    """Square metres that are off, and named; places; cubic metres. ``side``: of the cells of places, file units."""
    at, off, size = _cells(found, side)
    of = {cell: k for k, place in enumerate(places) for cell in map(tuple, place.cells.tolist())}
    place = np.array([of.get(cell, -1) for cell in map(tuple, at.tolist())], np.int64)
    inside = place >= 0
    judged, wrong = (np.bincount(place[inside], w, len(places)) for w in (None, off[inside]))
    expected = sum(one.volume * n / one.area for one, n in zip(places, judged.tolist(), strict=True))
    return {
        "cells": len(off), "off": int(off.sum()), "off_named": int(off[inside].sum()), "named": int(inside.sum()),
        "area": sum(one.area for one in places), "places": len(places), "judged": int((judged > 0).sum()),
        "right": int((wrong > 0).sum()), "tenth": int(((wrong >= 0.1 * judged) & (wrong > 0)).sum()),
        "volume": float(expected), "volume_true": float(size[inside].sum()), "first": places[0].reason if places else "",
        "first_off": 100 * float(wrong[0]) / max(float(judged[0]), 1.0) if places else 0.0,
    }  # fmt: skip


def _cells(found: Differences, side: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the cells that are compared: i64[k, 2], columns and rows of the cells of places that hold them; whether they are off;
    and by how many metres."""
    row, column = np.nonzero(np.isfinite(found.metres))
    size, grid = np.abs(found.metres[row, column]), found.grid
    x, y = (grid.left + column + 0.5) * grid.cell, (grid.bottom + grid.rows - row - 0.5) * grid.cell
    return np.floor(np.stack([x, y], axis=1) / side).astype(np.int64), size > OFF, size


def fitted(clouds: Iterable[tuple[Known, jf.FilterResult]]) -> np.ndarray:
    """f64[2, 5]: what ``MODEL`` of :mod:`jaxfilter.reports.places` should be by these clouds."""
    rng, parts = np.random.default_rng(0), []
    for known, result in clouds:
        cloud = known.cloud
        side = named.SIDE / cloud.units.xy
        grid = RasterGrid.over(extent_of(cloud), side, cloud.units.xy)
        surface, found = named.ReviewCells.of(cloud, result, grid), differences_of(known, result)
        cell, off, _ = _cells(found, side)
        column, row = (cell - (grid.left, grid.bottom)).T
        at, n = (grid.rows - 1 - row) * grid.columns + column, grid.rows * grid.columns
        count, wrong = np.bincount(at, minlength=n), np.bincount(at, off, n)
        open_ = np.flatnonzero((count > 0) & (named.around(surface.points).ravel() > 0))
        chosen = rng.choice(open_, min(PER_CLOUD, len(open_)), replace=False)
        columns = [named.evidence(one).reshape(n, -1)[chosen] for one in (surface, surface._replace(doubt=None))]
        weight = count[chosen] * (len(open_) / len(chosen)) ** 0.5
        parts.append((columns, wrong[chosen] / count[chosen], weight))
    y, w = (np.concatenate([part[k] for part in parts]) for k in (1, 2))
    with_doubt, without = (np.concatenate([part[0][k] for part in parts]) for k in (0, 1))
    other = logistic(without[:, 1:], y, w)
    return np.stack([logistic(with_doubt, y, w), np.insert(other, 1, 0.0)])


def logistic(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """f64[1 + features]: constant and weights, by Newton's method in features of unit variance; ``y``: shares."""
    mean, weight = np.average(x, axis=0, weights=weight), weight / weight.sum()
    spread = np.sqrt(np.average((x - mean) ** 2, axis=0, weights=weight))
    z, ridge = np.column_stack([np.ones(len(x)), (x - mean) / spread]), np.diag([0.0, *[RIDGE] * x.shape[1]])
    w, share = np.zeros(z.shape[1]), float(weight @ y)
    w[0] = np.log(share / (1 - share))
    for _ in range(60):
        p = 1 / (1 + np.exp(-z @ w))
        step = np.linalg.solve(
            (z * (weight * p * (1 - p))[:, None]).T @ z + ridge, z.T @ (weight * (p - y)) + ridge @ w
        )
        w -= step / max(1.0, float(np.abs(step).max()))
    return np.concatenate([[w[0] - (w[1:] / spread) @ mean], w[1:] / spread])
