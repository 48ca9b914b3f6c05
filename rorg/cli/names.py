"""Names that a shell offers after TAB: from the running rorg, or from a quick look at the manifests. What takes time is
imported only when a shell asks."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer._click.shell_completion import CompletionItem

from rorg.cli.kinds import KINDS, CompletedPath
from rorg.model.event_kinds import EVENT_KINDS

if TYPE_CHECKING:
    from rorg.cli.context import Context

LONGEST = 1.0
"""Longest time, in seconds, that a shell waits for names."""
MOST = 1 << 16
"""Characters of a manifest that are read."""
REVISIONS = 20
"""Revisions that are offered."""
FIELDS = Path(__file__).with_name("fields.txt")
"""Paths of all fields of manifests, one a line, from docs/reference/generate.py: importing the models takes too long
for a TAB."""
NAME = re.compile(
    r"""^metadata:\s*(?:\{[^}\n]*?|(?:.*\n\s+)*?)\bname:\s*["']?([\w.-]+(?:[/:][\w.-]+)*)""", re.MULTILINE
)
SEPARATOR = re.compile(r"^---(?=\s)", re.MULTILINE)
KIND = re.compile(r"^kind:\s*(\w+)", re.MULTILINE)


def complete_services(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of services and groups; only people make requests as developer, so nobody requests it."""
    names = _completions(ctx, "service", incomplete)
    return [n for n in names if n != "developer" or ctx.info_name != "request"]


def complete_groups(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of groups."""
    return _completions(ctx, "group", incomplete)


def complete_images(ctx: typer.Context, incomplete: str) -> list[str]:
    """Names of images of the tree."""
    return _completions(ctx, "image", incomplete)


def complete_requests(ctx: typer.Context, incomplete: str) -> list[str]:
    """Ids of requests that can be released."""
    return _completions(ctx, "request", incomplete)


def complete_kinds_and_names(ctx: typer.Context, incomplete: str) -> list[str]:
    """Kinds, services and groups; after a kind, its names."""
    first = next(_typed(ctx), "")
    kind = next((kind for kind, words in KINDS.items() if first in words), "service")
    kinds = [] if first else [words[0] for words in KINDS.values() if words[0].startswith(incomplete)]
    return kinds + _completions(ctx, kind, incomplete)


def complete_fields_and_services(ctx: typer.Context, incomplete: str) -> list[str]:
    """Services and groups, and fields of manifests down to the next dot. A field that alone fits comes with those in
    it, so that the shell does not end the word."""
    depth = incomplete.count(".")
    services = [] if depth else _completions(ctx, "service", incomplete)
    begun = [path.split(".") for path in _starts(FIELDS.read_text("utf-8").split()) if path.startswith(incomplete)]
    fields = {".".join(words[: depth + 1]): None for words in begun}
    if len(fields) == 1 and not services:
        fields |= {".".join(words[: depth + 2]): None for words in begun}
    return [*fields, *services]


def _starts(paths: Sequence[str]) -> Iterator[str]:
    """Every spelling of fields, as in field_paths.py: with the kind, and from `spec` or `metadata` on."""
    for path in paths:
        yield path
        _, dot, rest = path.partition(".")
        if dot:
            yield rest


def complete_revisions(ctx: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    """Numbers of the newest revisions, with their subjects."""
    with contextlib.suppress(Exception):  # a shell asks
        from rorg.cli.records import records_of

        context = _context(ctx)
        if context.client():
            context.serving("complete").timeout = LONGEST
        with records_of(context) as records:
            listed = [r for r in records.listed(REVISIONS) if r["standing"] != "refused"]
        typed = set(_typed(ctx))
        found = [(str(r["number"]), f"{r['standing']} {r['at'][:16]} {r['subject']}") for r in listed]
        return [(number, about) for number, about in found if number not in typed and number.startswith(incomplete)]
    return []


class DirectoryOrRevision(CompletedPath):
    """The first argument: a directory, or a revision in its place."""

    def shell_complete(self, ctx: Any, _param: object, incomplete: str) -> list[CompletionItem]:
        revisions = complete_revisions(ctx, incomplete)
        found = (CompletionItem(number, help=about) for number, about in revisions)
        return [*super().shell_complete(ctx, _param, incomplete), *found]


def complete_event_kinds(incomplete: str) -> list[str]:
    """Kinds of events; the list may have several, with commas."""
    begun, comma, last = incomplete.rpartition(",")
    return [f"{begun}{comma}{kind}" for kind in EVENT_KINDS if kind.startswith(last) and kind not in begun.split(",")]


def complete_commands(incomplete: str) -> list[tuple[str, str]]:
    """Commands with their summaries."""
    from rorg.cli.commands import SUMMARIES

    return [(name, summary) for name, summary in SUMMARIES.items() if name.startswith(incomplete)]


def _typed(ctx: typer.Context) -> Iterator[str]:
    """The words of arguments that take several."""
    return (word for value in ctx.params.values() if isinstance(value, list | tuple) for word in value)


def _context(ctx: typer.Context) -> Context:
    from rorg.cli.context import Context

    context = Context(ctx.params.get("state_dir"), None, ctx.params.get("directory"))
    context.notices.quiet = True
    return context


def _completions(ctx: typer.Context, kind: str, incomplete: str) -> list[str]:
    """Names of a kind that the line does not have yet; none if anything goes wrong, because a shell asks."""
    try:
        context = _context(ctx)
        names = _served(context, kind) if context.client() else _glanced(context, kind)
    except Exception:
        return []
    typed = set(_typed(ctx))
    return [name for name in names if name not in typed and name.startswith(incomplete)]


def _served(context: Context, kind: str) -> list[str]:
    client = context.serving("complete")
    client.timeout, client.patience = LONGEST, 0.0
    if kind == "request":
        return [r["id"] for r in client.requests() if not r["standing"]]
    if kind == "service":
        return [s["service"] for s in client.services()] + [g["name"] for g in client.groups()]
    if kind == "group":
        return [g["name"] for g in client.groups()]
    return [m["name"] for m in client.manifests() if m["kind"].lower() == kind]


def _glanced(context: Context, kind: str) -> Iterable[str]:
    if kind == "request":
        return [r.id for r in context.document().requests]
    return declared(context.root, ("service", "group") if kind == "service" else (kind,))


def declared(root: Path, kinds: Sequence[str]) -> list[str]:
    """Names in the manifests, by a quick look: a shell should not wait until they are loaded."""
    names = ["developer"] if "service" in kinds else []
    for path in sorted((*root.glob("*.yaml"), *(p for k in kinds for p in root.glob(f"{KINDS[k][0]}/*.yaml")))):
        with path.open(encoding="utf-8", errors="replace") as file:
            text = file.read(MOST)
        for part in SEPARATOR.split(text):
            kind, name = KIND.search(part), NAME.search(part)
            if kind and name and kind[1].lower() in kinds:
                names.append(name[1])
    return names
