"""Kinds of values that options of the commands take."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

INPUT = click.Path(exists=True, dir_okay=False, path_type=Path)
OUTPUT = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
CLASS = click.IntRange(0, 255)
"""An ASPRS class."""
_UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "t": 1e12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


class Bytes(click.ParamType):
    """A number of bytes: 4e9, 4GB, 512MiB."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Bytes of a text."""
        if isinstance(value, float):
            return value
        found = re.fullmatch(r"([\d.]+(?:e\d+)?)\s*([kmgt]?i?)b?", str(value).strip().lower())
        if found is None or float(found[1]) <= 0:
            self.fail(f"{value!r} is no number of bytes, such as 4GB or 512MiB.", param, ctx)
        return float(found[1]) * _UNITS[found[2]]


class Number(click.ParamType):
    """A number or a word; ``none`` where it may be None."""

    def __init__(self, base: type, optional: bool) -> None:
        self.base, self.optional = base, optional
        self.name = base.__name__ + ("|none" if optional else "")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """A value of a text."""
        if self.optional and isinstance(value, str) and value.lower() == "none":
            return None
        try:
            return self.base(value)
        except ValueError:
            self.fail(f"{value!r} is not a valid {self.name}.", param, ctx)
