"""Forms of single values of a Compose file: texts, numbers, durations, paths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rorg.compose import units
from rorg.compose.form import Context, Form
from rorg.compose.nodes import Node
from rorg.model.diagnostics import nearest


@dataclass(frozen=True)
class Scalar(Form):
    """A text or number that `convert` turns into its value (ValueError: why not)."""

    wanted: str
    types: tuple[type, ...]
    """What YAML may say: of bool only where it is among them."""
    convert: Callable[[Any], Any] = lambda value: value
    one_of: tuple[str, ...] = ()

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        value = node.value
        if value is None:
            return None
        if not isinstance(value, self.types) or (isinstance(value, bool) and bool not in self.types):
            remedy = self.otherwise(value)
            context.error(node, f"{name} is {node.kind()}, and must be {self.wanted}", remedy)
            return None
        try:
            value = self.convert(value)
        except ValueError as error:
            context.error(node, f"{name}: {error}", self.wanted)
            return None
        if self.one_of and value not in self.one_of:
            context.error(node, f"{name}: '{value}' is not known", nearest(str(value), self.one_of))
            return None
        return node.but(value)

    def otherwise(self, value: object) -> str:
        """A remedy for a value of another type."""
        if str not in self.types or not isinstance(value, int | float | bool):
            return ""
        return self.wanted if self.convert is units.duration else f'"{units.shown(value)}"'


def _size(value: Any) -> int:
    return units.size(value) if isinstance(value, str) else int(value)


def _whole(value: Any) -> int:
    if isinstance(value, float) and value != int(value):
        raise ValueError(f"{value} is not a whole number")
    return units.integer(value) if isinstance(value, str) else int(value)


TEXT = Scalar("text", (str,))
LOOSE = Scalar("text, a number, true or false", (str, int, float, bool), units.shown)
NUMBER_OR_TEXT = Scalar("text or a number", (str, int, float), units.shown)
BOOL = Scalar("true or false", (bool, str), lambda v: units.boolean(v) if isinstance(v, str) else v)
INT = Scalar("a whole number", (int, float, str), _whole)
FLOAT = Scalar("a number", (int, float, str), lambda v: units.number(v) if isinstance(v, str) else float(v))
SIZE = Scalar("an amount of memory, as 512m", (int, float, str), _size)
DURATION = Scalar("a duration, as 1m30s", (str,), units.duration)


def one_of(*names: str) -> Scalar:
    """A text that is one of these."""
    return Scalar(f"one of {', '.join(names)}", (str,), one_of=names)


@dataclass(frozen=True)
class PathOf(Scalar):
    """A path of this machine, made absolute, but for what `kept` takes for something else."""

    wanted: str = "a path"
    types: tuple[type, ...] = (str,)
    kept: Callable[[str], bool] = lambda _: False

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        found = super().read(node, name, context)
        if found is None or self.kept(found.value):
            return found
        return found.but(context.path(found.value))
