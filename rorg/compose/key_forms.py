"""Forms of a few keys: short forms that are made long first, sections that may also be a scalar, contexts of builds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from rorg.compose.form import Context, Form
from rorg.compose.forms import Pairs
from rorg.compose.nodes import Node

_NOT_HERE = ("git@", "github.com/", "docker-image://", "oci-layout://", "service:")


def is_remote(text: str) -> bool:
    """A URL or an image, and no directory: of a build's context, or an additional one."""
    return text.startswith(_NOT_HERE) or "://" in text


@dataclass(frozen=True)
class Changed(Form):
    """Another form, after what is short there has been made long."""

    change: Callable[[Node, str, Context], Node | None]
    form: Form
    only: type | tuple[type, ...] = object

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        if node.value is None:
            return None
        long = self.change(node, name, context) if isinstance(node.value, self.only) else node
        return None if long is None else self.form.read(long, name, context)

    def merge(self, base: Node, over: Node) -> Node:
        return self.form.merge(base, over)


@dataclass(frozen=True)
class Either(Form):
    """A mapping of one form, and everything else of another."""

    section: Form
    other: Form

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        form = self.section if isinstance(node.value, dict) else self.other
        return form.read(node, name, context)

    def merge(self, base: Node, over: Node) -> Node:
        both = isinstance(base.value, dict) and isinstance(over.value, dict)
        return self.section.merge(base, over) if both else over


class Contexts(Pairs):
    """Additional contexts of a build: paths are absolute."""

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        found = super().read(node, name, context)
        if found is None:
            return None
        return found.but(
            {k: v if is_remote(v.value) else v.but(context.path(v.value)) for k, v in found.mapping.items()}
        )
