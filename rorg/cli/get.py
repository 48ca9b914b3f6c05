"""rorg get"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from functools import partial
from typing import Annotated, Any, Literal

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import KIND_OF, service_name
from rorg.cli.names import complete_groups, complete_kinds_and_names
from rorg.cli.options import NoHeaders, Output, RobotManifests
from rorg.cli.output import end_with_reader, missing, note, print_rows
from rorg.cli.selection import select
from rorg.cli.watch import Watch
from rorg.errors import Invalid

Found = tuple[list[dict[str, Any]], list[Any]]
"""(rows for people, values for YAML and JSON)."""

What = Annotated[
    list[str] | None,
    typer.Argument(
        help="A kind (services, groups, images, networks, volumes, machines, profiles, policies, requests), or names "
        "of services and groups; names may follow a kind.",
        parser=service_name,
        autocompletion=complete_kinds_and_names,
    ),
]
Label = Annotated[
    str, typer.Option("-l", "--selector", help="Services with these labels: site=lab,arm.", metavar="LABELS")
]
SortBy = Annotated[
    Literal["name", "state", "age", "restarts", "priority"],
    typer.Option(help="name, state, age, restarts or priority."),
]
AllNamespaces = Annotated[
    bool, typer.Option("-A", "--all-namespaces", help="Ignored; accepted for compatibility with kubectl.")
]


def command(
    context: RobotManifests,
    what: What = None,
    *,
    label: Label = "",
    group: Annotated[str, typer.Option(help="Services of this group.", autocompletion=complete_groups)] = "",
    sort_by: SortBy = "name",
    output: Output = "table",
    watch: Annotated[bool, typer.Option("-w", "--watch", help="Keep showing changes.")] = False,
    no_headers: NoHeaders = False,
    all_namespaces: AllNamespaces = False,
) -> None:
    """List services with their state, or groups, images, networks, volumes, machines, profiles, policies, requests.
    RESTARTS counts unexpected exits. AGE is the time since the last start.

    Example: rorg get --group driving --sort-by restarts
    """
    show: Callable[..., None] = partial(print_rows, headers=not no_headers)
    if all_namespaces:
        note("-A changes nothing: rorg has no namespaces")
    if watch:
        end_with_reader()
        show = Watch().show
    words = list(what or ())
    named = bool(words) and words[0] in KIND_OF
    kind = KIND_OF[words.pop(0)] if named else "services"
    sort = SORTS[sort_by]
    if kind != "services" and (label or group or sort_by != "name"):
        _only_services(kind)
    while True:
        if kind == "services":
            chosen = select(context, words, label, group, () if named else KIND_OF)
            rows, full = service_rows(sorted(chosen, key=sort))
        else:
            rows, full = ROWS[kind](context, words)
        columns, wide = COLUMNS[kind]
        show(rows, output, _with_message(rows, columns), wide, full=full, below=BELOW)
        if not watch:
            return
        time.sleep(0.2)


def _with_message(rows: Sequence[Mapping[str, Any]], columns: tuple[str, ...]) -> tuple[str, ...]:
    """The columns, with one for machines and one for messages if there are any."""
    if any(row.get("machine") for row in rows):
        columns = (columns[0], "machine", *columns[1:])
    return (*columns, "message") if any(row.get("message") for row in rows) else columns


def _only_services(kind: str) -> None:
    raise Invalid(f"list {kind} that way", "-l, --group and --sort-by are about services", "`rorg get`")


SORTS: dict[str, Any] = {
    "name": lambda s: s["service"],
    "state": lambda s: (s["state"], s["service"]),
    "age": lambda s: (not s["incarnation"], s["started_at"], s["service"]),
    "restarts": lambda s: (-s["crashes"], s["service"]),
    "priority": lambda s: (-s["effective_priority"], s["service"]),
}
"""Sort keys of a service: the oldest run, the most restarts and the highest priority come first."""


def _groups(context: Context, names: Sequence[str]) -> Found:
    groups = _named("group", names, context.groups(), "name")
    return [{**g, "services": ",".join(g["services"])} for g in groups], groups


def _images(context: Context, names: Sequence[str]) -> Found:
    images = _named("image", names, _all_images(context), "name")
    rows = [
        {
            **i,
            "from": ", ".join(i["bases"]) or ("scratch" if i["context"] else "import"),
            "services": len(i["services"]),
        }
        for i in images
    ]
    return rows, images


def _all_images(context: Context) -> list[dict[str, Any]]:
    def here() -> list[dict[str, Any]]:
        from rorg.api.views import images

        return images(context.catalog())

    return context.asked("/v1/images", here)


def _all_manifests(context: Context) -> list[dict[str, Any]]:
    def here() -> list[dict[str, Any]]:
        from rorg.api.manifest_texts import listed

        context.here("read its manifests")
        return listed(context.root)

    return context.asked("/v1/manifests", here)


def _machines(context: Context, names: Sequence[str]) -> Found:
    def here() -> list[dict[str, Any]]:
        return [{"name": m.name, "address": m.address} for m in context.catalog().machines.values()]

    machines = _named("machine", names, context.asked("/v1/machines", here), "name")
    rows = [
        {
            **m,
            "link": "this one" if m.get("here") else m.get("link", ""),
            "answered": age(m["since"]) if m.get("since") is not None else "-",
            "lease": f"{m['lease']:g} s" if "lease" in m else "",
            "message": m.get("reason", ""),
        }
        for m in machines
    ]
    return rows, machines


def _objects(kind: str) -> Any:
    def listed(context: Context, names: Sequence[str]) -> Found:
        known = [view for view in context.view().get("objects", ()) if view["kind"] == kind]
        objects = _named(kind, names, known, "name")
        rows = [
            {
                **view,
                "engine": view["engine_name"],
                "ours": "yes" if view["ours"] else "no",
                "declared": "yes" if view["declared"] else "no",
                "services": ",".join(view["services"]),
            }
            for view in objects
        ]
        return rows, objects

    return listed


def _manifests(kind: str) -> Any:
    def listed(context: Context, names: Sequence[str]) -> Found:
        manifests = _named(kind.lower(), names, [m for m in _all_manifests(context) if m["kind"] == kind], "name")
        return manifests, manifests

    return listed


def _requests(context: Context, names: Sequence[str]) -> Found:
    view = context.view()
    requests = _requests_named(context, names, view) if names else view["requests"]
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
        for r in requests
    ]
    return rows, requests


def _requests_named(context: Context, names: Sequence[str], view: Mapping[str, Any]) -> list[Any]:
    """The requests with these ids, and those for these services and groups. Raises Invalid for an unknown name."""
    requests: list[Any] = view["requests"]
    known = {*(r["id"] for r in requests), *view["services"], *(g["name"] for g in context.groups())}
    for name in names:
        if name not in known:
            raise missing("request", name, known)
    wanted = {service for name in names for service in (name, *context.members(name))}
    return [
        r for r in requests if not wanted.isdisjoint((r["id"], *(m for s in r["services"] for m in context.members(s))))
    ]


def _named(kind: str, names: Sequence[str], known: Sequence[Any], key: str) -> list[Any]:
    """The entries with these names, all of them without names. Raises Invalid for an unknown name."""
    there = {entry[key] for entry in known}
    for name in names:
        if name not in there:
            raise missing(kind, name, there)
    return [entry for entry in known if not names or entry[key] in names]


ROWS = {
    "groups": _groups,
    "images": _images,
    "networks": _objects("network"),
    "volumes": _objects("volume"),
    "profiles": _manifests("Profile"),
    "machines": _machines,
    "policies": _manifests("Policy"),
    "requests": _requests,
}
COLUMNS = {
    "services": (("name", "state", "sync", "health", "restarts", "age", "why"), ("priority", "container")),
    "groups": (("name", "services"), ("description",)),
    "images": (("name", "from"), ("services", "context", "dockerfile")),
    "networks": (("name", "state", "engine", "services"), ("ours", "declared")),
    "volumes": (("name", "state", "engine", "services"), ("ours", "declared")),
    "profiles": (("name", "file"), ("digest",)),
    "machines": (("name", "link", "answered", "services", "requests"), ("address", "lease")),
    "policies": (("name", "file"), ("digest",)),
    "requests": (("id", "requester", "services", "kind"), ("priority", "ttl", "incarnation", "reason")),
}
BELOW = ("why", "message", "reason", "services", "description", "from", "context", "file", "digest")
"""Columns that move to lines of their own on a narrow terminal."""


UNITS = ((86400, "d"), (3600, "h"), (60, "m"), (1, "s"))


def service_rows(services: Iterable[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """(rows for people, the services)."""
    now, full = time.time(), list(services)
    rows = [
        {
            "name": s["service"],
            "state": s["state"],
            "sync": s["sync"],
            "health": s["health"],
            "restarts": s["crashes"],
            "age": age(now - datetime.fromisoformat(s["started_at"]).timestamp()) if s["incarnation"] else "-",
            "why": s["why"] or "-",
            "priority": s["effective_priority"],
            "container": s["container"][:12],
            "machine": s.get("machine", ""),
            "message": s["message"],
        }
        for s in full
    ]
    return rows, full


def age(seconds: float) -> str:
    """A duration as kubectl shows it: 5s, 3m, 2h, 4d."""
    whole = max(0, int(seconds))
    size, unit = next(((size, unit) for size, unit in UNITS if whole >= size), (1, "s"))
    return f"{whole // size}{unit}"
