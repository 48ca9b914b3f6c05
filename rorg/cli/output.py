"""The forms of output: tables for people, plain when piped; names, YAML and JSON for programs. Also notices for people
on standard error."""

from __future__ import annotations

import contextlib
import json
import os
import select
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn

from rorg.cli.terminal import entry, lines, printable, shown
from rorg.errors import Invalid, Refused
from rorg.model.units import counted


def echo(text: Any, end: str = "\n") -> None:
    """Prints data to standard output, escaped for terminals, and flushes it."""
    write(lines(text), end)


def write(text: str, end: str = "\n") -> None:
    """Prints text that rorg made itself, which may have colours."""
    print(text, end=end, flush=True)


def nobody_reads() -> NoReturn:
    """Exits with 0: the reader has seen enough, as `head` does."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(0)


def end_with_reader() -> None:
    """From now on the process exits as soon as its output is closed, even if it prints nothing."""

    def look() -> None:
        poll = select.poll()
        poll.register(sys.stdout.fileno(), 0)
        if any(event & select.POLLERR for _, event in poll.poll()):
            os._exit(0)

    threading.Thread(target=look, name="reader", daemon=True).start()


def note(text: str) -> None:
    """Prints a text for people to standard error; a closed standard error is ignored."""
    with contextlib.suppress(OSError):
        print(lines(text), file=sys.stderr, flush=True)


def confirm(question: str) -> bool:
    """Asks the person at the terminal; no answer means no."""
    print(f"{printable(question)} [y/N]: ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def consent(what: str, question: str, why: str = "it needs confirmation") -> None:
    """Asks the person at the terminal whether to do `what`. Raises Refused for a no, and without a terminal."""
    if not sys.stdin.isatty():
        raise Refused(what, f"{why}, and there is no terminal", "--yes")
    if not confirm(question):
        raise Refused(what, "you answered no")


@contextlib.contextmanager
def disk_errors(what: str, remedy: str) -> Iterator[None]:
    """Turns what the disk refuses in the block into Invalid for `what`, with the file if `what` does not name it."""
    try:
        yield
    except OSError as error:
        file = "" if not error.filename or str(error.filename) in what else f"{error.filename}: "
        raise Invalid(what, f"{file}{error.strerror or error}", remedy) from error


def dump(value: Any, form: str) -> None:
    """Prints JSON or YAML, which escape special characters themselves."""
    value = shown(value)
    if form == "json":
        write(as_json(value, 2))
    else:
        import yaml

        write(yaml.safe_dump(value, sort_keys=False), end="")


def as_json(value: Any, indent: int | None = None) -> str:
    """JSON in ASCII, with DEL escaped too."""
    return json.dumps(value, indent=indent).replace("\x7f", "\\u007f")


def cells(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> tuple[list[list[str]], list[int]]:
    """(rows of cells, the head first; the width of each column)."""
    grid = [[c.upper() for c in columns]] + [[printable(row.get(c, "")) for c in columns] for row in rows]
    return grid, [max(_width(line[i]) for line in grid) for i in range(len(columns))]


def _width(text: str) -> int:
    """Columns on a terminal."""
    if text.isascii():
        return len(text)
    from unicodedata import combining, east_asian_width

    return sum(0 if combining(c) else 2 if east_asian_width(c) in "WF" else 1 for c in text)


def _padded(text: str, width: int) -> str:
    return text + " " * (width - _width(text))


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """A plain table: heads in upper case, columns as wide as needed."""
    grid, widths = cells(rows, columns)
    return "\n".join("  ".join(_padded(c, w) for c, w in zip(line, widths, strict=True)).rstrip() for line in grid)


COLOURS = {
    "Healthy": "green",
    "Completed": "green",
    "Progressing": "yellow",
    "Degraded": "red",
    "Preempted": "yellow",
    "Waiting": "yellow",
    "Idle": "dim",
    "running": "green",
    "paused": "blue",
    "stopping": "yellow",
    "OutOfSync": "yellow",
    "Unknown": "magenta",
}
CODES = {"bold": "1", "dim": "2", "red": "31", "green": "32", "yellow": "33", "blue": "34", "magenta": "35"}


def coloured_table(
    rows: Sequence[Mapping[str, Any]],
    columns: Sequence[str],
    width: int,
    below: Sequence[str] = (),
    colours: bool = True,
) -> str:
    """The same with colours, for a terminal of `width` columns. If it does not fit, columns in `below` move to lines of
    their own under each row, the last one first. Nothing is ever cut."""
    beside, under = list(columns), list[str]()
    grid, widths = cells(rows, beside)
    while sum(widths) + 2 * (len(widths) - 1) > width and (movable := [c for c in beside if c in below]):
        beside.remove(movable[-1])
        under.insert(0, movable[-1])
        grid, widths = cells(rows, beside)
    styles = [["bold"] * len(beside), *([COLOURS.get(c, "") for c in line] for line in grid[1:])]
    lines: list[str] = []
    for index, (line, of) in enumerate(zip(grid, styles, strict=True)):
        shown = (_styled(_padded(c, w), style if colours else "") for c, w, style in zip(line, widths, of, strict=True))
        lines.append("  ".join(shown).rstrip())
        row: Mapping[str, Any] = rows[index - 1] if index else {}
        lines += [f"    {c}: {printable(row[c])}" for c in under if row.get(c) not in ("", "-", None)]
    return "\n".join(lines)


def _styled(text: str, style: str) -> str:
    return f"\033[{CODES[style]}m{text}\033[0m" if style else text


def print_rows(
    rows: Sequence[Mapping[str, Any]],
    form: str,
    columns: Sequence[str],
    wide: Sequence[str] = (),
    *,
    full: Any = None,
    below: Sequence[str] = (),
    text: str | None = None,
    headers: bool = True,
) -> None:
    """Prints rows in any form. `full`: what YAML and JSON show instead of the rows; `text`: what people read instead of
    the table, such as the result of an action; `below`: columns that a narrow terminal shows in lines of their own. The
    first column is the name."""
    shown = columns_of(form, columns, wide)
    if form in ("json", "yaml"):
        dump(rows if full is None else full, form)
    elif form == "name":
        for row in rows:
            echo(printable(row[columns[0]]))
    elif text is not None and form == "table":
        if text:
            echo(text)
    elif sys.stdout.isatty():
        table_text = screen_table(rows, shown, below)
        write(table_text if headers else table_text.partition("\n")[2])
    elif headers or rows:
        table_text = table(rows, shown)
        echo(table_text if headers else table_text.partition("\n")[2])


def columns_of(form: str, columns: Sequence[str], wide: Sequence[str]) -> list[str]:
    """The columns of a form."""
    return [*columns, *(wide if form == "wide" else ())]


def screen_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], below: Sequence[str]) -> str:
    """The table for this terminal."""
    colours = "NO_COLOR" not in os.environ and os.environ.get("TERM", "dumb") not in ("dumb", "unknown")
    return coloured_table(rows, columns, _terminal_width(), below, colours)


def _terminal_width() -> int:
    try:
        return int(os.environ.get("COLUMNS") or os.get_terminal_size(sys.stdout.fileno()).columns) or 80
    except (OSError, ValueError):
        return 80


def missing(what: str, name: str, known: Any) -> Invalid:
    """The error for an unknown name."""
    from rorg.model.diagnostics import nearest

    remedy = nearest(name, known) or "`rorg get` for all names"
    return Invalid(f"find the {what} '{printable(name)}'", f"no such {what}", remedy)


def kind_behind(command: str, kind: str, names: Sequence[str]) -> Invalid:
    """The error for a kind that is typed behind names, and so is taken for the name of a service."""
    remedy = " ".join(("rorg", command, kind, *map(printable, names)))
    return Invalid(f"find the service '{kind}'", "a kind comes before names", f"`{remedy}`")


class Notices:
    """What a command prints on standard error above its answer, each line once: what is not in force, and who does not
    answer. Standard output stays pure data."""

    def __init__(self) -> None:
        self.quiet = False
        """Print nothing, because a shell completes a line."""
        self._said: set[str] = set()

    def say(self, text: str) -> None:
        """Prints a notice, unless it was printed before."""
        if not self.quiet and text not in self._said:
            self._said.add(text)
            note(entry("", text))

    def of(self, view: dict[str, Any], silent: bool) -> None:
        """Prints what a reader of this status must know. `silent`: it was already noted that the engine does not
        answer."""
        for text in _of(view, silent):
            self.say(text)

    def of_standing(self, view: dict[str, Any]) -> None:
        """Notes that the manifests are still baking. Only for listings of services, because every change causes it for
        some seconds."""
        standing = view.get("tree", {}).get("standing") or {}
        if standing.get("code") == "baking":
            self.say(f"manifests are baking: {standing['reason']}")


def _of(view: dict[str, Any], silent: bool) -> Iterator[str]:
    engine, tree = view.get("engine", {}), view.get("tree", {})
    if not (engine.get("complete", True) or silent) and view.get("pid"):
        yield f"{engine.get('error') or 'the engine has not said yet what runs'}; states may be old"
    if errors := tree.get("errors"):
        kept = "the last good ones are in force" if tree.get("fingerprint") else "none are in force yet"
        yield f"manifests refused: {counted(len(errors), 'error')}, {kept}; try `rorg validate`"
    if error := (tree.get("git") or {}).get("error"):
        yield f"git: {error}"
    yield from view.get("requests_errors") or []
    if view.get("suspended"):
        yield f"rorg is {view['suspended']}"
    if view.get("down") == "down":
        yield "the robot is down; try `rorg up`"
