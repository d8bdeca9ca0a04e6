"""Small changes of a module's code: what could be mistyped or forgotten, a list per place of its syntax tree."""

from __future__ import annotations

import ast
import copy
import itertools
from collections.abc import Iterator
from dataclasses import dataclass

COMPARED = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE), ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip
SWAPPED = dict(
    pair
    for both in ("min max", "minimum maximum", "fmin fmax", "any all", "floor ceil", "argmin argmax")
    for pair in (both.split(), both.split()[::-1])
)
DROPPED = {"abs", "absolute", "fabs", "clip", "min", "max", "minimum", "maximum", "fmin", "fmax"}
QUIET = """
    warn warn_once progress tick print echo secho cast TypeVar dataclass njit
    set_title set_xlabel set_ylabel set_label ticklabel_format tick_params legend tight_layout
"""
"""Calls that speak or adorn, that only type checkers read, or whose words decide about speed."""
COSMETIC = """
    doc help show_default metavar stacklevel maxsize strict copy nogil cache frozen slots eq kw_only linewidth linewidths lw
    fontsize size alpha figsize dpi color colors marker s zorder pad labelpad fraction shrink rotation indent hspace wspace
    width_ratios height_ratios constrained_layout squeeze capsize title label nbins markersize bbox_inches
"""
"""Keywords that decide about looks, messages and speed."""
QUIET_NAMES, COSMETIC_NAMES = set(QUIET.split()), set(COSMETIC.split())


@dataclass(frozen=True)
class Mutation:
    """Bytes ``start`` to ``end`` of ``file`` become ``after``; the head of the statement is lines ``first`` to ``last``."""

    file: str
    kind: str
    first: int
    last: int
    line: int
    start: int
    end: int
    before: str
    after: str

    def apply(self, source: bytes) -> bytes:
        """The module's code, changed."""
        return source[: self.start] + self.after.encode() + source[self.end :]


def places(source: str, file: str) -> Iterator[list[Mutation]]:
    """What can be changed, place by place in the order of the code; never empty lists."""
    data = source.encode()
    starts = [0, *itertools.accumulate(len(line) for line in data.splitlines(keepends=True))]
    for node, statement, known in _nodes(ast.parse(source)):
        target = node.test if isinstance(node, ast.If) else node
        start, end = (starts[row - 1] + at for row, at in _span(target))
        first, last = head(statement)
        found = []
        for kind, after in _changes(node, known):
            text = after if isinstance(after, str) else ast.unparse(ast.fix_missing_locations(after))
            text = f"({text})" if isinstance(target, ast.expr) and not isinstance(target, ast.Constant) else text
            before = data[start:end].decode()
            found.append(Mutation(file, kind, first, last, node.lineno, start, end, before, text))
        if found:
            yield found


def head(statement: ast.stmt) -> tuple[int, int]:
    """First and last line of a statement, or of what stands before its body."""
    body = getattr(statement, "body", None) or getattr(statement, "cases", None)
    if not body:
        return statement.lineno, statement.end_lineno or statement.lineno
    inner = body[0].pattern.lineno if isinstance(body[0], ast.match_case) else body[0].lineno
    return statement.lineno, max(inner - 1, statement.lineno)


def _span(node: ast.AST) -> tuple[tuple[int, int], tuple[int, int]]:
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)


def _nodes(tree: ast.Module) -> Iterator[tuple[ast.AST, ast.stmt, bool]]:
    """Nodes that may be changed, the statement each is in, and whether its target had a value before."""
    stack: list[tuple[ast.AST, ast.stmt | None, set[str]]] = [(node, None, set()) for node in reversed(tree.body)]
    while stack:
        node, statement, names = stack.pop()
        if _left_out(node):
            continue
        if isinstance(node, ast.stmt):
            statement = node
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = {one.arg for one in (*node.args.args, *node.args.kwonlyargs)}
        if isinstance(node, ast.stmt | ast.expr) and statement is not None:
            yield node, statement, isinstance(node, ast.Assign) and _target(node) in names
        if isinstance(node, ast.Assign) and (name := _target(node)):
            names.add(name)
        if not isinstance(node, ast.Raise):
            stack += [(child, statement, names) for child in reversed(list(_children(node)))]


