"""What arguments of array operations may be: checked by name before they reach JAX, which wraps large integers in silence."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np

from .errors import InputError, ParameterError, check_whole

R = TypeVar("R")
_WHOLE = "int8 int16 int32 int64 uint8 uint16 uint32 uint64"
_REAL = f"bfloat16 float16 float32 float64 {_WHOLE}"
_KINDS = {"bool": "bool", "int": _WHOLE, "f32": "float32 float64", "real": _REAL, "number": _REAL}
_HELD = {"int": np.dtype(np.int32), "f32": np.dtype(np.float32), "number": np.dtype(np.float32)}
GRID, MASK = "f32[rows, columns]", "bool[rows, columns]"


def takes(**wanted: str | int | tuple[Any, ...]) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """A function that checks its arguments; of traced arrays types and shapes. What is None by default may be None.

    An array is stated as ``"f32[n, 2+]"``: its kind, then its sides: numbers, ``+`` for or more, or names, which have one length
    in all arguments; only ``n`` may be 0. Lists become arrays, ``int`` i32, into which all have to fit. ``f32`` may be float64,
    ``number`` anything real, and become f32. ``real`` stays what it is; without ``jax_enable_x64`` JAX holds 64 bits in 32, and
    integers have to fit. NaN is refused, but for ``"f32?[n]"``. Others are stated as the least of a whole number, or of several,
    or as what there is to choose from. Raises, when called: InputError for arrays, ParameterError for others.
    """

    def decorate(function: Callable[..., R]) -> Callable[..., R]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def checked(*args: Any, **named: Any) -> R:
            given, sides = signature.bind(*args, **named), dict[str, int]()
            for name, one in wanted.items():
                value = given.arguments.get(name, default := signature.parameters[name].default)
                if isinstance(one, int):
                    for part in value if isinstance(value, tuple) else (value,):
                        check_whole(one, **{name: part})
                elif isinstance(one, tuple) and value not in one:
                    raise ParameterError(f"{name}={value!r}: use {' or '.join(map(repr, one))}")
                elif isinstance(one, str) and value is not default:
                    given.arguments[name] = _array(name, value, one, sides)
            return function(*given.args, **given.kwargs)

        checked.lower = getattr(function, "lower", None)  # type: ignore[attr-defined]
        return checked

    return decorate


def operation(**wanted: str | int | tuple[Any, ...]) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """:func:`takes` for a function to compile; what is no array is static."""
    static = [name for name, one in wanted.items() if not isinstance(one, str)]
    return lambda function: takes(**wanted)(jax.jit(function, static_argnames=static))


def _array(name: str, value: Any, wanted: str, sides: dict[str, int]) -> Any:
    """The argument as an array, or the same Python number. ``sides``: lengths by name, to which new ones are added."""
    kind, _, shape = wanted[:-1].replace("?", "").partition("[")
    try:
        array = value if isinstance(value, jax.Array) else np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: an array is needed: {error}") from error
    dtype, here = array.dtype, [str(sides.get(side, side)) for side in shape.split(", ") if side]
    if np.ma.is_masked(value) or dtype.name not in _KINDS[kind].split():
        got = "masked" if np.ma.is_masked(value) else dtype
        raise InputError(f"{name} is {got}: an array of {_KINDS[kind].replace(' ', ', ')} is needed")
    if len(here) != array.ndim or not all(map(_fits, here, array.shape)):
        known = f", here ({', '.join(here)})" if sides else ""
        raise InputError(f"{name} of shape {array.shape}: [{shape}] is needed{known}; jax.vmap goes over several")
    sides.update(zip(shape.split(", "), array.shape, strict=False))
    held = (_HELD.get(kind) or jax.dtypes.canonicalize_dtype(dtype)).newbyteorder("=")
    if array.size > 0 and not isinstance(array, jax.core.Tracer):
        if held.kind in "iu" and held != dtype:
            least, most = int(np.asarray(array).min()), int(np.asarray(array).max())
            if least < np.iinfo(held).min or most > np.iinfo(held).max:
                raise InputError(f"{name} holds {least} to {most}: more than {held} has room for")
        if "?" not in wanted and dtype.name not in _WHOLE and np.isnan(np.asarray(array).min()):
            raise InputError(f"{name} has NaN: fill it, or leave it out")
    if type(value) in (bool, int, float):
        return value
    return array if held == dtype else array.astype(held)


def _fits(side: str, length: int) -> bool:
    if side[0].isdecimal():
        return length >= int(side[:-1]) if side[-1] == "+" else length == int(side)
    return length > 0 or side == "n"
