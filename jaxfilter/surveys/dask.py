"""A Dask cluster as the executor of a run. Needs the extra ``cluster``."""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable
from typing import Any

from ..core.errors import InputError, warn
from .executors import Outcome, attempt, outcome_of

_AHEAD = 2
"""Tasks in flight per thread of the cluster, so that no worker waits for the next one and few are lost with it."""
_ASK = 1.0  # seconds between questions for the workers there are


class Cluster:
    """Workers of a Dask cluster, which see the input files and the output folder by the same names as this process.

    Only paths and numbers travel. The scheduler never holds more than a few tasks per worker; those of a worker that dies are
    given to others.
    """

    def __init__(self, client: Any) -> None:
        """``client``: a ``dask.distributed.Client``, or the address of a scheduler.

        Raises: InputError if the scheduler cannot be reached; ImportError if Dask is missing.
        """
        try:
            from distributed import Client, KilledWorker
        except ImportError as error:
            raise ImportError("a Dask cluster needs dask: pip install 'jaxfilter[cluster]'") from error
        self._own = isinstance(client, str)
        if self._own:
            try:
                client = Client(client, timeout=10, set_as_default=False)
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(f"scheduler {client}: cannot be reached: {error}") from error
        self._client, self._death = client, KilledWorker
        self._running: dict[Any, Any] = {}
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._most, self._asked = 0, -math.inf
        if max(client.nthreads().values(), default=1) > 1:
            warn(
                "workers of the cluster have several threads: start them with --nthreads 1, so that memory is as planned"
            )

    def room(self) -> int:
        """Tasks that the workers there are now may be given, as of a second ago at most."""
        if time.monotonic() - self._asked > _ASK:
            self._most, self._asked = _AHEAD * sum(self._client.nthreads().values()), time.monotonic()
        return max(1, self._most) - len(self._running)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Give a task to the scheduler."""
        future = self._client.submit(attempt, function, arguments, pure=False)
        self._running[future] = tag
        future.add_done_callback(self._ended.put)

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended, see :class:`jaxfilter.surveys.executors.Executor`."""
        try:
            done = [self._ended.get(timeout=seconds)]
        except queue.Empty:
            return []
        done += [self._ended.get() for _ in range(self._ended.qsize())]
        return [(self._running.pop(future), outcome_of(future, self._death)) for future in done]

    def close(self) -> None:
        """Cancel what is in flight; a client that was made here is closed."""
        if self._running:
            self._client.cancel(list(self._running))
        self._running = {}
        if self._own:
            self._client.close()
