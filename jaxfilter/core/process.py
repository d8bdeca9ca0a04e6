"""This process: forks do not have the threads of JAX and of the LAZ codec, few heaps serve all threads, and garbage is small."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import os
import sys

from .errors import ForkError, JaxfilterError

_M_ARENA_MAX = -8  # of malloc.h
_owner: int | None = None
"""The process that has started the threads."""


def need_threads() -> None:
    """Called before JAX computes and before LAZ is coded. Raises: ForkError in a process that was forked from one in which
    this had been called."""
    global _owner
    if _owner not in (None, os.getpid()):
        raise ForkError(
            f"process {os.getpid()} was forked from one in which jaxfilter had started the threads of JAX or of the LAZ codec, "
            "which it does not have: make processes with multiprocessing.get_context('spawn'), or 'forkserver'"
        )
    _owner = os.getpid()


def share_heaps() -> None:
    """Let all threads share two heaps of the C library where that is glibc: with one for each thread, as it is by default, memory
    that one has freed serves no other. Commands and workers call it; it saves an eighth of the memory of OST."""
    with contextlib.suppress(AttributeError, OSError, TypeError):  # another C library
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)


def collect_seldom() -> None:
    """Look for garbage in circles of references once in a million new objects, and not at the end. Commands and workers call
    it: imports and compilation make that many objects, nearly all of which stay, and the search takes a third of the time of
    a small file."""
    gc.set_threshold(1_000_000)
    atexit.register(gc.freeze)


def check_main() -> None:
    """Raises JaxfilterError in a process that is being spawned, and so imports a script that comes here: it would start processes
    for ever."""
    import multiprocessing

    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise JaxfilterError(unguarded())


def unguarded() -> str:
    """What to do where a script starts workers as it is imported."""
    script = getattr(sys.modules["__main__"], "__file__", None) or "the script"
    return (
        f"{script}: processes that it starts import it, and would begin the run again: put what it does under "
        'if __name__ == "__main__":'
    )
