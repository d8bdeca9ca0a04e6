"""The lines that run differently after a change: its own, or those of who uses what is imported, declared or compiled."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

from experiments.mutations.kinds import Mutation, head

Line = tuple[str, int]
Function = ast.FunctionDef | ast.AsyncFunctionDef


class Felt:
    """Looks up a package: coverage.py sees neither loops that Numba compiled nor, by test, what runs at import."""

    def __init__(self, tree: Path, package: str) -> None:
        self.trees = {
            path.relative_to(tree).as_posix(): ast.parse(path.read_text()) for path in (tree / package).rglob("*.py")
        }
        self.uses: dict[str, list[Line]] = defaultdict(list)
        """Lines with a name, as a variable or after a dot."""
        self.imports: dict[str, set[str]] = defaultdict(set)
        """Files of the package that a file imports names from."""
        for file, module in self.trees.items():
            for node in ast.walk(module):
                if isinstance(node, ast.Name | ast.Attribute):
                    self.uses[node.id if isinstance(node, ast.Name) else node.attr].append((file, node.lineno))
                elif isinstance(node, ast.ImportFrom) and node.level:
                    home = Path(file).parents[node.level - 1] / (node.module or "").replace(".", "/")
                    names = [
                        home.with_suffix(".py"),
                        home / "__init__.py",
                        *(home / f"{one.name}.py" for one in node.names),
                    ]
                    self.imports[file] |= {name.as_posix() for name in names} & set(self.trees)
        self.compiled = {file for file, module in self.trees.items() if any(map(_is_compiled, ast.walk(module)))}

    def __call__(self, mutation: Mutation) -> set[Line]:
        """Lines by file; a test that reaches none of them cannot notice the change."""
        return self._felt(mutation.file, mutation.first, mutation.last, set())

    def compiled_with(self, file: str) -> set[str]:
        """Files whose loops hold code of this one."""
        found = {file} & self.compiled
        while more := {one for one in self.compiled - found if self.imports[one] & (found | {file})}:
            found |= more
        return found

    def _felt(self, file: str, first: int, last: int, seen: set[object]) -> set[Line]:
        around = [node for node in ast.walk(self.trees[file]) if _holds(node, first)]
        functions = [node for node in around if isinstance(node, Function)]
        if functions:
            inner, outer = functions[-1], functions[0]
            if any(map(_is_compiled, functions)):
                return self._users(outer.name, seen)
            if first >= inner.body[0].lineno:
                return {(file, line) for line in range(first, last + 1)}
            return {(file, line) for statement in inner.body for line in range(*head(statement))} | {
                (file, statement.lineno) for statement in inner.body
            }
        classes = [node for node in around if isinstance(node, ast.ClassDef)]
        if classes:
            lines = range(classes[-1].lineno, (classes[-1].end_lineno or 0) + 1)
            return {(file, line) for line in lines if self._within_function(file, line)} | self._users(
                classes[-1].name, seen
            )
        found = set()
        for node in self.trees[file].body:
            if node.lineno <= first <= (node.end_lineno or 0):
                names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
                found |= {line for name in names for line in self._users(name, seen)}
        return found

    def _users(self, name: str, seen: set[object]) -> set[Line]:
        if name in seen:
            return set()
        seen.add(name)
        found = set()
        for file, line in self.uses[name]:
            if (file, line) not in seen:
                seen.add((file, line))
                found |= self._felt(file, line, line, seen)
        return found

    def _within_function(self, file: str, line: int) -> bool:
        return any(
            isinstance(node, Function) and node.body[0].lineno <= line
            for node in ast.walk(self.trees[file])
            if _holds(node, line)
        )


def _holds(node: ast.AST, line: int) -> bool:
    if not isinstance(node, Function | ast.ClassDef):
        return False
    return min([node.lineno, *(one.lineno for one in node.decorator_list)]) <= line <= (node.end_lineno or 0)


def _is_compiled(node: ast.AST) -> bool:
    calls = [getattr(one, "func", one) for one in getattr(node, "decorator_list", ())]
    return any(isinstance(one, ast.Name) and one.id == "compiled" for one in calls)
