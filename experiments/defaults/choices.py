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

    ``present``: the alternative that the library has. ``on``: the groups of clouds it is run on, whose means decide; all if
    none is named.
    """

    name: str
    method: str
    alternatives: Mapping[str, Make]
    present: str
    on: tuple[str, ...] = ()

    def filter(self, alternative: str, spacing: float) -> jf.Filter:
        """The filter of an alternative for a cloud with this spacing."""
        cls = jf.FILTERS[self.method]
        return cls(**{**cls.from_spacing(spacing, None), **self.alternatives[alternative](spacing)})


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


def _rules() -> list[Choice]:
    """Whether what follows from the spacing is of use."""
    out = []
    for method in jf.FILTERS:
        plain = {field.name: field.default for field in dataclasses.fields(jf.FILTERS[method])}
        rules = {"for_cloud": _constant({}), "plain defaults": _constant(plain)}
        out.append(Choice(f"{method}: rule", method, rules, "for_cloud"))
    return out


SPARSE = ("0.3 per m2", "1 per m2")
DENSE = ("15 per m2", "tiles")


def _thresholds() -> list[Choice]:
    """Thresholds and switches, one at a time."""
    degrees = {f"{a} degrees, {h:g} m": _constant({"slope": s, "max_height": h})
               for a, s, h in ((15, 0.268, 3.0), (20, 0.364, 4.0), (30, 0.577, 6.0), (40, 0.839, 9.0),
                               (50, 1.192, 12.0))}  # fmt: skip
    openings = {f"slope {s:g}, {h:g} m": _constant({"slope": s, "max_distance": h})
                for s, h in ((0.15, 2.5), (0.268, 3.0), (0.5, 3.0))}  # fmt: skip
    limits = {kind: _constant({"thresholds": kind}) for kind in ("constant", "adaptive")}
    out = [
        Choice("msf: slope", "msf", degrees, "30 degrees, 6 m", SPARSE),
        Choice("pmf: slope", "pmf", openings, "slope 0.268, 3 m", SPARSE),
        Choice("atin: thresholds", "atin", limits, "constant", SPARSE),
    ]
    tried: dict[str, dict[str, tuple[Any, ...]]] = {
        "atin": {"max_angle": (15.0, 20.0, 25.0, 30.0, 35.0)},
        "spf": {"max_angle": (15.0, 20.0, 25.0, 30.0, 35.0), "slope": (0.3, 0.5, 0.7)},
        "stin": {"max_angle": (20.0, 25.0, 30.0, 35.0, 40.0), "max_distance": (1.0, 1.4, 2.0, 3.0),
                 "mirror": ("off", "nearest"), "outlier_surface": ("local", "quadratic", "off")},
        "iptd": {"max_angle": (20.0, 25.0, 30.0, 35.0), "tolerance": (0.5, 1.0, 2.0, 3.0), "plane_error": (0.4, 0.8, 1.2),
                 "k": (50, 100, 200), "translation": ("none", "lowest")},
        "csf": {"surface": ("nearest", "lowest"), "rigidness": (1, 2, 3), "resolution": (0.5, 1.0, 1.5, 2.0)},
        "ppdf": {"reference_cell": (0.5, 1.0, 2.0), "reference_distance": (0.3, 0.5, 0.7, 1.0),
                 "max_distance": (0.2, 0.3, 0.4, 0.5), "window": (0.0, 18.0, 30.0, 40.0), "slope": (0.2, 0.3, 0.5)},
    }  # fmt: skip
    for method, fields in tried.items():
        for field, given in fields.items():
            alternatives = {f"{field} {_text(value)}": _constant({field: value}) for value in given}
            present = f"{field} {_text(getattr(jf.FILTERS[method](), field))}"
            on = ("0.1 per m2", *SPARSE) if field == "resolution" else SPARSE
            out.append(Choice(f"{method}: {field}", method, alternatives, present, on))
    for field, values, present in (
        ("noise_floor", (0.0, 0.05, 0.1, 0.2), 0.1),
        ("vertex_spacing", (0.0, 0.5, 0.7, 1.0), 0.7),
    ):
        alternatives = {f"{field} {value:g}": _constant({field: value}) for value in values}
        out += [Choice(f"{m}: {field}", m, alternatives, f"{field} {present:g}", DENSE) for m in ("fptd", "ptd")]
    return out


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


CHOICES: list[Choice] = [*_cells(), *_windows(), *_rules(), *_thresholds()]
