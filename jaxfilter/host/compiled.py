"""Host loops as machine code: Numba, without the GIL, kept on disk between processes."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numba

from ..core.errors import warn


def compiled(function: Callable[..., Any] | None = None, *, fused: bool = False) -> Callable[..., Any]:
    """The function, compiled at its first call for the types of its arguments.

    What is compiled is kept beside the module, or in the user's cache folder (``NUMBA_CACHE_DIR`` sets another), and read by
    the next process. Where neither can be written, each process compiles for itself, and says so once.

    ``fused``: a product and the sum it goes into may be one instruction, which rounds once instead of twice, as XLA does.
    """
    if function is None:
        return functools.partial(compiled, fused=fused)
    fastmath: Any = {"contract"} if fused else False
    try:
        return numba.njit(nogil=True, cache=True, fastmath=fastmath)(function)
    except RuntimeError:  # Numba found no folder
        _say_uncached()
        return numba.njit(nogil=True, fastmath=fastmath)(function)


@functools.cache
def _say_uncached() -> None:
    warn(
        "compiled code cannot be kept on disk, since neither the folder of jaxfilter nor the user's cache folder can be "
        "written: every process compiles for some seconds. Set NUMBA_CACHE_DIR to a folder that can be written"
    )
