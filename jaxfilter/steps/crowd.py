"""Points so dense that a few of them stand for all: these make the ground, and the others are only held against it."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from ..core.filter import Labels
from ..core.points import Points, has_area
from ..engines.tin.ground import GroundTin

_SIDE = 0.25
"""Metres: the squares for which a point stands, where they hold two or more in the mean. As a power of two of the quantum it
holds points that follow each other."""
_SHEET = 0.2
"""Metres that the lowest sheet of a square is thick at most: noise of a few centimetres, upward and downward."""


class Crowd(NamedTuple):
    """Points, some of which stand for all.

    Attributes:
        every: the points, m of them; points: those that stand for others.
        rows: i64[s], which of ``every`` these are. own: i32[m], which of these stands for each of ``every``.
    """

    every: Points
    points: Points
    rows: np.ndarray
    own: np.ndarray

    @classmethod
    def from_points(cls, points: Points) -> Crowd | None:
        """None where all points stand for themselves, else one of each square of 0.25 m: from the middle of its lowest sheet,
        since the lowest of many lies below the ground. All do where these lie on a line.

        Squares count from the anchor, so tiles of a survey have the same.
        """
        if 2 * points.spacing() ** 2 >= _SIDE**2:
            return None
        from ..engines.sheets import middles  # imports Numba

        rows, own = np.empty(len(points), np.int64), np.empty(len(points), np.int32)
        rows = rows[: middles(points.xyz, np.float32(_SIDE), np.float32(_SHEET), rows, own)].copy()
        if not has_area(points.xyz[rows]):
            return None
        weight = np.bincount(own).astype(np.int32)
        few = dataclasses.replace(points, xyz=points.xyz[rows], member=own[points.member], weight=weight)
        return cls(points, few, rows, own)

    def labels(self, ground: GroundTin, low: np.ndarray, depth: float) -> Labels:
        """The labels of all points by the ground of those that stand for them, grown and with its rule as it is.

        The others are tested once, by the limits of the points that stand for them. ``low``: bool[s], points that are barred,
        and so are those that they stand for up to ``depth`` metres above them.
        """
        near = np.flatnonzero(self.every.near_core(0.0))
        found = ground.over(self.every.xyz[near], self.own[near])
        known: dict[str, Any] = {}
        for name, values in found.items():
            known[name] = np.zeros(len(self.own), values.dtype)
            known[name][near], known[name][self.rows] = values, getattr(ground, name)
        barred = low[self.own] & (self.every.xyz[:, 2] < (self.points.xyz[:, 2] + np.float32(depth))[self.own])
        return Labels(**known, barred=barred)