def _target(node: ast.Assign) -> str:
    return node.targets[0].id if isinstance(node.targets[0], ast.Name) else ""


def _left_out(node: ast.AST) -> bool:
    """Messages, annotations, what only type checkers see, names for export."""
    match node:
        case ast.JoinedStr() | ast.Assert() | ast.Import() | ast.ImportFrom() | ast.expr_context():
            return True
        case ast.Expr(value=ast.Constant()):
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")) | ast.Assign(targets=[ast.Name(id="__all__")]):
            return True
        case ast.keyword():
            return node.arg in COSMETIC_NAMES
        case ast.Call():
            return _name(node) in QUIET_NAMES
    return False


def _children(node: ast.AST) -> Iterator[ast.AST]:
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "pattern") or (isinstance(node, ast.Call) and field == "func"):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                yield node.func.value
            continue
        if isinstance(node, ast.Call) and field == "args" and _name(node) in ("isinstance", "issubclass"):
            value = value[:1]
        yield from (one for one in (value if isinstance(value, list) else [value]) if isinstance(one, ast.AST))


def _name(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


def _changes(node: ast.AST, known: bool) -> Iterator[tuple[str, ast.AST | str]]:
    match node:
        case ast.Compare():
            for number, operator in enumerate(node.ops):
                for other in COMPARED[type(operator)]:
                    ops = [*node.ops[:number], other(), *node.ops[number + 1 :]]
                    yield "comparison", ast.Compare(node.left, ops, node.comparators)
        case ast.BoolOp():
            yield "and, or", ast.BoolOp(ast.And() if isinstance(node.op, ast.Or) else ast.Or(), node.values)
        case ast.UnaryOp(op=ast.Not() | ast.Invert()):
            yield "not dropped", node.operand
        case ast.BinOp() if type(node.op) in OPERATORS and not any(
            _is_text(side) or _is_slack(side) for side in (node.left, node.right)
        ):
            yield "operator", ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right)
        case ast.Constant(value=bool()):
            yield "constant", str(not node.value)
        case ast.Constant(value=int()):
            yield "constant", str(node.value + 1)
            if node.value:
                yield "constant", str(node.value - 1)
        case ast.Constant(value=float()) if node.value == 0 or 1e-3 <= node.value < 1e6:
            yield "constant", str(node.value * 2 or 1.0)
        case ast.IfExp():
            yield "branches swapped", ast.IfExp(node.test, node.orelse, node.body)
        case ast.Call():
            yield from _calls(node)
        case ast.If(test=test) if not isinstance(test, ast.Compare | ast.UnaryOp):
            yield "condition negated", ast.UnaryOp(ast.Not(), node.test)
        case ast.Expr(value=ast.Call()) if _name(node.value) not in QUIET_NAMES:
            yield "statement removed", "pass"
        case ast.AugAssign() | ast.Raise() | ast.Break() | ast.Continue():
            yield "statement removed", "pass"
        case ast.Assign() if known or isinstance(node.targets[0], ast.Subscript | ast.Attribute):
            yield "statement removed", "pass"


def _calls(node: ast.Call) -> Iterator[tuple[str, ast.AST]]:
    name, plain = _name(node), not node.keywords and not any(isinstance(one, ast.Starred) for one in node.args)
    if name in SWAPPED:
        func = copy.copy(node.func)
        setattr(func, "id" if isinstance(func, ast.Name) else "attr", SWAPPED[name])
        yield "call swapped", ast.Call(func, node.args, node.keywords)
    if name in DROPPED and (len(node.args) > 1 or name.startswith(("abs", "fabs"))) and plain:
        yield from (("call dropped", one) for one in (node.args[:2] if name in SWAPPED else node.args[:1]))
    if name in ("where", "select") and len(node.args) == 3 and plain:
        yield "arguments swapped", ast.Call(node.func, [node.args[0], node.args[2], node.args[1]], [])


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or isinstance(
        getattr(node, "value", None), str | bytes
    )


def _is_slack(node: ast.AST) -> bool:
    """A constant that only makes up for rounding."""
    return isinstance(node, ast.Constant) and isinstance(node.value, float) and abs(node.value) < 1e-3
