"""The house rules that a machine can check."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

import jaxfilter

PACKAGE = Path(jaxfilter.__file__).parent
ROOT = PACKAGE.parent
FLOORS = {
    "core": 0, "ops": 1, "host": 1, "stages": 2, "filters": 3, "sweeps": 5, "plots": 6, "tiles": 7, "reports": 7, "cli": 8,
    "__main__": 9,
}  # fmt: skip
TOP = 4  # every other module or subpackage
MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


def room(module: str) -> str:
    """The part of the package that a dotted name inside it belongs to."""
    return module.split(".")[0]


def imports(path: Path) -> set[str]:
    """Names inside the package that a module imports, wherever in the file."""
    place = path.relative_to(PACKAGE).parent.parts
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = place[: len(place) + 1 - node.level]
            found |= {
                ".".join([*base, *filter(None, [node.module]), *([] if node.module or base else [a.name])])
                for a in node.names
            }
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "jaxfilter":
            found.add(node.module.removeprefix("jaxfilter").lstrip(".") or node.names[0].name)
        elif isinstance(node, ast.Import):
            found |= {a.name.removeprefix("jaxfilter.") for a in node.names if a.name.startswith("jaxfilter.")}
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_downward_only(path):
    own = room(str(path.relative_to(PACKAGE)).removesuffix(".py").replace("/", "."))
    floor = FLOORS.get(own, TOP)
    for module in imports(path):
        other = room(module)
        below = FLOORS.get(other, TOP)
        if other != own and not (own == "cli" and other in jaxfilter.__all__):
            assert below < floor, f"{path.name} on floor {floor} imports {module} on floor {below}"


@pytest.mark.parametrize(
    "library, rooms",
    [
        ("laspy", {"host"}),
        ("scipy", {"host", "stages", "filters", "plots", "reports", "sweeps"}),
        ("jax", {"core", "ops", "stages", "filters"}),
        ("numba", {"host"}),
    ],
)
def test_libraries_stay_in_their_rooms(library, rooms):
    for path in MODULES:
        own = room(str(path.relative_to(PACKAGE)).removesuffix(".py").replace("/", "."))
        names = {
            name.split(".")[0]
            for node in ast.walk(ast.parse(path.read_text()))
            for name in (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else [node.module or ""]
                if isinstance(node, ast.ImportFrom) and not node.level
                else []
            )
        }
        assert library not in names or own in rooms, f"{path.relative_to(PACKAGE)} imports {library}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_public_names_have_docstrings(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree), f"{path} has no docstring"
    for node in tree.body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not node.name.startswith("_"):
            assert ast.get_docstring(node), f"{path.name}: {node.name} has no docstring"


def test_public_names_resolve_and_are_the_documented_ones():
    assert len((PACKAGE / "__init__.py").read_text().splitlines()) < 80
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
