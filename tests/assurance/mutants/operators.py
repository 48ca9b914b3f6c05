"""Enumerates the mutants of a module: small changes of its syntax tree, each of which should make a test fail.

Not mutated, because nothing decides on them: documentation, annotations, decorators, imports, enums, f-strings, the
arguments of `raise`, `assert` (it only tells mypy what is known), and texts unless they are compared.
"""

from __future__ import annotations

import ast
import copy
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
BOUNDARIES = ast.Lt, ast.LtE, ast.Gt, ast.GtE
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}
SKIPPED = ast.JoinedStr, ast.Raise, ast.Assert, ast.Import, ast.ImportFrom
UNDECIDED = "annotation", "returns", "decorator_list", "bases"
TEXTS = ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp
"""Adding these is joining them, and joining has no opposite."""
TOP = ast.FunctionDef, ast.ClassDef, ast.Assign, ast.AnnAssign
FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef


@dataclass(frozen=True, eq=False)
class Mutant:
    """One change. `place` is what holds the node, its field, and the index if that is a list."""

    file: str
    line: int
    number: int
    """Among the mutants of this line, from 1."""
    change: str
    statement: ast.stmt
    """The one that it is in."""
    top: ast.stmt
    """Of the module."""
    inside: bool
    """Whether it is in the body of a function, so that its code is all that changes."""
    place: tuple[ast.AST, str, int | None]
    new: ast.AST

    @property
    def name(self) -> str:
        return f"{self.file}:{self.line}.{self.number}"

    @property
    def lines(self) -> range:
        """The lines of its statement, without the body if it is a condition or a loop."""
        body = [] if isinstance(self.statement, (*FUNCTIONS, ast.ClassDef)) else getattr(self.statement, "body", [])
        last = body[0].lineno - 1 if body else self.statement.end_lineno or 0
        return range(self.statement.lineno, max(last, self.statement.lineno) + 1)

    def apply(self) -> None:
        """Change the tree, for good."""
        holder, field, index = self.place
        if index is None:
            setattr(holder, field, self.new)
        else:
            getattr(holder, field)[index] = self.new


@dataclass(frozen=True)
class _Place:
    """Where the walk is. `bound` counts how often each name is bound in the function; None outside of functions."""

    statement: ast.stmt
    top: ast.stmt
    holder: ast.AST
    field: str
    index: int | None
    bound: Counter[str] | None


def mutants_of(file: str, tree: ast.Module) -> list[Mutant]:
    """Return all mutants of a module, in the order of its text."""
    found, numbers = [], Counter[int]()
    changes = [change for node, place in _places(tree, None) if isinstance(node, TOP) for change in _walk(node, place)]
    for place, old, new, said in sorted(changes, key=lambda c: (c[1].lineno, c[1].col_offset)):
        ast.fix_missing_locations(ast.copy_location(new, old))
        numbers[old.lineno] += 1
        where = place.holder, place.field, place.index
        inside = place.bound is not None and not isinstance(place.statement, FUNCTIONS)
        found.append(
            Mutant(file, old.lineno, numbers[old.lineno], said, place.statement, place.top, inside, where, new)
        )
    return found


Change = tuple[_Place, ast.expr | ast.stmt, ast.AST, str]


def _places(parent: ast.AST, place: _Place | None) -> Iterator[tuple[ast.AST, _Place]]:
    """What a node holds, each with its place."""
    for field, value in ast.iter_fields(parent):
        if field in ("annotation", "returns", "decorator_list", "bases", "keywords") and not isinstance(
            parent, ast.Call
        ):
            continue
        several = isinstance(value, list)
        for index, node in enumerate(value if several else [value]):
            if isinstance(node, ast.AST):
                statement = node if isinstance(node, ast.stmt) else place and place.statement
                top = place.top if place else node
                bound = _bound(node) if isinstance(node, FUNCTIONS) else place and place.bound
                yield node, _Place(statement, top, parent, field, index if several else None, bound)


def _walk(node: ast.AST, place: _Place) -> Iterator[Change]:
    if isinstance(node, SKIPPED) or _typing_only(node):
        return
    if isinstance(node, ast.stmt):
        yield from _deletions(node, place)
    elif isinstance(node, ast.expr):
        for new in _others(node, place):
            yield place, node, new, f"{ast.unparse(node)} -> {ast.unparse(new)}"
    for child, inner in _places(node, place):
        yield from _walk(child, inner)


