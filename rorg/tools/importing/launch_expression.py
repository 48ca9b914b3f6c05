"""Evaluates the harmless part of `$(eval ...)`: comparisons, logic, sums, and a few functions of texts. Nothing in it
can reach a file, a module or an attribute, and its result is not much longer than the expression."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from rorg.tools.importing.launch_words import Refusal

LONGEST = 2000
"""Characters of an expression."""
_COMPARE: Mapping[type, Callable[[Any, Any], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda left, right: left in right,
    ast.NotIn: lambda left, right: left not in right,
}
_NUMBERS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
_UNARY: Mapping[type, Callable[[Any], Any]] = {ast.Not: operator.not_, ast.USub: operator.neg, ast.UAdd: operator.pos}
_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{"int": int, "float": float, "str": str, "len": len, "abs": abs, "min": min, "max": max, "round": round},
    **{"sqrt": math.sqrt, "sin": math.sin, "cos": math.cos, "radians": math.radians, "degrees": math.degrees},
}
_METHODS = ("lower", "upper", "strip", "startswith", "endswith")
"""Of texts."""
_CONSTANTS = {"pi": math.pi, "e": math.e}


def evaluate(expression: str) -> str:
    """The value, as a text. Raises Refusal for everything else that Python can do."""
    shown = expression if len(expression) <= 60 else f"{expression[:60]}..."
    if len(expression) > LONGEST:
        raise Refusal(f"$(eval {shown}) has more than {LONGEST} characters", "a shorter expression")
    try:
        return str(_value(ast.parse(expression.strip(), mode="eval").body))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise Refusal(f"$(eval {shown}) is not a valid expression of Python") from error
    except _Unsupported as error:
        message = f"$(eval {shown}): rorg evaluates comparisons, logic and sums, but not {error}"
        raise Refusal(message, "an argument (<arg>) with the value") from error
    except (TypeError, ArithmeticError) as error:
        raise Refusal(f"$(eval {shown}) fails: {error}") from error


class _Unsupported(Exception):
    pass


def _value(node: ast.expr) -> Any:
    if isinstance(node, ast.Constant) and isinstance(node.value, str | int | float | bool | None):
        return node.value
    if isinstance(node, ast.BoolOp):
        return _logic(node)
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return _UNARY[type(node.op)](_value(node.operand))
    if isinstance(node, ast.BinOp):
        return _sum(node)
    if isinstance(node, ast.Compare):
        return _comparison(node)
    if isinstance(node, ast.IfExp):
        return _value(node.body) if _value(node.test) else _value(node.orelse)
    if isinstance(node, ast.List | ast.Tuple):
        return [_value(item) for item in node.elts]
    if isinstance(node, ast.Name) and node.id in _CONSTANTS:
        return _CONSTANTS[node.id]
    if isinstance(node, ast.Call) and not node.keywords:
        return _call(node)
    shown = ast.unparse(node)
    raise _Unsupported(shown if len(shown) <= 40 else f"{shown[:40]}...")


def _logic(node: ast.BoolOp) -> Any:
    value = None
    for item in node.values:
        value = _value(item)
        if bool(value) == isinstance(node.op, ast.Or):
            break
    return value


def _sum(node: ast.BinOp) -> Any:
    """A sum of texts or numbers. Other operations are for numbers: with a text, * and % could fill the memory."""
    left, right = _value(node.left), _value(node.right)
    if isinstance(node.op, ast.Add) and not isinstance(left, list) and not isinstance(right, list):
        return left + right
    if type(node.op) not in _NUMBERS or not all(isinstance(side, int | float) for side in (left, right)):
        raise _Unsupported(ast.unparse(node)[:40])
    return _NUMBERS[type(node.op)](left, right)


def _comparison(node: ast.Compare) -> bool:
    left = _value(node.left)
    for sign, item in zip(node.ops, node.comparators, strict=True):
        right = _value(item)
        if not _COMPARE[type(sign)](left, right):
            return False
        left = right
    return True


def _call(node: ast.Call) -> Any:
    arguments = [_value(item) for item in node.args]
    if isinstance(node.func, ast.Name) and node.func.id in _FUNCTIONS:
        return _FUNCTIONS[node.func.id](*arguments)
    if isinstance(node.func, ast.Attribute) and node.func.attr in _METHODS:
        owner = _value(node.func.value)
        if isinstance(owner, str):
            return getattr(owner, node.func.attr)(*arguments)
    raise _Unsupported(ast.unparse(node.func)[:40])
