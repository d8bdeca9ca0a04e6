"""Compiled host loops: kept on disk where that can be, compiled all the same where not; interrupts come through."""

import ctypes
import importlib
import os
import signal
import subprocess
import sys
import warnings

import numba
import numpy as np
import pytest

from jaxfilter import JaxfilterWarning
from jaxfilter.core import compilation
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


@pytest.fixture
def tmp_path(private_folder):
    return private_folder


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """A cache folder in which machine code of ``collatz`` lies."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "way" / "kept"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert compiled(collatz)(27) == 111
    return tmp_path / "way" / "kept"


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


owners_and_modes = pytest.mark.skipif(not hasattr(os, "getuid"), reason="no owners and modes here")
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


def places(kept):
    return {"folder": kept, "parent": kept.parent, "grandparent": kept.parent.parent}


def check_use(kept, said):
    """Code in the folder is used, or it is not and ``said`` is said, once."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert (hits(), hits()) == (said is None, said is None)
    assert len(caught) == (said is not None)
    assert said is None or (said in str(caught[0].message) and str(kept) in str(caught[0].message))


@owners_and_modes
@pytest.mark.parametrize(
    ("place", "mode"),
    [*(("parent", mode) for mode in (0o755, 0o720, 0o702, 0o1777, 0o1770)), ("folder", 0o770), ("grandparent", 0o777)],
)
def test_a_folder_below_one_that_others_may_write_to_is_not_used(place, mode, kept):
    assert hits() == 1
    places(kept)[place].chmod(mode)  # also after it was found to be private
    check_use(kept, f"others may write to {places(kept)[place]}," if mode & 0o022 else None)


@owners_and_modes
@pytest.mark.parametrize("place", ["folder", "parent", "grandparent"])
def test_a_folder_of_another_user_or_below_one_is_not_used(place, kept, monkeypatch):
    me = os.getuid()
    if me == 0:
        os.chown(places(kept)[place], 4321, -1)
    else:
        monkeypatch.setattr(os, "getuid", lambda: me + 1)
    check_use(kept, "belongs to user")


@owners_and_modes
@pytest.mark.parametrize("absolute", [True, False])
@pytest.mark.parametrize("exposed", ["link", "target", "nothing"])
def test_a_link_on_the_way_is_as_safe_as_where_it_lies_and_where_it_leads(absolute, exposed, kept, monkeypatch):
    house = kept.parents[1]
    (house / "links").mkdir()
    leads = {"link": house / "links", "target": kept.parent, "nothing": house / "nothing"}
    (house / "links" / "link").symlink_to(kept.parent if absolute else "../way")
    if exposed != "nothing":
        leads[exposed].chmod(0o1777)
    given = house / "links" / "link" / "kept"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(given))
    check_use(given, None if exposed == "nothing" else f"others may write to {leads[exposed]},")


def test_a_link_to_itself_is_told_of(tmp_path, monkeypatch):
    (tmp_path / "link").symlink_to("link")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "link"))
    check_use(tmp_path / "link", "exists")


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
        assert importlib.import_module("calling").outer(7) == 7 * factor


def test_code_is_kept_of_the_source_that_was_loaded(tmp_path, monkeypatch):
    """An edit and a reload in one process; and an edit after the import and before the first call, which compiles."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def write(factor):
        text = f"from jaxfilter.engines.compiled import compiled\n@compiled\ndef times(n):\n    return n * {factor}\n"
        (tmp_path / "edited.py").write_text(text)
        importlib.invalidate_caches()

    write(2)
    edited = importlib.import_module("edited")
    assert edited.times(7) == 14
    write(3)
    edited = importlib.reload(edited)
    assert edited.times(7) == 21
    write(4)
    assert edited.times(0.5) == 1.5, "compiled of what was loaded"
    assert importlib.reload(edited).times(0.5) == 2.0
    monkeypatch.delitem(sys.modules, "edited")


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


SCRIPT = """
import collections, sys, warnings, jax, jax.monitoring, jax.numpy as jnp, numpy as np
import jaxfilter as jf
heard = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: heard.update([event.rpartition("/")[2]]))
(jnp.ones(3) + 1).block_until_ready()  # JAX has compiled something of the user's own before
if sys.argv[1:]:
    jax.config.update("jax_compilation_cache_dir", sys.argv[1])
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    ground = jf.MSF(window=4.0)(np.random.default_rng(0).random((500, 3)) * 20).ground.sum()
print(ground, heard["cache_hits"], heard["cache_misses"], jax.config.jax_compilation_cache_dir, *[one.message for one in said])
"""


def in_script(*arguments, **variables):
    """Of a new process: ground points, programs read from the disk and written to it, JAX's own cache; and warnings."""
    own = {key: value for key, value in os.environ.items() if not key.startswith(("JAX_COMPILATION", "JAXFILTER"))}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True, env=own | variables, check=True
    )
    ground, read, written, folder, *said = done.stdout.split(maxsplit=4)
    return int(ground), int(read), int(written), folder, "".join(said)


def test_what_jax_compiles_is_not_compiled_by_the_next_process_unless_it_is_damaged(tmp_path):
    place = tmp_path / "jax"
    first, second = (in_script(JAXFILTER_CACHE=str(tmp_path)) for _ in range(2))
    assert first[1] == 0 and first[2] > 0 and first[3:] == (str(place), "")
    assert second == (first[0], first[2], 0, str(place), "")
    assert place.stat().st_mode & 0o777 == 0o700 and len(list(place.iterdir())) == first[2]
    for number, file in enumerate(place.iterdir()):
        (DAMAGES["empty"], DAMAGES["cut"], DAMAGES["text"])[number % 3](file)
    third = in_script(JAXFILTER_CACHE=str(tmp_path))
    assert third[:2] == (first[0], 0) and third[4].count("Error reading persistent") == first[2]


@pytest.mark.parametrize("way", ["off", "variable", "setting"])
def test_jax_keeps_nothing_if_told_so_and_in_its_own_cache_if_it_has_one(way, tmp_path):
    cache, own = tmp_path / "cache", str(tmp_path / "own")
    variables = {
        "JAXFILTER_CACHE": "off" if way == "off" else str(cache),
        "XDG_CACHE_HOME": str(cache),
        "HOME": str(cache),
    }
    if way == "variable":
        variables["JAX_COMPILATION_CACHE_DIR"] = own
    found = in_script(*[own] * (way == "setting"), **variables)
    assert found[3:] == ("None" if way == "off" else own, "") and not (cache / "jax").exists()


@owners_and_modes
def test_a_script_says_once_that_it_keeps_nothing_where_others_may_write(tmp_path):
    tmp_path.chmod(0o1777)
    found = in_script(JAXFILTER_CACHE=str(tmp_path / "cache"), NUMBA_CACHE_DIR=str(tmp_path / "numba"))
    assert found[1:4] == (0, 0, "None") and found[4].count("cannot be read or kept here") == 1
    assert f"others may write to {tmp_path}," in found[4] and not list(tmp_path.iterdir())


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
