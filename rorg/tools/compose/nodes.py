"""YAML of Compose files as nodes: values that know where they are written.

Compose reads YAML with anchors, aliases, merge keys (`<<`), and two tags of its own: `!reset` removes what earlier
files say, `!override` replaces it instead of merging. A value from an alias or a merge key has the place where it is
written. Scalars: true and false (also True, TRUE), null and ~; integers in decimal, 0x, 0o, 0b, and octal with a
leading 0; _ within digits; floats; a plain date becomes the text that Compose makes of it. Everything else is text,
including yes, no, on and off.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import yaml

from rorg.manifest.yaml_source import UNREADABLE, BaseLoader, check_size, not_yaml
from rorg.model.diagnostics import Diagnostic, Where

MOST_VALUES = 50_000
"""Limit for a whole project, with everything that it merges. The largest real ones have some thousand."""


class _Loader(BaseLoader):  # type: ignore[misc, valid-type]
    yaml_implicit_resolvers: dict[str, Any] = {}


_INT = re.compile(r"([-+]?)(?:0x([0-9a-fA-F_]+)|0b([01_]+)|0o?([0-7_]+)|([0-9][0-9_]*))$")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")
_DATE = re.compile(r"[0-9]{4}-[0-9]{1,2}-[0-9]{1,2}$")
_SPECIAL = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_TAGS = {"!reset": "reset", "!override": "override"}

Scalar = str | int | float | bool | None


@dataclass(slots=True)
class Node:
    """A value and its place. `value`: {key: Node}, [Node], or a scalar."""

    value: Any
    where: Where
    key: Where | None = None
    """The place of its key, in a mapping."""
    tag: str = ""
    """`reset` or `override`."""
    taken: tuple[str, ...] = field(default=())
    """Names of the variables that were filled in."""
    exact: bool = False
    """Whether it is a text on one line, exactly as in the file: offsets in it are columns, counted from `where`."""

    @property
    def place(self) -> Where:
        return self.key or self.where

    def but(self, value: Any, **changes: Any) -> Node:
        return replace(self, value=value, **changes)

    @property
    def mapping(self) -> dict[str, Node]:
        """The entries of a mapping; empty for other values."""
        return self.value if isinstance(self.value, dict) else {}

    def get(self, *path: str) -> Node:
        """The value at a path of keys; a node with the value None if it is missing."""
        node = self
        for key in path:
            node = node.mapping.get(key) or Node(None, self.where)
        return node

    def having(self, /, **entries: Node) -> Node:
        """The mapping with more entries, or with others instead of its own."""
        return self.but({**self.mapping, **entries})

    @property
    def items(self) -> list[Node]:
        return self.value if isinstance(self.value, list) else []

    def plain(self) -> Any:
        """The value without places."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value

    def size(self) -> int:
        """The number of values in it, including itself."""
        inner = self.value.values() if isinstance(self.value, dict) else self.items
        return 1 + sum(node.size() for node in inner)

    def kind(self) -> str:
        """The type of the value, for messages."""
        names: dict[type, str] = {dict: "a mapping", list: "a list", str: "text", bool: "true or false"}
        return names.get(type(self.value), "nothing" if self.value is None else "a number")


def scalar(text: str) -> Scalar:
    """The value of a plain scalar."""
    if text in _SPECIAL:
        return _SPECIAL[text]
    match = _INT.match(text)
    if match:
        sign, *digits = match.groups()
        base, number = next((b, d) for b, d in zip((16, 2, 8, 10), digits, strict=True) if d)
        number = number.replace("_", "")
        if number and len(number) < 40:
            return int(sign + number, base)
        return text
    if _FLOAT.match(text):
        return float(text)
    if _DATE.match(text):
        return f"{text} 00:00:00 +0000 UTC"
    return text


class _Reader:
    def __init__(self, file: str) -> None:
        self.file, self.count = file, 0
        self.diagnostics: list[Diagnostic] = []

    def where(self, node: yaml.Node) -> Where:
        return Where(self.file, node.start_mark.line + 1, node.start_mark.column + 1)

    def error(self, node: yaml.Node, message: str, remedy: str = "") -> None:
        self.diagnostics.append(Diagnostic(self.where(node), message, remedy))

    def read(self, node: yaml.Node) -> Node:
        self.count += 1
        if self.count > MOST_VALUES:
            raise yaml.MarkedYAMLError(problem=f"more than {MOST_VALUES} values", problem_mark=node.start_mark)
        made = Node(None, self.where(node), tag=_TAGS.get(node.tag, ""))
        if isinstance(node, yaml.MappingNode):
            made.value = self.mapping(node)
        elif isinstance(node, yaml.SequenceNode):
            made.value = [self.read(item) for item in node.value]
        else:
            assert isinstance(node, yaml.ScalarNode)
            self.scalar(node, made)
        standard = ("tag:yaml.org,2002:", "!reset", "!override")
        if not node.tag.startswith(standard) and node.tag != "!":
            self.error(node, f"tag {node.tag} is not supported", "'!reset' or '!override'")
        return made

    def scalar(self, node: yaml.ScalarNode, made: Node) -> None:
        text, tag = str(node.value), node.tag.rpartition(":")[2]
        plain = not node.style and (tag == "str" or node.tag in _TAGS)
        made.value = scalar(text) if plain or tag in ("int", "float", "bool", "null") else text
        if "\0" in text:
            self.error(node, "a NUL character, which ends a text for the engine and for programs", "to remove it")
        same_line = node.start_mark.line == node.end_mark.line
        quotes = 0 if not node.style else 2
        made.exact = same_line and node.end_mark.column - node.start_mark.column == len(text) + quotes
        if made.exact and quotes:
            made.where = replace(made.where, column=made.where.column + 1)

    def mapping(self, node: yaml.MappingNode) -> dict[str, Node]:
        entries: dict[str, Node] = {}
        merged: list[Node] = []
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.error(key_node, "a key must be plain text")
                continue
            if key_node.value == "<<" and not key_node.style:
                merged += self.merged(value_node)
                continue
            key = str(key_node.value)
            value = self.read(value_node)
            if not key_node.style and not isinstance(scalar(key), str):
                self.error(key_node, f"key {key} is not a text", f'"{key}"')
            if key in entries:
                line = entries[key].place.line
                remedy = f"to remove it here or in line {line}"
                self.error(key_node, f"key '{key}' appears twice in one mapping", remedy)
                continue
            entries[key] = value.but(value.value, key=self.where(key_node))
        for other in merged:
            for key, value in other.mapping.items():
                entries.setdefault(key, value)
        return entries

    def merged(self, node: yaml.Node) -> Iterator[Node]:
        """The mappings of a merge key, in order of precedence."""
        for one in node.value if isinstance(node, yaml.SequenceNode) else [node]:
            if isinstance(one, yaml.MappingNode):
                yield self.read(one)
            else:
                self.error(one, "a merge key (<<) takes a mapping", "an alias of a mapping, or a list of aliases")


def read_nodes(text: str, file: str) -> tuple[list[Node], list[Diagnostic]]:
    """The documents of a file, which Compose merges, and its mistakes as YAML. `file` is used only in messages."""
    reader = _Reader(file)
    try:
        check_size(text, MOST_VALUES)
        documents = [reader.read(node) for node in yaml.compose_all(text, Loader=_Loader) if node is not None]
    except UNREADABLE as error:
        return [], [not_yaml(error, file, text)]
    return documents, reader.diagnostics
