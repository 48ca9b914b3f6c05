"""The life of requests: which may be accepted, and which are still live. The paper (section III-B) defines a request as
a relation between services that lasts until the requester releases it or ends.

A requested restart ends the run that was going on, and is done when another run has begun.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from rorg.core.admission import expected, over_budget
from rorg.core.changes import updated
from rorg.core.memory import Due, Lease, Memory
from rorg.core.observed import Container, Observed
from rorg.core.wanted import wanted
from rorg.model.catalog import DEVELOPER, Catalog, Request
from rorg.model.diagnostics import nearest
from rorg.model.graph import closure, conflicting, overbooked
from rorg.model.units import format_seconds

MOST_TOLD = 10
"""Unknown names listed per request."""


class ProblemCode(StrEnum):
    """Why a request cannot be accepted."""

    UNKNOWN = "unknown"
    """The requester or a requested name is not declared."""
    EMPTY = "empty"
    """It names no service."""
    CONFLICT = "conflict"
    """It would make two conflicting services wanted."""
    RESOURCES = "resources"
    """It needs more units of an exclusive resource than exist."""
    OVER_BUDGET = "over-budget"
    """Its services would exceed the Policy's budget, which says `over: refuse`."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One reason against a request; `cause` and `remedy` are for people."""

    code: ProblemCode
    cause: str
    remedy: str

    @property
    def mistaken(self) -> bool:
        """Whether the request is wrong in itself, rather than incompatible with other requests."""
        return self.code in (ProblemCode.UNKNOWN, ProblemCode.EMPTY)


@dataclass(frozen=True, slots=True)
class Settled:
    """Requests after their requesters' runs were checked."""

    requests: tuple[Request, ...]
    dropped: tuple[tuple[Request, str], ...] = ()
    """Requests whose requester's run is over or whose lease ran out, with the reason."""
    bound: tuple[Request, ...] = ()
    """Requests that were written without an incarnation and now have that of the current run."""
    leases: Mapping[tuple[str, str], Lease] = field(default_factory=dict)


def tried_again(memory: Memory, catalog: Catalog, requests: Sequence[Request]) -> Memory:
    """Drop the back-off of everything that a new request names or needs, so that it is tried immediately. Repeating the
    same request changes nothing; otherwise a client in a loop would speed up a crash loop."""
    before, memory = memory.asked, memory if memory.asked == requests else replace(memory, asked=tuple(requests))
    if before is None or before == requests:
        return memory
    known = {(r.key, r.services) for r in before}
    asked = {m for r in requests if (r.key, r.services) not in known for s in r.services for m in catalog.members(s)}
    progress = {
        name: replace(progress_of, exits=0, attempts={}, error="")
        for name in closure(catalog.services, asked)
        if (progress_of := memory.of(name)).exits or progress_of.attempts
    }
    return replace(memory, progress=updated(memory.progress, progress)) if progress else memory


def settle(
    catalog: Catalog,
    requests: Iterable[Request],
    observed: Observed,
    leases: Mapping[tuple[str, str], Lease] | None = None,
    renewals: Mapping[tuple[str, str], int] | None = None,
    now: float = 0.0,
) -> Settled:
    """Drop requests of ended runs and expired leases, and bind requests that name no run.

    Requests of a paused or inactive requester stay, and their leases do not run out, because it cannot renew them.
    While the observation is incomplete nothing is dropped.

    A lease begins when the loop first sees it or its renewal. So a restart of rorg gives every lease its full time
    again, and renewals (numbered in `renewals`) need not be written to disk.
    """
    leases_now: dict[tuple[str, str], Lease] = {}
    kept, bound = list[Request](), list[Request]()
    dropped, expired = list[tuple[Request, str]](), list[tuple[Request, str]]()
    for declared in requests:
        request, why = _in_its_run(catalog, declared, observed)
        bound += [] if request is declared else [request]
        if why:
            dropped.append((request, why))
        elif request.ttl is None or request.standing:
            kept.append(request)
        else:
            stamp = f"{request.renewed}/{(renewals or {}).get(request.key, 0)}/{request.ttl}/{request.incarnation}"
            lease = (leases or {}).get(request.key)
            asleep = any(c.asleep for c in observed.of(request.requester)[:1])
            if lease is None or lease.stamp != stamp or asleep or not observed.complete:
                lease = Lease(stamp, now + request.ttl)
            # Remember an expired lease too: if the drop cannot be written to disk, the request must stay expired.
            leases_now[request.key] = lease
            if lease.until <= now:
                expired.append((request, f"its lease of {format_seconds(request.ttl)} ran out"))
            else:
                kept.append(request)
    return Settled(tuple(kept), (*dropped, *expired), tuple(bound), leases_now)


