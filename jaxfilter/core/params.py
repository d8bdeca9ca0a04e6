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
import re
import textwrap
from collections import UserDict
from collections.abc import Iterable, Mapping
from importlib import import_module
from typing import Any, TypeGuard, TypeVar, dataclass_transform

import jax
import numpy as np

from .errors import SIZES, ParameterError

T = TypeVar("T")
_SIGNS = {">": operator.gt, ">=": operator.ge, "<": operator.lt, "<=": operator.le}
_LIMIT = r"[<>]=? \S+"
_DOMAIN = re.compile(rf"(?P<symbol>\w*) ?(?P<range>{_LIMIT}(?: and {_LIMIT})?)? ?(?P<unit>\S*)")


def _field(doc: str, domain: str, default: Any, **more: Any) -> Any:
    found = _DOMAIN.fullmatch(domain)
    if found is None:
        raise ValueError(f"domain={domain!r}: a symbol, limits and a unit are needed, as in 's > 0 and <= 90 degrees'")
    facts = found.groupdict("")
    limits = {sign: float(bound) for sign, bound in map(str.split, re.findall(_LIMIT, facts["range"]))}
    return dataclasses.field(default=default, metadata={"doc": doc, **facts, "limits": limits, **more})


def param(doc: str, domain: str = "", *, default: float) -> Any:
    """Declare a traced threshold: its meaning in one line, and in ``domain`` the paper's symbol, the limits and the unit, each if
    there is one, as in ``"s > 0 and <= 90 degrees"``; a word alone is the symbol. ``default`` is a
    keyword, since type checkers see a default in no other place (PEP 681)."""
    return _field(doc, domain, default, static=False)


def static(
    doc: str,
    domain: str = "",
    *,
    default: Any,
    cells: int | None = None,
    choices: tuple[Any, ...] | Mapping[str, Any] | None = None,
    optional: bool = False,
    endless: bool = False,
) -> Any:
    """Declare a static field (fixes shapes or picks a code path); see :func:`param`. ``optional`` fields may be None ("off"),
    ``endless`` ones infinite, those with ``cells`` so many times as long as ``cell`` at most. Those whose ``choices`` are a
    mapping are tuples of its keys, or such keys as a text. A switch, whose default is True or False, may be either."""
    choices = (True, False) if isinstance(default, bool) else choices
    more = {"cells": cells, "choices": choices, "optional": optional, "endless": endless}
    return _field(doc, domain, default, static=True, **more)


class Preset(dict[str, Any]):
    """Field values of a named set, and ``note``: one line that says what the set is. The note of "paper" begins with "as
    printed", or "as reported" where the original was not at hand, and names what is not."""

    def __init__(self, note: str, /, **fields: Any) -> None:
        super().__init__(fields)
        self.note = note


class _Registry(UserDict[str, Any]):
    """Filter classes by name; look-ups ignore case, iteration gives the lower-case names.

    The name of a module may stand for a class: it is imported when the class is first looked up, and enters it.

    >>> jf.FILTERS["SMRF"] is jf.SMRF, "fptd" in jf.FILTERS
    (True, True)
    """

    def __setitem__(self, name: str, item: type[Any] | str) -> None:
        self.data[name.lower()] = item

    def __getitem__(self, name: str) -> type[Any]:
        if name not in self:
            raise KeyError(f"no filter named {name!r}; known filters: {', '.join(self)}")
        if isinstance(self.data[name.lower()], str):
            import_module(self.data[name.lower()])
        return self.data[name.lower()]  # type: ignore[no-any-return]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lower() in self.data


FILTERS = _Registry()
"""Every filter class by name, for example ``FILTERS["fptd"]``."""


def is_number(value: Any) -> TypeGuard[float]:
    """Whether this is a real number; True and False are none."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def declared(params: Any) -> list[dataclasses.Field[Any]]:
    """The fields of a filter, class or instance, in the order of its signature: a method's own before those it shares."""
    return sorted(dataclasses.fields(params), key=lambda field: bool(field.kw_only))


def describe_field(field: dataclasses.Field[Any]) -> str:
    """Type, unit, range, default and meaning of a field, as a line of a docstring."""
    meta, default = field.metadata, field.default
    choices = meta.get("choices")
    kind = " or ".join(map(repr, choices)) if choices else type(default).__name__ if default is not None else "float"
    kind = "tuple of " * isinstance(choices, Mapping) + kind
    facts = [kind + " or None" * bool(meta.get("optional")), meta.get("unit"), meta.get("range")]
    facts += ["static" * bool(meta.get("static")), f"default {default!r}"]
    symbol = f"; {meta['symbol']} in the paper" if meta.get("symbol") else ""
    return f"{field.name} ({', '.join(filter(None, facts))}): {meta.get('doc', '')}{symbol}."


