"""What is measured of the labels that a method gives a cloud: errors, cuts, named places, water and decks."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import partial

import numpy as np

import jaxfilter as jf
from experiments.report import Row
from experiments.scenes import water
from experiments.scenes.clouds import FILLED, Site
from jaxfilter.reports import places as named
from jaxfilter.surveys.tiles import part_of
from jaxfilter.terrain.accuracy import OFF, differences

COUNT, RIM = 2, 20.0
"""Cuts of a cloud; metres along a cut that are looked at."""
FAR_OFF, NEAR = 1.0, 3.0
"""Metres that a cell at a cut is off by, and metres from ground of the reference within which cells count."""
LEAST, SHARE = 1000, (0.2, 0.9)
"""Points, and shares of the points, that are left by a cut."""
FIGURES = ("rmse", "p95", "off", "off_1m", "low", "high_1m", "low_1m", "border_off_1m", "inside_off_1m")
"""Of terrain errors, those that are kept."""


def errors(site: Site, method: str, result: jf.FilterResult) -> list[Row]:
    """Scores, terrain errors on cells of 1 m, and what share of each part of the cloud is ground, percent."""
    truth, ground = site.ground, result.ground
    row: Row = {"points": len(ground)} | {name: 100 * float(ground[part].mean()) for name, part in site.parts.items()}
    if not truth.any():
        return [row | {"called": 100 * float(ground[site.scored].mean())}]
    scores = jf.evaluate(result, truth, ignore=~site.scored)
    row |= {key: getattr(scores, key) for key in ("total", "kappa", "type1", "type2")}
    cloud = site.cloud
    if site.beside is not None:
        cloud = jf.PointCloud.from_arrays(np.concatenate([cloud.coordinates(), site.beside]))
        more = np.zeros(len(site.beside), bool)
        truth, ground = np.concatenate([truth & False, ~more]), np.concatenate([ground, more])
    try:
        found = jf.dtm_rmse(cloud, ground, truth, interpolation=FILLED, near=NEAR).as_dict()
    except jf.InputError as error:  # hardly any ground
        return [row | {"status": str(error)}]
    return [row | {key: found[key] for key in FIGURES}]


def drawn(name: str, xy: np.ndarray, count: int) -> list[Callable[[np.ndarray], np.ndarray]]:
    """The first cuts of a cloud, the same for all methods: half planes and turned squares. Each gives f64[n], metres inward of
    positions f64[n, 2], negative for those that are cut off."""
    rng, found = np.random.default_rng(zlib.crc32(name.encode())), []
    side = min(float(np.ptp(xy, axis=0).min()), 300.0)
    while len(found) < count:
        middle, turn, half = xy[rng.integers(len(xy))], rng.uniform(0, 2 * np.pi), side * rng.uniform(0.2, 0.4)
        square = bool(rng.random() < 0.5)
        inward = partial(inside, middle=middle, turn=turn, half=half if square else None)
        left = np.count_nonzero(inward(xy) >= 0)
        if left >= LEAST and (square or SHARE[0] <= left / len(xy) <= SHARE[1]):
            found.append(inward)
    return found


def inside(xy: np.ndarray, middle: np.ndarray, turn: float, half: float | None) -> np.ndarray:
    """f64[n]: metres to the outline of half a plane, or of a square whose half side is ``half`` metres."""
    (x, y), c, s = (xy - middle).T, np.cos(turn), np.sin(turn)
    along, across = c * x + s * y, c * y - s * x
    return along if half is None else half - np.maximum(np.abs(along), np.abs(across))


def cuts(site: Site, method: str, result: jf.FilterResult) -> list[Row]:
    """A row for each cut: cells within :data:`RIM` of it, how many are off, and how many of these were right in the whole."""
    cloud, xy, whole = site.cloud, site.cloud.coordinates()[:, :2], result.ground
    truth = jf.dtm(cloud, site.ground, max_gap=NEAR, fill=True)
    before = jf.dtm(cloud, whole, fill=True).values
    found = []
    for number, cut in enumerate(drawn(site.name, xy, COUNT)):
        left = np.flatnonzero(cut(xy) >= 0)
        part = part_of(cloud, left)
        ground = jf.FILTERS[method].for_cloud(part)(part, workers=1).ground
        model = jf.dtm(part, ground, fill=True)
        x, y = np.meshgrid(*model.centres())
        rim = cut(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
        top, first = round(truth.transform[5] - model.transform[5]), round(model.transform[2] - truth.transform[2])
        there = np.s_[top : top + x.shape[0], first : first + x.shape[1]]
        seen = (rim > 0) & (rim <= RIM) & np.isfinite(truth.values[there])
        now, then = (np.abs(heights - truth.values[there])[seen] > FAR_OFF for heights in (model.values, before[there]))
        counts = {"off": now, "off_whole": then, "spoiled": now & ~then}
        found.append({"cut": number, "cells": now.size} | {key: int(values.sum()) for key, values in counts.items()})
    return found


def places(site: Site, method: str, result: jf.FilterResult) -> list[Row]:
    """What the named places of a cloud hold: square metres that are off, and named; places; cubic metres. A place is right if
    some cell of 1 m in it is off by more than half a metre; those without a cell near reference ground are not judged."""
    cloud, side = site.cloud, named.SIDE / site.cloud.units.xy
    listed = named.places_of([named.find_suspects(cloud, result)], cloud.units.xy)
    found = differences(cloud, result, site.ground, 1.0 / cloud.units.xy, FILLED, near=NEAR, rim=RIM)
    row, column = np.nonzero(np.isfinite(found.metres))
    size, grid = np.abs(found.metres[row, column]), found.grid
    x, y = (grid.left + column + 0.5) * grid.cell, (grid.bottom + grid.rows - row - 0.5) * grid.cell
    at = np.floor(np.stack([x, y], axis=1) / side).astype(np.int64)
    off = size > OFF
    of = {cell: k for k, place in enumerate(listed) for cell in map(tuple, place.cells.tolist())}
    place = np.array([of.get(cell, -1) for cell in map(tuple, at.tolist())], np.int64)
    held = place >= 0
    judged, wrong = (np.bincount(place[held], w, len(listed)) for w in (None, off[held]))
    expected = sum(one.volume * n / one.area for one, n in zip(listed, judged.tolist(), strict=True))
    return [{
        "off": int(off.sum()), "off_named": int(off[held].sum()), "named": int(held.sum()), "judged": int((judged > 0).sum()),
        "right": int((wrong > 0).sum()), "tenth": int(((wrong >= 0.1 * judged) & (wrong > 0)).sum()),
        "volume": float(expected), "volume_true": float(size[held].sum()),
    }]  # fmt: skip


def areas(site: Site, method: str, result: jf.FilterResult) -> list[Row]:
    """Of scenes F1 of decks and water by area, m2 that are neither, and cells of 1 m that are off (water without echoes has no
    surface to hold it to). Of tiles how many points have classes 9 and 17, how many are marked, and how many are both."""
    row: Row = {}
    if (place := site.area) is None:
        for name, number in (("water", 9), ("deck", 17)):
            own, marked = site.cloud.classification == number, getattr(result, name)
            row |= {f"{name}_points": int(own.sum()), f"{name}_marked": int(marked.sum())}
            row[f"{name}_both"] = int((marked & own).sum())
        return [row]
    marked = np.zeros(len(place.cloud), bool) if result.deck is None else result.deck
    deck = water.nearest(place.cloud, marked, place.x, place.y, 1.5 * place.spacing)
    wet = np.zeros(len(place.x), bool)
    if (cells := result.water_cells) is not None:
        at = np.column_stack([place.y, place.x]) - place.cloud.anchor[::-1]
        index = np.floor(at / cells.side + 0.5).astype(np.int64) @ [1 << 32, 1]
        wet = np.isin(index, cells.at.astype(np.int64) @ [1 << 32, 1])
    for name, area, truth in (("deck", deck, place.deck), ("water", wet, place.water)):
        row |= {f"{name}_f1": water.by_area(area, truth)["f1"], f"{name}_wrong": int((area & ~truth).sum())}
    model = jf.dtm(place.cloud, result, 1.0)
    x, y = model.centres()
    off = model.values[np.rint(y[0] - place.y).astype(int), np.rint(place.x - x[0]).astype(int)] - place.terrain
    known = np.isfinite(off) & np.isfinite(place.terrain)
    return [row | {"off": 100 * float((np.abs(off[known]) > OFF).mean())}]


MEASURES: dict[str, Callable[[Site, str, jf.FilterResult], list[Row]]] = {
    "errors": errors, "cuts": cuts, "places": places, "water": areas,
}  # fmt: skip
"""By the name of the file that holds their rows."""
