"""The base class of forms. A form checks a node of a Compose file, converts it into the one canonical form, and merges
it with what a later file says."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from os.path import normpath
from pathlib import Path

from rorg.compose.nodes import Node
from rorg.model.diagnostics import Diagnostic, Where, nearest

MOST_COMPARED = 20_000
"""Names compared for one project. Some hundred mistakes in a project of a hundred services need fewer."""
LONGEST = 100
"""Characters of a name that is compared."""


class Suggestions:
    """Suggests similar names, within a limit for the whole project."""

    def __init__(self) -> None:
        self._compared = 0

    def __call__(self, name: str, known: Collection[str]) -> str:
        """A remedy as nearest() gives it; empty once too many names were compared."""
        self._compared += len(known)
        if self._compared > MOST_COMPARED or len(name) > LONGEST:
            return ""
        return nearest(name, [one for one in known if len(one) <= LONGEST])


@dataclass
class Context:
    """The file that is being read."""

    directory: Path
    """Relative paths start here."""
    home: str
    diagnostics: list[Diagnostic] = field(default_factory=list)
    spend: Callable[[int, Where], None] = lambda _values, _where: None
    """Counts the values that a short form expands to."""
    near: Suggestions = field(default_factory=Suggestions)

    def error(self, node: Node, message: str, remedy: str = "", key: bool = False) -> None:
        self.diagnostics.append(Diagnostic(node.place if key else node.where, message, remedy))

    def warn(self, node: Node, message: str, remedy: str) -> None:
        self.diagnostics.append(Diagnostic(node.where, message, remedy, "warning"))

    def path(self, text: str) -> str:
        """An absolute path, as Compose makes it; `~` is the reader's home."""
        if text == "~" or text.startswith("~/"):
            text = self.home + text[1:]
        return normpath(self.directory / text)


class Form:
    """Any value, kept as written, such as `x-` keys."""

    def read(self, node: Node, name: str, context: Context) -> Node | None:  # noqa: ARG002
        """The canonical form; None if the node is empty, or wrong and reported. `name`: what messages call the node."""
        return node

    def merge(self, base: Node, over: Node) -> Node:  # noqa: ARG002
        """A later file's value, merged over an earlier one's."""
        return over


def wrong(node: Node, name: str, context: Context, wanted: str) -> Node | None:
    """Reports what the node must be."""
    context.error(node, f"{name or 'a Compose file'} is {node.kind()}, and must be {wanted}")
    return None


ANY = Form()