def _typing_only(node: ast.AST) -> bool:
    """Whether it is for type checkers, an enum, or documentation."""
    if isinstance(node, ast.If):
        return "TYPE_CHECKING" in ast.unparse(node.test)
    if isinstance(node, ast.ClassDef):
        return any(ast.unparse(base).endswith(("Enum", "Protocol")) for base in node.bases)
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _deletions(node: ast.stmt, place: _Place) -> Iterator[Change]:
    new: ast.stmt = ast.Pass()
    if isinstance(node, ast.Return):
        if isinstance(node.value, ast.Constant) and (isinstance(node.value.value, bool) or _last(node, place)):
            return
        if node.value is not None and not isinstance(node.value, ast.Constant):
            new = ast.Return(ast.Constant(None))
    elif isinstance(node, ast.Assign | ast.AnnAssign):
        names = [t.id for t in (node.targets if isinstance(node, ast.Assign) else [node.target]) if _is_name(t)]
        if place.bound is None or node.value is None or any(place.bound[name] < 2 for name in names):
            return
        if any(isinstance(t, ast.Tuple) for t in getattr(node, "targets", ())):
            return
    elif not isinstance(node, ast.Expr | ast.AugAssign | ast.Continue | ast.Break):
        return
    yield place, node, new, f"{ast.unparse(node)} -> {ast.unparse(new)}"


def _others(node: ast.expr, place: _Place) -> Iterator[ast.expr]:
    """What may stand in the place of an expression. A condition that is forced is not negated too."""
    forced = _forced(node, place)
    yield from (ast.Constant(value) for value in forced if not isinstance(node, ast.Constant))
    if isinstance(node, ast.Compare):
        for index, operator in enumerate(node.ops):
            for other in COMPARISONS[type(operator)][: 1 if forced else None]:
                if not forced or other in BOUNDARIES:
                    yield _with(node, "ops", [*node.ops[:index], other(), *node.ops[index + 1 :]])
    elif isinstance(node, ast.BoolOp):
        yield _with(node, "op", ast.And() if isinstance(node.op, ast.Or) else ast.Or())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not) and not forced:
        yield node.operand
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS and not _joins(node, place):
        yield _with(node, "op", OPERATORS[type(node.op)]())
    elif isinstance(node, ast.Constant):
        yield from _constants(node, place)


def _constants(node: ast.Constant, place: _Place) -> Iterator[ast.expr]:
    value: Any = node.value
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int | float):
        yield ast.Constant(value + 1)
    elif isinstance(value, str) and isinstance(place.holder, ast.Compare | ast.Tuple | ast.Set) and _compared(place):
        yield ast.Constant(value + "!")


def _forced(node: ast.expr, place: _Place) -> tuple[bool, ...]:
    """Which truths to force on an expression. If it is a condition of several parts, forcing one of these says more."""
    holder, field = place.holder, place.field
    if isinstance(holder, ast.BoolOp):
        return () if isinstance(node, ast.BoolOp) else (isinstance(holder.op, ast.And),)
    if (field == "test" and isinstance(holder, ast.If | ast.IfExp | ast.While)) or field == "ifs":
        most = (False,) if isinstance(holder, ast.While) else (True, False)
        return tuple(v for v in most if not isinstance(node, ast.BoolOp) or v is isinstance(node.op, ast.Or))
    return ()


def _compared(place: _Place) -> bool:
    """Whether a text, or the collection that it is in, is part of a comparison."""
    return isinstance(place.holder, ast.Compare) or any(
        place.holder in node.comparators for node in ast.walk(place.statement) if isinstance(node, ast.Compare)
    )


def _joins(node: ast.BinOp, place: _Place) -> bool:
    """Whether it joins texts or lists, or is a type."""
    sides = node.left, node.right
    if isinstance(node.op, ast.BitOr) and place.bound is None:
        return True
    return any(isinstance(s, TEXTS) or (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in sides)


def _with(node: ast.expr, field: str, value: object) -> ast.expr:
    new = copy.copy(node)
    setattr(new, field, value)
    return new


def _last(node: ast.stmt, place: _Place) -> bool:
    return isinstance(place.holder, FUNCTIONS) and place.holder.body[-1] is node


def _is_name(node: ast.AST) -> bool:
    return isinstance(node, ast.Name)


def _bound(function: ast.AST) -> Counter[str]:
    """How often a function binds each name, its parameters included."""
    nodes = list(ast.walk(function))
    names = Counter(n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
    return names + Counter(n.arg for n in nodes if isinstance(n, ast.arg))
