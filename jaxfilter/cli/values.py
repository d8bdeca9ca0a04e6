"""Options of commands, and the kinds of values that they take."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

INPUT = click.Path(exists=True, dir_okay=False, path_type=Path)
OUTPUT = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
CLASS = click.IntRange(0, 255)
"""An ASPRS class."""
METRES = click.FloatRange(0, min_open=True)
METRES.name = "metres"
BOX = "XMIN YMIN XMAX YMAX"
COUNT, SEED = click.IntRange(1), click.IntRange(0)
_UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


def size(text: str) -> float:
    """A number of bytes, a million or more: 4e9, 4GB, 512MiB. A type for click."""
    found = re.fullmatch(r"([\d.]+(?:e\d+)?)\s*([kmgt]?i?)b?", text.strip().lower())
    number = 0.0 if found is None else float(found[1]) * _UNITS[found[2]]
    if number < 1e6:
        raise click.BadParameter(f"{text!r} is no number of bytes, such as 4GB or 512MiB.")
    return number


class Number(click.ParamType):
    """A number or a word; ``none`` where it may be None."""

    def __init__(self, base: type, optional: bool) -> None:
        self.base, self.optional = base, optional
        self.name = base.__name__ + ("|none" if optional else "")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if self.optional and isinstance(value, str) and value.lower() == "none":
            return None
        try:
            return self.base(value)
        except ValueError:
            self.fail(f"{value!r} is not a valid {self.name}.", param, ctx)


def option(flags: str, help: str, kind: Any = None, **more: Any) -> click.Option:
    """An option by its flags, separated by spaces, with the name of its argument last where it is another. ``kind``: bool for
    a switch, a text that stands for words in the help, or a type of click."""
    if isinstance(kind, str):
        kind, more["metavar"] = None, kind
    if more.get("multiple"):
        help = help.replace(".", "; may be repeated.", 1)
    switch = True if kind is bool else None  # False would let the value be left out, and no value could begin with -
    return click.Option(flags.split(), help=help, type=kind, is_flag=switch, **more)


def on_command_line(names: Iterable[str]) -> dict[str, Any]:
    """The arguments out of these that the command line gives to the running command, by name."""
    context = click.get_current_context()
    return {n: context.params[n] for n in names if context.get_parameter_source(n) == ParameterSource.COMMANDLINE}


IN_OUT = click.Argument(["names"], metavar="IN... OUT", nargs=-1, required=True)
