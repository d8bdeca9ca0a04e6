"""Errors and warnings. Each message names the file, field or parameter, the offending value and what to do."""

import numbers
import sys
import warnings
import zipfile
import zlib
from collections.abc import Collection
from typing import Any

SIZES = (1e-9, 1e9)  # least and largest of a number that is not 0: what is beyond is a slip, and overflows somewhere
DAMAGED = (OSError, ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError)  # by odd JSON
DAMAGED_ARRAYS = (*DAMAGED, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)  # by odd files of NumPy


class JaxfilterError(Exception):
    """Base of every error that jaxfilter raises on purpose.

    >>> try:
    ...     jf.read("no_such_file.laz")
    ... except jf.JaxfilterError as error:
    ...     print(type(error).__name__)
    InputError
    """


class ParameterError(JaxfilterError, ValueError):
    """A filter or function parameter is out of range, unknown or contradictory.

    >>> jf.SMRF(cell=-1)
    Traceback (most recent call last):
        ...
    jaxfilter.core.errors.ParameterError: SMRF(cell=-1): must be > 0 m
    """


class InputError(JaxfilterError, ValueError):
    """A file or an array cannot be used as a point cloud.

    >>> jf.PointCloud.from_arrays(np.full((3, 3), np.nan))
    Traceback (most recent call last):
        ...
    jaxfilter.core.errors.InputError: xyz: 3 of 3 points have NaN or infinite coordinates; remove them, or pas...
    """


class OutputError(JaxfilterError, OSError):
    """An output cannot be written: it exists, cannot hold the values, or the disk refused.

    >>> jf.write("scene.laz", cloud, result)
    Traceback (most recent call last):
        ...
    jaxfilter.core.errors.OutputError: scene.laz: the file exists; pass overwrite=True to replace it
    """


class ForkError(JaxfilterError, RuntimeError):
    """The process was forked after threads had been started that it needs.

    >>> issubclass(jf.ForkError, (jf.JaxfilterError, RuntimeError))
    True
    """


class JaxfilterWarning(UserWarning):
    """Something unusual was met and handled as the message says.

    >>> import warnings
    >>> warnings.simplefilter("ignore", jf.JaxfilterWarning)
    """


def warn(message: str) -> None:
    """Give a :class:`JaxfilterWarning` for the line outside this package that led here."""
    package = __name__.partition(".")[0]
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, JaxfilterWarning, stacklevel=level)


def check_positive(unit: str = "", **values: float | None) -> None:
    """Raises: ParameterError for what is not above 0, or beyond :data:`SIZES`; None stands for nothing. ``unit``: in words."""
    for name, value in values.items():
        try:
            good = value is None or (not isinstance(value, (str, bool)) and SIZES[0] <= float(value) <= SIZES[1])
        except (TypeError, ValueError, OverflowError):
            good = False
        if not good:
            raise ParameterError(f"{name}={value!r}: must be a positive number{unit}, {SIZES[0]:g} to {SIZES[1]:g}")


def check_whole(least: int = 1, most: Any = float("inf"), /, **values: Any) -> None:
    """Raises: ParameterError for what is no whole number, below ``least``, or above ``most``."""
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least or value > most:
            limit = f", at most {most:,}" * (most < float("inf"))
            raise ParameterError(f"{name}={value!r}: must be a whole number, at least {least}{limit}")


def check_choice(choices: Collection[Any], /, **values: Any) -> None:
    """Raises: ParameterError for what is none of the choices."""
    for name, value in values.items():
        if value not in choices:
            raise ParameterError(f"{name}={value!r}: choose one of {', '.join(map(repr, choices))}")
