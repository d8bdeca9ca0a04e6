"""What every command that works has in common: progress, warnings and errors as lines, timing, the compile cache."""

from __future__ import annotations

import contextlib
import math
import os
import re
import signal
import threading
import time
import warnings
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import Any, Self

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from ..core.errors import JaxfilterError, JaxfilterWarning, ParameterError


class BadUsage(click.ClickException):
    """Wrong usage that is found before anything is read: one line, exit code 2."""

    exit_code = 2


class Stopped(KeyboardInterrupt):
    """A signal asked the command to stop; clean-up runs as it does for Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


_STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """A block that SIGINT (Ctrl-C), SIGTERM and SIGHUP end in order: what is unfinished is removed, one line is printed,
    and the exit code is 128 and the number of the signal. A signal that was ignored before stays so, as nohup wants it."""
    old = {}
    if threading.current_thread() is threading.main_thread():
        heard = [number for number in _STOPS if signal.getsignal(number) not in (signal.SIG_IGN, None)]
        old = {number: signal.signal(number, _stop) for number in heard}
    try:
        yield
    except KeyboardInterrupt as error:
        number = getattr(error, "number", signal.SIGINT)
        notes = getattr(error, "__notes__", [])
        click.echo("; ".join([f"stopped by {signal.Signals(number).name}", *notes]), err=True)
        raise SystemExit(128 + number) from None
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)


def _stop(number: int, frame: FrameType | None) -> None:
    if not Session.running:  # nothing to clean up yet, and JAX aborts when its import is interrupted by an exception
        os.write(2, f"stopped by {signal.Signals(number).name}\n".encode())
        os._exit(128 + number)
    if frame is not None and frame.f_code.co_name == "_xla_gc_callback":  # what is raised there is ignored, and printed
        threading.Timer(0.01, os.kill, (os.getpid(), number)).start()
        return
    Session.stopped_by = number
    for other in _STOPS:
        if other != signal.SIGINT:  # Ctrl-C can end a clean-up that hangs, the others come in pairs
            signal.signal(other, signal.SIG_IGN)
    raise Stopped(number)


def session_options() -> list[click.Parameter]:
    """The options of every command that works."""
    return [
        click.Option(["--quiet", "-q"], is_flag=True, help="No progress and no summary; warnings remain."),
        click.Option(["--json", "as_json"], is_flag=True, help="Print the result as JSON."),
        click.Option(["--debug"], is_flag=True, help="Show the traceback of an error."),
    ]


def in_flags(text: str) -> str:
    """A message of the library in the words of the running command: ``pass drop_invalid=True`` becomes
    ``pass --drop-invalid``. Arguments that the command has no flag for stay."""
    context = click.get_current_context(silent=True)
    options = {p.name: p for p in context.command.params if isinstance(p, click.Option)} if context else {}

    def flag(found: re.Match[str]) -> str:
        option = options.get(found[1])
        if option is None:
            return found[0]
        return f"pass {option.opts[0]}" + (f" {found[2]}" if found[2] and not option.is_flag else "")

    return re.sub(r"\bpass (\w+)=([\w.]*)", flag, " ".join(text.split()))


class Session:
    """A context in which a command runs.

    Messages go to standard error, one line each. Errors of this package and of the system become one line and an exit
    code: 2 for parameters, 1 for the rest. Compilations are counted and kept for the next process.
    """

    running = 0
    """How many there are now."""
    stopped_by: int | None = None
    """The signal that ``stoppable`` has received in them."""

    def __init__(self, *, quiet: bool, debug: bool, remaining: bool = False) -> None:
        """``remaining`` shows the time left in a step as well, by its mean rate so far."""
        self.debug = debug
        self.seconds: dict[str, float] = {}
        self.steps: dict[str, float] = {}
        self.warnings: list[str] = []
        self._console = Console(stderr=True, soft_wrap=True, markup=False, highlight=False)
        self._bar = Progress(
            TextColumn("{task.description:24}"),
            BarColumn(),
            TimeElapsedColumn(),
            *([TextColumn("left"), TimeRemainingColumn()] if remaining else []),
            transient=True,
            speed_estimate_period=math.inf,
            console=self._console,
            disable=quiet or not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=1.0)
        self._stack = contextlib.ExitStack()
        self._mark = ("", 0.0)
        self._begun = False

    def __enter__(self) -> Self:
        from ..core import compilation

        compilation.watch_compilations()
        compilation.use_persistent_cache()
        self._stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("always", JaxfilterWarning)
        warnings.showwarning = self._warn
        self._stack.enter_context(self._bar)
        Session.running, Session.stopped_by = Session.running + 1, None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._stack.close()
        finally:
            Session.running -= 1
        if Session.stopped_by is not None and not isinstance(error, KeyboardInterrupt):
            raise Stopped(Session.stopped_by)  # finalisers and decoders had swallowed it
        if error is None or self.debug or not isinstance(error, Exception) or isinstance(error, click.ClickException):
            return
        if isinstance(error, ParameterError):
            raise BadUsage(in_flags(str(error))) from error
        text = in_flags(str(error)) if isinstance(error, JaxfilterError) else f"{type(error).__name__}: {error}"
        raise click.ClickException(" ".join(text.split())) from error

    @contextlib.contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Show and time a step of the command."""
        start = time.perf_counter()
        self._bar.reset(self._task, description=name)
        self._begun = False
        yield
        self._next("")
        self.seconds[name] = time.perf_counter() - start

    @property
    def is_terminal(self) -> bool:
        """Whether there is one to show progress on."""
        return self._console.is_terminal

    def progress(self, fraction: float, step: str, note: str = "") -> None:
        """The callback for a filter: shows the fraction done, with a note, and adds up seconds by step."""
        self._next(step)
        if not self._begun:  # what a resumed sweep had done before does not count as speed
            self._bar.reset(self._task)
            fraction, self._begun = max(fraction, 1e-9), True
        self._bar.update(self._task, description=f"{step} {note}".rstrip(), completed=fraction)

    def _next(self, step: str) -> None:
        if Session.stopped_by is not None:  # see __exit__
            raise Stopped(Session.stopped_by)
        now = time.perf_counter()
        running, since = self._mark
        if running:
            self.steps[running] = self.steps.get(running, 0.0) + now - since
        self._mark = (step, now)

    def _warn(self, message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
        text = in_flags(str(message))
        self.warnings.append(text)
        self._console.print(f"warning: {text}")

    def as_dict(self) -> dict[str, Any]:
        """Seconds by step of the command and of the filter, compilations, and warnings."""
        from ..core.compilation import compilations

        count, seconds = compilations()
        return {
            "seconds": self.seconds,
            "filter_seconds": self.steps,
            "compilations": {"count": count, "seconds": seconds},
            "warnings": self.warnings,
        }
