"""The rule of activation: the least set of services that must be active now, and why each is in it. It follows the
paper (section III-B): only requested services are kept active."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure

ROOTS = ("always_on", "meta")
"""Kinds of causes that need nothing else to be wanted."""


@dataclass(frozen=True, slots=True)
class Cause:
    """Why a service is wanted: `always_on`, `meta`, `requested` (by a service, with the request's id), or
    `needed`."""

    kind: str
    by: str = ""
    request: str = ""

    def __str__(self) -> str:
        if self.kind == "requested":
            return f"requested by {self.by} ({self.request})"
        return {"always_on": "always on", "meta": "meta-service"}.get(self.kind, f"needed by {self.by}")


@dataclass(frozen=True, slots=True)
class Link:
    """One step of the chain from a root to a service, with the reason."""

    service: str
    cause: Cause

    def __str__(self) -> str:
        return f"{self.service} ({self.cause})"


Wanted = Mapping[str, tuple[Cause, ...]]


def wanted(catalog: Catalog, requests: Iterable[Request], without: Collection[str] = ()) -> Wanted:
    """Return the least set closed under the rules, found from its roots outwards.

    A request counts only while its requester is in the set. So services that only request each other are not reached
    from any root, and cease. Services in `without` are left out, with everything that only they want.
    """
    by_requester: dict[str, list[Request]] = {}
    for request in requests:
        by_requester.setdefault(request.requester, []).append(request)
    causes_of: dict[str, dict[Cause, None]] = {}
    pending = list(_roots(catalog))
    while pending:
        name, cause = pending.pop(0)
        if name in without:
            continue
        if name in causes_of:
            causes_of[name][cause] = None
            continue
        causes_of[name] = {cause: None}
        pending += _asked(catalog, name, by_requester.get(name, []))
    return {name: tuple(reasons) for name, reasons in causes_of.items()}


def _roots(catalog: Catalog) -> Iterator[tuple[str, Cause]]:
    for service in catalog.services.values():
        if service.meta:
            yield service.name, Cause("meta")
        if service.always_on:
            yield service.name, Cause("always_on")


def _asked(catalog: Catalog, name: str, requests: Iterable[Request]) -> Iterator[tuple[str, Cause]]:
    """Return what follows from a service being wanted: what it requests and what it needs."""
    for request in requests:
        for member in dict.fromkeys(m for s in request.services for m in catalog.members(s)):
            yield member, Cause("requested", name, request.id)
    for need in catalog.services[name].needs:
        if need in catalog.services:
            yield need, Cause("needed", name)


def urgent(catalog: Catalog, wanted_now: Wanted) -> frozenset[str]:
    """Return what live requests wait for: requested services and everything they need."""
    asked = [name for name, causes in wanted_now.items() if any(c.kind == "requested" for c in causes)]
    return frozenset(closure(catalog.services, asked))


def wanted_by(wanted_now: Wanted, names: Collection[str]) -> set[str]:
    """Return the services that are wanted because of these, directly or through others. They include the named ones
    themselves if they are in a ring."""
    because: dict[str, list[str]] = {}
    """A service -> those that it wants; "" -> those that are wanted without another one."""
    for service, reasons in wanted_now.items():
        for cause in reasons:
            because.setdefault(cause.by, []).append(service)
    reached, pending = set[str](), list(names)
    while pending:
        for service in because.get(pending.pop(), ()):
            if service not in reached:
                reached.add(service)
                pending.append(service)
    return reached


def wanted_without(wanted_now: Wanted, name: str) -> frozenset[str]:
    """Return what would still be wanted without this service."""
    if name not in wanted_now:
        return frozenset(wanted_now)
    return frozenset(wanted_by({n: causes for n, causes in wanted_now.items() if n != name}, [""]))


def chain(wanted_now: Wanted, name: str) -> list[tuple[str, Cause]]:
    """Return the shortest chain [(service, why it is wanted), ...] from a root to the service; empty if it is
    unwanted."""
    if name not in wanted_now:
        return []
    trails: list[list[tuple[str, Cause]]] = [[(name, cause)] for cause in wanted_now[name]]
    visited = {name}
    while trails:
        trail = trails.pop(0)
        cause = trail[0][1]
        if cause.kind in ROOTS:
            return trail
        if cause.by not in visited:
            visited.add(cause.by)
            trails += [[(cause.by, c), *trail] for c in wanted_now.get(cause.by, ())]
    return []
