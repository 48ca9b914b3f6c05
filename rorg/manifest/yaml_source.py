"""Reads YAML 1.2 with the position of every key and value, on PyYAML's composer.

PyYAML implements YAML 1.1, in which `NO` is false and `1:30` is 90. Robots have services named `no` and times like
`1:30`, so scalars follow the core schema of YAML 1.2 instead (yaml.org/spec/1.2.2, 10.3.2).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import yaml

from rorg.model.diagnostics import Diagnostic, Where

BaseLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""In C where PyYAML has it. Only for composing nodes: its constructors of values take quadratic time for some texts."""
MAX_DEPTH = 50
"""The parser's recursion crashes at some ten thousand levels."""
MAX_NODES = 100_000
"""No robot's manifest has this many nodes; an alias bomb quickly does."""
MAX_ITEMS = 1000
"""Items of one list, keys of one mapping, or documents of one file, in a manifest."""
MOST_NUMBER = (1 << 63) - 1
"""The largest number that engines and kernels can store."""


class _Loader(BaseLoader):  # type: ignore[misc, valid-type]
    yaml_implicit_resolvers: dict[str, Any] = {}


for _tag, _pattern, _first in (
    ("null", r"^(~|null|Null|NULL|)$", "~nN\0"),
    ("bool", r"^(true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("int", r"^([-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", "-+0123456789"),
    (
        "float",
        r"^([-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN))$",
        "-+.0123456789",
    ),
):
    _firsts = [c for c in _first if c != "\0"] + ([""] if "\0" in _first else [])
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), _firsts)

Path = tuple[str | int, ...]


@dataclass(frozen=True, slots=True)
class Allow:
    """A comment `# rorg: allow CODE: reason`, and the lines that it covers."""

    where: Where
    code: str
    reason: str
    lines: tuple[int, int]
    """First and last line that it covers."""


class Use(NamedTuple):
    """A variable in a text, and the place that declares it; None if a default of the text was used."""

    name: str
    where: Where | None


@dataclass
class Document:
    """One YAML document: its value, and the position of each key and each value."""

    file: str
    value: Any = None
    keys: dict[Path, tuple[int, int]] = field(default_factory=dict)
    values: dict[Path, tuple[int, int]] = field(default_factory=dict)
    files: dict[Path, str] = field(default_factory=dict)
    """Path -> file, for values from an overlay that was merged in."""
    allows: tuple[Allow, ...] = ()
    """Comments that allow warnings."""
    filled: dict[Path, tuple[Use, ...]] = field(default_factory=dict)
    """Path -> variables that were filled into the text there."""
    start: int = 0
    """Lines of the file before this document."""

    def where(self, path: Path, key: bool = False) -> Where:
        """The place of a value (or of its key); of its nearest existing ancestor if the path does not exist."""
        while path:
            place = (self.keys if key else self.values).get(path) or self.values.get(path)
            if place:
                return Where(self.files.get(path, self.file), *place)
            path, key = path[:-1], False
        return Where(self.file, *self.values.get((), (1, 1)))


class Reader:
    """Converts nodes to plain values, with positions; reports duplicate keys and unsupported tags."""

    def __init__(self, file: str, nul: bool, most: int, items: int, line: int = 0, count: int = 0) -> None:
        self.document, self.nul, self.most, self.items = Document(file, start=line), nul, most, items
        self.diagnostics: list[Diagnostic] = []
        self.line, self.count = line + 1, count

    def error(self, node: yaml.Node, message: str, remedy: str = "", code: str = "") -> None:
        where = Where(self.document.file, node.start_mark.line + self.line, node.start_mark.column + 1)
        self.diagnostics.append(Diagnostic(where, message, remedy, code=code))

    def read(self, node: yaml.Node, path: Path = ()) -> Any:
        self.count += 1
        if self.count > self.most:
            raise yaml.YAMLError(f"more than {self.most} values")
        self.document.values[path] = (node.start_mark.line + self.line, node.start_mark.column + 1)
        if isinstance(node, yaml.CollectionNode) and len(node.value) > self.items:
            self.error(node, f"{len(node.value)} items, which is more than {self.items}", "fewer")
            return None
        if isinstance(node, yaml.SequenceNode):
            return [self.read(item, (*path, index)) for index, item in enumerate(node.value)]
        if isinstance(node, yaml.MappingNode):
            return self.mapping(node, path)
        assert isinstance(node, yaml.ScalarNode)
        return self.scalar(node)

    def mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.error(key_node, "a key must be plain text")
                continue
            key = key_node.value
            if key == "<<" and not key_node.style:
                self.error(key_node, "merge keys (<<) are not part of YAML 1.2", "a Profile for what services share")
                continue
            if key in result:
                line = self.document.keys[(*path, key)][0]
                remedy = f"to drop it here or in line {line}"
                self.error(key_node, f"key '{key}' appears twice in one mapping", remedy, "duplicate-key")
                continue
            self.document.keys[(*path, key)] = (key_node.start_mark.line + self.line, key_node.start_mark.column + 1)
            result[key] = self.read(value_node, (*path, key))
        return result

    def scalar(self, node: yaml.ScalarNode) -> Any:
        tag, text = node.tag.rpartition(":")[2], node.value
        if tag == "null":
            return None
        if tag == "bool":
            return text.lower() == "true"
        if tag in ("int", "float"):
            return self.number(node, tag, text)
        if tag != "str":
            self.error(node, f"tag {node.tag} is not supported", "plain text, numbers, lists and mappings")
        if "\0" in text and not self.nul:
            self.error(node, "a NUL character, which ends a text for the engine and for programs", "to leave it out")
        return text

    def number(self, node: yaml.Node, tag: str, text: str) -> int | float:
        try:
            if tag == "int":
                value: int | float = int(text, 0) if text[:2] in ("0o", "0x") else int(text)
            else:
                value = float(re.sub(r"\.(?=[inIN])", "", text))
        except ValueError:  # so many digits that Python does not even try
            value = math.inf
        if not -MOST_NUMBER <= value <= MOST_NUMBER:
            shown = text if len(text) <= 40 else f"{text[:40]}..."
            self.error(node, f"{shown} is out of range for any number", "quotes around it where it is a text")
            return 0
        return value


def check_size(text: str, most: float = math.inf) -> None:
    """Raises YAMLError if the nesting is too deep, or for more than `most` values, before an object of each exists.
    Every level needs at least one of these characters, and every value but the first has one directly before or after
    it."""
    signs = sum(map(text.count, ",[{-:?"))
    if signs <= MAX_DEPTH and 2 * signs < most:
        return
    try:
        _count(text, most, _Loader)
    except yaml.MarkedYAMLError as error:
        if error.problem != LIBYAML_TOO_DEEP:
            raise
        _count(text, most, yaml.SafeLoader)  # it reads only as far as the limit


LIBYAML_TOO_DEEP = "exceeded maximum nesting depth"
"""libyaml's message since PyYAML 6.0.4. It reads ahead, so it names a place behind the one that is too deep."""


def _count(text: str, most: float, loader: Any) -> None:
    depth = count = 0
    for event in yaml.parse(text, Loader=loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        count += isinstance(event, yaml.NodeEvent)
        if depth > MAX_DEPTH or count > most:
            why = f"nested more than {MAX_DEPTH} deep" if depth > MAX_DEPTH else f"more than {most} values"
            mark: Any = event.start_mark
            raise yaml.MarkedYAMLError(problem=why, problem_mark=mark)


UNREADABLE = (yaml.YAMLError, RecursionError, UnicodeError)
"""What PyYAML raises for a bad text."""


_TAB = re.compile(r"[ -]*\t")


def not_yaml(error: Exception, file: str, text: str = "", start: int = 0) -> Diagnostic:
    """Says why a text is not valid YAML. `start`: lines of the file before it."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return Diagnostic(Where(file, start + 1), f"not valid YAML: {error}")
    mark = error.problem_mark or error.context_mark
    where = Where(file, start + mark.line + 1, mark.column + 1) if mark else Where(file, start + 1)
    line = next(iter(text.split("\n")[mark.line : mark.line + 1]), "") if mark else ""
    if tab := _TAB.match(line):
        where = Where(file, where.line, tab.end())
        return Diagnostic(where, "not valid YAML: this line is indented with a tab", "spaces")
    return Diagnostic(where, f"not valid YAML: {error.problem or error.context}")


_ALLOW = re.compile(r"(?:^|\s)(#+\s*rorg:\s*allow\b[ \t]*([^\s:]*)[ \t]*:?[ \t]*(.*))$")


def allows(text: str, file: str, start: int = 0) -> tuple[Allow, ...]:
    """Finds the comments that allow warnings. One behind code covers its line; one on its own line covers the next line
    that is not a comment. `start`: lines of the file before the text."""
    if "rorg:" not in text:
        return ()
    allowances, following = list[Allow](), 0
    for number, line in reversed([*enumerate(text.split("\n"), start + 1)]):
        comment = line.lstrip().startswith("#")
        if match := _ALLOW.search(line):
            last = following or number if comment else number
            allowances.append(
                Allow(Where(file, number, match.start(1) + 1), match[2], match[3].strip(), (number, last))
            )
        if line.strip() and not comment:
            following = number
    return tuple(reversed(allowances))


def read_yaml(
    text: str, file: str, nul: bool = False, most: int = MAX_NODES, items: int = MAX_NODES
) -> tuple[Document | None, list[Diagnostic]]:
    """Reads the single document of a file, and reports everything that is wrong with it as YAML. `file` is only shown,
    never opened. `nul` allows NUL characters, for texts that go to no engine and no program. `most` limits the number
    of values, `items` the length of one list or mapping."""
    reader = Reader(file, nul, most, items)
    return read_one(reader, text), reader.diagnostics


def read_one(reader: Reader, text: str) -> Document | None:
    """Reads the single document of a text; None if there is none, or if it is not YAML."""
    document, start = reader.document, reader.document.start
    try:
        check_size(text)
        nodes = [node for node in yaml.compose_all(text, Loader=_Loader) if not _empty(node)]
        if len(nodes) > 1:
            reader.error(nodes[1], "a second document in one file", "one file for each document")
        if not nodes:
            where = Where(document.file, start + 1)
            remedy = "to fill it, or delete the file"
            reader.diagnostics = [Diagnostic(where, "the document is empty", remedy, code="empty-document")]
            return None
        document.value = reader.read(nodes[0])
        document.allows = allows(text, document.file, start)
    except UNREADABLE as error:
        reader.diagnostics = [not_yaml(error, document.file, text, start)]
        return None
    return document


def _empty(node: Any) -> bool:
    return node is None or (node.tag.endswith(":null") and not node.value)


def as_scalar(text: str) -> str | int | float | bool:
    """Converts a text to the number or boolean that YAML reads, or returns it unchanged."""
    document, diagnostics = read_yaml(text, "")
    value = document.value if document and not diagnostics else None
    return value if isinstance(value, bool | int | float) else text
