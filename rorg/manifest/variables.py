"""Variables of a tree: `robot.env` declares them, and they are filled into the values of `spec`.

`robot.env` is at the top of the tree; the one in `robots/NAME/` is applied on top of it for that robot. Both are read
like a Compose .env file (dotenv.py). The environment of the process is never used, so a tree means the same wherever it
is read. In a tree with such a file, `${NAME}` and Compose's other forms in braces (template.py) are replaced, and
`$${NAME}` gives the text `${NAME}`. NAME must be declared; an undeclared name in capitals is an error. Every other
dollar sign stays: `$NAME`, `$(...)`, `$$`, `${service}`, and a shell's `${name}` in small letters. Without such a file
nothing is replaced, so that older trees keep their meaning.

A bare NAME in `environment`, or in the `args` of an Image, takes the value of the variable with that name.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rorg.manifest.dotenv import read_dotenv
from rorg.manifest.files import read_plain
from rorg.manifest.overlay import FOLDER
from rorg.manifest.template import Budget, Refused, interpolate, reference_at
from rorg.manifest.template import variables as references
from rorg.manifest.yaml_source import Document, Use
from rorg.manifest.yaml_source import Path as Loc
from rorg.model.diagnostics import Diagnostic, Reading, Where, nearest

FILE = "robot.env"
TAKEN = "service"
"""`${service}` is the service that uses the profile."""
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_CAPITALS = re.compile(r"[A-Z_][A-Z0-9_]*")
_BRACES = re.compile(r"(?<!\$)(\$+)\{([A-Za-z_][A-Za-z0-9_]*)")
_BARE = {"Service": ("container", "environment"), "Profile": ("container", "environment"), "Image": ("args",)}
"""Kind -> path in its spec where a bare name means a variable."""


@dataclass(frozen=True)
class Variables:
    """The variables of one tree, on one robot."""

    values: Mapping[str, str] = field(default_factory=dict)
    places: Mapping[str, Where] = field(default_factory=dict)
    """Name -> the line that declares it."""
    declared: bool = False
    """Whether any file of variables exists."""


NONE = Variables()


def variable_files(root: Path, robot: str) -> list[Path]:
    """Files that may declare variables, existing or not; later ones win."""
    return [root / FILE, *([root / FOLDER / robot / FILE] if robot else [])]


def read_variables(root: Path, robot: str) -> Reading[Variables]:
    """Reads the variables of a tree."""
    values: dict[str, str] = {}
    places: dict[str, Where] = {}
    declared = False
    for path in variable_files(root, robot):
        try:
            text = read_plain(path, root)
        except FileNotFoundError:
            continue
        except OSError as error:
            yield Diagnostic(Where(str(path)), f"cannot be read: {error.strerror}", "to fix or delete it")
            continue
        declared = True
        yield from _declare(text, str(path), values, places)
    return Variables(values, places, declared)


def _declare(text: str, file: str, values: dict[str, str], places: dict[str, Where]) -> Iterator[Diagnostic]:
    """Adds the variables of one file."""
    entries, mistakes = read_dotenv(text, lambda _: None, values)
    yield from (Diagnostic(Where(file, m.line, m.column), m.message, m.remedy) for m in mistakes)
    for entry in entries:
        where = Where(file, entry.line, entry.column)
        if entry.name == TAKEN or not _NAME.fullmatch(entry.name):
            message = f"a variable cannot be called '{entry.name}'"
            yield Diagnostic(where, message, "capital letters, digits and _, such as ROBOT_NAME")
        elif entry.value is None:
            yield Diagnostic(where, f"'{entry.name}' has no value", f"{entry.name}=value")
        for name in entry.unset:
            message = f"{entry.name} is made of '{name}', which no line before it declares"
            yield Diagnostic(where, message, f"{name}=value in a line before it")
        values[entry.name] = entry.value or ""
        places[entry.name] = where


def fill(document: Document, variables: Variables) -> tuple[Document, list[Diagnostic]]:
    """Fills in the variables of a manifest; returns it with what is wrong with them. The result records which variables
    each value uses."""
    if not isinstance(document.value, dict) or "spec" not in document.value:
        return document, []
    filler = _Filler(document, variables)
    spec = document.value["spec"]
    if variables.declared:
        spec = filler.value(spec, ("spec",))
    bare = _BARE.get(kind) if isinstance(kind := document.value.get("kind"), str) else None
    if bare:
        spec = filler.bare(spec, ("spec",), bare)
    if spec == document.value["spec"] and not filler.filled and not filler.diagnostics:
        return document, []
    return replace(document, value={**document.value, "spec": spec}, filled=filler.filled), filler.diagnostics


def noted(diagnostics: Iterable[Diagnostic], documents: Iterable[Document]) -> list[Diagnostic]:
    """Adds to each diagnostic about a filled-in value which variables it uses and where they are declared."""
    notes = {
        document.where(path): text
        for document in documents
        for path, used in document.filled.items()
        if (text := told(used))
    }
    annotated = []
    for one in diagnostics:
        note = notes.get(one.where, "")
        annotated.append(one if not note or note in one.message else replace(one, message=f"{one.message} ({note})"))
    return annotated


def told(used: Iterable[Use]) -> str:
    """Names of variables with the lines that declare them, for people."""
    return ", ".join(f"{use.name} is set at {use.where.file}:{use.where.line}" for use in used if use.where)


class _Filler:
    """Fills in one document and records the variables of each value."""

    def __init__(self, document: Document, variables: Variables) -> None:
        self.document, self.variables, self.budget = document, variables, Budget()
        self.filled: dict[Loc, tuple[Use, ...]] = {}
        self.diagnostics: list[Diagnostic] = []

    def value(self, value: Any, path: Loc) -> Any:
        if isinstance(value, str):
            return self.text(value, path) if "${" in value else value
        if isinstance(value, dict):
            return {key: self.value(below, (*path, key)) for key, below in value.items()}
        return [self.value(v, (*path, i)) for i, v in enumerate(value)] if isinstance(value, list) else value

    def text(self, text: str, path: Loc) -> str:
        """Fills in one text. Before a brace, two dollar signs stand for one, as in Compose."""
        parts, at = [], 0
        while match := _BRACES.search(text, at):
            dollars, name = len(match[1]), match[2]
            parts.append(text[at : match.start()])
            at = match.end(1)
            if not (name in self.variables.values or _CAPITALS.fullmatch(name)):
                parts.append(match[1])
                continue
            parts.append("$" * (dollars // 2))
            if dollars % 2:
                value, at = self.reference(text, at - 1, path)
                parts.append(value)
        return "".join(parts) + text[at:]

    def reference(self, text: str, at: int, path: Loc) -> tuple[str, int]:
        """Returns the value of the reference at an offset, and its end."""
        remedy = "${NAME}, ${NAME:-default}, or a second $ in front for that text itself"
        try:
            form = reference_at(text, at)
            remedy = ""
            self._use(path, (form.name, *(inner.name for inner in references(form.argument))))
            filled = interpolate(text[at : form.end], self._lookup, self.budget)
        except Refused as why:
            remedy = remedy or (f"{why.name}=value in {FILE}" if why.name else why.remedy)
            self._refuse(path, why.message, remedy)
            return "", len(text)
        for name in filled.unset:
            near = nearest(name, self.variables.values)
            known = f"{near}, " if near and not near.startswith("one of") else ""
            remedy = f"{known}{name}=value in {FILE}, or $${{{name}}} for that text itself"
            self._refuse(path, f"no variable '{name}' is declared in {FILE}", remedy)
        return filled.text, form.end

    def bare(self, value: Any, path: Loc, below: tuple[str, ...]) -> Any:
        """Gives bare names below a path the value of their variable."""
        if below:
            if not isinstance(value, dict) or below[0] not in value:
                return value
            return {**value, below[0]: self.bare(value[below[0]], (*path, below[0]), below[1:])}
        if isinstance(value, dict):
            return {k: self._of_variable(k, (*path, k)) if v is None else v for k, v in value.items()}
        if not isinstance(value, list):
            return value
        return [
            f"{item}={self._of_variable(item, (*path, index))}" if isinstance(item, str) and "=" not in item else item
            for index, item in enumerate(value)
        ]

    def _of_variable(self, name: str, path: Loc) -> str:
        self._use(path, (name,))
        if name not in self.variables.values:
            message = f"'{name}' has no value, and no variable of that name is declared in {FILE}"
            self._refuse(path, message, f"a value here, or {name}=value in {FILE}")
            return ""
        try:
            return interpolate(f"${{{name}}}", self._lookup, self.budget).text
        except Refused as why:
            self._refuse(path, why.message, why.remedy)
            return ""

    def _lookup(self, name: str) -> str | None:
        """Returns the value of a variable; names that are not variables stay as they are, even inside other braces."""
        return self.variables.values.get(name, None if _CAPITALS.fullmatch(name) else f"${{{name}}}")

    def _use(self, path: Loc, names: Iterable[str]) -> None:
        before = self.filled.get(path, ())
        uses = (Use(name, self.variables.places.get(name)) for name in names)
        self.filled[path] = tuple(dict.fromkeys((*before, *uses)))

    def _refuse(self, path: Loc, message: str, remedy: str) -> None:
        self.diagnostics.append(Diagnostic(self.document.where(path), message, remedy))
