"""Cells of water, on a lattice that counts from the anchor of a cloud, so that the parts of a scene share it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from .cloud import PointCloud


@dataclasses.dataclass(frozen=True, eq=False)
class WaterCells:
    """Where water is in a cloud, also where it returned nothing.

    Attributes:
        side: of a cell, metres. at: i32[k, 2], rows and columns, each cell once, in order. The middle of a cell is so many sides
            north and east of the anchor.
        z: f64[k], elevation of the surface, metres.
    """

    side: float
    at: np.ndarray
    z: np.ndarray

    @classmethod
    def from_levels(cls, cloud: PointCloud, level: np.ndarray, corner: Iterable[float], side: float) -> Self:
        """Of elevations, local metres, NaN on land: f32[rows, columns], from a corner in the south-west, local metres."""
        row, column = np.nonzero(~np.isnan(level))
        lag = (cloud.origin[:2] - cloud.anchor) * cloud.units.xy + np.fromiter(corner, np.float64)
        first = np.rint(lag / side + 0.5).astype(np.int64)
        at = np.stack([row + first[1], column + first[0]], axis=1).astype(np.int32)
        return cls(side, at, cloud.origin[2] * cloud.units.z + level[row, column].astype(np.float64))

    def with_others(self, others: WaterCells) -> WaterCells:
        """These cells, and those of others with the same lattice that are not among them."""
        at, which = np.unique(np.concatenate([self.at, others.at]), axis=0, return_index=True)
        return WaterCells(self.side, at, np.concatenate([self.z, others.z])[which])
