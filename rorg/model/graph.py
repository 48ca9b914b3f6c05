"""Of any set of services: what they need, what of them must not be active together, and what does not fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from rorg.model.catalog import Catalog, Service


def closure(services: Mapping[str, Service], names: Iterable[str]) -> set[str]:
    """The named services and all that they need."""
    found: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in found and name in services:
            found.add(name)
            pending += services[name].needs
    return found


def conflicting(services: Mapping[str, Service], names: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs among `names` that must not be active together; a conflict declared on one side counts for both."""
    chosen = set(names)
    pairs = {(min(n, c), max(n, c)) for n in chosen if n in services for c in services[n].conflicts if c in chosen}
    return sorted(p for p in pairs if p[0] != p[1])


def overbooked(catalog: Catalog, names: Iterable[str]) -> list[str]:
    """In words, the exclusive resources of which these services, all active, would use more than there are."""
    used: dict[str, dict[str, int]] = {}
    for name in sorted(n for n in names if n in catalog.services):
        for resource, units in catalog.services[name].exclusive.items():
            used.setdefault(resource, {})[name] = units
    there = catalog.policy.resources
    return [
        f"{', '.join(users)} use {sum(users.values())} of {there.get(resource, 1)} {resource}"
        for resource, users in sorted(used.items())
        if sum(users.values()) > there.get(resource, 1)
    ]
