"""Imports go downward, without a circle, and libraries stay in their rooms; ruff checks what else is a matter of style."""

import ast
import graphlib
from pathlib import Path

import pytest

import jaxfilter as jf

PACKAGE = Path(jf.__file__).parent
FLOORS = {
    "core": 0, "engines": 1, "steps": 2, "methods": 3, "files": 4, "scenes": 4, "metrics": 4, "ops": 4,
    "terrain": 5, "scoring": 5, "datasets": 6, "sweeps": 7, "plots": 8, "reports": 9, "surveys": 10, "reviews": 11, "cli": 12,
    "__main__": 13,
}  # fmt: skip
PATHS = {path.relative_to(PACKAGE).with_suffix("").parts: path for path in PACKAGE.rglob("*.py")}
ROOMS = {
    "laspy": "files", "lazrs": "files", "numba": "engines", "jax": "core engines steps methods metrics",
    "scipy": "engines steps methods scenes terrain sweeps plots reports reviews",
}  # fmt: skip


def imported(module):
    """Modules of the package and libraries that a module imports, wherever in the file, as their parts."""
    for node in ast.walk(ast.parse(PATHS[module].read_text())):
        if isinstance(node, ast.ImportFrom):
            above = module[: len(module) - node.level] if node.level else ()
            home = (*above, *node.module.split(".")) if node.module else above
            for alias in node.names:
                places = (*home, alias.name), (*home, alias.name, "__init__"), (*home, "__init__")
                yield next((place for place in places if place in PATHS), home)
        elif isinstance(node, ast.Import):
            yield from (tuple(alias.name.split(".")) for alias in node.names)


GRAPH = {module: set(imported(module)) - {module} for module in PATHS}
LIBRARIES = {module: {other[0] for other in found - PATHS.keys()} for module, found in GRAPH.items()}


def test_imports_go_downward_only_and_in_no_circle():
    """Those of types and late ones count. No module imports names through the public package."""
    for module in PATHS.keys() - {("__init__",)}:
        assert "jaxfilter" not in LIBRARIES[module], module
        for other in GRAPH[module] & PATHS.keys():
            below = FLOORS.get(other[0], 99) < FLOORS[module[0]]
            assert below or other[0] == module[0], f"{module} imports {other}"
    graphlib.TopologicalSorter({module: found & PATHS.keys() for module, found in GRAPH.items()}).prepare()


@pytest.mark.parametrize("library", ROOMS)
def test_libraries_stay_in_their_rooms(library):
    using = {module[0] for module in PATHS if library in LIBRARIES[module]}
    assert using and using <= set(ROOMS[library].split())


def test_jax_and_what_is_compiled_do_not_import_each_other_nor_scipy_and_jax_in_engines():
    compiled = {module for module in PATHS if ("engines", "compiled") in GRAPH[module]}
    assert len(compiled) > 5 and not [module for module in compiled if "jax" in LIBRARIES[module]]
    engines = {module for module in PATHS if module[0] == "engines"}
    jax = {module for module in engines if "jax" in LIBRARIES[module]}
    other = {module for module in engines if LIBRARIES[module] & {"numba", "scipy"}} | compiled & engines
    for one, two in ((jax, other), (other, jax)):
        assert len(one) > 5 and not [module for module in one if {module, *GRAPH[module]} & two]


def test_no_constant_has_the_name_of_another():
    """But those that are private to a module."""
    values = {}
    for path in PATHS.values():
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                values.setdefault(node.targets[0].id, set()).add(ast.unparse(node.value))
    constants = {name: found for name, found in values.items() if name[0] != "_" and name.isupper()}
    assert not {name: found for name, found in constants.items() if len(found) > 1}
