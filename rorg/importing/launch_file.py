"""The elements of a launch file with their places. A document type is refused: its entities multiply, and roslaunch's
users do not write them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where

MOST_ELEMENTS = 20_000
"""Of one file. The largest that people write have some hundreds."""
MOST_DEPTH = 100
"""Elements within each other."""


@dataclass(slots=True)
class Element:
    """One element. Text between elements is left out."""

    tag: str
    attributes: Mapping[str, str]
    where: Where
    children: list[Element] = field(default_factory=list)

    def get(self, name: str, otherwise: str = "") -> str:
        """The value of an attribute."""
        return self.attributes.get(name, otherwise)


def read_launch(path: Path, text: str) -> Element | Diagnostic:
    """The outermost element, or why there is none. Raises TooMuch."""
    parser = expat.ParserCreate("utf-8")  # it has been decoded, whatever it says
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
            raise TooMuch(place(), f"more than {MOST_DEPTH} elements within each other", "fewer groups")
        made = Element(tag, attributes, place())
        way[-1].children.append(made)
        way.append(made)

    def refuse(*_: object) -> None:
        raise TooMuch(place(), "a document type (<!DOCTYPE>), which rorg does not read", "dropping it")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: way.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        where = Where(str(path), error.lineno, error.offset + 1)
        return Diagnostic(where, f"not XML: {expat.ErrorString(error.code)}", "fixing it")
    found = top.children[0]
    if found.tag != "launch":
        return Diagnostic(found.where, f"it begins with <{found.tag}>", "<launch>")
    return found
