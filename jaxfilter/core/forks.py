"""Threads of this process: forks do not have those of JAX and of the LAZ codec, and few heaps serve them all."""

from __future__ import annotations

import contextlib
import ctypes
import os

from .errors import ForkError

_M_ARENA_MAX = -8  # of malloc.h
_owner: int | None = None
"""The process that has started the threads."""


def need_threads() -> None:
    """Called before JAX computes and before LAZ is coded.

    Raises: ForkError in a process that was forked from one in which this had been called.
    """
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
