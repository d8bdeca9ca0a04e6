"""Command-line flags made from the fields of a filter, so that a parameter is declared once, in its class."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping, Sequence
from typing import Any

import click

from ..core.filter import Filter
from ..core.params import declared
from ..methods import FILTERS
from .session import BadUsage
from .values import Number


def method_of(name: str) -> type[Filter]:
    """A filter class by its name. Raises BadUsage."""
    if name not in FILTERS:
        raise BadUsage(f"there is no method {name!r}: choose one of {', '.join(FILTERS)}")
    return FILTERS[name]


def fields(method: type[Filter]) -> dict[str, dataclasses.Field[Any]]:
    """The parameters of a filter by name."""
    return {f.name: f for f in declared(method)}


def options(method: type[Filter]) -> list[click.Option]:
    """One option per field of the filter: ``--max-angle`` for ``max_angle``, ``--x/--no-x`` for a bool."""
    made = []
    for name, field in fields(method).items():
        flag, kind = _flag(name), _kind(method, field)
        words = f"{flag}/--no-{flag[2:]}" if kind is click.BOOL else flag
        made.append(click.Option([words, name], type=kind, default=None, help=describe(field)))
    return made


def describe(field: dataclasses.Field[Any]) -> str:
    """One sentence on a field: what it is, its symbol, unit, admissible range and default."""
    meta = field.metadata
    choices = ", ".join(str(c) for c in meta.get("choices") or ())
    unit = f"{meta.get('range', '')} {meta.get('unit', '')}".strip()
    default = "none" if field.default is None else str(field.default)
    notes = [f"symbol {meta['symbol']}" if meta.get("symbol") else "", unit, choices, f"default {default}"]
    return f"{str(meta.get('doc', '')).rstrip('.')} [{'; '.join(n for n in notes if n)}]"


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _kind(method: type[Filter], field: dataclasses.Field[Any]) -> click.ParamType:
    """The kind of values of a field, which are not yet held against its limits."""
    if isinstance(field.metadata.get("choices"), Mapping):
        return click.STRING  # names joined by + or a comma, or none
    hint, choices = typing.get_type_hints(method)[field.name], field.metadata.get("choices")
    base = next(one for one in (*typing.get_args(hint), hint) if one is not type(None))  # float of float | None
    if base is bool:
        return click.BOOL
    if choices is not None and all(isinstance(choice, str) for choice in choices):
        return click.Choice(choices)
    return Number(base, bool(field.metadata.get("optional")))


def value_of(method: type[Filter], name: str, text: str, option: str) -> Any:
    """A value of a field from its text, not yet held against its limits. Raises BadUsage naming the ``option``."""
    known = fields(method)
    if name not in known:
        raise BadUsage(f"{option} {name}: {method.__name__} has no such field; it has {', '.join(known)}")
    try:
        return _kind(method, known[name]).convert(text, None, None)
    except click.UsageError as error:
        raise BadUsage(f"{option} {name}={text}: {error.message}") from error


def changed(filter_: Filter, base: Filter) -> dict[str, Any]:
    """The fields in which a filter differs from another of its kind."""
    values = {name: getattr(filter_, name) for name in fields(type(filter_))}
    return {name: value for name, value in values.items() if value != getattr(base, name)}


def command_for(filter_: Filter, names: Sequence[str], base: Filter) -> list[str]:
    """The words of a command that runs a filter over files, after those that make ``base`` of it."""
    words = ["jaxfilter", "ground", type(filter_).__name__.lower(), *names]
    for name, value in changed(filter_, base).items():
        flag = _flag(name)
        if isinstance(value, bool):
            words.append(flag if value else f"--no-{flag[2:]}")
        else:
            names = "+".join(value) if isinstance(value, tuple) else value
            words += [flag, "none" if names in (None, "") else str(names)]
    return words
