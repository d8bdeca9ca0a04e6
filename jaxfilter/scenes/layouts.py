"""What stands in a scene: the layout, its admissible values, and the ready ones by name."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any

import numpy as np

from ..core.errors import ParameterError
from ..core.params import check_fields, param, static


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
    WALL = 8  # facades, free-standing walls and weirs
    WATER = 9


ASPRS = np.array([2, 6, 17, 1, 3, 5, 7, 18, 1, 9], np.uint8)
"""ASPRS class of each :class:`Kind` (LAS 1.4, table 17; cars, boats and walls have none and are class 1)."""


@dataclasses.dataclass(frozen=True)
class SceneLayout:
    """Terrain and objects of a scene; zero leaves a thing out.

    Linear features (cutting, scarp, river, cliffs, embankment) and pits recur every 520 m across a common meandering course,
    bridges every 220 m along it, so every scene of about that size has them, and a larger one has more. Lengths in metres,
    shares and probabilities from 0 to 1. Raises: ParameterError for a value out of range.

    >>> flat = jf.scenes.SceneLayout(relief=0.0, forest=0.0)
    >>> jf.scenes.make(flat, size=20, density=1)
    Scene(399 points on 20 x 20 m, 83.7 % ground, seed 0)
    """

    relief: float = param("height range of the landforms: four standard deviations", ">= 0 and <= 3000 m", default=10.0)
    landform: float = param("size of the largest landforms, to a power of two", ">= 16 and <= 8192 m", default=256.0)
    hurst: float = param("Hurst exponent: detail shrinks by 2**-hurst per scale", ">= 0.3 and <= 2", default=1.0)
    ridges: float = param("how far landforms are folded into sharp ridges", ">= 0 and <= 1", default=0.0)
    tilt: float = param("general slope, rise over run", ">= 0 and <= 1.5", default=0.0)
    scarp: float = param("height of scarps", ">= 0 and <= 60 m", default=0.0)
    terraces: float = param("height of terrace steps on open land", ">= 0 and <= 20 m", default=0.0)
    pit: float = param("depth of open pits, worked in benches", ">= 0 and <= 100 m", default=0.0)
    river: float = param("width of rivers and arms of the sea", ">= 0 and <= 490 m", default=0.0)
    lake: float = param("radius of lakes and ponds; from 40 m on an islet is in them", ">= 0 and <= 120 m", default=0.0)
    quay: bool = static("whether rivers have upright banks", default=False)
    water_echoes: float = param(
        "share of the pulses straight down that water returns, fewer at an angle; 0 for none at all; not between rock faces",
        ">= 0 and <= 1",
        default=0.0,
    )
    boats: float = param("share of 12 m cells on water with a boat", ">= 0 and <= 1", default=0.0)
    reeds: float = param("share of shallow water under reeds, 0.3 to 2 m high", ">= 0 and <= 1", default=0.0)
    weir: bool = static("whether weirs, 1 m high, cross the rivers", default=False)
    cliff: float = param("height of rock faces on both sides of a valley floor", ">= 0 and <= 150 m", default=0.0)
    face: float = param("slope of rock faces", ">= 40 and <= 85 deg", default=72.0)
    floor: float = param("width between the feet of rock faces, around the river", ">= 1 and <= 500 m", default=20.0)
    bench: float = param("height of benches in rock faces; 0 for sheer ones", ">= 0 and <= 30 m", default=0.0)
    ditches: float = param("depth of ditches on open land", ">= 0 and <= 3 m", default=0.0)
    embankment: float = param("height of embankments", ">= 0 and <= 12 m", default=0.0)
    cutting: float = param("depth of road cuttings", ">= 0 and <= 12 m", default=0.0)
    road: float = param("width of roads on the level of the land that bridges cross", ">= 0 and <= 60 m", default=0.0)
    bridges: bool = static("whether bridges cross the cuttings, roads and rivers", default=True)
    bridge_width: float = param("width of decks", ">= 1 and <= 60 m", default=10.0)
    bridge_skew: float = param("angle between decks and the square to the course", ">= 0 and <= 60 deg", default=0.0)
    bridge_rise: float = param("height of the ends of decks above the land, on ramps", ">= 0 and <= 12 m", default=0.0)
    jetty: float = param("length of jetties from the banks of rivers", ">= 0 and <= 100 m", default=0.0)
    causeway: bool = static("whether low dams, which are ground, cross the rivers instead of decks", default=False)
    settlement: float = param("share of the area that is built up", ">= 0 and <= 1", default=0.0)
    houses: float = param("weight of quarters with detached houses, 7 to 15 m", ">= 0", default=1.0)
    rows: float = param("weight of quarters with rows of houses, 25 to 42 m", ">= 0", default=1.0)
    blocks: float = param("weight of quarters with blocks around courtyards, 32 to 44 m", ">= 0", default=0.0)
    towers: float = param("weight of quarters with towers, 16 to 26 m, up to 60 m high", ">= 0", default=0.0)
    halls: float = param("weight of quarters with one hall, 45 to 80 m", ">= 0", default=0.5)
    parks: float = param("weight of quarters left to trees", ">= 0", default=0.5)
    cars: float = param("share of the kerbside parking places that are taken", ">= 0 and <= 1", default=0.25)
    walls: float = param("share of house plots with walls", ">= 0 and <= 1", default=0.3)
    forest: float = param("share of the open land under forest", ">= 0 and <= 1", default=0.1)
    trees: float = param("share of 5 m cells with a tree outside forests", ">= 0 and <= 1", default=0.02)
    conifers: float = param("share of trees that are conifers", ">= 0 and <= 1", default=0.3)
    penetration: float = param("probability of an echo below a crown that was hit", ">= 0 and <= 1", default=0.35)
    low_vegetation: float = param("share of the open land under shrubs and tall grass", ">= 0 and <= 1", default=0.1)
    vines: float = param("share of terraced land under vines", ">= 0 and <= 1", default=0.0)
    scan_angle: float = param("angle of beams off the vertical at a strip's edge", ">= 0 and <= 30 deg", default=0.0)
    low_clusters: float = param("clusters of low outliers, 3 to about 120 points", ">= 0 and <= 200 1/km2", default=0.0)
    low_outliers: float = param("share of pulses with a lone echo 2 to 30 m too low", ">= 0 and <= 0.1", default=0.0)
    high_outliers: float = param("share of pulses with an echo 20 to 1000 m too high", ">= 0 and <= 0.1", default=0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.settlement > 0 and not sum(self.quarters()) > 0:
            kinds = "houses, rows, blocks, towers, halls, parks"
            raise ParameterError(f"SceneLayout(settlement={self.settlement!r}): one of {kinds} must be > 0")

    def quarters(self) -> tuple[float, ...]:
        """Weights of the kinds of quarter, in the order houses, rows, blocks, towers, halls, parks.

        >>> jf.scenes.SceneLayout(houses=2.0).quarters()[0]
        2.0
        """
        return self.houses, self.rows, self.blocks, self.towers, self.halls, self.parks


_WIDE: dict[str, Any] = {"landform": 128, "hurst": 1.2}
_STRAY: dict[str, Any] = {"low_clusters": 15.0, "low_outliers": 2e-5, "high_outliers": 1e-5}


def _ready(**fields: Any) -> SceneLayout:
    return SceneLayout(**_STRAY | fields)


LAYOUTS: dict[str, SceneLayout] = {
    "flat": _ready(relief=1.5, ditches=1.2, settlement=0.15, rows=0.3, halls=0.3, parks=0.1, forest=0.03),
    "town": _ready(relief=8, hurst=1.2, cutting=6, settlement=0.9, blocks=0.5, halls=0.6, forest=0.3, trees=0.035),
    "city": _ready(
        relief=4, river=28, settlement=1.0, houses=0.2, rows=0.4, blocks=3, towers=0.8, halls=0.8, parks=0.5, cars=0.5,
        trees=0.03, low_vegetation=0.03, low_clusters=40.0, low_outliers=5e-5, high_outliers=2e-5
    ),
    "hills": _ready(
        relief=60, **_WIDE, tilt=0.05, cutting=7, scarp=5, settlement=0.25, halls=0.15, parks=0.2, forest=0.35
    ),
    "mountain": _ready(
        relief=260, landform=512, hurst=0.85, ridges=0.8, tilt=0.2, scarp=15, forest=0.35, conifers=0.9, trees=0.01,
        low_vegetation=0.08
    ),
    "forest": _ready(
        relief=25, ditches=0.8, forest=0.93, trees=0.1, conifers=0.5, penetration=0.25, low_vegetation=0.3
    ),
    "quarry": _ready(relief=30, hurst=1.15, pit=42, scarp=6, forest=0.25, trees=0.01),
    "terraces": _ready(
        relief=45, landform=128, hurst=1.4, tilt=0.12, terraces=3, settlement=0.1, rows=0, halls=0, parks=0,
        forest=0.08, trees=0.03
    ),
    "mixed": _ready(
        relief=26, hurst=1.25, scarp=6, terraces=2.5, pit=26, river=18, ditches=1, embankment=4, cutting=6,
        settlement=0.7, blocks=0.6, towers=0.2, forest=0.35
    ),
    "benchmark": _ready(
        relief=45, **_WIDE, scarp=5, river=16, embankment=4, cutting=6, settlement=0.35, blocks=0.3, forest=0.2,
        trees=0.015, low_vegetation=0.08, low_clusters=5.0, low_outliers=5e-6, high_outliers=2e-6
    ),
    "coast": _ready(
        relief=9, landform=128, river=446, cliff=42, face=74, floor=458, bridges=False, settlement=0.1, rows=0,
        halls=0.2, forest=0.05, scan_angle=15
    ),
    "gorge": _ready(relief=24, **_WIDE, river=9, cliff=58, face=68, floor=26, forest=0.4, trees=0.03, scan_angle=15),
    "benches": _ready(
        relief=16, **_WIDE, cliff=50, face=70, floor=40, bench=12.5, bridges=False, forest=0.3, trees=0.02,
        scan_angle=15
    ),
    "vineyard": _ready(relief=18, landform=128, hurst=1.4, tilt=0.45, terraces=1.8, vines=0.8, forest=0.08, trees=0.01),
    "canopy": _ready(relief=24, **_WIDE, forest=0.75, trees=0.03, conifers=0.4, penetration=0.1),
}  # fmt: skip
"""Ready layouts. ``benchmark``, for timings, is at least half ground at any size; ``mixed`` has everything."""
