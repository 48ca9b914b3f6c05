"""Effective priorities: how much each wanted service matters, by who wants it."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.wanted import Wanted
from rorg.model.catalog import Catalog, Request

PROTECTED = 101
"""Effective priority of a protected service and of all that it needs: above every priority a manifest can set."""


def effective_priorities(catalog: Catalog, wanted_set: Wanted, requests: Collection[Request]) -> dict[str, int]:
    """Return how much each wanted service matters: the highest of its own priority, that of a request for it, and those
    of the services that request or need it. So what a navigation task needs is never shed before the task itself."""
    requested: dict[tuple[str, str, str], int] = {}
    for request in requests:
        for name in (m for s in request.services for m in catalog.members(s)) if request.priority is not None else ():
            key = (request.requester, request.id, name)
            requested[key] = max(request.priority or 0, requested.get(key, 0))
    priority: dict[str, int] = {}
    for name, causes in wanted_set.items():
        service = catalog.services[name]
        candidates = [0 if service.meta else PROTECTED if service.protected else service.priority]
        candidates += [requested[c.by, c.request, name] for c in causes if (c.by, c.request, name) in requested]
        priority[name] = max(candidates)
    wants: dict[str, list[str]] = {}
    for name, causes in wanted_set.items():
        for cause in causes:
            wants.setdefault(cause.by, []).append(name)
    # Highest first: each service then has its final priority when its turn comes.
    for name in sorted(priority, key=lambda n: -priority[n]):
        pending = [name]
        while pending:
            by = pending.pop()
            for other in wants.get(by, ()):
                if priority[other] < priority[by]:
                    priority[other] = priority[by]
                    pending.append(other)
    return priority
