"""Forked processes: the threads of JAX and of the LAZ codec do not live on in them, and what waits for these hangs."""

from __future__ import annotations

import os

from .errors import ForkError

_started = False
_lost = False


def need_threads() -> None:
    """Called before JAX computes and before LAZ is coded.

    Raises: ForkError in a process that was forked from one in which this had been called.
    """
    global _started
    if _lost:
        raise ForkError(
            f"process {os.getpid()} was forked from one in which jaxfilter had started the threads of JAX or of the LAZ codec, "
            "which it does not have: make processes with multiprocessing.get_context('spawn'), or 'forkserver'"
        )
    _started = True


def _after_fork() -> None:
    global _lost
    _lost = _started


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
