"""What is varied: the thresholds of each method, their ranges, and the sets that every method is tried with.

A *set* is a choice of thresholds. All else is what ``for_cloud`` gives for the sample, that is the defaults, and what
follows from the point spacing. Set 0 is that fixed set, thresholds and all.
The others are the points of the Sobol sequence over the ranges of
:mod:`jaxfilter.sweeps.ranges`, so that every method is tried with the same number of sets,
and methods with as many thresholds with the same points of the unit cube.
"""

from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

from scipy.stats import qmc

import jaxfilter as jf
from experiments.report import read_csv
from jaxfilter.sweeps.ranges import search_ranges

SPACINGS = {row["sample"]: row["spacing"] for row in read_csv(Path(__file__).parent / "spacing.csv")}
"""Mean point spacing of the samples in metres, as ``for_cloud`` measures it; kept so that no cloud need be read for it."""

FAMILY = ("ptd", "atin", "iptd", "fptd", "spf", "agptd", "stin", "ptdf", "ppdf", "msf", "pmf", "smrf", "csf")
"""Order in tables: methods on triangulations, on planes, on grids, cloth."""


def method_names() -> list[str]:
    """Every filter of the library: those of :data:`FAMILY` in its order, then others."""
    return [name for name in FAMILY if name in jf.FILTERS] + [name for name in jf.FILTERS if name not in FAMILY]


def fixed(method: str, sample: str) -> jf.Filter:
    """The method as ``for_cloud(cloud)`` gives it for a sample such as "samp11"."""
    cls = jf.FILTERS[method]
    return cls(**cls.from_spacing(SPACINGS[sample], None))


def matched(method: str, sample: str) -> jf.Filter:
    """The fixed set of a method with the limits of angle and distance that the fixed set of PTD has.

    Defaults differ between methods; with these the comparison with PTD is one of the methods, not of their limits.
    """
    filter_, classic = fixed(method, sample), fixed("ptd", sample)
    names = {f.name for f in dataclasses.fields(filter_)}
    return filter_.replace(**{name: getattr(classic, name) for name in ("max_angle", "max_distance") if name in names})


def sets(method: str, budget: int) -> list[dict[str, float]]:
    """The thresholds of each of ``budget`` sets; that of set 0 is empty: the fixed set as it is."""
    ranges = search_ranges(jf.FILTERS[method])
    if budget == 1 or not ranges:
        return [{}]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # no power of two many: their balance is not needed
        unit = qmc.Sobol(len(ranges), scramble=False).fast_forward(1).random(budget - 1)
    return [{}, *({name: r.at(u) for u, (name, r) in zip(row, ranges.items(), strict=True)} for row in unit)]
