"""Commands as tests call them: in this process, with what they print and their exit code."""

from __future__ import annotations

import json

from click.testing import CliRunner, Result

from jaxfilter.cli import main


def run(*words: object) -> Result:
    """A command by its words, such as ``run("ground", "smrf", path, "--quiet")``."""
    return CliRunner().invoke(main, [str(word) for word in words])


def done(*words: object) -> Result:
    """A command that has to succeed."""
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result


def facts(*words: object):
    """What a command that has to succeed reports as JSON."""
    return json.loads(done(*words, "--json").stdout)


def assert_one_line(result: Result, exit_code: int, *words: str) -> None:
    """An error is one line with these words; lines of warnings may stand beside it."""
    assert result.exit_code == exit_code, result.output
    lines = [line for line in result.stderr.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1 and lines[0].startswith("Error: "), result.stderr
    for word in words:
        assert word in lines[0], lines[0]
