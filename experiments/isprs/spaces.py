"""What is varied: the thresholds of each method, their ranges, and the sets that every method is tried with.

A *set* is a choice of thresholds. All else, such as grid cells and the size of the largest building, follows from the
point spacing and :data:`LARGEST_BUILDING` by the method's ``from_spacing``. Set 0 is that fixed set, thresholds and all.
The others are the points of the Sobol sequence over the ranges, so that every method is tried with the same number of sets,
and methods with as many thresholds with the same points of the unit cube.
"""

from __future__ import annotations

import dataclasses
import math
import warnings

from scipy.stats import qmc

import jaxfilter as jf

LARGEST_BUILDING = 60.0
"""Metres; the size that Li et al. (2021) give for all ISPRS sites."""
SPACINGS = {"urban": 1.25, "rural": 2.75}
"""Nominal point spacing in metres: middle of 1 to 1.5 m (samples 11 to 42) and of 2 to 3.5 m (51 to 71)."""

RANGES: dict[str, tuple[float, float, str]] = {
    "max_angle": (4.0, 45.0, "linear"),
    "max_distance": (0.3, 3.0, "log"),
    "max_elevation": (0.3, 3.0, "log"),
    "slope": (0.03, 1.0, "log"),
    "threshold": (0.1, 1.5, "log"),
    "initial_distance": (0.1, 1.5, "log"),
    "scaling": (0.0, 3.0, "linear"),
    "relative_slope": (0.02, 1.0, "log"),
    "buffer": (0.15, 1.5, "log"),
    "division_distance": (0.3, 3.0, "log"),
    "plane_error": (0.2, 2.0, "log"),
    "deviations": (1.0, 4.0, "linear"),
    "rigidness": (1, 3, "whole"),
}
"""One range per quantity, whatever the method: low, high, and whether it is drawn evenly, evenly in the logarithm, or from
the whole numbers."""

SWEPT: dict[str, tuple[str, ...]] = {
    "ptd": ("max_angle", "max_distance"),
    "ptdf": ("max_angle", "max_distance"),
    "atin": ("max_angle", "max_distance", "deviations"),
    "iptd": ("max_angle", "max_distance", "plane_error"),
    "stin": ("max_angle", "max_distance"),
    "fptd": ("max_angle", "max_elevation"),
    "spf": ("max_angle", "max_distance", "slope", "initial_distance"),
    "agptd": ("max_angle", "max_distance", "relative_slope"),
    "ppdf": ("slope", "buffer", "division_distance", "max_distance"),
    "msf": ("slope", "initial_distance"),
    "pmf": ("slope", "initial_distance"),
    "smrf": ("slope", "threshold", "scaling"),
    "csf": ("threshold", "rigidness"),
}
"""The thresholds that are varied. Methods that are not listed: all their thresholds, see :func:`swept`."""
LEFT_ALONE = ("noise_floor", "max_below")
"""Switches of ours for dense clouds and low points, off in the fixed set on these data."""

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


def swept(method: str) -> dict[str, tuple[float, float, str]]:
    """The thresholds of a method that are varied, with their ranges: those of :data:`SWEPT`, else all that are traced.

    A quantity without an entry in :data:`RANGES` is varied from half to twice its default, if that is positive and finite.
    """
    out = {}
    for field in dataclasses.fields(jf.FILTERS[method]):
        listed = field.name in SWEPT[method] if method in SWEPT else field.name not in LEFT_ALONE
        whole = field.name in RANGES and RANGES[field.name][2] == "whole"
        if listed and (whole or not field.metadata.get("static")):
            if field.name in RANGES:
                out[field.name] = RANGES[field.name]
            elif isinstance(field.default, (int, float)) and 0 < field.default < math.inf:
                out[field.name] = _around(field)
    return out


def _around(field: dataclasses.Field) -> tuple[float, float, str]:
    limits = [field.metadata.get(key) for key in ("lt", "le")]
    top = min((bound for bound in limits if bound is not None), default=math.inf)
    return 0.5 * field.default, min(2.0 * field.default, 0.99 * top), "log"


def sets(method: str, budget: int) -> list[dict[str, float]]:
    """The thresholds of each of ``budget`` sets; that of set 0 is empty: the fixed set as it is."""
    ranges = swept(method)
    if budget == 1 or not ranges:
        return [{}]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # no power of two many: their balance is not needed
        unit = qmc.Sobol(len(ranges), scramble=False).fast_forward(1).random(budget - 1)
    return [{}, *({name: _scaled(u, *r) for u, (name, r) in zip(row, ranges.items(), strict=True)} for row in unit)]


def _scaled(u: float, low: float, high: float, scale: str) -> float:
    if scale == "whole":
        return int(low + u * (high - low + 1))
    value = low * (high / low) ** u if scale == "log" else low + (high - low) * u
    return float(f"{value:.4g}")
