"""Who does the work of a run: this process, or processes on this machine, one task each at a time."""

from __future__ import annotations

import collections
import dataclasses
import errno
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures import Executor as Futures
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Protocol

from ..core.errors import JaxfilterError, OutputError
from ..core.process import unguarded
from ..core.result import Progress, silent
from .tiles import LOCAL, Local

RETRIES = 2
"""Times that a task that failed is tried again before it is set aside."""
_WAIT = 0.25  # seconds between ticks
_DEATHS = ("BrokenProcessPool", "KilledWorker")
"""What futures raise whose worker died."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a task: its value, or why there is none. ``full``: because a disk was, so that no other will do better."""

    value: Any = None
    reason: str | None = None
    full: bool = False


Take = Callable[[], tuple[Any, Callable[..., Any], tuple[Any, ...]] | None]
"""Gives a tag, a function and its picklable arguments; or None, if nothing is to be begun now."""


class Executor(Protocol):
    """Runs functions elsewhere, some at a time."""

    def outcomes(self, take: Take) -> Iterator[list[tuple[Any, Outcome]]]:
        """Tags and outcomes of what has ended, as soon as it has; now and then an empty list. ``take`` is called when one more
        can be begun. The end is when nothing runs and nothing is given. A worker that died is an outcome."""

    def close(self) -> None:
        """Stop at once whatever is running."""


class Task(NamedTuple):
    """Something to be done for a tile or a file.

    Attributes:
        function: called elsewhere with ``arguments``, and with whether it is the last try; number: of the tile or file.
    """

    function: Callable[..., Any]
    number: int
    arguments: tuple[Any, ...]


def carried_out(
    executor: Executor, todo: Iterator[Task], now: collections.deque[Task], tick: Callable[[], None]
) -> Iterator[tuple[Task, Outcome]]:
    """Tasks with their outcomes, in the order in which they end. What fails is tried again, :data:`RETRIES` times; the last time
    alone, so that no task is set aside for what another does, such as kill all workers.

    ``now`` holds tasks that come before the rest, and may be added to meanwhile; ``tick`` is called now and then.

    Raises: OutputError when a disk is full.
    """
    running, last, tries = 0, False, collections.Counter[tuple[Any, int]]()

    def take() -> tuple[Task, Callable[..., Any], tuple[Any, ...]] | None:
        nonlocal running, last
        task = None if last and running else now.popleft() if now else next(todo, None)
        if task is None:
            return None
        last = tries[task[:2]] == RETRIES
        if last and running:
            now.appendleft(task)
            return None
        running += 1
        return task, task.function, (*task.arguments, last)

    for ended in executor.outcomes(take):
        for task, outcome in ended:
            running -= 1
            if outcome.full:
                raise OutputError(f"{outcome.reason}; make room on the disk, and repeat the command")
            if outcome.reason is not None and tries[task[:2]] < RETRIES:
                tries[task[:2]] += 1
                now.appendleft(task)
            else:
                yield task, outcome
        tick()


def attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    """Call a function; what it raises becomes a reason."""
    try:
        return Outcome(function(*arguments))
    except MemoryError:
        return Outcome(reason="the memory did not suffice: pass a smaller tile=, or fewer workers=")
    except Exception as error:
        if type(error).__name__ in _DEATHS:
            return Outcome(reason="a worker died; where the memory was short, pass a smaller tile=")
        own = type(error).__module__.startswith("jaxfilter")
        words = " ".join((str(error) if own else f"{type(error).__name__}: {error}").split())
        cause: BaseException | None = error
        while cause is not None and getattr(cause, "errno", None) not in (errno.ENOSPC, errno.EDQUOT):
            cause = cause.__cause__
        return Outcome(reason=words, full=cause is not None)


class Here:
    """This process, one task at a time, which may use threads, and a callback for its progress."""

    def __init__(self, threads: int | None = 1, progress: Progress = silent) -> None:
        self._local = Local(threads, progress)

    def outcomes(self, take: Take) -> Iterator[list[tuple[Any, Outcome]]]:
        """One after the other."""
        while (given := take()) is not None:
            tag, function, arguments = given
            before = LOCAL.set(self._local)
            try:
                outcome = attempt(function, arguments)
            finally:
                LOCAL.reset(before)
            yield [(tag, outcome)]

    def close(self) -> None:
        """Nothing is running."""


class Pool:
    """Processes of this machine. They are spawned, since JAX must not be forked, and end with their parent."""

    _futures: Futures

    def __init__(self, workers: int) -> None:
        """The first worker is started, to know that it can be. Raises: JaxfilterError."""
        self._workers = workers
        self._begin()
        if self._futures.submit(os.getpid).exception() is not None:
            self.close()
            raise JaxfilterError(f"a worker process ended as it began; what it said stands above; {unguarded()}")

    def _begin(self) -> None:
        """Make the pool. Its workers hold one end of a pipe, and end when the other is closed, or this process ends."""
        context = multiprocessing.get_context("spawn")
        self._alive, theirs = context.Pipe()
        self._futures = ProcessPoolExecutor(self._workers, context, _begin_worker, (theirs,))

    def most(self) -> int:
        """How many tasks may be under way now."""
        return self._workers

    def outcomes(self, take: Take) -> Iterator[list[tuple[Any, Outcome]]]:
        """See :class:`Executor`. With a worker that died all end that were running, and the pool is made anew."""
        running: dict[Future[Outcome], Any] = {}
        while True:
            while len(running) < self.most() and (given := take()) is not None:
                tag, function, arguments = given
                try:
                    future = self._futures.submit(attempt, function, arguments)
                except BrokenProcessPool:
                    self.close()
                    self._begin()
                    future = self._futures.submit(attempt, function, arguments)
                running[future] = tag
            if not running:
                return
            done, _ = wait(running, _WAIT, FIRST_COMPLETED)
            found = [(running.pop(future), attempt(future.result, ())) for future in done]
            yield [(tag, outcome if outcome.reason is not None else outcome.value) for tag, outcome in found]

    def close(self) -> None:
        """End all processes."""
        self._alive.close()
        self._futures.shutdown(cancel_futures=True)


def _begin_worker(alive: Connection) -> None:
    """What a worker does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    os.environ.setdefault("RAYON_NUM_THREADS", "1")  # of the LAZ codec: one processor a worker
    threading.Thread(target=_end_with, args=(alive,), daemon=True).start()
    from ..core.compilation import keep_compilations
    from ..core.process import collect_seldom, share_heaps

    collect_seldom()
    share_heaps()
    keep_compilations()


def _end_with(alive: Connection) -> None:
    """End this process when the other end of a pipe is closed."""
    alive.poll(None)
    os._exit(1)
