"""rorg graph"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from rorg.cli.options import FORMS, Directory, Option, StateDirectory
from rorg.cli.output import check_form, echo, print_rows

if TYPE_CHECKING:
    from rorg.cli.context import Context

Graph = dict[str, Any]
"""`services`, `always_on`, and `edges` with from, to and kind: needs or requests."""
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
    found = _graph(Context(state_dir, None, directory, local=True))
    if form in DRAWN:
        echo("\n".join((_dot if form == "dot" else _mermaid)(found)))
    elif form == "wide":
        print_rows(found["edges"], form, ("from", "kind", "to"))
    else:
        names = [{"name": name} for name in found["services"]]
        print_rows(names, form, ("name",), full=found, text="\n".join(_text(found)))


def _graph(context: Context) -> Graph:
    """That of the running rorg, unless it is about another directory."""
    client = None if context.directory else context.client()
    if client:
        told: Graph = client.call("GET", "/v1/graph")
        return told
    from rorg.api.views import graph

    return graph(context.catalog(), () if context.remote else context.document().requests)


def _text(graph: Graph) -> list[str]:
    lines = []
    for name in graph["services"]:
        targets = [f"{e['kind']} {e['to']}" for e in graph["edges"] if e["from"] == name]
        mark = " (always on)" if name in graph["always_on"] else ""
        lines.append(name + mark + (": " + ", ".join(targets) if targets else ""))
    return lines


def _dot(graph: Graph) -> list[str]:
    nodes = [f'  "{n}"{" [style=bold]" if n in graph["always_on"] else ""};' for n in graph["services"]]
    arrows = [
        f'  "{e["from"]}" -> "{e["to"]}"{" [style=dashed]" if e["kind"] == "requests" else ""};' for e in graph["edges"]
    ]
    return ["digraph rorg {", "  rankdir=LR; node [shape=box];", *nodes, *arrows, "}"]


def _mermaid(graph: Graph) -> list[str]:
    arrow = {"needs": "-->", "requests": "-.->"}
    return ["graph LR", *[f"  {e['from']} {arrow[e['kind']]} {e['to']}" for e in graph["edges"]]]
