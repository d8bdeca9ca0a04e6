"""Errors and warnings. Each message names the file, field or parameter, the offending value and what to do."""

import sys
import warnings


class JaxfilterError(Exception):
    """Base of every error that jaxfilter raises on purpose."""


class ParameterError(JaxfilterError, ValueError):
    """A filter or function parameter is out of range, unknown or contradictory."""


class InputError(JaxfilterError, ValueError):
    """A file or an array cannot be used as a point cloud."""


class OutputError(JaxfilterError, OSError):
    """An output cannot be written: it exists, cannot hold the values, or the disk refused."""


class ForkError(JaxfilterError, RuntimeError):
    """The process was forked after threads had been started that it needs."""


class JaxfilterWarning(UserWarning):
    """Something unusual was met and handled as the message says."""


def warn(message: str) -> None:
    """Give a :class:`JaxfilterWarning` for the line outside this package that led here."""
    package = __name__.partition(".")[0]
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, JaxfilterWarning, stacklevel=level)
