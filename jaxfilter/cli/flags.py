"""Command-line flags made from the fields of a filter, so that a parameter is declared once, in its class."""

from __future__ import annotations

import dataclasses
import types
import typing
from typing import Any

import click
from click.core import ParameterSource

from ..core.errors import ParameterError
from ..core.filter import Filter
from ..core.params import declared
from ..pdal import aliases
from .values import Number


def fields(method: type[Filter]) -> dict[str, dataclasses.Field[Any]]:
    """The parameters of a filter by name."""
    return {f.name: f for f in declared(method)}


def options(method: type[Filter]) -> list[click.Option]:
    """One option per field of the filter: ``--max-angle`` for ``max_angle``, ``--x/--no-x`` for a bool. Fields that PDAL has
    under another name have that as well: ``--scalar`` for ``scaling``."""
    types_of, other = typing.get_type_hints(method), aliases(method.__name__.lower())
    return [_option(field, types_of[name], other.get(name)) for name, field in fields(method).items()]


def given(method: type[Filter], ctx: click.Context) -> dict[str, Any]:
    """The fields that the command line sets, by name."""
    said = [name for name in fields(method) if ctx.get_parameter_source(name) == ParameterSource.COMMANDLINE]
    return {name: ctx.params[name] for name in said}


def describe(field: dataclasses.Field[Any]) -> str:
    """One sentence on a field: what it is, its symbol, unit, admissible range and default."""
    meta = field.metadata
    choices = ", ".join(str(c) for c in meta.get("choices") or ())
    unit = f"{meta.get('range', '')} {meta.get('unit', '')}".strip()
    default = "none" if field.default is None else str(field.default)
    notes = [f"symbol {meta['symbol']}" if meta.get("symbol") else "", unit, choices, f"default {default}"]
    return f"{str(meta.get('doc', '')).rstrip('.')} [{'; '.join(n for n in notes if n)}]"


def _option(field: dataclasses.Field[Any], annotation: Any, alias: str | None = None) -> click.Option:
    flag = _flag(field.name)
    choices = field.metadata.get("choices")
    if annotation is bool:
        return click.Option([f"{flag}/--no-{flag[2:]}", field.name], default=None, help=describe(field))
    kind: click.ParamType = Number(_base(annotation), bool(field.metadata.get("optional")))
    if choices is not None and all(isinstance(c, str) for c in choices):
        kind = click.Choice(choices)
    names = [flag, _flag(alias)] if alias else [flag]
    return click.Option([*names, field.name], type=kind, default=None, help=describe(field))


def _flag(name: str) -> str:
    return "--" + name.replace("_", "-")


def _base(annotation: Any) -> type:
    """``float`` of ``float`` and of ``float | None``."""
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union:
        annotation = next(a for a in typing.get_args(annotation) if a is not type(None))
    return annotation


def value_of(method: type[Filter], name: str, text: str, option: str) -> Any:
    """A value of a field from its text, not yet held against its limits. Raises ParameterError naming the ``option``."""
    known = fields(method)
    if name not in known:
        raise ParameterError(f"{option} {name}: {method.__name__} has no such field; it has {', '.join(known)}")
    base = _base(typing.get_type_hints(method)[name])
    optional = bool(known[name].metadata.get("optional"))
    kind = click.BOOL if base is bool else Number(base, optional)
    try:
        return kind.convert(text, None, None)
    except click.UsageError as error:
        raise ParameterError(f"{option} {name}={text}: {error.message}") from error


def words_for(name: str, value: Any) -> list[str]:
    """The words that set a field on the command line."""
    flag = _flag(name)
    if isinstance(value, bool):
        return [flag if value else f"--no-{flag[2:]}"]
    return [flag, "none" if value is None else str(value)]
