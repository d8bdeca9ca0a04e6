"""Compiled host loops: kept on disk where that can be, compiled all the same where not; interrupts come through."""

import contextlib
import ctypes
import importlib
import os
import signal
import subprocess
import sys
import warnings
from typing import NamedTuple

import jax
import numba
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache as jax_cache

import jaxfilter as jf
from jaxfilter import JaxfilterWarning
from jaxfilter.cli.session import Session
from jaxfilter.core import compilation
from jaxfilter.engines import compiled as module
from jaxfilter.engines.compiled import compiled


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
    """A folder of its own for what JAX compiles; nothing is known of it yet."""
    monkeypatch.setenv("JAXFILTER_CACHE", str(tmp_path))
    monkeypatch.setattr(compilation, "_keeps", False)
    monkeypatch.setattr(compilation, "_quiet", True)
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    jax_cache.reset_cache()
    compilation._kept_folder.cache_clear()
    yield tmp_path / "jax"
    compilation._kept_folder.cache_clear()
    jax.config.update("jax_compilation_cache_dir", before)
    jax_cache.reset_cache()


@contextlib.contextmanager
def keeping():
    before = compilation.keep_compilations()
    yield
    compilation.keep_compilations(before)


class Scaled(NamedTuple):
    values: jax.Array


traces = []


def scaled(factor, given, power, *, label="none"):
    """Notes each time that it is traced."""
    traces.append(label)
    return Scaled(given["x"] ** power * factor)


def new_process():
    """The function, as a new process has it, and what it returns."""
    jax.clear_caches()
    function = compilation.jit(scaled, static_argnames=("power", "label"))
    with keeping():
        found = function(2.0, {"x": np.arange(3.0, dtype=np.float32)}, 2, label="one")
    return function, found.values.tolist()


def test_what_jax_compiles_is_neither_traced_nor_compiled_by_the_next_process(kernels):
    traces.clear()
    compilation.watch_compilations()
    assert new_process()[1] == [0.0, 2.0, 8.0] and traces == ["one"]
    [file] = kernels.iterdir()
    before = compilation.compilations()[0]
    function, found = new_process()
    assert found == [0.0, 2.0, 8.0] and traces == ["one"] and compilation.compilations()[0] == before
    assert kernels.stat().st_mode & 0o777 == 0o700 and file.name.startswith("scaled-")
    x = np.arange(3.0, dtype=np.float32)
    with keeping():
        assert function(2, {"x": x}, power=2, label="one").values.tolist() == [0.0, 2.0, 8.0]
        assert function(2.0, {"x": x[:2]}, 3, label="two").values.tolist() == [0.0, 2.0]
        assert function(2.0, {"x": x.astype(np.int32)}, 2, label="one").values.tolist() == [0.0, 2.0, 8.0]
        assert jax.vmap(lambda k: function(k, {"x": x}, 2, label="many").values)(x).shape == (3, 3)
    assert traces == ["one", "one", "two", "one", "many"] and len(list(kernels.iterdir())) == 4
    assert function(3.0, {"x": x}, 2, label="outside").values.tolist() == [0.0, 3.0, 12.0]
    assert traces[-1] == "outside" and len(list(kernels.iterdir())) == 4


@pytest.mark.slow
def test_a_method_is_kept_by_the_parameters_that_are_not_traced(kernels, rng):
    filters = jf.PMF(max_window=9.25), jf.PMF(max_window=9.25, slope=0.4), jf.PMF(max_window=17.25)  # of no other test
    cells = filters[0].cells(filters[0].points_of(jf.PointCloud.from_arrays(rng.random((500, 3)) * 20)))
    expected = [one.model(cells).limits[0].tolist() for one in filters]
    with keeping():
        for one, limits in zip(filters, expected, strict=True):
            assert one.model(cells).limits[0].tolist() == limits
    assert len([file for file in kernels.iterdir() if file.name.startswith("PMF._open")]) == 2


