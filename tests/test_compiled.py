"""Compiled host loops: kept on disk where that can be, compiled all the same where not; interrupts come through."""

import ctypes
import importlib
import os
import signal
import subprocess
import sys
import warnings

import jax
import numba
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache as jax_cache

from jaxfilter import JaxfilterWarning
from jaxfilter.cli.session import Session
from jaxfilter.core import compilation
from jaxfilter.engines import compiled as module
from jaxfilter.engines.compiled import compiled
from jaxfilter.surveys.report import collected_warnings


def collatz(n):
    steps = 0
    while n > 1:
        n = n // 2 if n % 2 == 0 else 3 * n + 1
        steps += 1
    return steps


@pytest.fixture(autouse=True)
def nothing_said(monkeypatch):
    """As in a new process."""
    monkeypatch.setattr(compilation, "_troubles", [])
    compilation.private_folder.cache_clear()


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A cache folder in which machine code of ``collatz`` lies."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compiled(collatz)(27) == 111
    return tmp_path / "kept"


def hits():
    """How often code from the disk is used by a new process."""
    function = compiled(collatz)
    assert function(27) == 111
    return sum(function.stats.cache_hits.values())


def flip(file):
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def replace_by_folder(file):
    file.unlink()
    file.mkdir()


DAMAGES = {
    "empty": lambda file: file.write_bytes(b""),
    "cut": lambda file: file.write_bytes(file.read_bytes()[:-100]),
    "zeros": lambda file: file.write_bytes(bytes(file.stat().st_size)),
    "one bit": flip,
    "text": lambda file: file.write_text("no code"),
    "folder": replace_by_folder,
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_told_of_once_and_made_anew(damage, kept):
    [file] = kept.iterdir()
    DAMAGES[damage](file)
    with pytest.warns(JaxfilterWarning, match="cannot be read or kept here.*JAXFILTER_CACHE") as said:
        assert hits() == 0
        if damage == "folder":
            assert hits() == 0
            return
        assert hits() == 1, "the run made it anew"
    assert len(said) == 1 and str(kept) in str(said[0].message)


def test_the_folder_is_private_and_what_other_versions_kept_is_no_matter(kept, monkeypatch):
    assert kept.stat().st_mode & 0o777 == 0o700
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert hits() == 1
        monkeypatch.setattr(numba, "__version__", "0.1")
        assert (hits(), hits()) == (0, 1)
    assert len(list(kept.iterdir())) == 1, "an older one is replaced"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners and modes here")
@pytest.mark.parametrize(("place", "mode", "said"), [
    ("kept", 0o777, "others may write"), ("kept", 0o720, "others may write"), ("kept", 0o1777, "others may write"),
    ("", 0o770, "others may write"), ("", 0o1777, None), ("kept", 0o755, None), ("kept", None, "belongs to user"),
])  # fmt: skip
def test_a_folder_that_others_may_write_to_is_not_used(place, mode, said, kept, monkeypatch):
    compilation.private_folder.cache_clear()
    if mode is None:
        owner = os.getuid()
        monkeypatch.setattr(os, "getuid", lambda: owner + 1)
        os.chown(kept, owner or 4321, -1)  # what belongs to root is trusted
    else:
        (kept.parent / place).chmod(mode)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert hits() == (said is None)
        assert hits() == (said is None)
    assert len(caught) == (said is not None)
    assert said is None or said in str(caught[0].message)


@pytest.mark.parametrize("full", [True, False])
def test_a_folder_that_cannot_be_written_is_told_of_once(full, tmp_path, monkeypatch, request):
    if full:
        folder = request.getfixturevalue("disk")("8k")
        (folder / "kept").mkdir(0o700)
    else:
        folder = tmp_path
        (folder / "kept").write_text("no folder")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder / "kept"))
    with pytest.warns(JaxfilterWarning, match="cannot be read or kept here") as said:
        assert (hits(), hits()) == (0, 0)
    assert len(said) == 1 and str(folder / "kept") in str(said[0].message)
    assert not full or not list((folder / "kept").iterdir())