def check_fields(params: Any) -> None:
    """Validate every field of ``params`` against its declaration. Tracers, whose values nobody knows yet, are left alone.

    NumPy and JAX scalars, concrete arrays without dimensions included, are replaced by Python's own numbers, in place; 3.0 by 3
    in fields of whole numbers: static ones, which count rounds or points, or fix a shape.

    Raises: ParameterError naming class, field, value and range.
    """
    name = type(params).__name__
    for f in dataclasses.fields(params):
        value, meta = getattr(params, f.name), f.metadata
        traced = isinstance(value, jax.core.Tracer)
        if isinstance(value, np.generic | np.ndarray | jax.Array) and not traced and np.ndim(value) == 0:
            value = value.item()
        whole = bool(meta.get("static")) and f.type in ("int", int)
        if whole and isinstance(value, float) and value.is_integer():
            value = int(value)
        object.__setattr__(params, f.name, value)
        if traced:
            if meta.get("static"):
                why = "the field fixes shapes or a path through the code, and cannot be traced by jax.jit, vmap or grad"
                raise ParameterError(f"{name}({f.name}=...): {why}; make one filter for each value")
            continue
        if isinstance(names := meta.get("choices"), Mapping):
            found = None if value is None else _checked_names(f"{name}({f.name}={value!r})", value, names)
            object.__setattr__(params, f.name, found)
            continue
        if np.ndim(value) > 0:
            wanted = f"a single value is needed, not an array of shape {np.shape(value)}"
            advice = "jaxfilter.sweep takes several values, and jax.vmap maps a function of one"
            raise ParameterError(f"{name}({f.name}=...): {wanted}; {advice}")
        given, choices = f"{name}({f.name}={value!r})", meta.get("choices")
        if choices is not None:
            if value not in choices:
                raise ParameterError(f"{given}: choose one of {', '.join(map(repr, choices))}")
            continue
        if value is None and meta.get("optional"):
            continue
        limits = meta.get("limits", {})
        if not is_number(value):
            if limits or meta.get("static") is False:
                raise ParameterError(f"{given}: a number is needed")
            continue
        if whole and not isinstance(value, numbers.Integral):
            raise ParameterError(f"{given}: a whole number is needed")
        endless = value in (math.inf, -math.inf)
        beyond = endless and meta.get("static") and not meta.get("endless")
        absurd = value == value and value and not endless and not SIZES[0] <= abs(value) <= SIZES[1]
        if value != value or beyond or absurd or not all(_SIGNS[sign](value, bound) for sign, bound in limits.items()):
            wanted = "finite and " * bool(beyond) + (meta.get("range") or "a number")
            unit = f" {meta['unit']}" if meta.get("unit") else ""
            unit += f", of a size from {SIZES[0]:g} to {SIZES[1]:g}" if absurd else ""
            raise ParameterError(f"{given}: must be {wanted}{unit}")
        most = meta.get("cells")
        if most is not None and value > most * params.cell:
            raise ParameterError(f"{given}: more than {most} cells of {params.cell:g} m; use a larger cell")


def _checked_names(given: str, value: Any, names: Mapping[str, Any]) -> tuple[str, ...]:
    """Each name once, in the order of ``names``; also of a text, such as "one+other" or "none". Raises: ParameterError."""
    if isinstance(value, str):
        value = () if value == "none" else re.split(r"\s*[+,]\s*", value)
    if not isinstance(value, (tuple, list)):
        raise ParameterError(f"{given}: a tuple of names is needed, such as {tuple(names)[:1]}")
    for one in value:
        if one not in names:
            raise ParameterError(f"{given}: {one!r} is none of {', '.join(map(repr, names))}")
    return tuple(one for one in names if one in value)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(param, static))
def filter_params(cls: type[T]) -> type[T]:
    """Class decorator: frozen dataclass, registered as a pytree and, if it is a filter, in :data:`FILTERS`.

    The fields, as they are declared, become the part ``Args`` of the docstring. A plain value for a field of a base class, such
    as ``max_angle: float = 25.0``, is another default of that field. JAX rebuilds trees with leaves that no user may give
    (stacked arrays, placeholders); so a tree is rebuilt without ``__post_init__``.
    """
    kinds = inspect.get_annotations(cls)
    own = {name for name in kinds.keys() & vars(cls).keys() if "ClassVar" not in str(kinds[name])}
    for base in filter(dataclasses.is_dataclass, cls.__mro__[1:]):
        for field in dataclasses.fields(base):
            if field.name in own and not isinstance(value := vars(cls)[field.name], dataclasses.Field):
                new = dataclasses.field(default=value, metadata=field.metadata, kw_only=field.kw_only)
                setattr(cls, field.name, new)
    out = dataclasses.dataclass(frozen=True)(cls)
    if out.__doc__:  # python -OO has none
        wrap = textwrap.TextWrapper(100, initial_indent=" " * 4, subsequent_indent=" " * 8, break_on_hyphens=False)
        lines = [wrap.fill(describe_field(field)) for field in declared(out)]
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
        FILTERS[out.__name__] = out
    return out
