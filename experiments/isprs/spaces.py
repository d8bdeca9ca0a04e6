"""What is varied: the thresholds of each method, their ranges, and the sets that every method is tried with.

A *set* is a choice of thresholds. All else, such as grid cells and the size of the largest building, follows from the
point spacing and :data:`LARGEST_BUILDING` by the method's ``from_spacing``. Set 0 is that fixed set, thresholds and all.
The others are the points of the Sobol sequence over the ranges of
:mod:`jaxfilter.sweeps.ranges`, so that every method is tried with the same number of sets,
and methods with as many thresholds with the same points of the unit cube.
"""

from __future__ import annotations

import dataclasses
import warnings

from scipy.stats import qmc

import jaxfilter as jf
from jaxfilter.sweeps.ranges import search_ranges

LARGEST_BUILDING = 60.0
"""Metres; the size that Li et al. (2021) give for all ISPRS sites."""
SPACINGS = {"urban": 1.25, "rural": 2.75}
"""Nominal point spacing in metres: middle of 1 to 1.5 m (samples 11 to 42) and of 2 to 3.5 m (51 to 71)."""

FAMILY = ("ptd", "atin", "iptd", "fptd", "spf", "agptd", "stin", "ptdf", "ppdf", "msf", "pmf", "smrf", "csf")
"""Order in tables: methods on triangulations, on planes, on grids, cloth."""


def method_names() -> list[str]:
    """Every filter of the library: those of :data:`FAMILY` in its order, then others."""
    return [name for name in FAMILY if name in jf.FILTERS] + [name for name in jf.FILTERS if name not in FAMILY]


def spacing(sample: str) -> float:
    """Nominal spacing of a sample such as "samp11", metres."""
    return SPACINGS["urban" if sample.removeprefix("samp") < "50" else "rural"]


def fixed(method: str, sample: str) -> jf.Filter:
    """The method with the one set of parameters that point spacing and largest building give."""
    cls = jf.FILTERS[method]
    return cls(**cls.from_spacing(spacing(sample), LARGEST_BUILDING))


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
