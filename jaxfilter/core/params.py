"""Filter parameters: a filter *is* its parameters, a frozen dataclass that is also a JAX pytree.

Fields made with :func:`param` are traced leaves (thresholds: one compilation serves all values, ``vmap`` may sweep
them). Fields made with :func:`static` fix array shapes or choose between code paths; they are part of the tree
structure, so a new value compiles anew. Each field carries its paper symbol, unit and admissible range once; errors,
command-line flags and documentation are derived from there.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import numbers
import operator
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from typing import Any, TypeVar, dataclass_transform

import jax
import numpy as np

from .errors import ParameterError

T = TypeVar("T")


def _field(default: Any, is_static: bool, meta: dict[str, Any]) -> Any:
    return dataclasses.field(default=default, metadata={"static": is_static, **meta})


def param(
    *,
    default: float,
    doc: str,
    symbol: str = "",
    unit: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """Declare a traced threshold with its documentation and admissible range.

    ``default`` is a keyword, since type checkers see a default in no other place (PEP 681).
    """
    return _field(default, False, {"doc": doc, "symbol": symbol, "unit": unit, "gt": gt, "ge": ge, "lt": lt, "le": le})


def static(
    *,
    default: Any,
    doc: str,
    symbol: str = "",
    unit: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    cells: int | None = None,
    choices: tuple[Any, ...] | None = None,
    optional: bool = False,
    endless: bool = False,
) -> Any:
    """Declare a static field (fixes shapes or picks a code path). ``optional`` fields may be None ("off"), ``endless`` ones
    infinite, those with ``cells`` so many times as long as ``cell`` at most; a switch, whose default is True or False, may be
    either.

    ``default`` is a keyword, as in :func:`param`.
    """
    choices = (True, False) if isinstance(default, bool) else choices
    meta = {"doc": doc, "symbol": symbol, "unit": unit, "gt": gt, "ge": ge, "lt": lt, "le": le, "cells": cells}
    return _field(default, True, {**meta, "choices": choices, "optional": optional, "endless": endless})


class Preset(dict[str, Any]):
    """Field values of a named set, and ``note``: one line that says what the set is.

    The note of "paper" begins with "as printed", or "as reported" where the original was not at hand, and names what is not.
    """

    def __init__(self, note: str, /, **fields: Any) -> None:
        super().__init__(fields)
        self.note = note


def sample_presets(note: str, names: str, rows: Mapping[int, tuple[float, ...]], /, **fields: Any) -> dict[str, Preset]:
    """The presets "samp11", ... of a table with a row of values for each ISPRS sample.

    ``names``: the fields that the columns are, separated by spaces; ``fields``: values of others, which all samples share;
    ``note``: follows the number of the sample and its values.
    """
    out = {}
    for number, row in rows.items():
        values = dict(zip(names.split(), row, strict=True))
        listed = ", ".join(f"{name} {value:g}" for name, value in values.items())
        out[f"samp{number}"] = Preset(f"ISPRS sample {number}: {listed}{note}", **values, **fields)
    return out


class _Registry(Mapping[str, type[Any]]):
    """Filter classes by name; look-ups ignore case, iteration gives the lower-case names.

    A class that is only announced is imported when it is first looked up.

    >>> jf.FILTERS["SMRF"] is jf.SMRF, "fptd" in jf.FILTERS
    (True, True)
    """

    def __init__(self) -> None:
        self._homes: dict[str, str] = {}
        self._classes: dict[str, type[Any]] = {}

    def announce(self, name: str, module: str) -> None:
        """A class of this name is entered by the import of a module."""
        self._homes[name.lower()] = module

    def add(self, cls: type) -> None:
        """Enter a class under its own name."""
        name = cls.__name__.lower()
        self._homes.setdefault(name, cls.__module__)
        self._classes[name] = cls

    def __getitem__(self, name: str) -> type[Any]:
        key = name.lower()
        if key not in self._homes:
            raise KeyError(f"no filter named {name!r}; known filters: {', '.join(self._homes)}")
        if key not in self._classes:
            import_module(self._homes[key])
        return self._classes[key]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lower() in self._homes

    def __iter__(self) -> Iterator[str]:
        return iter(self._homes)

    def __len__(self) -> int:
        return len(self._homes)


FILTERS = _Registry()
"""Every filter class by name, for example ``FILTERS["fptd"]``."""


_LIMITS = (("gt", ">", operator.gt), ("ge", ">=", operator.ge), ("lt", "<", operator.lt), ("le", "<=", operator.le))


def _is_number(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def declared(params: Any) -> list[dataclasses.Field[Any]]:
    """The fields of a filter, class or instance, in the order of its signature: a method's own before those it shares."""
    return sorted(dataclasses.fields(params), key=lambda field: bool(field.kw_only))


def described(field: dataclasses.Field[Any]) -> str:
    """Type, unit, range, default and meaning of a field, as a line of a docstring."""
    meta, default = field.metadata, field.default
    choices = meta.get("choices")
    kind = " or ".join(map(repr, choices)) if choices else type(default).__name__ if default is not None else "float"
    facts = [kind + " or None" * bool(meta.get("optional")), meta.get("unit")]
    facts += [f"{sign} {meta[key]:g}" for key, sign, _ in _LIMITS if meta.get(key) is not None]
    facts += ["static" * bool(meta.get("static")), f"default {default!r}"]
    symbol = f"; {meta['symbol']} in the paper" if meta.get("symbol") else ""
    return f"{field.name} ({', '.join(filter(None, facts))}): {meta.get('doc', '')}{symbol}."


