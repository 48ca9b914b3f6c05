"""rorg history"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from rorg.cli.kinds import FILE
from rorg.cli.names import complete_revisions
from rorg.cli.options import NoHeaders, Output, Robot
from rorg.cli.output import dump, echo, print_rows, table
from rorg.cli.records import Kept, Served, records_of
from rorg.cli.terminal import entry, printable
from rorg.errors import Invalid, Refused

ACTIONS = ("list", "show", "diff", "export")
TAKEN = {"list": (0, 0), "show": (1, 1), "diff": (1, 2), "export": (0, 0)}
"""Action -> least and most words after it."""
FORMATS = ("jsonl", "protobuf")
MOST = 1000
Number = Annotated[int, typer.Option("-n", "--number", help="For list: how many of the newest.", min=1, max=MOST)]

Revs = Annotated[
    list[str],
    typer.Argument(
        help="Numbers from the list, or commits as in git: a hash, a tag, HEAD~2.", autocompletion=complete_revisions
    ),
]


def command(
    context: Robot,
    action: Annotated[
        Literal["list", "show", "diff", "export"],
        typer.Argument(help="list, show REV, diff REV [REV] (default: the newest), or export."),
    ] = "list",
    revisions: Revs = [],  # noqa: B006
    *,
    number: Number = 20,
    format: Annotated[Literal["jsonl", "protobuf"], typer.Option(help="For export: jsonl or protobuf.")] = "jsonl",
    file: Annotated[
        Path | None,
        typer.Option(
            "--file", help="For export: the file to write. Default: standard output.", metavar="FILE", click_type=FILE
        ),
    ] = None,
    output: Output = "table",
    no_headers: NoHeaders = False,
) -> None:
    """List the revisions of the manifests and the standing of each: applying, baking, untested, good, failed,
    superseded or refused. `show` one, `diff` two, or `export` everything.

    Example: rorg history diff 3 7
    """
    least, most = TAKEN[action]
    if not least <= len(revisions) <= most:
        why = f"unexpected argument '{revisions[most]}'" if len(revisions) > most else "no revision is named"
        raise Invalid(f"{action} the history", why, f"`rorg history {action}{' REV' * least}`")
    with records_of(context) as records:
        if action == "list":
            _print(records.listed(number), output, headers=not no_headers)
        elif action == "show":
            _show(records.shown(revisions[0]), output)
        elif action == "diff":
            _compare(records, revisions[0], revisions[1] if len(revisions) > 1 else "", output)
        else:
            _export(records, format, file)


def _print(revisions: list[dict[str, Any]], output: str, headers: bool) -> None:
    rows = [
        {
            **revision,
            "when": revision["at"][:19].replace("T", " "),
            "commit": _commit(revision),
            "standing": standing_text(revision),
            "author": revision["author"] or "-",
            "subject": revision["subject"] or "-",
            "settled": revision["settled_at"][:19].replace("T", " ") or "-",
        }
        for revision in revisions
    ]
    columns = ("number", "when", "commit", "author", "standing", "subject")
    wide, below = ("settled", "reason", "robot"), ("subject", "author")
    print_rows(rows, output, columns, wide, full=revisions, below=below, headers=headers)


def standing_text(revision: dict[str, Any]) -> str:
    """The standing of a revision as people read it: what was good does not look as if it had never worked."""
    if revision["standing"] == "failed" and revision.get("proven_at"):
        return f"good, then failed at {revision['settled_at'][11:16]}"
    return str(revision["standing"])


def _commit(revision: dict[str, Any]) -> str:
    return f"{revision['commit'][:10] or '-'}{'+' * revision['dirty']}"


def _show(revision: dict[str, Any], output: str) -> None:
    """Shows a revision in full."""
    if output in ("json", "yaml"):
        dump(revision, output)
        return
    if output == "name":
        echo(revision["number"])
        return
    names = ("at", "commit", "author", "subject", "robot", "settled_at", "reason")
    facts = {name: revision[name] for name in names if revision[name]} | (
        {"commit": _commit(revision)} if revision["commit"] else {}
    )
    echo(f"revision {revision['number']}: {standing_text(revision)}")
    for name, value in facts.items():
        echo(entry(f"  {name.removesuffix('_at'):<8} ", value))
    for error in revision["errors"]:
        echo(entry("  error    ", error))
    if revision["plan"]:
        echo("\n" + revision["plan"], end="")
    rows = [
        {
            "service": name,
            "image": made["image"] or "-",
            "id": made["image_id"].removeprefix("sha256:")[:12] or "-",
            "digest": made["digest"][:12],
            "declared": made["declared"],
        }
        for name, made in revision["services"].items()
    ]
    columns = ("service", "image", "id", "digest", *(("declared",) if output == "wide" else ()))
    if rows:
        echo("\n" + table(rows, columns))


def _compare(records: Served | Kept, a: str, b: str, output: str) -> None:
    newest = records.listed(1) if not b else []
    comparison = records.compared(a, b or str(newest[0]["number"] if newest else 0))
    lines = [_change(change) for change in comparison["services"]]
    same = _same(comparison["old"], comparison["new"])
    form = "table" if output == "wide" else output
    print_rows(comparison["services"], form, ("service",), full=comparison, text="\n".join(lines) or same)


def _same(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Says that no container differs. Only the manifests have fields that change no container, such as conflicts."""
    a, b = old["number"], new["number"]
    if old["fingerprint"] and old["fingerprint"] == new["fingerprint"]:
        return f"the manifests of revisions {a} and {b} are the same"
    readable = all(r["commit"] and not r["dirty"] and r["standing"] != "refused" for r in (old, new))
    return f"no container differs between revisions {a} and {b}" + (
        f"; `rorg diff {a}..{b}` compares the manifests" if readable else ""
    )


def _change(change: dict[str, Any]) -> str:
    sign = {"added": "+", "removed": "-"}.get(change["change"], "~")
    return printable(f"{sign} {change['service']}  {'; '.join(f['text'] for f in change['fields'])}".rstrip())


def _export(records: Served | Kept, format: str, file: Path | None) -> None:
    """Raises Invalid if the file cannot be written, and Refused for a format that a terminal cannot show."""
    from rorg.api.records import ENCODERS

    encode = ENCODERS[format]
    if file is None and format == "protobuf" and sys.stdout.isatty():
        raise Refused("write protocol buffers to a terminal", "they are no text", "--file FILE, or a pipe")
    try:
        with open(file, "wb") if file else open(sys.stdout.fileno(), "wb", closefd=False) as to:
            for record in records.everything():
                to.write(encode(record))
    except OSError as error:
        if isinstance(error, BrokenPipeError) or file is None:
            raise
        raise Invalid(f"write {file}", error.strerror or str(error), "another file") from error
