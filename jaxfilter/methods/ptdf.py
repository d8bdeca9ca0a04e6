"""PTDF: progressive TIN densification with the settings of a ground routine that works upward only (Cai et al. 2023)."""

from __future__ import annotations

from typing import ClassVar

from ..core.params import Preset, filter_params, param
from .papers import bibtex
from .ptd import PTD


@filter_params
class PTDF(PTD):
    """Progressive TIN densification, upward only: a model of the comparator of Cai et al. (2023).

    S. Cai, X. Liang, S. Yu (2023) compare their filter with the ground routine of TerraSolid, which they name PTDF: seed
    window 10 m, terrain angle 88 degrees, iteration angle 15 degrees, iteration distance 1.5 m. The program is closed. It
    builds on Axelsson (2000), so this is :class:`PTD` with those settings and one more test: a point further below its
    facet than ``max_below`` is rejected, since they say that the routine works upward and adds no points below the
    surface. Lengths in metres, angles in degrees.

    Presets: "recommended" is the default, with seed cells as large as the largest building; a window of 10 m, as in
    "paper", is for forest without large buildings. "paper" also leaves out the search for low clusters, and its simulated
    border points keep their first elevation.

    Departure (docs/filters/ptdf.md): how far below the surface a point may lie is not printed; 0.1 m is ours.

    >>> upward, both = (filter_(cloud).ground.sum() for filter_ in (jf.PTDF(), jf.PTD(max_distance=1.5)))
    >>> bool(upward < both)
    True
    """

    max_distance: float = 1.5
    max_rounds: int = 200
    max_below: float = param("a point is rejected if it lies more than this below its facet", "> 0 m", default=0.1)

    BIBTEX: ClassVar[str] = bibtex("axelsson2000dem", "cai2023progressive")
    PRESETS: ClassVar[dict[str, Preset]] = {
        "recommended": Preset(
            "the default: seed cells as large as the largest building, clusters of low points are barred, border points "
            "follow the ground"
        ),
        "paper": Preset(
            "as printed (window 10 m, terrain angle 88, iteration angle 15, iteration distance 1.5 m), except that the "
            "program is closed: PTD that works upward, with a tolerance of 0.1 m",
            seed_cell=10.0,
            low_clusters=False,
            refresh_border=False,
        ),
    }
