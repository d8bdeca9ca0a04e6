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
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Protocol

from ..core.errors import JaxfilterError, OutputError
from ..core.process import unguarded
from ..core.result import Progress, silent
from .tiles import LOCAL, Local

RETRIES = 2
"""Times that a task that failed is tried again before it is set aside."""
_WAIT = 0.25  # seconds between ticks


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a task: its value, or why there is none. ``full``: because a disk was, so that no other will do better;
    ``died``: because a worker did, which this task may have killed, or another that ran at the same time."""

    value: Any = None
    reason: str | None = None
    full: bool = False
    died: bool = False


class Executor(Protocol):
    """Runs functions of picklable arguments elsewhere, some at a time."""

    def room(self) -> int:
        """How many further tasks may be submitted now."""

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Begin a task, which is known by its tag; only while there is room."""

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended; waits so long for the first of them. A worker that died is an outcome."""

    def close(self) -> None:
        """Stop at once whatever is running."""


@dataclasses.dataclass(frozen=True)
class Task:
    """Something to be done for a tile or a file.

    Attributes:
        function: called elsewhere with what ``arguments`` returns; number: of the tile or file.
        arguments: called when the task is submitted, with whether it is the last try.
    """

    function: Callable[..., Any]
    number: int
    arguments: Callable[[bool], tuple[Any, ...]]


def carried_out(
    executor: Executor,
    todo: Iterator[Task],
    now: collections.deque[Task],
    tick: Callable[[], None],
) -> Iterator[tuple[Task, Outcome]]:
    """Tasks with their outcomes, in the order in which they end. What fails is tried again, :data:`RETRIES` times; the last time
    alone, if a worker died meanwhile, so that a task is not set aside for what another does.

    ``now`` holds tasks that come before the rest, and may be added to meanwhile; ``tick`` is called now and then.

    Raises: OutputError when a disk is full.
    """
    running, alone = 0, False
    tries, suspects = collections.Counter[Task](), set[Task]()
    while True:
        while executor.room() > 0 and not (alone and running):
            task = now.popleft() if now else next(todo, None)
            if task is None:
                break
            last = tries[task] >= RETRIES
            alone = last and task in suspects
            if alone and running:
                now.appendleft(task)
                break
            executor.submit(task, task.function, *task.arguments(last))
            running += 1
        if not running:
            return
        for task, outcome in executor.completed(_WAIT):
            running -= 1
            if outcome.full:
                raise OutputError(f"{outcome.reason}; make room, then pass resume=True to go on")
            if outcome.reason is not None and tries[task] < RETRIES:
                tries[task] += 1
                now.appendleft(task)
                if outcome.died:
                    suspects.add(task)
                continue
            yield task, outcome
        tick()


def attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    """Call a function; what it raises becomes a reason."""
    try:
        return Outcome(function(*arguments))
    except MemoryError:
        return Outcome(reason="the memory did not suffice: pass a smaller tile=, or fewer workers=")
    except Exception as error:
        own = type(error).__module__.startswith("jaxfilter")
        words = str(error) if own else f"{type(error).__name__}: {error}"
        return Outcome(reason=" ".join(words.split()), full=_is_full(error))


class Here:
    """This process, one task at a time, which may use threads, and a callback for its progress."""

    def __init__(self, threads: int | None = 1, progress: Progress = silent) -> None:
        self._local = Local(threads, progress)
        self._waiting: list[tuple[Any, Callable[..., Any], tuple[Any, ...]]] = []

    def room(self) -> int:
        """One, if nothing waits."""
        return 1 - len(self._waiting)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Keep a task for ``completed``."""
        self._waiting.append((tag, function, arguments))

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Do what waits."""
        tag, function, arguments = self._waiting.pop()
        before = LOCAL.set(self._local)
        try:
            return [(tag, attempt(function, arguments))]
        finally:
            LOCAL.reset(before)

    def close(self) -> None:
        """Nothing is running."""


def _is_full(error: BaseException | None) -> bool:
    """Whether an error, or what it comes from, is that of a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        error = error.__cause__
    return False


def outcome_of(future: Any, death: type[Exception]) -> Outcome:
    """What became of a call of :func:`attempt`, by its future, which is done. ``death``: what it raises if a worker died."""
    if isinstance(future.exception(), death):
        return Outcome(reason="a worker died; where the memory was short, pass a smaller tile=", died=True)
    found = attempt(future.result, ())
    return found if found.reason is not None else found.value


class Pool:
    """Processes of this machine. They are spawned, since JAX must not be forked, and end with their parent."""

    def __init__(self, workers: int) -> None:
        """The first worker is started, to know that it can be. Raises: JaxfilterError."""
        self._size = workers
        self._running: dict[Future[Outcome], Any] = {}
        self._begin()
        try:
            self._pool.submit(os.getpid).result()
        except BaseException as error:
            self.close()
            if isinstance(error, BrokenProcessPool):
                raise JaxfilterError(
                    f"a worker process ended as it began; what it said stands above; {unguarded()}"
                ) from error
            raise

    def _begin(self) -> None:
        """Make the pool. Its workers hold one end of a pipe, and end when the other is closed, or this process ends."""
        context = multiprocessing.get_context("spawn")
        self._alive, theirs = context.Pipe()
        self._pool = ProcessPoolExecutor(self._size, context, _begin_worker, (theirs,))

    def room(self) -> int:
        """Workers without a task."""
        return self._size - len(self._running)

    def submit(self, tag: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Give a task to a worker. A pool that broke, since a worker died, is made anew."""
        try:
            future = self._pool.submit(attempt, function, arguments)
        except BrokenProcessPool:
            self.close()
            self._begin()
            future = self._pool.submit(attempt, function, arguments)
        self._running[future] = tag

    def completed(self, seconds: float) -> list[tuple[Any, Outcome]]:
        """Tasks that have ended, see :class:`Executor`. With a worker that died all end that were running."""
        done, _ = wait(self._running, seconds, FIRST_COMPLETED)
        return [(self._running.pop(future), outcome_of(future, BrokenProcessPool)) for future in done]

    def close(self) -> None:
        """End all processes."""
        self._alive.close()
        self._pool.shutdown(cancel_futures=True)


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
