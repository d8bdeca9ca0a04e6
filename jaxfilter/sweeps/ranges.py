"""Where the thresholds of a method are searched for when nobody says where."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from typing import Any

from ..core.errors import ParameterError, check_choice
from ..core.filter import Filter
from ..core.params import declared, is_number

RANGE_SCALES = ("linear", "log", "whole")
"""Drawn evenly, evenly in the logarithm, or from the whole numbers."""


@dataclasses.dataclass(frozen=True)
class Range:
    """Where a quantity is searched for: from ``low`` to ``high``, on one of :data:`RANGE_SCALES`."""

    low: float
    high: float
    scale: str = "linear"

    def __post_init__(self) -> None:
        check_choice(RANGE_SCALES, scale=self.scale)
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ParameterError(f"Range({self.low!r}, {self.high!r}): the range must go from low to high")
        if self.scale == "log" and self.low <= 0:
            raise ParameterError(f"Range({self.low!r}, {self.high!r}, 'log'): must begin above 0")
        if self.scale == "whole" and (self.low % 1 or self.high % 1):
            raise ParameterError(f"Range({self.low!r}, {self.high!r}, 'whole'): must have whole ends")

    def at(self, u: float) -> float:
        """The value at a position of the unit interval, to four digits."""
        if self.scale == "whole":
            return min(int(self.low + u * (self.high - self.low + 1)), int(self.high))
        log = self.scale == "log"
        value = self.low * (self.high / self.low) ** u if log else self.low + u * (self.high - self.low)
        return float(f"{value:.4g}")

    def position(self, value: float) -> float:
        """Where a value lies on the unit interval; outside the range beyond it, but not further than its length."""
        if self.scale == "log":
            place = math.log(max(value, 1e-12) / self.low) / math.log(self.high / self.low)
        else:
            whole = self.scale == "whole"
            place = (value - self.low + 0.5 * whole) / (self.high - self.low + whole)
        return min(max(place, -1.0), 2.0)


RANGES: dict[str, Range] = {
    "max_angle": Range(4.0, 45.0),
    "max_distance": Range(0.3, 3.0, "log"),
    "max_elevation": Range(0.3, 3.0, "log"),
    "slope": Range(0.03, 1.0, "log"),
    "relief": Range(0.1, 1.0),
    "tolerance": Range(0.03, 0.3, "log"),
    "threshold": Range(0.1, 1.5, "log"),
    "initial_distance": Range(0.1, 1.5, "log"),
    "scaling": Range(0.0, 3.0),
    "relative_slope": Range(0.02, 1.0, "log"),
    "buffer": Range(0.15, 1.5, "log"),
    "division_distance": Range(0.3, 3.0, "log"),
    "plane_error": Range(0.2, 2.0, "log"),
    "rigidness": Range(1, 3, "whole"),
}
"""One range per quantity, whatever the method."""

SEARCHED: dict[str, tuple[str, ...]] = {
    "ptd": ("max_angle", "max_distance"),
    "ptdf": ("max_angle", "max_distance"),
    "atin": ("max_angle", "max_distance"),
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
    "ost": ("slope", "relief", "tolerance", "max_angle"),
}
"""The thresholds that decide the accuracy of each method. Of other methods all traced fields with a range are searched."""


def check_filter(filter_: Any) -> Filter:
    """The filter with plain numbers, which trees may hold as arrays. Raises ParameterError for what is no instance of one."""
    if not isinstance(filter_, Filter):
        shown = filter_.__name__ if isinstance(filter_, type) else repr(filter_)
        raise ParameterError(f"filter_={shown}: an instance of a filter is needed, such as jaxfilter.SMRF()")
    return filter_.replace()


def fields_of(filter_: Filter, names: Iterable[str]) -> dict[str, dataclasses.Field[Any]]:
    """All fields of a filter by name. Raises: ParameterError naming an axis that is none of them."""
    fields = {f.name: f for f in declared(filter_)}
    for name in names:
        if name not in fields:
            raise ParameterError(f"axes: {type(filter_).__name__} has no field {name!r}; it has {', '.join(fields)}")
    return fields


def search_ranges(filter_: Filter | type[Filter]) -> dict[str, Range]:
    """The fields of a method to search, with their ranges.

    A field without an entry in :data:`RANGES` is searched from half to twice its default, if that is positive and finite.
    """
    method = filter_ if isinstance(filter_, type) else type(filter_)
    listed = SEARCHED.get(method.__name__.lower())
    if listed is not None:
        return {field.name: RANGES[field.name] for field in declared(method) if field.name in listed}
    found = {f.name: RANGES.get(f.name) or around(f) for f in declared(method) if not f.metadata["static"]}
    return {name: one for name, one in found.items() if one is not None}


def around(field: dataclasses.Field[Any]) -> Range | None:
    """Half to twice the default of a field, within its limits; None if that is not a range."""
    default = field.default
    if not is_number(default) or not 0 < default < math.inf:
        return None
    top = min((bound for sign, bound in field.metadata["limits"].items() if "<" in sign), default=math.inf)
    high = min(2.0 * default, 0.99 * top)
    return Range(0.5 * default, high, "log") if high > 0.5 * default else None
