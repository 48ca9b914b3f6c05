"""rorg get"""

from __future__ import annotations

from typing import Annotated, Any

from rorg.cli.options import Argument, EngineName, Option, Output, StateDirectory

KINDS = {
    "services": "services",
    "service": "services",
    "svc": "services",
    "groups": "groups",
    "group": "groups",
    "images": "images",
    "image": "images",
    "requests": "requests",
    "request": "requests",
}


def command(
    kind: Annotated[str, Argument(help="services, groups, images or requests.")] = "services",
    name: Annotated[str, Argument(help="Only this one.")] = "",
    directory: Annotated[Any, Option(names=("--manifests",), help="Directory of manifests.", parser=str)] = None,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
    output: Output = "table",
    watch: Annotated[bool, Option(names=("-w", "--watch"), help="Go on showing changes.")] = False,
) -> None:
    """List services with their state, or groups, images, requests."""
    import time
    from pathlib import Path

    from rorg.cli.context import Context
    from rorg.cli.output import nearest_kind, print_rows

    chosen = KINDS.get(kind) or nearest_kind(kind, KINDS)
    context = Context(state_dir, engine, Path(directory) if directory else None)
    columns, wide, last = COLUMNS[chosen][0], COLUMNS[chosen][1], None
    while True:
        rows, full = ROWS[chosen](context, name)
        if rows != last:
            print_rows(rows, output, columns, wide, full)
        if not watch:
            return
        last = rows
        time.sleep(0.2)


def _services(context: Any, name: str) -> tuple[list[dict[str, Any]], Any]:
    from rorg.cli.context import condition
    from rorg.cli.output import missing

    view = context.view()
    wanted = {name, *context.members(name)} if name else set(view["services"])
    services = {n: s for n, s in view["services"].items() if n in wanted}
    if name and not services:
        raise missing("service", name, view["services"])
    rows = [
        {
            "name": n,
            "state": s["state"],
            "sync": s["sync"],
            "health": s["health"],
            "why": s["why"] or "-",
            "crashes": s["crashes"],
            "priority": s["effective_priority"],
            "container": s["container"][:12],
            "message": condition(s, "Ready")["message"],
        }
        for n, s in services.items()
        if s["state"] != "meta" or name
    ]
    return rows, list(services.values())


def _groups(context: Any, name: str) -> tuple[list[dict[str, Any]], Any]:
    groups = context.groups()
    found = [g for g in groups if name in ("", g["name"])]
    _there("group", name, found, {g["name"] for g in groups})
    rows = [{**g, "services": ",".join(g["services"])} for g in found]
    return rows, found


def _images(context: Any, name: str) -> tuple[list[dict[str, Any]], Any]:
    images = context.images()
    rows = [
        {"name": i["name"], "from": i["context"] or "import", "dockerfile": i["dockerfile"]}
        for i in images
        if name in ("", i["name"])
    ]
    _there("image", name, rows, {i["name"] for i in images})
    return rows, None


def _there(kind: str, name: str, found: list[Any], known: Any) -> None:
    from rorg.cli.output import missing

    if name and not found:
        raise missing(kind, name, set(known))


def _requests(context: Any, name: str) -> tuple[list[dict[str, Any]], Any]:
    requests = context.view()["requests"]
    found = [r for r in requests if name in ("", r["id"])]
    _there("request", name, found, {r["id"] for r in requests})
    rows = [
        {
            "id": r["id"],
            "requester": r["requester"],
            "services": ",".join(r["services"]),
            "kind": "standing" if r["standing"] else "live",
            "reason": r["reason"],
            "incarnation": r["incarnation"] or "",
            "priority": r["priority"] if r["priority"] is not None else "",
            "ttl": f"{r['ttl']:g} s" if r["ttl"] else "",
        }
        for r in found
    ]
    return rows, found


ROWS = {"services": _services, "groups": _groups, "images": _images, "requests": _requests}
COLUMNS = {
    "services": (("name", "state", "sync", "health", "why"), ("crashes", "priority", "container", "message")),
    "groups": (("name", "services"), ("description",)),
    "images": (("name", "from"), ("dockerfile",)),
    "requests": (("id", "requester", "services", "kind"), ("priority", "ttl", "incarnation", "reason")),
}
