"""The base class of forms. A form checks a node of a Compose file, converts it into the one canonical form, and merges
it with what a later file says."""

from __future__ import annotations

from dataclasses import dataclass
from os.path import normpath
from pathlib import Path

from rorg.model.diagnostics import Diagnostic
from rorg.tools.compose.nodes import Node
from rorg.tools.compose.variables import Files


@dataclass
class Context:
    """The file that is being read."""

    directory: Path
    """Relative paths start here."""
    home: str
    files: Files
    """Of the whole project."""

    def error(self, node: Node, message: str, remedy: str = "", key: bool = False) -> None:
        self.files.error(node.place if key else node.where, message, remedy)

    def warn(self, node: Node, message: str, remedy: str) -> None:
        self.files.diagnostics.append(Diagnostic(node.where, message, remedy, "warning"))

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
