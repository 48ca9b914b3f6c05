"""Forms of lists, mappings and sections of a Compose file, and forms that combine others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from rorg.tools.compose import shorts
from rorg.tools.compose.command_line import split
from rorg.tools.compose.form import ANY, Context, Form, wrong
from rorg.tools.compose.nodes import Node
from rorg.tools.compose.scalars import LOOSE, TEXT


@dataclass(frozen=True)
class Words(Form):
    """A command: one line, split as Compose splits it, or a list. A later one replaces it."""

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        if node.value is None:
            return node  # removes the command of earlier files
        if isinstance(node.value, str):
            try:
                words, rest = split(node.value)
            except ValueError as error:
                context.error(node, f"{name}: {error}", "to close the quotes, or use a list")
                return None
            if rest:
                context.warn(node, f"{name}: Compose ignores '{rest}', because it runs no shell", "sh -c '...'")
            return node.but([Node(word, node.where, taken=node.taken) for word in words])
        if not isinstance(node.value, list):
            return wrong(node, name, context, "text or a list")
        return node.but(_read_all(node.value, TEXT, name, context))


Short = Callable[[Node, str, Context], "Node | None"]
"""Expands a short form; None if it is wrong and reported."""
SINGLE = (str, int, float, bool)
"""Types of a value that is neither a list nor a mapping."""


@dataclass(frozen=True, kw_only=True)
class Compound(Form):
    """A list or a mapping, perhaps with a short form."""

    kind: ClassVar[type] = dict
    short: Short | None = None
    of: type | tuple[type, ...] = str
    """The types of short forms."""
    wanted: str = ""
    """What messages call the accepted values; by default "a list" or "a mapping"."""

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        if node.value is None:
            return None
        long: Node | None = node
        if self.short and isinstance(node.value, self.of):
            long = self.short(node, name, context)
        elif not isinstance(node.value, self.kind):
            text = "text or " if self.short and self.of is str else ""
            return wrong(node, name, context, self.wanted or f"{text}a {'list' if self.kind is list else 'mapping'}")
        return None if long is None else self.convert(long, name, context)

    def convert(self, node: Node, name: str, context: Context) -> Node | None:
        """The canonical form of a long form."""
        raise NotImplementedError


@dataclass(frozen=True)
class ListOf(Compound):
    """A list. Items of a later list are appended, or replace the item with the same `key`."""

    kind = list
    item: Form = TEXT
    key: Callable[[Any], object] | None = None
    """The identity of a plain item: of several equal ones, the last remains."""
    spread: Callable[[Node, str, Context], list[Node]] | None = None
    """Expands one item into its long forms."""
    replaced: bool = False
    """A later list replaces this one."""

    def convert(self, node: Node, name: str, context: Context) -> Node:
        listed = node.items
        if self.spread:
            listed = [n for i, one in enumerate(listed) for n in self.spread(one, f"{name}[{i}]", context)]
        return node.but(self.unique(_read_all(listed, self.item, name, context)))

    def unique(self, items: list[Node]) -> list[Node]:
        if self.key is None:
            return items
        by_key: dict[object, Node] = {}
        for item in items:
            by_key[self.key(item.plain())] = item
        return list(by_key.values())

    def merge(self, base: Node, over: Node) -> Node:
        return over if self.replaced else base.but(self.unique([*base.items, *over.items]))


def one_or_many(item: Form, key: Callable[[Any], object] | None = None) -> ListOf:
    """A list whose only item may be written without the list."""
    return ListOf(item, key, short=lambda node, _, __: node.but([node.but(node.value, key=None, tag="")]), of=SINGLE)


def _read_all(items: list[Node], form: Form, name: str, context: Context) -> list[Node]:
    nodes = (form.read(item, f"{name}[{index}]", context) for index, item in enumerate(items))
    return [item for item in nodes if item is not None]


@dataclass(frozen=True)
class MapOf(Compound):
    """A mapping with names that people choose."""

    item: Form
    null: bool = False
    """A name may have no value: it is None, or an empty mapping if the items are sections."""
    extensible: bool = True
    """Entries whose names start with x- are not read. A service, however, may have such a name."""

    def convert(self, node: Node, name: str, context: Context) -> Node:
        entries: dict[str, Node] = {}
        for key, value in node.mapping.items():
            if key.startswith("x-") and self.extensible and isinstance(self.item, Section):
                entries[key] = value
                continue
            one = self.item.read(value, f"{name}.{key}", context)
            if one is None and self.null and value.value is None:
                one = value.but({} if isinstance(self.item, Section) else None)
            if one is not None:
                entries[key] = one
        return node.but(entries)

    def merge(self, base: Node, over: Node) -> Node:
        return _merged(base, over, lambda _: self.item)


@dataclass(frozen=True)
class Pairs(Compound):
    """`{NAME: value}` or `[NAME=value]`; a bare NAME has no value."""

    bare: bool = False
    """A name without a value is None; otherwise it is an empty text."""
    short: Short | None = field(default=shorts.pairs, kw_only=True)
    of: type | tuple[type, ...] = field(default=list, kw_only=True)
    wanted: str = field(default="a mapping, or a list of NAME=value", kw_only=True)

    def convert(self, node: Node, name: str, context: Context) -> Node:
        entries: dict[str, Node] = {}
        for key, value in node.mapping.items():
            one = value.but(None) if value.value is None else LOOSE.read(value, f"{name}.{key}", context)
            if one is not None:
                entries[key] = one.but("" if one.value is None and not self.bare else one.value)
        return node.but(entries)

    def merge(self, base: Node, over: Node) -> Node:
        return _merged(base, over, lambda _: TEXT)


@dataclass(frozen=True)
class Section(Compound):
    """A mapping with known keys, and `x-` keys."""

    keys: Mapping[str, Form]
    required: tuple[str, ...] = ()
    defaults: Mapping[str, Any] = field(default_factory=dict)
    extensible: bool = True
    finish: Callable[[Node, str, Context], Node] | None = None
    """Completes the node once it is read."""
    same: str = ""
    """Merge key by key only if this key is equal or missing in one of the two; otherwise the later section wins."""

    def convert(self, node: Node, name: str, context: Context) -> Node | None:
        entries = self.entries(node, name, context)
        missing = [key for key in self.required if key not in entries]
        for key in missing:
            if node.get(key).value is None:
                context.error(node, f"{name} has no '{key}'", f"{key}: ...", key=True)
        if missing:
            return None
        for key, value in self.defaults.items():
            entries.setdefault(key, Node(value, node.where))
        made = node.but(entries)
        return self.finish(made, name, context) if self.finish else made

    def entries(self, node: Node, name: str, context: Context) -> dict[str, Node]:
        """The known entries. Unknown keys are reported."""
        entries: dict[str, Node] = {}
        for key, value in node.mapping.items():
            if key.startswith("x-") and self.extensible:
                entries[key] = value
            elif key in self.keys:
                one = self.keys[key].read(value, f"{name}.{key}" if name else key, context)
                if one is not None:
                    entries[key] = one
            else:
                inside = f"in {name}" if name else "at the top"
                context.error(value, f"unknown key '{key}' {inside}", context.files.near(key, self.keys), key=True)
        return entries

    def merge(self, base: Node, over: Node) -> Node:
        ours, theirs = (node.mapping.get(self.same) for node in (base, over))
        if self.same and ours and theirs and ours.value != theirs.value:
            return over
        return _merged(base, over, lambda key: self.keys.get(key, ANY))


def _merged(base: Node, over: Node, form: Callable[[str], Form]) -> Node:
    entries = dict(base.mapping)
    for key, value in over.mapping.items():
        before = entries.get(key)
        if before is None or before.value is None or value.value is None or value.tag == "override":
            entries[key] = value
        else:
            entries[key] = form(key).merge(before, value)
    return base.but(entries)


_NOT_HERE = ("git@", "github.com/", "docker-image://", "oci-layout://", "service:")


def is_remote(text: str) -> bool:
    """Whether a build context is a URL or an image instead of a directory."""
    return text.startswith(_NOT_HERE) or "://" in text


@dataclass(frozen=True)
class Either(Form):
    """A mapping has one form, everything else another."""

    section: Form
    other: Form

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        form = self.section if isinstance(node.value, dict) else self.other
        return form.read(node, name, context)

    def merge(self, base: Node, over: Node) -> Node:
        both = isinstance(base.value, dict) and isinstance(over.value, dict)
        return self.section.merge(base, over) if both else over


class Contexts(Pairs):
    """Additional contexts of a build, with absolute paths."""

    def convert(self, node: Node, name: str, context: Context) -> Node:
        entries = super().convert(node, name, context)
        return entries.but(
            {k: v if is_remote(v.value) else v.but(context.path(v.value)) for k, v in entries.mapping.items()}
        )
