"""What a form is: it checks a node of a Compose file, brings it into the one canonical form, and says how what a later
file says is laid over it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from os.path import normpath
from pathlib import Path

from rorg.compose.nodes import Node
from rorg.model.diagnostics import Diagnostic, Where, nearest

MOST_COMPARED = 20_000
"""Names that are compared for one project. Some hundred mistakes in a project of a hundred services need fewer."""
LONGEST = 100
"""Characters of a name that is compared."""


class Suggestions:
    """Those of one project."""

    def __init__(self) -> None:
        self._compared = 0

    def __call__(self, name: str, known: Collection[str]) -> str:
        """A remedy as nearest() gives it; empty once enough names were compared."""
        self._compared += len(known)
        if self._compared > MOST_COMPARED or len(name) > LONGEST:
            return ""
        return nearest(name, [one for one in known if len(one) <= LONGEST])


@dataclass
class Context:
    """Of the file that is read."""

    directory: Path
    """Where relative paths begin."""
    home: str
    diagnostics: list[Diagnostic] = field(default_factory=list)
    spend: Callable[[int, Where], None] = lambda _values, _where: None
    """Counts values that a short form stands for."""
    near: Suggestions = field(default_factory=Suggestions)

    def error(self, node: Node, message: str, remedy: str = "", key: bool = False) -> None:
        self.diagnostics.append(Diagnostic(node.place if key else node.where, message, remedy))

    def warn(self, node: Node, message: str, remedy: str) -> None:
        self.diagnostics.append(Diagnostic(node.where, message, remedy, "warning"))

    def path(self, text: str) -> str:
        """Absolute, as Compose makes it; `~` is the home of whoever reads it."""
        if text == "~" or text.startswith("~/"):
            text = self.home + text[1:]
        return normpath(self.directory / text)


class Form:
    """Anything, as it is written: `x-` keys and the like."""

    def read(self, node: Node, name: str, context: Context) -> Node | None:  # noqa: ARG002
        """The canonical form; None where it says nothing, or is wrong and told. `name`: what it is, for messages."""
        return node

    def merge(self, base: Node, over: Node) -> Node:  # noqa: ARG002
        """What a later file says, over what one before does."""
        return over


def wrong(node: Node, name: str, context: Context, wanted: str) -> Node | None:
    """Tells what it should be; there is nothing to read."""
    context.error(node, f"{name or 'a Compose file'} is {node.kind()}, and must be {wanted}")
    return None


ANY = Form()
