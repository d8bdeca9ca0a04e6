"""What defaults are chosen on: simulated scenes, and labelled tiles that no table of results has."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import jaxfilter as jf
from jaxfilter import scenes

SIZES = {0.1: (640.0, 480.0), 0.3: (480.0, 360.0), 1.0: (320.0, 240.0), 4.0: (240.0, 180.0), 15.0: (160.0, 120.0)}
"""Extents in metres by density in pulses per square metre."""
SEED = 101
LAYOUTS = ("flat", "town", "city", "hills", "mountain", "forest", "quarry", "terraces", "mixed", "benchmark")
"""Layouts that defaults are chosen on; the others of ``scenes.LAYOUTS`` are kept for testing."""
TILES = (
    "amsterdam_ahn_2386", "amsterdam_ahn_2397", "geo1101_Biesbosch_manual", "ign_77050_627755", "ign_77060_627760",
    "ign_bridge_0299_6802", "ign_mnx_crop_2", "lasR_bcts_2", "lastools_house", "lff_2_67", "lff_2_bas_lig",
    "zf_wassenaar_ahn3",
)  # fmt: skip
"""The labelled tiles but those of ``experiments/tiles``, which are kept for testing."""
LEFT_OUT = (0, 7, 9, 12, 18, 26, 65, 66, 67)
"""Classes that are neither ground nor object; they are not scored."""


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """A cloud whose ground is known. ``group``: what means are taken over; ``scored``: bool[n]."""

    name: str
    group: str
    cloud: jf.PointCloud
    ground: np.ndarray
    scored: np.ndarray


def names(layouts: Sequence[str] = LAYOUTS) -> list[tuple[str, str, str | float]]:
    """Group, name, and density of a scene, or file name of a tile, of all clouds that defaults are chosen on."""
    every: list[tuple[str, str, str | float]] = [
        (f"{density:g} per m2", layout, density) for density in SIZES for layout in layouts
    ]
    return every + [("tiles", tile, tile) for tile in TILES]


def load(group: str, name: str, what: str | float, folder: Path) -> Known | None:
    """One of :func:`names`. None if it is a tile that is not in ``folder``.

    Of scenes last echoes are filtered and scored, as in the ISPRS samples; of tiles all echoes.
    """
    if isinstance(what, float):
        scene = scenes.make(name, size=SIZES[what], density=what, seed=SEED)
        return Known(name, group, scene.cloud, scene.truth, scene.cloud.candidate)
    path = next((folder / "tiles").glob(f"{what}.la[sz]"), None)
    return None if path is None else tile(name, group, path)


def tile(name: str, group: str, path: Path) -> Known:
    """A labelled tile. Noise apart it is filtered as a whole: what its producer classified as water, bridge or artefact is a
    candidate like any other."""
    cloud = jf.read(path, units="m", returns="all", ignore_classes=(7, 18))
    assert cloud.classification is not None
    return Known(name, group, cloud, cloud.classification == 2, ~np.isin(cloud.classification, LEFT_OUT))


def clouds(folder: Path, wanted: Sequence[tuple[str, str, str | float]]) -> Iterator[Known]:
    """The clouds of these names that are at hand."""
    for group, name, what in wanted:
        known = load(group, name, what, folder)
        if known is not None:
            yield known
