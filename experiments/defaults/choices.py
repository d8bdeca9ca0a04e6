"""The choices that are made on simulated scenes and tiles: for each the alternatives, and which of them the library has."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import jaxfilter as jf

Make = Callable[[float], dict[str, Any]]
"""Fields for a mean point spacing in metres."""


@dataclasses.dataclass(frozen=True)
class Choice:
    """Alternatives for some fields of a method; all other fields are those of ``for_cloud``.

    ``present``: the alternative that the library has. ``on``: the groups of clouds whose means decide.
    """

    name: str
    method: str
    alternatives: Mapping[str, Make]
    present: str
    on: tuple[str, ...] = ()
    tie: str = ""

    def filter(self, alternative: str, cloud: jf.PointCloud, spacing: float) -> jf.Filter:
        """The filter of an alternative for a cloud."""
        return jf.FILTERS[self.method].for_cloud(cloud, **self.alternatives[alternative](spacing))


def values(field: str, *given: Any) -> dict[str, Make]:
    """An alternative for each value of one field."""
    return {f"{field} {value}": _constant({field: value}) for value in given}


def _constant(fields: dict[str, Any]) -> Make:
    return lambda spacing: dict(fields)


def _steps(spacing: float, spacings: float) -> float:
    """So many point spacings in steps of 0.5 m, 1 m at least."""
    return max(1.0, 0.5 * math.ceil(2 * spacings * spacing - 1e-6))


def _cells() -> list[Choice]:
    """How wide cells are where points are sparse: so many spacings, in steps of 0.5 m, 1 m at least."""
    sparse = ("0.1 per m2", "0.3 per m2", "1 per m2", "tiles")
    shares = {"smrf": 0.5, "pmf": 0.25, "msf": 0.25, "spf": 0.5, "iptd": 0.5}
    out = []
    for method, present in shares.items():
        tried = (0.25, 0.35, 0.5, 0.75, 1.0) if method in ("smrf", "pmf", "msf") else (0.5, 1.0, 2.0, 3.0)
        rules = {f"{share:g} spacings": _cell(share) for share in tried}
        out.append(Choice(f"{method}: cell", method, rules, f"{present:g} spacings", sparse))
    return out


def _cell(share: float) -> Make:
    return lambda spacing: {"cell": _steps(spacing, share)}


def _windows() -> list[Choice]:
    widths = (20.0, 36.0, 48.0, 60.0, 80.0)
    out = [
        Choice(
            "smrf: window",
            "smrf",
            {f"{w:g} m wide": _constant({"cell": 1.0, "window": w / 2}) for w in widths},
            "36 m wide",
        ),
        Choice(
            "pmf: window",
            "pmf",
            {f"{w:g} m wide": _constant({"cell": 1.0, "max_window": w}) for w in widths},
            "60 m wide",
        ),
    ]
    rises: dict[str, Make] = {}
    for w in widths:
        for share in (0.3, 0.45, 0.6):
            rises[f"{w:g} m wide, rise {share:g} of the radius"] = _constant(
                {"cell": 1.0, "window": w / 2, "max_height": max(6.0, share * w / 2)}
            )
    out.append(Choice("msf: window", "msf", rises, "20 m wide, rise 0.6 of the radius"))
    return out


CHOICES: list[Choice] = [*_cells(), *_windows()]
