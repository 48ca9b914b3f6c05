"""Who gives way when not everything that is asked for can be: held services, conflicts, exclusive resources, budget.

A pure function of what is asked now, with no memory: the same requests always give the same winners, so nothing flaps.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from rorg.core.wanted import Wanted, wanted
from rorg.manifest.catalog import Catalog, Request
from rorg.manifest.references import closure, conflicting
from rorg.manifest.scalars import format_memory

PROTECTED = 101
"""Rank of a protected service and of all that it needs: above every priority."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The wanted set without what gives way; why that gave way; and every wanted service's rank."""

    wanted: Wanted
    gave_way: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted otherwise, each with the reason."""
    ranks: Mapping[str, int] = field(default_factory=dict)
    requests: tuple[Request, ...] = ()
    """Those that count: all but the queued ones."""


def arbitrate(catalog: Catalog, requests: Collection[Request], barred: Mapping[str, str]) -> Verdict:
    """`barred` are services that must not be active now whoever asks, with the reason (held, or shed). What needs a
    service that gives way gives way too."""
    admitted, queued = _within_budget(catalog, requests, barred)
    out: dict[str, str] = {}
    for name, why in barred.items():
        _give_way(catalog, out, name, why)
    while True:
        found = wanted(catalog, admitted, out)
        rank = ranks(catalog, found, admitted)
        loser = _conflict(catalog, found, rank) or _overbooked(catalog, found, rank)
        if loser is None:
            break
        _give_way(catalog, out, *loser)
    if not out and not queued:
        return Verdict(found, {}, rank, tuple(admitted))
    asked = wanted(catalog, requests)
    gave_way = {n: why for n, why in out.items() if n in asked}
    gave_way |= {n: why for n, why in queued.items() if n not in found and n not in out}
    return Verdict(found, gave_way, rank, tuple(admitted))


def _give_way(catalog: Catalog, out: dict[str, str], name: str, why: str) -> None:
    out[name] = why
    for other in catalog.services:
        if other not in out and name in closure(catalog.services, [other]):
            out[other] = f"{name} {why}"


def ranks(catalog: Catalog, found: Wanted, requests: Collection[Request]) -> dict[str, int]:
    """How much each wanted service matters: its priority, that of a request for it, or that of what requests or needs
    it, whichever is highest. Protected services are above all."""
    asked = {(r.requester, r.id): r.priority for r in requests if r.priority is not None}
    rank: dict[str, int] = {}
    for name, causes in found.items():
        service = catalog.services[name]
        own = [0 if service.meta else PROTECTED if service.protected else service.priority]
        own += [asked[c.by, c.request] for c in causes if (c.by, c.request) in asked]
        rank[name] = max(own)
    pending = list(found)
    while pending:
        name = pending.pop()
        for cause in found[name]:
            if cause.by in rank and rank[cause.by] > rank[name]:
                rank[name] = rank[cause.by]
                pending += [n for n, causes in found.items() if any(c.by == name for c in causes)]
    return rank


def _conflict(catalog: Catalog, found: Wanted, rank: Mapping[str, int]) -> tuple[str, str] | None:
    """Conflicts are refused when a request or a manifest arrives; what is left are requests that slept meanwhile, and
    conflicts declared later. The higher rank goes first, then the name."""
    pairs = conflicting(catalog.services, found)
    if not pairs:
        return None
    first, second = sorted(pairs[0], key=lambda n: (-rank[n], n))
    return second, f"conflicts with {first}, which goes first"


def _overbooked(catalog: Catalog, found: Wanted, rank: Mapping[str, int]) -> tuple[str, str] | None:
    """The lowest holder of an exclusive resource of which more is wanted than there is."""
    for resource in sorted({r for n in found for r in catalog.services[n].exclusive}):
        holders = sorted((n for n in found if resource in catalog.services[n].exclusive), key=lambda n: (-rank[n], n))
        left = catalog.policy.resources.get(resource, 1)
        for index, name in enumerate(holders):
            left -= catalog.services[name].exclusive[resource]
            if left < 0:
                others = ", ".join(holders[:index]) or "nobody: there are too few"
                return name, f"waits for {resource}, which is taken by {others}"
    return None


def expected(catalog: Catalog, names: Collection[str]) -> tuple[float, int]:
    """(cores, bytes) that these services declare to use."""
    services = [catalog.services[n] for n in names if n in catalog.services]
    return sum(s.cpu for s in services), sum(s.memory for s in services)


def over_budget(catalog: Catalog, names: Collection[str]) -> str:
    """In words, where the expected use of these services is above the budget; empty when it fits."""
    budget = catalog.policy.budget
    if budget is None:
        return ""
    cpu, memory = expected(catalog, names)
    if budget.cpu is not None and cpu > budget.cpu + 1e-9:
        return f"{cpu:g} cores would be used of a budget of {budget.cpu:g}"
    if budget.memory is not None and memory > budget.memory:
        return f"{format_memory(memory)} would be used of a budget of {format_memory(budget.memory)}"
    return ""


def _within_budget(catalog: Catalog, requests: Collection[Request], barred: Mapping[str, str]
                   ) -> tuple[list[Request], dict[str, str]]:
    """Requests that fit into the budget, the higher priority first, then the older; and why the services of the
    others wait. Only where the Policy says so: `over: queue`."""
    budget = catalog.policy.budget
    if budget is None or budget.over != "queue":
        return list(requests), {}
    names = set(wanted(catalog, ())) - set(barred)
    waiting = sorted(requests, key=lambda r: -_priority(catalog, r))
    admitted: list[Request] = []
    queued: dict[str, str] = {}
    tried = True
    while tried:
        tried = False
        for request in [r for r in waiting if r.requester in names]:
            waiting.remove(request)
            tried = True
            more = closure(catalog.services, [m for s in request.services for m in catalog.members(s)]) - set(barred)
            why = over_budget(catalog, names | more)
            if why and not more <= names:
                queued |= dict.fromkeys(sorted(more - names), f"waits for room: {why}")
                continue
            admitted.append(request)
            names |= more
            break
    # What nobody active asks for takes no room.
    return admitted + waiting, queued


def _priority(catalog: Catalog, request: Request) -> int:
    own = [catalog.services[m].priority for s in request.services for m in catalog.members(s)]
    return max([*own, request.priority or 0], default=0)
