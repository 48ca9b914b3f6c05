"""Reads launch files in XML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where

MOST_ELEMENTS = 20_000
"""Of one file. The largest real files have some hundreds."""
MOST_DEPTH = 100
"""Levels of nesting."""


@dataclass(slots=True)
class Element:
    """One element, without the text between elements."""

    tag: str
    attributes: Mapping[str, str]
    where: Where
    children: list[Element] = field(default_factory=list)
    literals: Mapping[str, Any] = field(default_factory=dict)
    """Attributes whose type the file itself gives, as YAML does: numbers, true and false, plain texts and lists."""

    def get(self, name: str, otherwise: str = "") -> str:
        """The value of an attribute."""
        return self.attributes.get(name, otherwise)


def read_launch(path: Path, text: str) -> Element | Diagnostic:
    """The outermost element, or why there is none. A document type is refused, because its entities multiply, and
    launch files do not use them. Raises TooMuch."""
    parser = expat.ParserCreate("utf-8")  # the text is decoded already; the encoding that it declares does not matter
    top = Element("", {}, Where(str(path)))
    way, count = [top], 0

    def place() -> Where:
        return Where(str(path), parser.CurrentLineNumber, parser.CurrentColumnNumber + 1)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        if count > MOST_ELEMENTS:
            raise TooMuch(place(), f"more than {MOST_ELEMENTS} elements", "a smaller file")
        if len(way) > MOST_DEPTH:
            raise TooMuch(place(), f"more than {MOST_DEPTH} nested elements", "fewer groups")
        made = Element(tag, attributes, place())
        way[-1].children.append(made)
        way.append(made)

    def refuse(*_: object) -> None:
        raise TooMuch(place(), "a document type (<!DOCTYPE>), which rorg does not read", "to drop it")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: way.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        where = Where(str(path), error.lineno, error.offset + 1)
        return Diagnostic(where, f"not XML: {expat.ErrorString(error.code)}", "to fix it")
    root = top.children[0]
    if root.tag != "launch":
        return Diagnostic(root.where, f"it starts with <{root.tag}>", "<launch>")
    return root
