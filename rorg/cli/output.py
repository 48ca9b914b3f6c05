"""The forms of output: tables for people, plain when piped; names, YAML and JSON for programs."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import typer

from rorg.errors import Invalid

FORMS = ("table", "wide", "name", "yaml", "json")


def check_form(form: str, allowed: Sequence[str] = FORMS) -> None:
    """Raises Invalid for an output format that there is not."""
    if form not in allowed:
        raise Invalid(f"print as '{form}'", "there is no such form", "one of " + ", ".join(allowed))


def note(text: str) -> None:
    """For people; data alone goes to standard output. That nobody reads it ends nothing."""
    with contextlib.suppress(OSError):
        typer.echo(text, err=True)


def dump(value: Any, form: str) -> None:
    """JSON or YAML."""
    if form == "json":
        typer.echo(json.dumps(value, indent=2))
    else:
        import yaml

        typer.echo(yaml.safe_dump(value, sort_keys=False), nl=False)


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    """A plain table: upper-case heads, columns as wide as needed."""
    cells = [[c.upper() for c in columns]] + [[str(row.get(c, "")) for c in columns] for row in rows]
    widths = [max(len(line[i]) for line in cells) for i in range(len(columns))]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in cells)


COLOURS = {
    "Healthy": "green",
    "Completed": "green",
    "Progressing": "yellow",
    "Degraded": "red",
    "Idle": "dim",
    "running": "green",
    "paused": "blue",
    "OutOfSync": "yellow",
    "Unknown": "magenta",
}


def rich_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str], title: str = "") -> Any:
    """The same for a terminal, with colours."""
    from rich.table import Table
    from rich.text import Text

    found = Table(title=title or None, box=None, pad_edge=False, header_style="bold", title_justify="left")
    for column in columns:
        found.add_column(column.upper(), no_wrap=column != "why", overflow="ellipsis")
    for row in rows:
        texts = [str(row.get(c, "")) for c in columns]
        found.add_row(*[Text(t, style=COLOURS.get(t, "")) for t in texts])
    return found


def print_rows(
    rows: Sequence[Mapping[str, Any]], form: str, columns: Sequence[str], wide: Sequence[str] = (), full: Any = None
) -> None:
    """Rows in any form. `full` is what YAML and JSON show instead of the rows."""
    check_form(form)
    if form in ("json", "yaml"):
        dump(rows if full is None else full, form)
    elif form == "name":
        for row in rows:
            typer.echo(row[columns[0]])
    elif sys.stdout.isatty():
        from rich.console import Console

        Console().print(rich_table(rows, [*columns, *(wide if form == "wide" else ())]))
    else:
        typer.echo(table(rows, [*columns, *(wide if form == "wide" else ())]))


def missing(what: str, name: str, known: Any) -> Invalid:
    """The error for a name that is not there."""
    from rorg.model.diagnostics import nearest

    return Invalid(f"find the {what} '{name}'", "there is none of that name", nearest(name, known))


def nearest_kind(kind: str, known: Any) -> str:
    """Raises Invalid with the closest kind as its remedy."""
    raise missing("kind", kind, known)
