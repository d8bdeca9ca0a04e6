"""The house rules that a machine can check."""

from __future__ import annotations

import ast
import functools
import graphlib
import tomllib
from pathlib import Path

import pytest

import jaxfilter

PACKAGE = Path(jaxfilter.__file__).parent
ROOT = PACKAGE.parent
FLOORS = {
    "core": 0, "engines": 1, "steps": 2, "methods": 3, "files": 4, "scenes": 4, "metrics": 4, "citing": 4,
    "terrain": 5, "scoring": 5, "datasets": 6, "sweeps": 7, "plots": 8, "reports": 9, "surveys": 10, "cli": 11, "__main__": 12,
}  # fmt: skip
PATHS = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
"""Dotted name of every module, and its file."""
MODULES = [name for name in PATHS if name != "jaxfilter"]


@functools.cache
def imported(module: str, typing: bool = True) -> set[str]:
    """Dotted names that a module imports, wherever in the file; ``typing``: also where only type checkers look."""
    path, found = PATHS[module], set()
    place = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    unread = set()
    for node in ast.walk(tree := ast.parse(path.read_text())):
        if not typing and isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            unread |= {id(inner) for statement in node.body for inner in ast.walk(statement)}
    for node in ast.walk(tree):
        if id(node) in unread:
            continue
        if isinstance(node, ast.ImportFrom):
            base = place[: len(place) + 1 - node.level] if node.level else []
            home = ".".join([*base, *filter(None, [node.module])])
            found |= {f"{home}.{a.name}" if f"{home}.{a.name}" in PATHS else home for a in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name for a in node.names}
    return found - {module}


def room(module: str) -> str:
    """The part of the package that a module belongs to."""
    return module.split(".")[1]


def libraries(module: str) -> set[str]:
    """Names of the libraries that a module imports when it runs."""
    return {name.split(".")[0] for name in imported(module, typing=False)} - {"jaxfilter"}


def below(module: str) -> set[str]:
    """The modules that a module imports when it runs, and those that they import, and so on."""
    found, rest = set(), [module]
    while rest:
        rest += (new := (imported(rest.pop(), typing=False) & PATHS.keys()) - found)
        found |= new
    return found


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_downward_only(module):
    for other in imported(module) & PATHS.keys():
        assert other != "jaxfilter", f"{module} imports a name through the public package"
        if room(other) != room(module):
            assert FLOORS[room(other)] < FLOORS[room(module)], f"{module} imports {other}, which is not below it"


def test_no_imports_go_in_a_circle():
    """Late imports and those of types count, and what the public package loads when it is first asked for."""
    graph = {module: imported(module) & PATHS.keys() for module in PATHS}
    assert len(graph["jaxfilter"]) > 20
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(f"a circle of imports: {' <- '.join(error.args[1])}")


@pytest.mark.parametrize(
    "library, rooms",
    [
        ("laspy", {"files"}),
        ("lazrs", {"files"}),
        ("scipy", {"engines", "steps", "methods", "terrain", "sweeps", "plots", "surveys", "reports"}),
        ("jax", {"core", "engines", "steps", "methods", "metrics"}),
        ("numba", {"engines"}),
    ],
)
def test_libraries_stay_in_their_rooms(library, rooms):
    assert {room(module) for module in MODULES if library in libraries(module)} <= rooms


def test_what_is_compiled_or_scipy_and_what_is_jax_do_not_import_each_other():
    """Of engines; where a file is neither, both may meet. Compiled code is apart from JAX in all rooms."""
    wrapper = "jaxfilter.engines.compiled"
    jax = {module for module in MODULES if "jax" in libraries(module)}
    compiled = {module for module in MODULES if wrapper in imported(module) or "numba" in libraries(module)}
    other = compiled | {module for module in MODULES if "scipy" in libraries(module)}
    assert len(compiled) > 5
    assert not jax & compiled, f"{jax & compiled} are compiled and import JAX"
    engines = {module for module in MODULES if room(module) == "engines"}
    assert len(jax & engines) > 5
    assert not jax & other & engines, f"{jax & other & engines} import JAX and SciPy"
    for module in jax & engines:
        reached = below(module)
        assert not reached & other, f"{module}, which is JAX, reaches {reached & other}"
        assert not {name for name in reached if room(name) == "files"}, f"{module}, which is JAX, reaches files"
    for module in other & engines:
        reached = imported(module, typing=False) & jax & engines
        assert not reached, f"{module}, which is compiled or SciPy, imports {reached}"


@pytest.mark.parametrize("module", MODULES)
def test_public_names_have_docstrings(module):
    tree = ast.parse(PATHS[module].read_text())
    assert ast.get_docstring(tree), f"{module} has no docstring"
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{module}: {node.name} has no docstring"


def test_public_names_resolve_and_are_the_documented_ones():
    assert len((PACKAGE / "__init__.py").read_text().splitlines()) < len(jaxfilter.__all__) + 10, "names and no more"
    for name in jaxfilter.__all__:
        assert getattr(jaxfilter, name) is not None
    assert callable(jaxfilter.evaluate) and callable(jaxfilter.read)
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    block = next(n for n in tree.body if isinstance(n, ast.If))
    typed = {alias.name for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert typed == set(jaxfilter.__all__)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = jaxfilter.no_such_name
    assert dir(jaxfilter) == sorted(jaxfilter.__all__)


def test_version_is_said_once_more_in_pyproject_only():
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"] == jaxfilter.__version__
