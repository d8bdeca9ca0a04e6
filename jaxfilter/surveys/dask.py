"""A Dask cluster as the executor of a run. Needs the extra ``cluster``."""

from __future__ import annotations

from typing import Any

from ..core.errors import InputError, warn
from .executors import Pool

_AHEAD = 2
"""Tasks in flight per thread of the cluster, so that no worker waits for the next one and few are lost with it."""


class Cluster(Pool):
    """Workers of a Dask cluster, which see the input files and the output folder by the same names as this process.

    Only paths and numbers travel. The scheduler never holds more than a few tasks per worker; those of a worker that dies are
    given to others.
    """

    def __init__(self, client: Any) -> None:
        """``client``: a ``dask.distributed.Client``, or the address of a scheduler.

        Raises: InputError if the scheduler cannot be reached; ImportError if Dask is missing.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise ImportError("a Dask cluster needs dask: pip install 'jaxfilter[cluster]'") from error
        self._own = isinstance(client, str)
        if self._own:
            try:
                client = Client(client, timeout=10, set_as_default=False)
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(f"scheduler {client}: cannot be reached: {error}") from error
        self._client, self._futures = client, client.get_executor(pure=False)
        if max(client.nthreads().values(), default=1) > 1:
            warn(
                "workers of the cluster have several threads: start them with --nthreads 1, so that memory is as planned"
            )

    def most(self) -> int:
        """Tasks that the workers there are now may be given."""
        return max(1, _AHEAD * sum(self._client.nthreads().values()))

    def close(self) -> None:
        """Cancel what is in flight; a client that was made here is closed."""
        self._futures.shutdown(wait=False)
        if self._own:
            self._client.close()
