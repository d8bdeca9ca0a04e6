"""Compiled host loops: kept on disk where that can be, compiled all the same where not."""

import os
import subprocess
import sys
import warnings

import pytest

from jaxfilter import JaxfilterWarning
from jaxfilter.host import compiled as module
from jaxfilter.host.compiled import compiled

COLLATZ = """
def collatz(n):
    steps = 0
    while n > 1:
        n = n // 2 if n % 2 == 0 else 3 * n + 1
        steps += 1
    return steps
"""


def from_no_file():
    """A function that Numba cannot keep: no file holds it."""
    space = {}
    exec(COLLATZ, space)
    return space["collatz"]


def test_a_function_that_cannot_be_kept_is_compiled_all_the_same_and_that_is_said_once():
    module._say_uncached.cache_clear()
    with pytest.warns(JaxfilterWarning, match="NUMBA_CACHE_DIR") as said:
        first = compiled(from_no_file())
    assert len(said) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        second = compiled(from_no_file())
    assert first(27) == second(27) == from_no_file()(27) == 111
    assert first.signatures


def test_what_is_compiled_is_kept_where_the_user_says(tmp_path):
    script = (
        "from jaxfilter.host.predicates import in_circle; print(in_circle(0, 0, 4, 0, 0, 4, 3, 3), in_circle.stats)"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment).stdout
        for _ in range(2)
    ]
    assert all(text.startswith("True") and str(tmp_path) in text for text in said)
    assert "cache_hits=Counter()" in said[0] and "cache_hits=Counter({" in said[1]
    assert list(tmp_path.rglob("*.nbi"))
