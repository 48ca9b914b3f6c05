"""Admission: who may be active when not everything that is wanted fits. Held and shed services, conflicts, exclusive
resources and the budget are settled here; a service that loses is *preempted*.

Admission depends only on the current requests and keeps no history. The same requests always give the same winners, so
services do not flap.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace

from rorg.core.wanted import Wanted, wanted
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure, conflicting
from rorg.model.units import format_memory

PROTECTED = 101
"""Effective priority of a protected service and of all that it needs: above every priority a manifest can set."""


@dataclass(frozen=True, slots=True)
class Admission:
    """The wanted set without preempted services, the reasons, and the effective priority of every wanted service."""

    wanted: Wanted
    preempted: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted if nothing stood against them -> the reason."""
    priorities: Mapping[str, int] = field(default_factory=dict)
    requests: tuple[Request, ...] = ()
    """The requests that count: all except queued ones."""


@dataclass(frozen=True, slots=True)
class Admitted:
    """An admission together with its inputs, kept so that the next pass can reuse it."""

    catalog: Catalog = Catalog()
    requests: tuple[Request, ...] = ()
    excluded: Mapping[str, str] = field(default_factory=dict)
    admission: Admission = Admission({})


def admission_for(
    last: Admitted, catalog: Catalog, requests: tuple[Request, ...], excluded: Mapping[str, str]
) -> Admitted:
    """Return the last admission if its inputs are the same, otherwise call admit(). With hundreds of requests admit()
    takes longer than the rest of a pass."""
    if last.catalog is catalog and last.excluded == excluded and last.requests == requests:
        return last
    return Admitted(catalog, requests, excluded, admit(catalog, requests, excluded))


def admit(catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]) -> Admission:
    """Decide who may be active. `excluded` are services that must not be active, with the reason (held or shed).

    What needs a preempted service is preempted too. A meta-service never is: it has no container that could stop.
    """
    budget = catalog.policy.budget
    admission = _contest(catalog, tuple(requests), excluded)
    if budget is None or budget.over != "queue" or not over_budget(catalog, admission.wanted):
        return admission
    return _within_budget(catalog, requests, excluded)


def _contest(catalog: Catalog, requests: tuple[Request, ...], excluded: Mapping[str, str]) -> Admission:
    """Settle all contests without the budget.

    First the losers of each contest go out, one contest after another. Then they come back, highest effective priority
    first, if there is room for them after all: a winner may have been preempted itself.
    """
    preempted: dict[str, str] = {}
    for name, why in excluded.items():
        _give_way(catalog, preempted, name, why)
    initial = dict(preempted)
    admitted, priority, losses = _losers_go_out(catalog, requests, preempted)
    for loss in sorted(losses, key=lambda p: (p[0], p[1].loser)):
        if all(w in admitted for w in loss[1].winners):
            continue  # its winners are still wanted
        retried = _all_out(catalog, dict(initial), [c for _, c in losses if c is not loss[1]])
        # Another contest may keep it out, its own or that of the service which needs it: that one is the reason.
        candidate, retried_priority, others = _losers_go_out(catalog, requests, retried)
        if (others or loss[1].loser in candidate) and set(admitted) <= set(candidate):
            losses.remove(loss)
            losses += others
            admitted, priority, preempted = candidate, retried_priority, retried
    asked = wanted(catalog, requests) if preempted else admitted
    return Admission(admitted, {n: why for n, why in preempted.items() if n in asked}, priority, requests)


def _losers_go_out(
    catalog: Catalog, requests: tuple[Request, ...], preempted: dict[str, str]
) -> tuple[Wanted, Mapping[str, int], list[tuple[int, Contest]]]:
    """Settle one contest after another, and add the losers to `preempted`. Return (who is left, their effective
    priorities, each loss with the loser's negated priority)."""
    losses: list[tuple[int, Contest]] = []
    while True:
        admitted = wanted(catalog, requests, preempted)
        priority = effective_priorities(catalog, admitted, requests)
        contests = _contested(catalog, admitted, priority)
        if not contests:
            return admitted, priority, losses
        without = wanted(catalog, requests, _all_out(catalog, dict(preempted), contests))
        # Losers are sorted by priority: of several that request the winner, the last one is the first to go out.
        self_defeating = next(((c, w) for c in reversed(contests) for w in c.winners if w not in without), None)
        if self_defeating:
            # Nobody is preempted by what it requests itself: its request would vanish, the winner would no longer be
            # wanted, and the two would alternate for ever.
            contests = [_turned_round(catalog, requests, preempted, *self_defeating)]
        losses += [(-priority[c.loser], c) for c in contests]
        _all_out(catalog, preempted, contests)


def _give_way(catalog: Catalog, preempted: dict[str, str], name: str, why: str) -> None:
    """Add a service and everything that needs it to `preempted`."""
    if name in catalog.services and catalog.services[name].meta:
        return
    preempted.setdefault(name, why)
    pending = [name]
    while pending:
        lost = pending.pop()
        for dependant, service in catalog.services.items():
            if lost in service.needs and dependant not in preempted and not service.meta:
                preempted[dependant] = f"{name} {why}"
                pending.append(dependant)


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


