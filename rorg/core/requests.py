"""The life of requests: what may be accepted, and which are still live."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from rorg.core.admission import expected, over_budget
from rorg.core.memory import Lease, Memory
from rorg.core.observed import Container, Observed
from rorg.core.wanted import wanted
from rorg.model.catalog import Catalog, Request
from rorg.model.diagnostics import nearest
from rorg.model.graph import closure, conflicting, overbooked
from rorg.model.units import format_seconds

MOST_TOLD = 10
"""Unknown names that are told of one request."""


class ProblemCode(StrEnum):
    """Why a request cannot be accepted."""

    UNKNOWN = "unknown"
    """The requester, or something that it names, is not declared."""
    EMPTY = "empty"
    """It names no service."""
    CONFLICT = "conflict"
    """Two services that would both be wanted must not be active together."""
    RESOURCES = "resources"
    """It takes more units of an exclusive resource than there are."""
    OVER_BUDGET = "over-budget"
    """Its services would use more than the Policy's budget, which says `over: refuse`."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One reason against a request; `cause` and `remedy` are for people."""

    code: ProblemCode
    cause: str
    remedy: str

    @property
    def mistaken(self) -> bool:
        """The request is wrong in itself, and not only in the way of what else is asked for."""
        return self.code in (ProblemCode.UNKNOWN, ProblemCode.EMPTY)


@dataclass(frozen=True, slots=True)
class Settled:
    """Requests after a look at their requesters' incarnations."""

    requests: tuple[Request, ...]
    dropped: tuple[tuple[Request, str], ...] = ()
    """Requests whose incarnation is over, each with the reason."""
    bound: tuple[Request, ...] = ()
    """Requests that were written without an incarnation, now with the one that runs."""
    leases: Mapping[tuple[str, str], Lease] = field(default_factory=dict)


def tried_again(memory: Memory, catalog: Catalog, requests: Sequence[Request]) -> Memory:
    """Drop the back-off of everything that a new request names, and of what that needs: a new request gets an attempt
    now. Sending the same request again changes nothing, or a repeated request would hurry a crash loop."""
    before, memory = memory.asked, memory if memory.asked == requests else replace(memory, asked=tuple(requests))
    if before is None or before == requests:
        return memory
    known = {(r.key, r.services) for r in before}
    asked = {m for r in requests if (r.key, r.services) not in known for s in r.services for m in catalog.members(s)}
    progress = {
        name: replace(step, exits=0, attempts={}, error="")
        for name in closure(catalog.services, asked)
        if (step := memory.of(name)).exits or step.attempts
    }
    return replace(memory, progress={**memory.progress, **progress}) if progress else memory


def settle(
    catalog: Catalog,
    requests: Iterable[Request],
    observed: Observed,
    leases: Mapping[tuple[str, str], Lease] | None = None,
    renewals: Mapping[tuple[str, str], int] | None = None,
    now: float = 0.0,
) -> Settled:
    """Drops requests of dead incarnations and those whose lease ran out, and binds those that name no incarnation.
    Paused requesters keep theirs, and no lease runs out meanwhile: they cannot renew it. Nothing is concluded while
    observation is incomplete.

    A lease begins when the loop first sees it or its renewal, so a restart of rorg gives every request its full time
    again; therefore renewals (numbered in `renewals`) need not be written down.
    """
    settled = _by_incarnation(catalog, requests, observed)
    by_service = observed.by_service()
    held: dict[tuple[str, str], Lease] = {}
    kept, expired = [], []
    for request in settled.requests:
        if request.ttl is None or request.standing:
            kept.append(request)
            continue
        stamp = f"{request.renewed}/{(renewals or {}).get(request.key, 0)}/{request.ttl}/{request.incarnation}"
        lease = (leases or {}).get(request.key)
        asleep = any(c.state == "paused" for c in by_service.get(request.requester, [])[:1])
        if lease is None or lease.stamp != stamp or asleep or not observed.complete:
            lease = Lease(stamp, now + request.ttl)
        # Kept in mind even when it has run out: should the drop not be written down, it stays so.
        held[request.key] = lease
        if lease.until <= now:
            expired.append((request, f"its lease of {format_seconds(request.ttl)} ran out"))
        else:
            kept.append(request)
    return Settled(tuple(kept), (*settled.dropped, *expired), settled.bound, held)


