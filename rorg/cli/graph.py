"""rorg graph"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rorg.cli.drawing import FORMS as DRAWN
from rorg.cli.options import FORMS, Argument, Directory, Option, StateDirectory
from rorg.cli.output import echo, print_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rorg.cli.context import Context

KINDS = ("services", "images")
Graph = dict[str, Any]
"""The answer of the API: names, and `edges` with from and to."""


def command(
    what: Annotated[str, Argument("services or images. Default: services.", completes=KINDS)] = "services",
    directory: Directory = None,
    form: Annotated[
        str,
        Option(
            "table, wide, name, yaml, json, dot, mermaid or svg.", names=("-o", "--output"), choices=(*FORMS, *DRAWN)
        ),
    ] = "table",
    state_dir: StateDirectory = None,
) -> None:
    """Show who needs and who requests whom, with networks and volumes, or the hierarchy of images.

    Example: rorg graph images -o mermaid
    """
    from rorg.cli.context import Context

    if what not in KINDS:
        if directory or not Path(what).exists():
            from rorg.cli.output import missing

            raise missing("graph", what, KINDS)
        what, directory = "services", Path(what)
    show = _services if what == "services" else _images
    show(Context(state_dir, None, directory, local=True), form)


def _services(context: Context, form: str) -> None:
    def here() -> Graph:
        from rorg.api.views import graph

        return graph(context.catalog(), () if context.remote else context.document().requests)

    found = context.asked("/v1/graph", here)
    if form in DRAWN:
        echo(_drawn_services(found, form))
    elif form == "wide":
        print_rows(found["edges"], form, ("from", "kind", "to"))
    else:
        names = [{"name": name} for name in found["services"]]
        print_rows(names, form, ("name",), full=found, text="\n".join(_text(found)))


def _text(graph: Graph) -> list[str]:
    lines = []
    for name in graph["services"]:
        targets = [f"{e['kind']} {e['to']}" for e in graph["edges"] if e["from"] == name]
        mark = " (always on)" if name in graph["always_on"] else ""
        lines.append(name + mark + (": " + ", ".join(targets) if targets else ""))
    return lines


def _drawn_services(graph: Graph, form: str) -> str:
    """Levels come from needs alone, because requests may form a circle."""
    from rorg.cli.drawing import Arrow, Drawing, draw

    objects = graph.get("objects", [])  # missing from an older rorg
    levels: Sequence[Sequence[str]] = [[*graph["services"], *objects]]
    if form == "svg":
        from rorg.images.graph import generations, hierarchy

        needs = {n: [e["to"] for e in graph["edges"] if e["from"] == n and e["kind"] != "requests"] for n in levels[0]}
        levels = generations(hierarchy(needs))
    arrows = [Arrow(e["from"], e["to"], e["kind"] == "requests") for e in graph["edges"]]
    return draw(Drawing(levels, arrows, bold=graph["always_on"], dashed=objects), form)


def _images(context: Context, form: str) -> None:
    from rorg.images.graph import descendants, generations, hierarchy, services_on

    def here() -> Graph:
        from rorg.api.views import image_graph

        return image_graph(context.catalog())

    found = context.asked("/v1/graph/images", here)
    below = {n: [e["to"] for e in found["edges"] if e["from"] == n] for n in found["images"]}
    graph = hierarchy(below)
    levels = generations(graph)
    if form in DRAWN:
        echo(_drawn_images(found, graph, levels, form))
    elif form == "wide":
        level = {name: at for at, names in enumerate(levels) for name in names}
        rows = [
            {
                **edge,
                "level": level[edge["from"]],
                "descendants": len(descendants(graph, edge["from"])),
                "services": len(services_on(graph, found["services"], edge["from"])),
            }
            for edge in found["edges"]
        ]
        print_rows(rows, form, ("from", "to", "level", "descendants", "services"))
    else:
        names = [{"name": name} for names in levels for name in names if name in below]
        text = "\n".join(_tree(levels, below))
        print_rows(names, form, ("name",), full={**found, "levels": levels}, text=text)


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


def _drawn_images(found: Graph, graph: Any, levels: Sequence[Sequence[str]], form: str) -> str:
    """Without the arrows that follow from longer paths."""
    from rorg.cli.drawing import Arrow, Drawing, draw
    from rorg.images.graph import reduced

    arrows = sorted(Arrow(name, base) for base, name in reduced(graph).edges)
    return draw(Drawing(levels, arrows, dashed=found["external"]), form)
