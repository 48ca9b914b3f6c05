"""Variables of a project: where their values come from, and filling them in."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from rorg.manifest.dotenv import read_dotenv
from rorg.manifest.files import Outside
from rorg.manifest.template import Refused, interpolate
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Diagnostic, Where, nearest
from rorg.tools.compose.nodes import MOST_VALUES, Node
from rorg.tools.compose.project import Variable

OF_A_VALUE, OF_A_FILE = 64, 32
"""Characters of filled-in variables, and of an env file, that count as one value."""
MISSING = (FileNotFoundError, NotADirectoryError, IsADirectoryError)


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
class Files:
    """Reads each file once, reports unreadable ones, and counts the values of the project."""

    read: Callable[[Path], str]
    diagnostics: list[Diagnostic] = field(default_factory=list)
    texts: dict[Path, str | None] = field(default_factory=dict)
    spent: int = 0
    near: Suggestions = field(default_factory=Suggestions)

    def spend(self, values: int, where: Where) -> None:
        """Raises TooMuch for more values than anyone writes: files that include each other again and again, a service
        that is extended a thousand times."""
        self.spent += values
        if self.spent > MOST_VALUES:
            message = f"with what it includes, extends and fills in, the project has more than {MOST_VALUES} values"
            raise TooMuch(where, message)

    def error(self, where: Where, message: str, remedy: str) -> None:
        self.diagnostics.append(Diagnostic(where, message, remedy))

    def text(self, path: Path, where: Where, what: str) -> str | None:
        """The text of a file; None if it cannot be read, which is reported at `where` for everything that names it."""
        if path not in self.texts:
            self.texts[path] = None
            try:
                self.texts[path] = self.read(path)
            except (OSError, UnicodeError) as error:
                why = error.strerror if isinstance(error, OSError) else "not a text in UTF-8"
                named = f"--read {path}, if you trust the project"
                remedy = named if isinstance(error, Outside) else "the path of an existing file"
                self.error(where, f"cannot read {what} {path}: {why}", remedy)
        elif self.texts[path] is None:
            self.error(where, f"cannot read {what} {path}", "the path of an existing file")
        return self.texts[path]

    def there(self, path: Path) -> bool:
        """Whether the file exists. An unreadable file exists; text() reports why it cannot be read."""
        if path not in self.texts:
            try:
                self.texts[path] = self.read(path)
            except MISSING:
                return False
            except (OSError, UnicodeError):
                return True
        return self.texts[path] is not None


@dataclass
class Variables:
    """Values for interpolation. The process's environment takes precedence over env files."""

    environment: Mapping[str, str]
    of_files: dict[str, tuple[str, Where]] = field(default_factory=dict)
    asked: dict[str, Variable] = field(default_factory=dict)
    """All variables that were used."""
    spend: Callable[[int, Where], None] = lambda _values, _where: None
    """Counts the values that are filled in."""

    def get(self, name: str) -> str | None:
        value = self.environment.get(name)
        if value is None and name in self.of_files:
            return self.of_files[name][0]
        return value

    def take(self, name: str, where: Where) -> str | None:
        """The value, noted as used at `where`."""
        value = self.get(name)
        self.spend(len(value or "") // OF_A_VALUE, where)
        from_file = name not in self.environment and name in self.of_files
        self.asked.setdefault(name, Variable(name, value, self.of_files[name][1] if from_file else None))
        return value

    def add_file(self, path: Path, text: str, diagnostics: list[Diagnostic]) -> None:
        """Adds the variables of an env file, which override those of earlier files."""
        for name, (value, where, _) in read_env_file(path, text, self, diagnostics).items():
            if value is not None:
                self.of_files[name] = (value, where)

    def within(self) -> Variables:
        """The variables of an included file: its own env files can only add names that are not set yet."""
        every = {name: value for name, (value, _) in self.of_files.items()} | dict(self.environment)
        return Variables(every, {}, self.asked, self.spend)


def read_env_file(
    path: Path,
    text: str,
    variables: Variables,
    diagnostics: list[Diagnostic],
    raw: bool = False,
    before: Mapping[str, str] | None = None,
) -> dict[str, tuple[str | None, Where, bool]]:
    """Name -> its value, its place, and whether it is a bare name. `raw`: NAME=value lines are read literally, as
    Docker does (`format: raw`). `before`: values from earlier files of the same service."""
    variables.spend(len(text) // OF_A_FILE, Where(str(path)))
    if raw:
        return _raw(path, text, variables)
    earlier, whole = before or {}, Where(str(path))
    entries, mistakes = read_dotenv(text, lambda name: _either(variables.take(name, whole), earlier.get(name)))
    for mistake in mistakes:
        where = Where(str(path), mistake.line, mistake.column)
        diagnostics.append(Diagnostic(where, mistake.message, mistake.remedy))
    values: dict[str, tuple[str | None, Where, bool]] = {}
    for entry in entries:
        where = Where(str(path), entry.line, entry.column)
        diagnostics += [unset(name, where) for name in entry.unset]
        if not entry.bare or entry.value is not None:
            values[entry.name] = (entry.value, where, entry.bare)
    return values


def _either(value: str | None, other: str | None) -> str | None:
    return other if value is None else value


def _raw(path: Path, text: str, variables: Variables) -> dict[str, tuple[str | None, Where, bool]]:
    values: dict[str, tuple[str | None, Where, bool]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        name, assigned, value = line.lstrip().partition("=")
        if name and not name.startswith("#"):
            where = Where(str(path), number)
            values[name] = (value, where, False) if assigned else (variables.take(name, where), where, True)
    return values


def unset(name: str, where: Where) -> Diagnostic:
    """The same warning that Compose gives."""
    message = f"variable {name} is not set, so it is empty here"
    return Diagnostic(
        where, message, f"a value of {name} in .env or the environment, or ${{{name}:-default}}", "warning"
    )


def fill(node: Node, variables: Variables, diagnostics: list[Diagnostic]) -> Node:
    """A node with its variables filled in. Texts that cannot be filled in stay as they are, and are reported."""
    if isinstance(node.value, dict):
        return node.but({key: fill(value, variables, diagnostics) for key, value in node.value.items()})
    if isinstance(node.value, list):
        return node.but([fill(value, variables, diagnostics) for value in node.value])
    if not isinstance(node.value, str) or "$" not in node.value:
        return node
    try:
        filled = interpolate(node.value, lambda name: variables.take(name, node.where))
    except Refused as why:
        where = node.where
        if node.exact:
            where = replace(where, column=where.column + why.offset)
        diagnostics.append(Diagnostic(where, why.message, why.remedy))
        return node
    diagnostics += [unset(name, node.where) for name in filled.unset]
    return node.but(filled.text, taken=filled.used, exact=node.exact and not filled.used)


def bare(name: str, node: Node, variables: Variables) -> Node:
    """A name without a value, with its value from outside."""
    if node.value is not None:
        return node
    return node.but(variables.take(name, node.where), taken=(name,))