def test_a_function_without_a_file_is_compiled_all_the_same(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    space = {"__name__": "nowhere"}
    exec("def twice(n):\n    return 2 * n", space)
    with pytest.warns(JaxfilterWarning, match="no such file|No such file"):
        assert compiled(space["twice"])(21) == 42


def test_code_is_made_anew_when_a_function_changes_that_it_calls(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.syspath_prepend(tmp_path)
    head = "from jaxfilter.engines.compiled import compiled\n"
    (tmp_path / "calling.py").write_text(
        head + "from called import inner\n@compiled\ndef outer(n):\n    return inner(n)\n"
    )
    for factor in (2, 3):
        (tmp_path / "called.py").write_text(
            head + f"@compiled\ndef inner(n):\n    return n * {factor}  # {'x' * factor}\n"
        )
        for name in ("calling", "called"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        module._digest.cache_clear()
        assert importlib.import_module("calling").outer(7) == 7 * factor


def test_what_is_compiled_is_kept_where_the_user_says(tmp_path):
    script = "from jaxfilter.engines.tin.predicates import in_circle; print(in_circle(0, 0, 4, 0, 0, 4, 3, 3), in_circle.stats)"
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment["JAXFILTER_CACHE"] = str(tmp_path)
    said = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment).stdout
        for _ in range(2)
    ]
    assert all(text.startswith("True") and str(tmp_path / "numba") in text for text in said)
    assert "cache_hits=Counter()" in said[0] and "cache_hits=Counter({" in said[1]


@pytest.fixture
def kernels(tmp_path, monkeypatch):
    """The cache of JAX in a folder of its own."""
    before = jax.config.jax_compilation_cache_dir
    monkeypatch.setenv("JAXFILTER_CACHE", str(tmp_path))
    jax.config.update("jax_compilation_cache_dir", None)
    jax_cache.reset_cache()
    yield tmp_path / "xla"
    jax.config.update("jax_compilation_cache_dir", before)
    jax_cache.reset_cache()


def test_damage_in_the_cache_of_jax_is_told_of_once_and_repaired(kernels):
    def said():
        """In a new process."""
        jax.clear_caches()
        compilation._troubles.clear()
        with Session(quiet=True, debug=False) as session:
            assert float(jax.jit(plus)(1.0)) == 2.0 and float(jax.jit(times)(1.0)) == 3.0
        return session.warnings

    def plus(x):
        return x + 1.0

    def times(x):
        return x * 3.0

    assert said() == [] and kernels.stat().st_mode & 0o777 == 0o700
    entries = sorted(kernels.glob("*-cache"))
    assert len(entries) >= 2
    for damage in (DAMAGES["empty"], DAMAGES["cut"]):
        for entry in entries:
            damage(entry)
        [text] = said()
        assert str(kernels) in text and "cannot be read or kept here" in text
        assert said() == []
    for entry in entries:
        damage(entry)
    jax.clear_caches()
    compilation._troubles.clear()
    with collected_warnings() as remarks:
        assert float(jax.jit(plus)(1.0)) == 2.0 and float(jax.jit(times)(1.0)) == 3.0
    assert len(remarks) == 1 and "cannot be read or kept here" in remarks[0]


@pytest.mark.parametrize("way", ["folder", "file"])
def test_the_command_says_once_that_it_keeps_nothing(way, kernels, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if way == "folder":
        kernels.parent.chmod(0o777)
    else:
        kernels.parent.rmdir()
        kernels.parent.write_text("no folder")
    with Session(quiet=True, debug=False) as session:
        assert hits() == 0
    assert len(session.warnings) == 1 and str(kernels) in session.warnings[0]
    assert jax.config.jax_compilation_cache_dir is None


@pytest.mark.skipif(sys.platform == "win32", reason="no signals within a process")
@pytest.mark.parametrize("error", [KeyboardInterrupt, InterruptedError])
def test_an_interrupt_within_compiled_code_is_what_its_handler_raised(error):
    say = ctypes.CDLL(None)["raise"]
    say.argtypes, say.restype = [ctypes.c_int], ctypes.c_int

    def worked(values, number):
        say(number)
        return values, values.sum()

    def handler(*_):
        raise error("stop")

    function = compiled(worked)
    function(np.ones(3), 0)
    before = signal.signal(signal.SIGINT, handler)
    try:
        with pytest.raises(error, match="stop"):
            function(np.ones(3), int(signal.SIGINT))
    finally:
        signal.signal(signal.SIGINT, before)
    with pytest.raises(ZeroDivisionError):
        compiled(lambda n: 1 // n)(0)
