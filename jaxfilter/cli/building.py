"""A filter out of the words of a command: method, preset, fields."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import click

from .session import BadUsage

if TYPE_CHECKING:
    from ..core.cloud import PointCloud
    from ..core.filter import Filter

set_option = click.option(
    "--set",
    "fixed",
    metavar="FIELD=VALUE",
    multiple=True,
    help="The value of a field, the same in all sets; may be repeated.",
)
preset_option = click.option("--preset", metavar="NAME", help="A named set of parameters to start from.")
largest_option = click.option(
    "--largest-building",
    type=click.FloatRange(0, min_open=True),
    metavar="METRES",
    help="Set what depends on point spacing and on this width from the (first) cloud.",
)
units_option = click.option(
    "--units", metavar="UNIT", help="Of the coordinates: m, ft, us-ft, or XY,Z.  [default: as the CRS says]"
)
workers_option = click.option(
    "--workers", type=click.IntRange(1), help="Threads for triangulation.  [default: one per core]"
)
method_argument = click.argument("method", metavar="METHOD")
memory_option = click.option(
    "--memory",
    type=click.FloatRange(0, min_open=True),
    default=2.0,
    show_default=True,
    metavar="GB",
    help="That may be held for sets computed at the same time.",
)


@dataclasses.dataclass(frozen=True)
class Builder:
    """A filter as the command line describes it; part of it may depend on the cloud."""

    method: type[Filter]
    preset: str | None
    fixed: dict[str, Any]
    largest_building: float | None
    for_cloud: bool = False

    def alone(self) -> Filter:
        """Before any cloud is read, to find wrong values early."""
        return self.method.preset(self.preset, **self.fixed) if self.preset else self.method(**self.fixed)

    def on(self, cloud: PointCloud) -> Filter:
        """For this cloud."""
        if self.largest_building is None and not self.for_cloud:
            return self.alone()
        return self.method.for_cloud(cloud, self.largest_building, preset=self.preset, **self.fixed)


def builder(
    method: str,
    fixed: tuple[str, ...],
    preset: str | None,
    largest_building: float | None,
    for_cloud: bool = False,
) -> Builder:
    """Raises BadUsage for a method, preset or field that there is not."""
    from ..methods import FILTERS
    from . import flags

    if method not in FILTERS:
        raise BadUsage(f"no method {method!r}: choose one of {', '.join(FILTERS)}")
    cls = FILTERS[method]
    if preset is not None and preset not in cls.PRESETS:
        raise BadUsage(f"--preset {preset!r}: {cls.__name__} has {', '.join(cls.PRESETS)}")
    values = {name: flags.value_of(cls, name, text, "--set") for name, text in pairs("--set", fixed)}
    return Builder(cls, preset, values, largest_building, for_cloud)


def pairs(option: str, texts: tuple[str, ...]) -> list[tuple[str, str]]:
    """Field and value of FIELD=VALUE; a field with dashes is the one with underscores."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise BadUsage(f"{option} {text!r}: write it as FIELD=...")
        if name in found:
            raise BadUsage(f"{option} {name}: given twice")
        found[name] = value.strip()
    return list(found.items())


def drawn_range(method: type[Filter], name: str, text: str) -> tuple[Any, Any]:
    """The ends of LOW..HIGH."""
    from . import flags

    low, dots, high = text.partition("..")
    if not (dots and low and high):
        raise BadUsage(f"--axis {name}={text}: write a range as LOW..HIGH")
    ends = flags.value_of(method, name, low, "--axis"), flags.value_of(method, name, high, "--axis")
    if not all(isinstance(end, (int, float)) and not isinstance(end, bool) for end in ends):
        raise BadUsage(f"--axis {name}={text}: a range needs numbers; give words as a list")
    return ends
