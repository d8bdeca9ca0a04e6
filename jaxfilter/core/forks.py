"""Forked processes: the threads of JAX and of the LAZ codec do not live on in them, and what waits for these hangs."""

from __future__ import annotations

import os

from .errors import ForkError

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
