"""Clouds that are cut at a random place: what is found along the cut, against what is found there in the whole cloud."""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np

import jaxfilter as jf
from experiments.defaults.clouds import Known
from experiments.report import Row
from jaxfilter.surveys.tiles import part_of

RIM = 20.0
"""Metres along the cut that are looked at."""
OFF, NEAR = 1.0, 3.0
"""Metres that a cell is off by, and metres from ground of the reference within which cells count."""
LEAST, SHARE = 1000, (0.2, 0.9)
"""Points, and shares of the points, that are left."""


class Cut(NamedTuple):
    """What is left of a cloud: half a plane, or a square whose half side is ``half`` metres, turned by ``turn``."""

    square: bool
    middle: np.ndarray
    turn: float
    half: float

    def inward(self, xy: np.ndarray) -> np.ndarray:
        """f64[n]: metres from the cut to positions f64[n, 2], negative for those that are cut off."""
        (x, y), c, s = (xy - self.middle).T, np.cos(self.turn), np.sin(self.turn)
        along, across = c * x + s * y, c * y - s * x
        return self.half - np.maximum(np.abs(along), np.abs(across)) if self.square else along


def drawn(name: str, xy: np.ndarray, count: int) -> list[Cut]:
    """The first cuts of a cloud, the same for all methods. ``xy``: f64[n, 2]."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    side = min(float(np.ptp(xy, axis=0).min()), 300.0)
    found: list[Cut] = []
    while len(found) < count:
        middle, turn, half = xy[rng.integers(len(xy))], rng.uniform(0, 2 * np.pi), side * rng.uniform(0.2, 0.4)
        cut = Cut(bool(rng.random() < 0.5), middle, turn, half)
        left = np.count_nonzero(cut.inward(xy) >= 0)
        if left >= LEAST and (cut.square or SHARE[0] <= left / len(xy) <= SHARE[1]):
            found.append(cut)
    return found


def rows(known: Known, method: str, count: int) -> list[Row]:
    """A row for each cut: cells and points within :data:`RIM` of it, how many are off or wrong, and how many of these were
    right in the whole. Without a reference the result of the whole takes its place."""
    cloud, xy = known.cloud, known.cloud.coordinates()[:, :2]
    whole = jf.FILTERS[method].for_cloud(cloud)(cloud).ground
    reference = known.ground if known.ground.any() else whole
    truth = jf.dtm(cloud, reference, max_gap=NEAR, fill=True)
    before = jf.dtm(cloud, whole, fill=True).values
    found = []
    for number, cut in enumerate(drawn(known.name, xy, count)):
        inward = cut.inward(xy)
        left = np.flatnonzero(inward >= 0)
        row: Row = {"cloud": known.name, "kind": known.group, "method": method, "cut": number, "points": len(left)}
        part = part_of(cloud, left)
        ground = jf.FILTERS[method].for_cloud(part)(part).ground
        try:
            model = jf.dtm(part, ground, fill=True)
        except jf.InputError as error:  # hardly any ground
            found.append(row | {"status": str(error)})
            continue
        x, y = np.meshgrid(*model.centres())
        rim = cut.inward(np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
        top, first = round(truth.transform[5] - model.transform[5]), round(model.transform[2] - truth.transform[2])
        there = np.s_[top : top + x.shape[0], first : first + x.shape[1]]
        seen = (rim > 0) & (rim <= RIM) & np.isfinite(truth.values[there])
        now, then = (model.values - truth.values[there])[seen], (before[there] - truth.values[there])[seen]
        spoiled = (np.abs(now) > OFF) & (np.abs(then) <= OFF)
        row |= {
            "cells": now.size, "off": int((np.abs(now) > OFF).sum()), "off_whole": int((np.abs(then) > OFF).sum()),
            "spoiled": int(spoiled.sum()), "spoiled_high": int((now[spoiled] > 0).sum()),
        }  # fmt: skip
        judged = known.scored[left] & (inward[left] <= RIM)
        now_wrong, then_wrong = (
            (labels != reference[left])[judged] for labels in (ground, whole[left])
        )  # fmt: skip
        found.append(row | {
            "rim_points": int(judged.sum()), "wrong": int(now_wrong.sum()), "wrong_whole": int(then_wrong.sum()),
            "spoiled_points": int((now_wrong & ~then_wrong).sum()), "status": "",
        })  # fmt: skip
    return found