def plain_fields(params: Any) -> None:
    """Replace NumPy and JAX scalars, concrete arrays without dimensions included, by Python's own numbers, in place; 3.0 by 3
    in fields of whole numbers."""
    for f in dataclasses.fields(params):
        value = _plain(getattr(params, f.name))
        if _is_whole(f) and isinstance(value, float) and value.is_integer():
            value = int(value)
        if value is not getattr(params, f.name):
            object.__setattr__(params, f.name, value)


def _plain(value: Any) -> Any:
    """A concrete scalar of NumPy or JAX, or array without dimensions, as Python's own; all else as it is."""
    if isinstance(value, np.generic | np.ndarray | jax.Array) and not _traced(value) and np.ndim(value) == 0:
        return value.item()
    return value


def _is_whole(field: dataclasses.Field[Any]) -> bool:
    """Whether only whole numbers will do: they count rounds or points, or fix a shape."""
    return bool(field.metadata.get("static")) and field.type in ("int", int)


def _traced(value: Any) -> bool:
    return isinstance(value, jax.core.Tracer)


def check_fields(params: Any) -> None:
    """Validate every field of ``params`` against its declaration. Tracers, whose values nobody knows yet, are left alone.

    Raises: ParameterError naming class, field, value and range.
    """
    name = type(params).__name__
    for f in dataclasses.fields(params):
        value, meta = _plain(getattr(params, f.name)), f.metadata
        if _traced(value):
            if meta.get("static"):
                raise ParameterError(
                    f"{name}({f.name}=...): the field fixes shapes of arrays or a path through the code, and cannot be "
                    "traced by jax.jit, vmap or grad; make one filter for each value"
                )
            continue
        if np.ndim(value) > 0:
            raise ParameterError(
                f"{name}({f.name}=...): a single value is needed, not an array of shape {np.shape(value)}; "
                "jaxfilter.sweep takes several values, and jax.vmap maps a function of one"
            )
        choices = meta.get("choices")
        if choices is not None:
            if value not in choices:
                raise ParameterError(f"{name}({f.name}={value!r}): choose one of {', '.join(map(repr, choices))}")
            continue
        if value is None and meta.get("optional"):
            continue
        limits = [(sign, meta[key], ok) for key, sign, ok in _LIMITS if meta.get(key) is not None]
        if not _is_number(value):
            if limits or meta.get("static") is False:
                raise ParameterError(f"{name}({f.name}={value!r}): a number is needed")
            continue
        if _is_whole(f) and not isinstance(value, numbers.Integral):
            raise ParameterError(f"{name}({f.name}={value!r}): a whole number is needed")
        beyond = math.isinf(value) and meta.get("static") and not meta.get("endless")
        if math.isnan(value) or beyond or not all(ok(value, bound) for _, bound, ok in limits):
            wanted = " and ".join(f"{sign} {bound:g}" for sign, bound, _ in limits) or "a number"
            wanted = "finite and " * bool(beyond) + wanted
            unit = f" {meta['unit']}" if meta.get("unit") else ""
            raise ParameterError(f"{name}({f.name}={value!r}): must be {wanted}{unit}")
        most = meta.get("cells")
        if most is not None and value > most * params.cell:
            raise ParameterError(
                f"{name}({f.name}={value!r}): more than {most} cells of {params.cell:g} m; use a larger cell"
            )


@dataclass_transform(frozen_default=True, kw_only_default=False, field_specifiers=(param, static))
def filter_params(cls: type[T]) -> type[T]:
    """Class decorator: frozen dataclass, registered as a pytree and, if it is a filter, in :data:`FILTERS`.

    The fields, as they are declared, become the part ``Args`` of the docstring. JAX rebuilds trees with leaves that no user
    may give (stacked arrays, placeholders); so a tree is rebuilt without ``__post_init__``.
    """
    out = dataclasses.dataclass(frozen=True)(cls)
    if out.__doc__:  # python -OO has none
        wrap = textwrap.TextWrapper(100, initial_indent=" " * 4, subsequent_indent=" " * 8, break_on_hyphens=False)
        lines = [wrap.fill(described(field)) for field in declared(out)]
        out.__doc__ = "\n".join([inspect.cleandoc(out.__doc__), "", "Args:", *lines])
    fields = dataclasses.fields(out)  # type: ignore[arg-type]
    leaves = [f.name for f in fields if not f.metadata.get("static")]
    structure = [f.name for f in fields if f.metadata.get("static")]
    keys = [jax.tree_util.GetAttrKey(name) for name in leaves]

    def flatten(params: T) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:
        values = (getattr(params, name) for name in leaves)
        return list(zip(keys, values, strict=True)), tuple(getattr(params, name) for name in structure)

    def unflatten(fixed: tuple[Any, ...], values: Iterable[Any]) -> T:
        params = object.__new__(out)
        for field, value in zip((*structure, *leaves), (*fixed, *values), strict=True):
            object.__setattr__(params, field, value)
        return params

    jax.tree_util.register_pytree_with_keys(out, flatten, unflatten)
    if callable(getattr(out, "classify", None)):
        FILTERS.add(out)
    return out
