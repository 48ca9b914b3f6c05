"""Who is preempted when not everything that is asked for can be: held services, conflicts, exclusive resources, budget.

A pure function of what is asked now, with no memory: the same requests always give the same winners, so nothing flaps.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

from rorg.core.wanted import Wanted, wanted
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure, conflicting
from rorg.model.units import format_memory

PROTECTED = 101
"""Effective priority of a protected service and of all that it needs: above every priority."""


@dataclass(frozen=True, slots=True)
class Admission:
    """The wanted set without what is preempted; why that is; and every wanted service's effective priority."""

    wanted: Wanted
    preempted: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted otherwise, each with the reason."""
    priorities: Mapping[str, int] = field(default_factory=dict)
    requests: tuple[Request, ...] = ()
    """Those that count: all but the queued ones."""


@dataclass(frozen=True, slots=True)
class Admitted:
    """A admission with what it was found from."""

    catalog: Catalog
    requests: tuple[Request, ...]
    excluded: Mapping[str, str]
    admission: Admission


def admission_for(
    last: Admitted | None, catalog: Catalog, requests: tuple[Request, ...], excluded: Mapping[str, str]
) -> Admitted:
    """admit(), unless the last time was the same: with hundreds of requests it takes longer than all the rest."""
    if last and last.catalog is catalog and last.excluded == excluded and last.requests == requests:
        return last
    return Admitted(catalog, requests, excluded, admit(catalog, requests, excluded))


def admit(catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]) -> Admission:
    """`excluded` are services that must not be active now whoever asks, with the reason (held, or shed). What needs a
    service that is preempted is preempted too; a meta-service never is."""
    budget = catalog.policy.budget
    admission = _contest(catalog, tuple(requests), excluded)
    if budget is None or budget.over != "queue" or not over_budget(catalog, admission.wanted):
        return admission
    return _within_budget(catalog, requests, excluded)


def _contest(catalog: Catalog, requests: tuple[Request, ...], excluded: Mapping[str, str]) -> Admission:
    """Without a look at the budget: first whoever loses a contest goes out, one after another, then those come back,
    the highest effective priority first, for whom there is room after all, since who won against them is out itself."""
    out: dict[str, str] = {}
    for name, why in excluded.items():
        _give_way(catalog, out, name, why)
    held, lost = dict(out), []
    while True:
        found = wanted(catalog, requests, out)
        priority = effective_priorities(catalog, found, requests)
        contests = _contested(catalog, found, priority)
        if not contests:
            break
        without = wanted(catalog, requests, _all_out(catalog, dict(out), contests))
        undone = next(((c, w) for c in contests for w in c.winners if w not in without), None)
        if undone:
            # Who asks for something is not preempted by it: then nobody would ask for it any more.
            contests = [_turned_round(catalog, requests, out, *undone)]
        lost += [(-priority[c.loser], c) for c in contests]
        _all_out(catalog, out, contests)
    for place in sorted(lost, key=lambda p: (p[0], p[1].loser)):
        if all(w in found for w in place[1].winners):
            continue  # who won against it runs
        others = _all_out(catalog, dict(held), [c for _, c in lost if c is not place[1]])
        more = wanted(catalog, requests, others)
        if (
            place[1].loser in more
            and set(found) <= set(more)
            and not _contested(catalog, more, effective_priorities(catalog, more, requests))
        ):
            lost.remove(place)
            found, out = more, others
    priority = effective_priorities(catalog, found, requests) if lost else priority
    asked = wanted(catalog, requests) if out else found
    return Admission(found, {n: why for n, why in out.items() if n in asked}, priority, requests)


def _give_way(catalog: Catalog, out: dict[str, str], name: str, why: str) -> dict[str, str]:
    """Adds a service and all that needs it to those that are out; returns these."""
    if name in catalog.services and catalog.services[name].meta:
        return out
    out.setdefault(name, why)
    pending = [name]
    while pending:
        need = pending.pop()
        for other, service in catalog.services.items():
            if need in service.needs and other not in out and not service.meta:
                out[other] = f"{name} {why}"
                pending.append(other)
    return out


def effective_priorities(catalog: Catalog, found: Wanted, requests: Collection[Request]) -> dict[str, int]:
    """How much each wanted service matters: its priority, that of a request for it, or that of what requests or needs
    it, whichever is highest. Protected services are above all."""
    asked: dict[tuple[str, str, str], int] = {}
    for request in requests:
        for name in (m for s in request.services for m in catalog.members(s)) if request.priority is not None else ():
            key = (request.requester, request.id, name)
            asked[key] = max(request.priority or 0, asked.get(key, 0))
    priority: dict[str, int] = {}
    for name, causes in found.items():
        service = catalog.services[name]
        own = [0 if service.meta else PROTECTED if service.protected else service.priority]
        own += [asked[c.by, c.request, name] for c in causes if (c.by, c.request, name) in asked]
        priority[name] = max(own)
    wants: dict[str, list[str]] = {}
    for name, causes in found.items():
        for cause in causes:
            wants.setdefault(cause.by, []).append(name)
    # The highest first, so that each is settled when its turn comes.
    for name in sorted(priority, key=lambda n: -priority[n]):
        pending = [name]
        while pending:
            by = pending.pop()
            for other in wants.get(by, ()):
                if priority[other] < priority[by]:
                    priority[other] = priority[by]
                    pending.append(other)
    return priority


@dataclass(frozen=True, slots=True)
class Contest:
    """One service that others keep from being active."""

    loser: str
    why: str
    winners: tuple[str, ...]


def _all_out(catalog: Catalog, out: dict[str, str], contests: Iterable[Contest]) -> dict[str, str]:
    for contest in contests:
        _give_way(catalog, out, contest.loser, contest.why)
    return out


def _turned_round(
    catalog: Catalog, requests: tuple[Request, ...], out: dict[str, str], contest: Contest, winner: str
) -> Contest:
    """The contest in favour of its loser, where the winner would not be wanted without that one."""
    without = wanted(catalog, requests, _all_out(catalog, dict(out), [contest]))
    if winner in without:
        return contest  # it takes others' loss as well, which is seen next time
    holder, loser = catalog.services[contest.loser], catalog.services[winner]
    shared = sorted(set(holder.exclusive) & set(loser.exclusive))
    why = f"waits for {shared[0]}, which is taken by" if shared else "conflicts with"
    return Contest(winner, f"{why} {holder.name}, on whose behalf it is asked for", (holder.name,))


def _contested(catalog: Catalog, found: Wanted, priority: Mapping[str, int]) -> list[Contest]:
    """Contests among wanted services that no service loses twice; empty when all of them can be active."""
    return _conflict(catalog, found, priority) or _overbooked(catalog, found, priority)


def _conflict(catalog: Catalog, found: Wanted, priority: Mapping[str, int]) -> list[Contest]:
    """Conflicts are refused when a request or a manifest arrives; what is left are requests that slept meanwhile, and
    conflicts declared later. The higher effective priority goes first, then the name."""
    pairs = conflicting(catalog.services, [n for n in found if not catalog.services[n].meta])
    if not pairs:
        return []
    first, second = sorted(pairs[0], key=lambda n: (-priority[n], n))
    return [Contest(second, f"conflicts with {first}, which goes first", (first,))]


def _overbooked(catalog: Catalog, found: Wanted, priority: Mapping[str, int]) -> list[Contest]:
    """The lower holders of the first exclusive resource of which more is wanted than there is."""
    users = [
        n
        for n in sorted(found, key=lambda n: (-priority[n], n))
        if catalog.services[n].exclusive and not catalog.services[n].meta
    ]
    for resource in sorted({r for n in users for r in catalog.services[n].exclusive}):
        left = catalog.policy.resources.get(resource, 1)
        winners: list[str] = []
        losers: list[Contest] = []
        for name in users:
            units = catalog.services[name].exclusive.get(resource, 0)
            if units > left:
                others = ", ".join(winners) or "nobody: there are too few"
                losers.append(Contest(name, f"waits for {resource}, which is taken by {others}", tuple(winners)))
            elif units:
                winners.append(name)
                left -= units
        if losers:
            return losers
    return []


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


def _within_budget(catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]) -> Admission:
    """Requests that fit into the budget, the higher priority first, then the older; why the services of the others
    wait. Only where the Policy says so: `over: queue`. What is preempted takes no room."""
    waiting = sorted(requests, key=lambda r: -_priority(catalog, r))
    rivals = _rivals(catalog) | set(excluded)
    names = set(_contest(catalog, (), excluded).wanted)
    admitted: list[Request] = []
    queued: dict[str, str] = {}
    while (request := next((r for r in waiting if r.requester in names), None)) is not None:
        waiting.remove(request)
        asked = closure(catalog.services, [m for s in request.services for m in catalog.members(s)])
        # Only where there is somebody to be preempted by must it be found out who does.
        found = set(_contest(catalog, (*admitted, request), excluded).wanted) if asked & rivals else names | asked
        why = over_budget(catalog, found)
        if why and expected(catalog, found - names) != (0.0, 0):
            queued |= dict.fromkeys(sorted(found - names), f"waits for room: {why}")
        else:
            admitted.append(request)
            names = found
    # What nobody active asks for takes no room.
    admission = _contest(catalog, (*admitted, *waiting), excluded)
    return replace(
        admission,
        preempted={
            **admission.preempted,
            **{n: why for n, why in queued.items() if n not in admission.wanted and n not in admission.preempted},
        },
    )


def _rivals(catalog: Catalog) -> set[str]:
    """Services that may be preempted by others, or others by them."""
    services = catalog.services.values()
    return {n for s in services if s.conflicts or s.exclusive for n in (s.name, *s.conflicts)}


def _priority(catalog: Catalog, request: Request) -> int:
    own = [catalog.services[m].priority for s in request.services for m in catalog.members(s)]
    return max([*own, request.priority or 0], default=0)
