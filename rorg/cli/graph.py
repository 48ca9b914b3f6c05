"""rorg graph"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from rorg.cli.context import Context
from rorg.cli.names import complete_services
from rorg.cli.options import Directory, StateDirectory
from rorg.cli.output import echo, missing, print_rows
from rorg.plots.drawing import FORMS as DRAWN
from rorg.plots.drawing import Arrow, Drawing, draw

KINDS = ("services", "images")
Graph = dict[str, Any]
"""The answer of the API: names, and `edges` with from and to."""


def command(
    what: Annotated[
        str, typer.Argument(help="services or images. Default: services.", autocompletion=lambda: list(KINDS))
    ] = "services",
    directory: Directory = None,
    form: Annotated[
        Literal["table", "wide", "name", "yaml", "json", "dot", "mermaid", "svg"],
        typer.Option("-o", "--output", help="table, wide, name, yaml, json, dot, mermaid or svg."),
    ] = "table",
    hide: Annotated[
        list[str] | None,
        typer.Option(
            "--hide", help="Leave out a service that nearly everything needs.", autocompletion=complete_services
        ),
    ] = None,
    state_dir: StateDirectory = None,
) -> None:
    """Show who needs and who requests whom, with networks and volumes, or the hierarchy of images.

    Example: rorg graph images -o mermaid
    """
    if what not in KINDS:
        if directory or not Path(what).exists():
            raise missing("graph", what, KINDS)
        what, directory = "services", Path(what)
    context = Context(state_dir, None, directory, local=True)
    if what == "services":
        _services(context, form, hide or ())
    else:
        _images(context, form)


def _services(context: Context, form: str, hidden: Sequence[str]) -> None:
    def here() -> Graph:
        from rorg.api.views import graph

        return graph(context.catalog(), () if context.remote else context.document().requests)

    view = _without(context.asked("/v1/graph", here), hidden)
    if form in DRAWN:
        echo(_drawn_services(view, form, hidden))
    elif form == "wide":
        print_rows(view["edges"], form, ("from", "kind", "to"))
    else:
        names = [{"name": name} for name in view["services"]]
        print_rows(names, form, ("name",), full=view, text="\n".join(_text(view)))


def _text(graph: Graph) -> list[str]:
    lines = []
    for name in graph["services"]:
        targets = [f"{e['kind']} {e['to']}" for e in graph["edges"] if e["from"] == name]
        mark = " (always on)" if name in graph["always_on"] else ""
        lines.append(name + mark + (": " + ", ".join(targets) if targets else ""))
    return lines


def _drawn_services(graph: Graph, form: str, hidden: Sequence[str]) -> str:
    """The picture leaves out needs that follow from others: nearly everything needs roscore."""
    objects = graph.get("objects", [])  # missing from an older rorg
    names = [*graph["services"], *objects]
    needs = [(e["from"], e["to"]) for e in graph["edges"] if e["kind"] != "requests"]
    legend = {"bold": "always on", "dashed": "network or volume", "arrow": "needs", "dashed arrow": "requests"}
    if form == "svg":
        from rorg.images.graph import hierarchy, reduced

        below = {n: [end for begin, end in needs if begin == n] for n in names}
        needs = [(name, need) for need, name in reduced(hierarchy(below)).edges]
        legend["arrow"] = "needs; needs that follow from others are left out"
    arrows = [Arrow(begin, end) for begin, end in needs]
    arrows += [Arrow(e["from"], e["to"], dashed=True) for e in graph["edges"] if e["kind"] == "requests"]
    there = {"bold": graph["always_on"], "dashed": objects, "arrow": needs, "dashed arrow": arrows[len(needs) :]}
    legend = {kind: text for kind, text in legend.items() if there[kind]}
    if hidden:
        legend[""] = f"without {', '.join(hidden)}"
    return draw(Drawing(names, sorted(arrows), graph["always_on"], objects, legend), form)


def _without(graph: Graph, hidden: Sequence[str]) -> Graph:
    """The graph without these names. Raises Invalid for a name that it does not have."""
    names = {*graph["services"], *graph.get("objects", [])}
    for name in hidden:
        if name not in names:
            raise missing("service", name, names)
    left = names.difference(hidden)
    return {
        **{key: [n for n in value if n in left] for key, value in graph.items() if key != "edges"},
        "edges": [e for e in graph["edges"] if {e["from"], e["to"]} <= left],
    }


def _images(context: Context, form: str) -> None:
    from rorg.images.graph import descendants, generations, hierarchy, services_on

    def here() -> Graph:
        from rorg.api.views import image_graph

        return image_graph(context.catalog())

    view = context.asked("/v1/graph/images", here)
    below = {n: [e["to"] for e in view["edges"] if e["from"] == n] for n in view["images"]}
    graph = hierarchy(below)
    levels = generations(graph)
    if form in DRAWN:
        echo(_drawn_images(view, graph, levels, form))
    elif form == "wide":
        level = {name: at for at, names in enumerate(levels) for name in names}
        rows = [
            {
                **edge,
                "level": level[edge["from"]],
                "descendants": len(descendants(graph, edge["from"])),
                "services": len(services_on(graph, view["services"], edge["from"])),
            }
            for edge in view["edges"]
        ]
        print_rows(rows, form, ("from", "to", "level", "descendants", "services"))
    else:
        names = [{"name": name} for names in levels for name in names if name in below]
        text = "\n".join(_tree(levels, below))
        print_rows(names, form, ("name",), full={**view, "levels": levels}, text=text)


def _tree(levels: Sequence[Sequence[str]], below: dict[str, list[str]]) -> list[str]:
    """The hierarchy as an indented list: each image below one of the previous level, with its other bases named."""
    level = {name: at for at, names in enumerate(levels) for name in names}
    under: dict[str, list[str]] = {}
    for name, bases in below.items():
        parent = min((b for b in bases if level[b] == level[name] - 1), default="")
        under.setdefault(parent, []).append(name)
    lines: list[str] = []
    pending = [(name, "") for name in reversed(levels[0] if levels else ())]
    while pending:
        name, parent = pending.pop()
        others = [b for b in below.get(name, ()) if b != parent]
        mark = " (external)" if name not in below else f" (also on {', '.join(others)})" if others else ""
        lines.append("  " * level[name] + name + mark)
        pending += [(child, name) for child in sorted(under.get(name, ()), reverse=True)]
    return lines


def _drawn_images(view: Graph, graph: Any, levels: Sequence[Sequence[str]], form: str) -> str:
    """Without the arrows that follow from longer paths."""
    from rorg.images.graph import reduced

    arrows = sorted(Arrow(name, base) for base, name in reduced(graph).edges)
    legend = {"dashed": "not an image of the tree", "arrow": "is built on"}
    return draw(Drawing([n for names in levels for n in names], arrows, dashed=view["external"], legend=legend), form)
