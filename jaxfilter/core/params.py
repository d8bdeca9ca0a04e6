"""Filter parameters: a filter *is* its parameters, a frozen dataclass that is also a JAX pytree.

Fields made with :func:`param` are traced leaves (thresholds: one compilation serves all values, ``vmap`` may sweep
them). Fields made with :func:`static` fix array shapes or choose between code paths; they are part of the tree
structure, so a new value compiles anew. Each field carries its paper symbol, unit and admissible range once; errors,
command-line flags and documentation are derived from there.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar, dataclass_transform

import jax

from .errors import ParameterError

T = TypeVar("T")


def _field(default: Any, is_static: bool, meta: dict[str, Any]) -> Any:
    return dataclasses.field(default=default, metadata={"static": is_static, **meta})


def param(
    default: float,
    *,
    doc: str,
    symbol: str = "",
    unit: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
) -> Any:
    """Declare a traced threshold with its documentation and admissible range."""
    return _field(default, False, {"doc": doc, "symbol": symbol, "unit": unit, "gt": gt, "ge": ge, "lt": lt, "le": le})


def static(
    default: Any,
    *,
    doc: str,
    symbol: str = "",
    unit: str = "",
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    choices: tuple[Any, ...] | None = None,
    optional: bool = False,
) -> Any:
    """Declare a static field (fixes shapes or picks a code path). ``optional`` fields may be None ("off")."""
    meta = {"doc": doc, "symbol": symbol, "unit": unit, "gt": gt, "ge": ge, "lt": lt, "le": le}
    return _field(default, True, {**meta, "choices": choices, "optional": optional})


class Preset(dict[str, Any]):
    """Field values of a named set, and ``note``: one line that says what the set is.

    The note of "paper" begins with "as printed", or "as reported" where the original was not at hand, and names what is not.
    """

    def __init__(self, note: str, /, **fields: Any) -> None:
        super().__init__(fields)
        self.note = note


class _Registry(Mapping[str, type[Any]]):
    """Filter classes by name; look-ups ignore case, iteration gives the lower-case names."""

    def __init__(self) -> None:
        self._classes: dict[str, type[Any]] = {}

    def add(self, cls: type) -> None:
        self._classes[cls.__name__.lower()] = cls

    def __getitem__(self, name: str) -> type[Any]:
        try:
            return self._classes[name.lower()]
        except KeyError:
            known = ", ".join(self._classes)
            raise KeyError(f"no filter named {name!r}; known filters: {known}") from None

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and name.lower() in self._classes

    def __iter__(self) -> Iterator[str]:
        return iter(self._classes)

    def __len__(self) -> int:
        return len(self._classes)


FILTERS = _Registry()
"""Every filter class by name, for example ``FILTERS["fptd"]``."""


def _is_number(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def declared(params: Any) -> list[dataclasses.Field[Any]]:
    """The fields of a filter, class or instance, in the order of its signature: a method's own before those it shares."""
    return sorted(dataclasses.fields(params), key=lambda field: bool(field.kw_only))


def check_fields(params: Any) -> None:
    """Validate every field of ``params`` against its declaration.

    Leaves that are not plain numbers (tracers, batched arrays, the placeholders of tree transformations) are left
    alone, since ``__post_init__`` also runs when a tree is rebuilt inside ``jit`` or ``vmap``.

    Raises: ParameterError naming class, field, value and range.
    """
    name = type(params).__name__
    for f in dataclasses.fields(params):
        value, meta = getattr(params, f.name), f.metadata
        choices = meta.get("choices")
        if choices is not None:
            if value not in choices:
                raise ParameterError(f"{name}({f.name}={value!r}): choose one of {', '.join(map(repr, choices))}")
            continue
        if value is None and meta.get("optional"):
            continue
        if not _is_number(value):
            wants_number = any(meta.get(k) is not None for k in ("gt", "ge", "lt", "le"))
            if wants_number and (value is None or isinstance(value, (str, bytes, bool))):
                raise ParameterError(f"{name}({f.name}={value!r}): a number is needed")
            continue
        limits = [
            ("gt", ">", lambda v, b: v > b),
            ("ge", ">=", lambda v, b: v >= b),
            ("lt", "<", lambda v, b: v < b),
            ("le", "<=", lambda v, b: v <= b),
        ]
        active = [(sign, meta[key], ok) for key, sign, ok in limits if meta.get(key) is not None]
        if math.isnan(value) or not all(ok(value, bound) for _, bound, ok in active):
            wanted = " and ".join(f"{sign} {bound:g}" for sign, bound, _ in active) or "a number"
            unit = f" {meta['unit']}" if meta.get("unit") else ""
            raise ParameterError(f"{name}({f.name}={value!r}): must be {wanted}{unit}")


@dataclass_transform(frozen_default=True, kw_only_default=False, field_specifiers=(param, static))
def filter_params(cls: type[T]) -> type[T]:
    """Class decorator: frozen dataclass, registered as a pytree and, if it is a filter, in :data:`FILTERS`."""
    out = dataclasses.dataclass(frozen=True)(cls)
    names = dataclasses.fields(out)  # type: ignore[arg-type]
    jax.tree_util.register_dataclass(
        out,
        data_fields=[f.name for f in names if not f.metadata.get("static")],
        meta_fields=[f.name for f in names if f.metadata.get("static")],
    )
    if callable(getattr(out, "classify", None)):
        FILTERS.add(out)
    return out