def _by_incarnation(catalog: Catalog, requests: Iterable[Request], observed: Observed) -> Settled:
    kept: list[Request] = []
    dropped: list[tuple[Request, str]] = []
    bound: list[Request] = []
    by_service = observed.by_service()
    for request in requests:
        service = catalog.services.get(request.requester)
        bodiless = service is not None and service.meta and request.incarnation is None
        # A bridge asks for callers that outlive its own runs: what it holds ends with its lease.
        carried = service is not None and service.may_act_for and request.ttl is not None
        if request.standing or not observed.complete or bodiless or carried:
            kept.append(request)
            continue
        containers = by_service.get(request.requester, [])
        alive = [c for c in containers if c.alive]
        if request.incarnation is None:
            if alive and not alive[0].brief:
                request = replace(request, incarnation=alive[0].incarnation)
                bound.append(request)
            kept.append(request)
        elif any(c.incarnation == request.incarnation or c.brief for c in alive):
            kept.append(request)
        else:
            dropped.append((request, _obituary(request, containers)))
    return Settled(tuple(kept), tuple(dropped), tuple(bound))


def _obituary(request: Request, containers: list[Container]) -> str:
    if not containers:
        return f"{request.requester} was removed"
    if containers[0].alive:
        return f"{request.requester} was restarted"
    code = containers[0].exit_code
    return f"{request.requester} ended" + (f" with exit code {code}" if code is not None else "")


def problems(catalog: Catalog, existing: Iterable[Request], new: Request) -> list[Problem]:
    """Why a request cannot be accepted; empty when it can. Accepted whole or not at all."""
    found = mistakes(catalog, new)
    if found:
        return found
    kept = [r for r in existing if r.key != new.key]
    # A conflict must not come up later either, so the requester counts as active.
    ask = Request(new.id, "developer", (new.requester, *new.services))
    names = set(wanted(catalog, [*catalog.requests, *kept, new, ask]))
    before = set(conflicting(catalog.services, wanted(catalog, [*catalog.requests, *kept])))
    for a, b in conflicting(catalog.services, names):
        if (a, b) not in before:
            cause = f"'{a}' and '{b}' conflict and would both be wanted"
            found.append(Problem(ProblemCode.CONFLICT, cause, "`rorg why` for who wants which"))
    own = [new.requester, *(m for s in new.services for m in catalog.members(s))]
    remedy = "requesting them one after another, or `resources` in the Policy"
    found += [
        Problem(ProblemCode.RESOURCES, f"it does not fit: {why}", remedy)
        for why in overbooked(catalog, closure(catalog.services, own))
    ]
    budget = catalog.policy.budget
    if budget and budget.over == "refuse":
        why = over_budget(catalog, names)
        if why and expected(catalog, names) != expected(catalog, wanted(catalog, [*catalog.requests, *kept])):
            remedy = "releasing something, or a larger budget in the Policy"
            found.append(Problem(ProblemCode.OVER_BUDGET, f"it does not fit: {why}", remedy))
    return found


def mistakes(catalog: Catalog, new: Request) -> list[Problem]:
    """What is wrong with a request whatever else is asked for."""
    found: list[Problem] = []
    if new.requester not in catalog.services:
        cause = f"unknown requester '{new.requester}'"
        found.append(Problem(ProblemCode.UNKNOWN, cause, nearest(new.requester, catalog.services)))
    if not new.services:
        found.append(Problem(ProblemCode.EMPTY, "it names no service", "`rorg release` to give a request up"))
    known = {*catalog.services, *catalog.groups}
    unknown = [name for name in new.services if name not in known]
    for name in unknown[:MOST_TOLD]:
        # The nearest name is looked for among all, which takes its time: once is enough.
        remedy = nearest(name, known) if name == unknown[0] else ""
        found.append(Problem(ProblemCode.UNKNOWN, f"unknown service '{name}'", remedy))
    if len(unknown) > MOST_TOLD:
        found.append(Problem(ProblemCode.UNKNOWN, f"{len(unknown) - MOST_TOLD} more unknown services", ""))
    return found
