"""Reads launch files of ROS 2 in YAML, as the same elements that XML has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rorg.manifest.yaml_source import MAX_DEPTH, MOST_NUMBER, UNREADABLE, BaseLoader, check_size, not_yaml
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where
from rorg.tools.importing.launch_xml import MOST_ELEMENTS, Element

CHILDREN = "children"
"""The key for the children of an element that has attributes, too."""
LONGEST_GUESS = 4096
"""Characters of a text that may be a number or a list."""
LONGEST_NUMBER = 400
"""Characters of a number. PyYAML takes quadratic time for one with colons, and Python writes none of 4300 digits."""
TEXTS = tuple(f"tag:yaml.org,2002:{name}" for name in ("str", "null", "timestamp", "binary"))


class _Wrong(Exception):
    """The file is YAML, but not a launch file."""

    def __init__(self, node: yaml.Node, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.node, self.message, self.remedy = node, message, remedy


def read_yaml_launch(path: Path, text: str) -> Element | Diagnostic:
    """The outermost element, or why there is none. Raises TooMuch."""
    try:
        check_size(text, MOST_ELEMENTS)
        root = yaml.compose(text, Loader=BaseLoader)
    except UNREADABLE as error:
        return not_yaml(error, str(path), text)
    tree = _Tree(path)
    try:
        if not isinstance(root, yaml.MappingNode) or [key.value for key, _ in root.value] != ["launch"]:
            raise _Wrong(root or yaml.ScalarNode("", ""), "it does not start with `launch:`", "launch: [...]")
        return tree.element("launch", root.value[0][0], root.value[0][1])
    except _Wrong as wrong:
        return Diagnostic(tree.where(wrong.node), wrong.message, wrong.remedy)


@dataclass
class _Tree:
    path: Path
    count: int = 0
    depth: int = 0

    def where(self, node: yaml.Node) -> Where:
        mark = node.start_mark
        return Where(str(self.path), mark.line + 1, mark.column + 1) if mark else Where(str(self.path))

    def element(self, tag: str, key: yaml.Node, value: yaml.Node) -> Element:
        """One element. A list holds its children; a mapping has attributes, and lists of named parts."""
        self._count(key)
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise _Wrong(key, f"more than {MAX_DEPTH} elements in each other", "fewer groups")
        made = Element(tag, {}, self.where(key))
        if isinstance(value, yaml.SequenceNode):
            made.children = self._children(value)
        elif isinstance(value, yaml.MappingNode):
            self._fill(made, value)
        else:
            raise _Wrong(key, f"{tag} is neither a list nor a mapping", f"{tag}: {{...}}")
        self.depth -= 1
        return made

    def _fill(self, made: Element, value: yaml.MappingNode) -> None:
        """Reads the attributes and parts of an element."""
        attributes, literals = dict[str, str](), dict[str, Any]()
        for inner_key, inner in value.value:
            name = _text_of(inner_key)
            if name == CHILDREN and isinstance(inner, yaml.SequenceNode):
                made.children += self._children(inner)
            elif isinstance(inner, yaml.SequenceNode) and any(isinstance(i, yaml.MappingNode) for i in inner.value):
                made.children += [self.element(name, item, item) for item in inner.value]
            elif isinstance(inner, yaml.MappingNode):
                raise _Wrong(
                    inner, f"{name} of {made.tag} is a mapping", f"a list of mappings (`- {{...}}`) for {name}"
                )
            elif isinstance(inner, yaml.SequenceNode) and name != "value":
                raise _Wrong(inner, f"{name} of {made.tag} is a list", "a text")
            else:
                value_of = self._value(inner)
                attributes[name] = _shown(value_of)
                if not (isinstance(value_of, str) and "$(" in value_of):
                    literals[name] = value_of
        made.attributes, made.literals = attributes, literals

    def _children(self, node: yaml.SequenceNode) -> list[Element]:
        children = []
        for item in node.value:
            if not isinstance(item, yaml.MappingNode) or len(item.value) != 1:
                raise _Wrong(item, "each action has one name", "`- node: {...}`")
            key, value = item.value[0]
            children.append(self.element(_text_of(key), key, value))
        return children

    def _value(self, node: yaml.Node) -> Any:
        if isinstance(node, yaml.SequenceNode) and node.tag == "tag:yaml.org,2002:seq":
            return [self._scalar(item) for item in node.value]
        return self._scalar(node)

    def _scalar(self, node: yaml.Node) -> str | int | float | bool:
        self._count(node)
        if not isinstance(node, yaml.ScalarNode):
            raise _Wrong(node, "neither a text, nor a number, nor a list of them")
        try:
            return plain_scalar(node)
        except (yaml.YAMLError, ValueError) as error:
            raise _Wrong(node, f"not a value of YAML: {node.value[:40]}") from error

    def _count(self, node: yaml.Node) -> None:
        self.count += 1
        if self.count > MOST_ELEMENTS:
            raise TooMuch(self.where(node), f"more than {MOST_ELEMENTS} values", "a smaller file")


def _text_of(key: yaml.Node) -> str:
    if not isinstance(key, yaml.ScalarNode) or key.value == "<<":
        raise _Wrong(key, "a key must be plain text, and merge keys (<<) are not read", "to write it out")
    return str(key.value)


def plain_scalar(node: yaml.Node) -> str | int | float | bool:
    """The value of a scalar in YAML 1.1, as ROS 2 reads it: yes is true, and 1:30 is 90. Dates, nothing, and numbers
    that are out of range for ROS stay the text that they are. Raises YAMLError and ValueError."""
    if node.tag in TEXTS or len(node.value) > LONGEST_NUMBER:
        return str(node.value)
    try:
        value: int | float | bool = yaml.constructor.SafeConstructor().construct_object(node)
    except (LookupError, OverflowError) as error:
        raise ValueError(str(error)) from error
    return str(node.value) if isinstance(value, int) and abs(value) > MOST_NUMBER else value


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def guess(text: str) -> Any:
    """The value that ROS 2 makes of a text without a type: a number, true or false, a list of one type, or the text."""
    if len(text) > LONGEST_GUESS:
        return text
    try:
        check_size(text)
        node = yaml.compose(text, Loader=BaseLoader)
        if isinstance(node, yaml.SequenceNode):
            scalars = all(isinstance(item, yaml.ScalarNode) for item in node.value)
            return uniform([plain_scalar(item) for item in node.value] if scalars else []) or text
        return plain_scalar(node) if isinstance(node, yaml.ScalarNode) and not node.style else _quoted(node, text)
    except (*UNREADABLE, ValueError, AttributeError, TypeError):
        return text


def _quoted(node: Any, text: str) -> str:
    return str(node.value) if isinstance(node, yaml.ScalarNode) and node.style in ("'", '"') else text


def uniform(items: list[Any]) -> list[Any]:
    """The items as one type; empty if they have several. Whole numbers among others become floating point."""
    kinds = {type(item) for item in items}
    if kinds == {int, float}:
        return [float(item) for item in items]
    return items if len(kinds) == 1 and kinds <= {str, int, float, bool} else []


TYPES: Mapping[str, type] = {"str": str, "int": int, "float": float, "bool": bool}
"""Names of types in launch files."""