@dataclass(frozen=True, slots=True)
class Contest:
    """One service that cannot be active because of others."""

    loser: str
    why: str
    winners: tuple[str, ...]


def _all_out(catalog: Catalog, out: dict[str, str], contests: Iterable[Contest]) -> dict[str, str]:
    for contest in contests:
        _give_way(catalog, out, contest.loser, contest.why)
    return out


def _turned_round(
    catalog: Catalog, requests: tuple[Request, ...], preempted: dict[str, str], contest: Contest, winner: str
) -> Contest:
    """Return the contest decided the other way if the winner is wanted only because of the loser."""
    without = wanted(catalog, requests, _all_out(catalog, dict(preempted), [contest]))
    if winner in without:
        return contest  # the winner also depends on other losers; the next round handles those
    holder, loser = catalog.services[contest.loser], catalog.services[winner]
    shared = sorted(set(holder.exclusive) & set(loser.exclusive))
    why = f"waits for {shared[0]}, which is taken by" if shared else "conflicts with"
    return Contest(winner, f"{why} {holder.name}, for which it was requested", (holder.name,))


def _contested(catalog: Catalog, active: Wanted, priority: Mapping[str, int]) -> list[Contest]:
    """Return unsettled contests, each service losing at most once; empty when all of them can be active."""
    return _conflict(catalog, active, priority) or _overbooked(catalog, active, priority)


def _conflict(catalog: Catalog, active: Wanted, priority: Mapping[str, int]) -> list[Contest]:
    """Settle the first conflict: higher effective priority wins, then the name.

    New conflicts are refused when a request or manifest arrives. The ones seen here come from requests suspended with a
    paused requester, and from conflicts declared later.
    """
    pairs = conflicting(catalog.services, [n for n in active if not catalog.services[n].meta])
    if not pairs:
        return []
    first, second = sorted(pairs[0], key=lambda n: (-priority[n], n))
    return [Contest(second, f"conflicts with {first}, which has priority", (first,))]


def _overbooked(catalog: Catalog, active: Wanted, priority: Mapping[str, int]) -> list[Contest]:
    """Return the losers for the first exclusive resource that is requested more often than it exists."""
    users = [
        n
        for n in sorted(active, key=lambda n: (-priority[n], n))
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
    """Return (cores, bytes) that these services declare to use."""
    services = [catalog.services[n] for n in names if n in catalog.services]
    return sum(s.cpu for s in services), sum(s.memory for s in services)


def over_budget(catalog: Catalog, names: Collection[str]) -> str:
    """Return in words how the expected use exceeds the budget; "" if it fits."""
    budget = catalog.policy.budget
    if budget is None:
        return ""
    cpu, memory = expected(catalog, names)
    if budget.cpu is not None and cpu > budget.cpu + 1e-9:
        return f"{cpu:g} cores would exceed the budget of {budget.cpu:g}"
    if budget.memory is not None and memory > budget.memory:
        return f"{format_memory(memory)} would exceed the budget of {format_memory(budget.memory)}"
    return ""


def _within_budget(catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]) -> Admission:
    """Admit requests that fit into the budget, higher priority first, then older; queue the others.

    Only used if the Policy says `over: queue`. Preempted services take no room.
    """
    waiting = sorted(requests, key=lambda r: -_priority(catalog, r))
    rivals = _rivals(catalog) | set(excluded)
    admitted_names = set(_contest(catalog, (), excluded).wanted)
    admitted: list[Request] = []
    queued: dict[str, str] = {}
    while (request := next((r for r in waiting if r.requester in admitted_names), None)) is not None:
        waiting.remove(request)
        asked = closure(catalog.services, [m for s in request.services for m in catalog.members(s)])
        # Contests cost time: settle them only if this request can take part in one.
        active = (
            set(_contest(catalog, (*admitted, request), excluded).wanted) if asked & rivals else admitted_names | asked
        )
        why = over_budget(catalog, active)
        if why and expected(catalog, active - admitted_names) != (0.0, 0):
            queued |= dict.fromkeys(sorted(active - admitted_names), f"waits for room: {why}")
        else:
            admitted.append(request)
            admitted_names = active
    # A request whose requester is not active takes no room: it stays admitted and has no effect.
    admission = _contest(catalog, (*admitted, *waiting), excluded)
    return replace(
        admission,
        preempted={
            **admission.preempted,
            **{n: why for n, why in queued.items() if n not in admission.wanted and n not in admission.preempted},
        },
    )


def _rivals(catalog: Catalog) -> set[str]:
    """Services that can preempt others or be preempted by them."""
    services = catalog.services.values()
    return {n for s in services if s.conflicts or s.exclusive for n in (s.name, *s.conflicts)}


def _priority(catalog: Catalog, request: Request) -> int:
    """Return the highest priority among a request and the services it names."""
    own = [catalog.services[m].priority for s in request.services for m in catalog.members(s)]
    return max([*own, request.priority or 0], default=0)