def test_other_sources_versions_and_processors_do_not_share(kernels, monkeypatch):
    traces.clear()
    new_process()
    monkeypatch.setattr(compilation, "_stamp", lambda: bytes(32))
    for _ in range(2):
        assert new_process()[1] == [0.0, 2.0, 8.0]
    assert traces == ["one", "one"]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_to_what_jax_compiled_is_told_of_once(damage, kernels):
    new_process()
    [file] = kernels.iterdir()
    DAMAGES[damage](file)
    with pytest.warns(JaxfilterWarning, match="cannot be read or kept here") as said:
        assert new_process()[1] == [0.0, 2.0, 8.0]
    assert len(said) == 1 and str(kernels) in str(said[0].message)
    if damage != "folder":
        traces.clear()
        assert new_process()[1] == [0.0, 2.0, 8.0] and traces == [], "it was made anew"


@pytest.mark.parametrize("way", ["folder", "file"])
def test_the_command_says_once_that_it_keeps_nothing(way, kernels, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    if way == "folder":
        kernels.parent.chmod(0o777)
    else:
        kernels.parent.rmdir()
        kernels.parent.write_text("no folder")
    with Session(quiet=True, debug=False) as session:
        assert hits() == 0 and new_process()[1] == [0.0, 2.0, 8.0]
    assert len(session.warnings) == 1 and str(kernels.parent) in session.warnings[0]


SCRIPT = """
import sys, numpy as np, jax
from jaxfilter.core import compilation
from jaxfilter.engines.grid import morphology
compilation.watch_compilations()
out = morphology.erosion(np.eye(5, dtype=np.float32), 1, reach=3)
print(float(np.asarray(out).sum()), compilation.compilations()[0], jax.config.jax_compilation_cache_dir)
"""


def in_script(**variables):
    """Elevations, compilations and JAX's own cache of a script, and what it says."""
    own = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_COMPILATION", "JAXFILTER"))}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, env=own | variables, check=True
    )
    return done.stdout.split(), done.stderr


def test_a_script_keeps_what_it_compiles_and_says_so_once(tmp_path):
    first, second = (in_script(JAXFILTER_CACHE=str(tmp_path)) for _ in range(2))
    assert first[0] == ["0.0", "1", "None"] and second[0] == ["0.0", "0", "None"]
    assert f"{tmp_path / 'jax'}: compiled code is kept here" in first[1] and not second[1]


@pytest.mark.slow
@pytest.mark.parametrize("variable", ["JAXFILTER_CACHE", "JAX_COMPILATION_CACHE_DIR"])
def test_a_script_keeps_nothing_if_told_so_or_if_jax_does(variable, tmp_path):
    own = "off" if variable == "JAXFILTER_CACHE" else str(tmp_path / "own")
    for _ in range(2):
        found, said = in_script(**{"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), variable: own})
        assert found == ["0.0", "1", "None" if own == "off" else own] and "kept" not in said
    assert not list(tmp_path.rglob("*.jax"))


@pytest.mark.parametrize("block", [
    lambda: jax.disable_jit(), lambda: jax.debug_nans(True), lambda: jax.default_device(jax.devices()[0]),
])  # fmt: skip
def test_kept_code_is_not_used_where_jax_shall_run_in_another_way(block, kernels):
    with keeping(), block():
        assert (
            compilation.jit(scaled, static_argnames=("power", "label"))(2.0, {"x": jax.numpy.ones(2)}, 2).values.sum()
            == 4
        )
    assert not kernels.exists() or not list(kernels.iterdir())


def test_another_precision_is_another_program(kernels):
    function = compilation.jit(scaled, static_argnames=("power", "label"))
    for precision in ("float32", "bfloat16", "float32"):
        with keeping(), jax.default_matmul_precision(precision):
            function(2.0, {"x": np.ones(2)}, 2)
    assert len(list(kernels.iterdir())) == 2


def test_a_cache_that_jax_was_given_is_left_to_jax(kernels, tmp_path):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "own"))
    assert new_process()[1] == [0.0, 2.0, 8.0]
    assert not kernels.exists()


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


def test_errors_of_compiled_code_come_through_and_divisions_by_zero_give_infinity():
    def refuse(n):
        if n == 0:
            raise ValueError("none")
        return n

    with pytest.raises(ValueError, match="none"):
        compiled(refuse)(0)
    assert compiled(lambda x: 1 / x)(0.0) == np.inf


def test_constants_make_no_further_version_of_a_function(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    inner = compiled(collatz)
    outer = compiled(lambda n: inner(27) + inner(6) + inner(n))
    assert outer(1) == 119 and len(inner.signatures) == 1
