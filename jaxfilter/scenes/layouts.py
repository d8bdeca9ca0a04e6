"""What stands in a scene: the layout, its admissible values, and the ready ones by name."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import numpy as np

from ..core.errors import ParameterError
from ..core.params import check_fields, param


class Kind(enum.IntEnum):
    """What a point was reflected by.

    >>> jf.scenes.Kind(int(scene.kind[truth][0])).name
    'GROUND'
    """

    GROUND = 0
    BUILDING = 1
    BRIDGE = 2
    CAR = 3
    LOW_VEGETATION = 4
    HIGH_VEGETATION = 5
    LOW_OUTLIER = 6
    HIGH_OUTLIER = 7
    WALL = 8  # facades and free-standing walls


ASPRS = np.array([2, 6, 17, 1, 3, 5, 7, 18, 1], np.uint8)
"""ASPRS class of each :class:`Kind` (LAS 1.4, table 17; cars and walls have none and are class 1)."""


@dataclasses.dataclass(frozen=True)
class Layout:
    """Terrain and objects of a scene; zero leaves a thing out.

    Linear features (cutting, scarp, river, embankment) and pits recur every 520 m across a common meandering course,
    bridges every 220 m along it, so every scene of about that size has them, and a larger one has more. Lengths in metres,
    shares and probabilities from 0 to 1. Raises: ParameterError for a value out of range.

    >>> flat = jf.scenes.Layout(relief=0.0, forest=0.0)
    >>> jf.scenes.make(flat, size=20, density=1)
    Scene(399 points on 20 x 20 m, 83.7 % ground, seed 0)
    """

    relief: float = param(
        default=10.0, unit="m", ge=0, le=3000, doc="height range of the landforms: four standard deviations"
    )
    landform: float = param(
        default=256.0, unit="m", ge=16, le=8192, doc="size of the largest landforms, to a power of two"
    )
    hurst: float = param(
        default=1.0, ge=0.3, le=2, doc="Hurst exponent: detail shrinks by 2**-hurst from scale to scale"
    )
    ridges: float = param(default=0.0, ge=0, le=1, doc="how far landforms are folded into sharp ridges")
    tilt: float = param(default=0.0, ge=0, le=1.5, doc="general slope, rise over run")
    scarp: float = param(default=0.0, unit="m", ge=0, le=60, doc="height of scarps")
    terraces: float = param(default=0.0, unit="m", ge=0, le=20, doc="height of terrace steps on open land")
    pit: float = param(default=0.0, unit="m", ge=0, le=100, doc="depth of open pits, worked in benches")
    river: float = param(default=0.0, unit="m", ge=0, le=60, doc="width of rivers; water returns no echo")
    ditches: float = param(default=0.0, unit="m", ge=0, le=3, doc="depth of ditches on open land")
    embankment: float = param(default=0.0, unit="m", ge=0, le=12, doc="height of embankments")
    cutting: float = param(default=0.0, unit="m", ge=0, le=12, doc="depth of road cuttings")
    bridges: bool = dataclasses.field(default=True, metadata={"doc": "whether bridges cross the cuttings and rivers"})
    settlement: float = param(default=0.0, ge=0, le=1, doc="share of the area that is built up")
    houses: float = param(default=1.0, ge=0, doc="weight of quarters with detached houses, 7 to 15 m")
    rows: float = param(default=1.0, ge=0, doc="weight of quarters with rows of houses, 25 to 42 m")
    blocks: float = param(default=0.0, ge=0, doc="weight of quarters with blocks around courtyards, 32 to 44 m")
    towers: float = param(default=0.0, ge=0, doc="weight of quarters with towers, 16 to 26 m, up to 60 m high")
    halls: float = param(default=0.5, ge=0, doc="weight of quarters with one hall, 45 to 80 m")
    parks: float = param(default=0.5, ge=0, doc="weight of quarters left to trees")
    cars: float = param(default=0.25, ge=0, le=1, doc="share of the kerbside parking places that are taken")
    walls: float = param(default=0.3, ge=0, le=1, doc="share of house plots with walls")
    forest: float = param(default=0.1, ge=0, le=1, doc="share of the open land under forest")
    trees: float = param(default=0.02, ge=0, le=1, doc="share of 5 m cells with a tree outside forests")
    conifers: float = param(default=0.3, ge=0, le=1, doc="share of trees that are conifers")
    penetration: float = param(default=0.35, ge=0, le=1, doc="probability of an echo below a crown that was hit")
    low_vegetation: float = param(default=0.1, ge=0, le=1, doc="share of the open land under shrubs and tall grass")
    low_clusters: float = param(
        default=0.0, unit="1/km2", ge=0, le=200, doc="clusters of low outliers, 3 to about 120 points"
    )
    low_outliers: float = param(
        default=0.0, ge=0, le=0.1, doc="share of pulses with an isolated echo 2 to 30 m too low"
    )
    high_outliers: float = param(
        default=0.0, ge=0, le=0.1, doc="share of pulses with an echo 20 to 1000 m above the surface"
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if not isinstance(self.bridges, bool):
            raise ParameterError(f"Layout(bridges={self.bridges!r}): must be True or False")
        if self.settlement > 0 and not sum(self.quarters()) > 0:
            raise ParameterError(
                f"Layout(settlement={self.settlement!r}): one of houses, rows, blocks, towers, halls, parks must be > 0"
            )

    def quarters(self) -> tuple[float, ...]:
        """Weights of the kinds of quarter, in the order houses, rows, blocks, towers, halls, parks.

        >>> jf.scenes.Layout(houses=2.0).quarters()[0]
        2.0
        """
        return self.houses, self.rows, self.blocks, self.towers, self.halls, self.parks


_STRAY: dict[str, Any] = {"low_clusters": 15.0, "low_outliers": 2e-5, "high_outliers": 1e-5}

LAYOUTS: dict[str, Layout] = {
    "flat": Layout(relief=1.5, ditches=1.2, settlement=0.15, rows=0.3, halls=0.3, parks=0.1, forest=0.03, **_STRAY),
    "town": Layout(
        relief=8,
        hurst=1.2,
        cutting=6,
        settlement=0.9,
        blocks=0.5,
        halls=0.6,
        forest=0.3,
        trees=0.035,
        **_STRAY,
    ),
    "city": Layout(
        relief=4,
        river=28,
        settlement=1.0,
        houses=0.2,
        rows=0.4,
        blocks=3,
        towers=0.8,
        halls=0.8,
        parks=0.5,
        cars=0.5,
        trees=0.03,
        low_vegetation=0.03,
        low_clusters=40.0,
        low_outliers=5e-5,
        high_outliers=2e-5,
    ),
    "hills": Layout(
        relief=60,
        landform=128,
        hurst=1.2,
        tilt=0.05,
        cutting=7,
        scarp=5,
        settlement=0.25,
        halls=0.15,
        parks=0.2,
        forest=0.35,
        **_STRAY,
    ),
    "mountain": Layout(
        relief=260,
        landform=512,
        hurst=0.85,
        ridges=0.8,
        tilt=0.2,
        scarp=15,
        forest=0.35,
        conifers=0.9,
        trees=0.01,
        low_vegetation=0.08,
        **_STRAY,
    ),
    "forest": Layout(
        relief=25,
        ditches=0.8,
        forest=0.93,
        trees=0.1,
        conifers=0.5,
        penetration=0.25,
        low_vegetation=0.3,
        **_STRAY,
    ),
    "quarry": Layout(relief=30, hurst=1.15, pit=42, scarp=6, forest=0.25, trees=0.01, **_STRAY),
    "terraces": Layout(
        relief=45,
        landform=128,
        hurst=1.4,
        tilt=0.12,
        terraces=3,
        settlement=0.1,
        rows=0,
        halls=0,
        parks=0,
        forest=0.08,
        trees=0.03,
        **_STRAY,
    ),
    "mixed": Layout(
        relief=26,
        hurst=1.25,
        scarp=6,
        terraces=2.5,
        pit=26,
        river=18,
        ditches=1,
        embankment=4,
        cutting=6,
        settlement=0.7,
        blocks=0.6,
        towers=0.2,
        forest=0.35,
        **_STRAY,
    ),
    "benchmark": Layout(
        relief=45,
        landform=128,
        hurst=1.2,
        scarp=5,
        river=16,
        embankment=4,
        cutting=6,
        settlement=0.35,
        blocks=0.3,
        forest=0.2,
        trees=0.015,
        low_vegetation=0.08,
        low_clusters=5.0,
        low_outliers=5e-6,
        high_outliers=2e-6,
    ),
}
"""Ready layouts. ``benchmark``, for timings, is at least half ground at any size; ``mixed`` has everything."""
