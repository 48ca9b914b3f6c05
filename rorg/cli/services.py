"""Services in listings: which ones, and what people want to see of each."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

from rorg.cli.output import missing, note

if TYPE_CHECKING:
    from rorg.cli.context import Context

UNITS = ((86400, "d"), (3600, "h"), (60, "m"), (1, "s"))


def select(
    context: Context, names: Sequence[str], labels: str, group: str, kinds: Iterable[str]
) -> list[dict[str, Any]]:
    """Services of a view: those of these names and groups, of this group, with these labels. `kinds`: what
    else a name may have been meant as. Raises Invalid for a name that is not there."""
    view = context.view()
    if view.get("pid") is None:
        note(f"no rorg runs on {context.state.path}: this is what the engine shows, and nothing manages it")
    known = view["services"]
    wanted = {m for name in names for m in _members(context, "service", name, known, kinds)}
    inside = _members(context, "group", group, known, ()) if group else known.keys()
    context.notices.of_standing(view)
    return [
        service
        for name, service in known.items()
        if name in inside and (name in wanted if names else service["state"] != "meta") and _labelled(service, labels)
    ]


def _members(context: Context, what: str, name: str, known: dict[str, Any], kinds: Iterable[str]) -> set[str]:
    """The services that a name stands for. Raises Invalid, which says `what` it was taken for."""
    found = {name} if name in known else {*context.members(name)} & known.keys()
    if not found:
        raise missing(what, name, {*known, *kinds} if what == "service" else {g["name"] for g in context.groups()})
    return found


def _labelled(service: dict[str, Any], selector: str) -> bool:
    """Whether a service has all labels of "key=value,key"."""
    labels = service.get("labels") or {}
    terms = (term.strip().partition("=") for term in selector.split(",") if term.strip())
    return all(key in labels and (not equals or labels[key] == value) for key, equals, value in terms)


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
            "message": s["message"],
        }
        for s in full
    ]
    return rows, full


def age(seconds: float) -> str:
    """As kubectl has it: 5s, 3m, 2h, 4d."""
    whole = max(0, int(seconds))
    size, unit = next(((size, unit) for size, unit in UNITS if whole >= size), (1, "s"))
    return f"{whole // size}{unit}"
