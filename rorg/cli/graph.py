"""rorg graph"""

from __future__ import annotations

from typing import Annotated, Any

from rorg.cli.options import FORMS, Directory, Option, StateDirectory
from rorg.cli.output import check_form, echo, print_rows

Edge = tuple[str, str, str]
"""From, to, and what it is: needs or requests."""
DRAWN = ("dot", "mermaid")
"""What programs draw pictures of."""


def command(
    directory: Directory = None,
    form: Annotated[
        str,
        Option(
            names=("-o", "--output"), help="table, wide, name, yaml, json, dot or mermaid.", completes=(*FORMS, *DRAWN)
        ),
    ] = "table",
    state_dir: StateDirectory = None,
) -> None:
    """Show who needs and who requests whom.

    Example: rorg graph -o mermaid
    """
    from rorg.cli.context import Context

    check_form(form, (*FORMS, *DRAWN))
    context = Context(state_dir, None, directory, local=True)
    catalog = context.catalog()
    edges = [(s.name, n, "needs") for s in catalog.services.values() for n in s.needs]
    for request in (*catalog.requests, *context.document().requests):
        edges += [(request.requester, m, "requests") for s in request.services for m in catalog.members(s)]
    edges = sorted(set(edges))
    arrows = [{"from": a, "to": b, "kind": k} for a, b, k in edges]
    if form in DRAWN:
        echo("\n".join((_dot if form == "dot" else _mermaid)(catalog, edges)))
    elif form == "wide":
        print_rows(arrows, form, ("from", "kind", "to"))
    else:
        names = [{"name": name} for name in sorted(catalog.services)]
        full = {"services": sorted(catalog.services), "edges": arrows}
        print_rows(names, form, ("name",), full=full, text="\n".join(_text(catalog, edges)))


def _text(catalog: Any, edges: list[Edge]) -> list[str]:
    lines = []
    for name in sorted(catalog.services):
        targets = [f"{'needs' if k == 'needs' else 'requests'} {b}" for a, b, k in edges if a == name]
        mark = " (always on)" if catalog.services[name].always_on else ""
        lines.append(name + mark + (": " + ", ".join(targets) if targets else ""))
    return lines


def _dot(catalog: Any, edges: list[Edge]) -> list[str]:
    nodes = [f'  "{n}"{" [style=bold]" if s.always_on else ""};' for n, s in sorted(catalog.services.items())]
    arrows = [f'  "{a}" -> "{b}"{" [style=dashed]" if k == "requests" else ""};' for a, b, k in edges]
    return ["digraph rorg {", "  rankdir=LR; node [shape=box];", *nodes, *arrows, "}"]


def _mermaid(_: Any, edges: list[Edge]) -> list[str]:
    return ["graph LR", *[f"  {a} {'-.->' if k == 'requests' else '-->'} {b}" for a, b, k in edges]]
