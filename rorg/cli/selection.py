"""Which services a command shows: by name, group and labels."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any

from rorg.cli.context import Context
from rorg.cli.output import kind_behind, missing, note


def select(
    context: Context, names: Sequence[str], labels: str, group: str, kinds: Collection[str]
) -> list[dict[str, Any]]:
    """The services of a view with these names and groups, in this group, with these labels. `kinds`: the kinds that may
    come before the names. Raises Invalid for an unknown name."""
    view = context.view()
    if view.get("pid") is None:
        note(f"no rorg runs on {context.state.path}: this is the state of the engine, and nothing manages it")
    known = view["services"]
    behind = next((n for n in names if n in kinds and n not in known and not {*context.members(n)} & known.keys()), "")
    if behind:
        raise kind_behind("get", behind, [name for name in names if name != behind])
    wanted = {m for name in names for m in _members(context, "service", name, known, kinds)}
    inside = _members(context, "group", group, known, ()) if group else known.keys()
    context.notices.of_standing(view)
    return [
        service
        for name, service in known.items()
        if name in inside and (name in wanted if names else service["state"] != "meta") and _labelled(service, labels)
    ]


def _members(context: Context, what: str, name: str, known: dict[str, Any], kinds: Iterable[str]) -> set[str]:
    """The services that a name stands for. Raises Invalid for an unknown name; `what` it was taken for."""
    services = {name} if name in known else {*context.members(name)} & known.keys()
    if not services:
        raise missing(what, name, {*known, *kinds} if what == "service" else {g["name"] for g in context.groups()})
    return services


def _labelled(service: dict[str, Any], selector: str) -> bool:
    """Whether a service has all labels of "key=value,key"."""
    labels = service.get("labels") or {}
    terms = (term.strip().partition("=") for term in selector.split(",") if term.strip())
    return all(key in labels and (not equals or labels[key] == value) for key, equals, value in terms)
