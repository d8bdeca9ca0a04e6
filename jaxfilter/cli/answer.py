"""How commands that work run: in a session, with one way to print what they found."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import click

from .output import print_json
from .session import Session, session_options


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a command has found.

    Attributes:
        facts: printed by --json.
        show: text for people, or what prints it.
        always: printed with --quiet as well.
        complete: False: something could not be done, and the exit code is 1.
    """

    facts: dict[str, Any]
    show: str | Callable[[], None]
    always: bool = False
    complete: bool = True


def in_session(command: Callable[..., Answer]) -> Callable[..., None]:
    """A decorator: ``command`` gets a Session before its arguments, and the options of all commands that work."""

    @functools.wraps(command)
    def run(*, quiet: bool, as_json: bool, debug: bool, **arguments: Any) -> None:
        with Session(quiet=quiet, debug=debug) as session:
            answer = command(session, **arguments)
        if as_json:
            print_json(answer.facts)
        elif answer.always or not quiet:
            click.echo(answer.show) if isinstance(answer.show, str) else answer.show()
        if not answer.complete:
            click.get_current_context().exit(1)

    run.__dict__["__click_params__"] = session_options()[::-1]
    return run
