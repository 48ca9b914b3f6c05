"""The rule of activation: the least set of services that must be active now, and why each is in it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure
from rorg.model.learned import Likelihood

ROOTS = ("always_on", "meta", "prewarmed")
"""Kinds of causes for which nothing else has to be wanted."""


@dataclass(frozen=True, slots=True)
class Cause:
    """Why a service is wanted: `always_on`, `meta`, `requested` (by a service, with a request's id), `needed`, or
    `prewarmed`, which is no request: it is likely that a service will soon ask for it."""

    kind: str
    by: str = ""
    request: str = ""
    likely: Likelihood | None = None

    def __str__(self) -> str:
        if self.kind == "requested":
            return f"requested by {self.by} ({self.request})"
        if self.kind == "prewarmed":
            return f"prewarmed: {self.likely}"
        return {"always_on": "always on", "meta": "meta-service"}.get(self.kind, f"needed by {self.by}")


@dataclass(frozen=True, slots=True)
class Link:
    """Of the chain from a root to a service: a service, and why it is wanted."""

    service: str
    cause: Cause

    def __str__(self) -> str:
        return f"{self.service} ({self.cause})"


Wanted = Mapping[str, tuple[Cause, ...]]


def wanted(catalog: Catalog, requests: Iterable[Request], without: Collection[str] = ()) -> Wanted:
    """The least set closed under the rules (design: the rule of activation), found from its roots outwards.

    A request counts only while its requester is itself in the set, so a ring of services that only request each other
    is not reached from any root, and is ceased. Services in `without` are left out, with all that only they want.
    """
    by_requester: dict[str, list[Request]] = {}
    for request in requests:
        by_requester.setdefault(request.requester, []).append(request)
    found: dict[str, dict[Cause, None]] = {}
    pending = list(_roots(catalog))
    while pending:
        name, cause = pending.pop(0)
        if name in without:
            continue
        if name in found:
            found[name][cause] = None
            continue
        found[name] = {cause: None}
        pending += _asked(catalog, name, by_requester.get(name, []))
    return {name: tuple(causes) for name, causes in found.items()}


def _roots(catalog: Catalog) -> Iterator[tuple[str, Cause]]:
    for service in catalog.services.values():
        if service.meta:
            yield service.name, Cause("meta")
        if service.always_on:
            yield service.name, Cause("always_on")


def _asked(catalog: Catalog, name: str, requests: Iterable[Request]) -> Iterator[tuple[str, Cause]]:
    """What follows from a service being wanted: what it requests, and what it needs."""
    for request in requests:
        for member in dict.fromkeys(m for s in request.services for m in catalog.members(s)):
            yield member, Cause("requested", name, request.id)
    for need in catalog.services[name].needs:
        if need in catalog.services:
            yield need, Cause("needed", name)


def urgent(catalog: Catalog, found: Wanted) -> frozenset[str]:
    """What live requests wait for: the requested services and all that they need."""
    asked = [name for name, causes in found.items() if any(c.kind == "requested" for c in causes)]
    return frozenset(closure(catalog.services, asked))


def wanted_without(found: Wanted, name: str) -> frozenset[str]:
    """What would be wanted still if this service were not."""
    causes: dict[str, list[str]] = {}
    for service, reasons in found.items():
        for cause in reasons:
            causes.setdefault(cause.by, []).append(service)
    # Roots are by nobody.
    reached, pending = set[str](), [""] if name in found else []
    while pending:
        for service in causes.get(pending.pop(), ()):
            if service != name and service not in reached:
                reached.add(service)
                pending.append(service)
    return frozenset(reached if name in found else found)


def chain(found: Wanted, name: str) -> list[tuple[str, Cause]]:
    """From a root to the service: [(service, why it is wanted), ...], shortest first; empty when it is not wanted."""
    if name not in found:
        return []
    trails: list[list[tuple[str, Cause]]] = [[(name, cause)] for cause in found[name]]
    seen = {name}
    while trails:
        trail = trails.pop(0)
        cause = trail[0][1]
        if cause.kind in ROOTS:
            return trail
        if cause.by not in seen:
            seen.add(cause.by)
            trails += [[(cause.by, c), *trail] for c in found.get(cause.by, ())]
    return []