def _in_its_run(catalog: Catalog, request: Request, observed: Observed) -> tuple[Request, str]:
    """Return the request, bound to its requester's current run if it names none, and why it is dropped ("" if not)."""
    service = catalog.services.get(request.requester)
    by_meta_service = service is not None and service.meta and request.incarnation is None
    # A bridge requests on behalf of callers that outlive its own runs; such a request ends with its lease.
    by_bridge = service is not None and service.may_act_for and request.ttl is not None
    if request.standing or not observed.complete or by_meta_service or by_bridge:
        return request, ""
    containers = observed.of(request.requester)
    alive = [c for c in containers if c.alive]
    if request.incarnation is None:
        known = alive and not alive[0].brief
        return (replace(request, incarnation=alive[0].incarnation) if known else request), ""
    goes_on = any(c.incarnation == request.incarnation or c.brief for c in alive)
    return request, "" if goes_on else _obituary(request, containers)


def _obituary(request: Request, containers: Sequence[Container]) -> str:
    if not containers:
        return f"{request.requester} was removed"
    if containers[0].alive:
        return f"{request.requester} was restarted"
    code = containers[0].exit_code
    return f"{request.requester} ended" + (f" with exit code {code}" if code is not None else "")


def problems(catalog: Catalog, existing: Iterable[Request], new: Request) -> list[Problem]:
    """Return why a request cannot be accepted; empty if it can. It is accepted whole or not at all."""
    problems_found = mistakes(catalog, new)
    if problems_found:
        return problems_found
    kept = [r for r in existing if r.key != new.key]
    # Count the requester as active: otherwise the conflict would come up when it becomes active.
    ask = Request(new.id, "developer", (new.requester, *new.services))
    names = set(wanted(catalog, [*catalog.requests, *kept, new, ask]))
    before = set(conflicting(catalog.services, wanted(catalog, [*catalog.requests, *kept])))
    for a, b in conflicting(catalog.services, names):
        if (a, b) not in before:
            cause = f"'{a}' and '{b}' conflict and would both be wanted"
            problems_found.append(Problem(ProblemCode.CONFLICT, cause, "`rorg why` for who wants which"))
    own = [new.requester, *(m for s in new.services for m in catalog.members(s))]
    remedy = "to request them one after another, or change `resources` in the Policy"
    problems_found += [
        Problem(ProblemCode.RESOURCES, f"it does not fit: {why}", remedy)
        for why in overbooked(catalog, closure(catalog.services, own))
    ]
    budget = catalog.policy.budget
    if budget and budget.over == "refuse":
        why = over_budget(catalog, names)
        if why and expected(catalog, names) != expected(catalog, wanted(catalog, [*catalog.requests, *kept])):
            remedy = "`rorg release`, or a larger budget in the Policy"
            problems_found.append(Problem(ProblemCode.OVER_BUDGET, f"it does not fit: {why}", remedy))
    return problems_found


def mistakes(catalog: Catalog, new: Request) -> list[Problem]:
    """Return what is wrong with a request regardless of other requests."""
    mistakes_found: list[Problem] = []
    if new.requester not in catalog.services:
        cause = f"unknown requester '{new.requester}'"
        mistakes_found.append(Problem(ProblemCode.UNKNOWN, cause, nearest(new.requester, catalog.services)))
    if not new.services:
        mistakes_found.append(Problem(ProblemCode.EMPTY, "it names no service", "`rorg release` to give a request up"))
    if DEVELOPER in new.services:
        cause = f"'{DEVELOPER}' stands for the people who make requests, and runs nothing"
        mistakes_found.append(Problem(ProblemCode.UNKNOWN, cause, "`rorg get` for the services"))
    known = {*catalog.services, *catalog.groups}
    unknown = [name for name in new.services if name not in known]
    for name in unknown[:MOST_TOLD]:
        # Searching all names for a similar one takes long: do it only once.
        remedy = nearest(name, known) if name == unknown[0] else ""
        mistakes_found.append(Problem(ProblemCode.UNKNOWN, f"unknown service '{name}'", remedy))
    if len(unknown) > MOST_TOLD:
        mistakes_found.append(Problem(ProblemCode.UNKNOWN, f"{len(unknown) - MOST_TOLD} more unknown services", ""))
    return mistakes_found


def note_restarts(
    memory: Memory, asked: Mapping[str, str], observed: Observed, wall: str
) -> tuple[Memory, Mapping[str, str]]:
    """Return which run each due restart must end, and the restarts that are done. `asked` says when each was requested,
    `wall` is the present time (both ISO 8601, UTC).

    Runs are compared by incarnation, so a clock that is set or differs from the engine's restarts nothing twice.
    """
    if not observed.complete:
        return memory, {}
    known, due, done, begun = memory.restarts, {}, {}, []
    for name, stamp in asked.items():
        if stamp > wall and name not in known:
            continue
        current = observed.current(name)
        if current and current.brief:
            due.update({name: known[name]} if name in known else {})
            continue
        run = current.incarnation if current else ""
        if name in known and known[name].stamp == stamp:
            due[name] = known[name]
        else:
            due[name] = Due(stamp, run)
            begun.append(name)
        if current and current.alive and run != due[name].run:
            done[name] = stamp
            del due[name]
    # Who asks for a restart wants it now, without the back-off of earlier failures.
    eager = {n: memory.of(n).start_forgotten() for n in begun}
    progress = updated(memory.progress, eager) if eager else memory.progress
    return (memory if due == memory.restarts else replace(memory, restarts=due, progress=progress)), done
