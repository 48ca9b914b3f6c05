"""Contests: which services give way when not all can be active at once, because they conflict or use the same exclusive
resource. The higher effective priority wins, then the name."""

from __future__ import annotations

from bisect import bisect
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

from rorg.core.priorities import PROTECTED, effective_priorities
from rorg.core.wanted import ROOTS, Wanted, wanted, wanted_by
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure, conflicting, overbooked

Ranks = Mapping[str, tuple[int, str]]
"""Services, and what to sort them by: the negated effective priority, then the name."""


@dataclass(frozen=True, slots=True)
class Admission:
    """The wanted set without preempted services, the reasons, and the effective priority of every wanted service."""

    wanted: Wanted
    preempted: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted if nothing stood against them -> the reason."""
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Preempted services -> the active services that have what they wait for, if that is the reason."""
    asked: Wanted = field(default_factory=dict)
    """What would be wanted if nothing stood against anything; empty if nothing is preempted."""
    priorities: Mapping[str, int] = field(default_factory=dict)
    requests: tuple[Request, ...] = ()
    """The requests that count: all except queued ones."""


@dataclass(frozen=True, slots=True)
class Loss:
    """Why a service cannot be active: the exclusive resource ("" for a conflict), and the active services that have
    it."""

    resource: str
    winners: tuple[str, ...]


def settle_contests(catalog: Catalog, requests: tuple[Request, ...], excluded: Mapping[str, str]) -> Admission:
    """Return who may be active, without regard to the budget. `excluded` are services that must not be active, with the
    reason.

    The set of services that are certain to be active grows round by round. What cannot be active beside them is out.
    The rest become certain where nothing may outrank them, and their requests count from the next round on.
    """
    rules, certain, impossible = _Rules(catalog), set[str](), dict(excluded)
    while True:
        out = rules.with_dependants([*impossible, *rules.losses(certain)])
        possible = wanted(catalog, requests, out)
        priorities = effective_priorities(catalog, possible, requests)
        if not any(name in possible and name not in certain for name in rules.contested):
            break
        ranks = _ranks(priorities)
        sure = {name: tuple(c for c in causes if c.by in certain or not c.by) for name, causes in possible.items()}
        lowest = _ranks(effective_priorities(catalog, sure, requests))
        outranked = rules.outranked(ranks, lowest, certain)
        if not outranked:
            break
        grown = wanted(catalog, requests, out | rules.with_dependants(outranked)).keys() - certain
        if not grown:
            chosen = _chosen_in_ring(catalog, possible, lowest, outranked, certain)
            grown = closure(catalog.services, [chosen])
            # What needs two units of a resource, itself and through its needs, may find only one.
            if why := _misfit(catalog, certain | grown):
                impossible[chosen], grown = why, set()
        certain |= grown
    if not out:
        return Admission(possible, priorities=priorities, requests=requests)
    asked = wanted(catalog, requests)
    ranks = _ranks(effective_priorities(catalog, asked, requests))
    reasons, rivals = _reasons(rules, impossible, possible, asked, ranks)
    return Admission(possible, reasons, rivals, asked if reasons else {}, priorities, requests)


def _ranks(priorities: Mapping[str, int]) -> Ranks:
    return {name: (-priority, name) for name, priority in priorities.items()}


def _misfit(catalog: Catalog, names: Collection[str]) -> str:
    """Return why these services cannot all be active; "" if they can."""
    names = [name for name in names if not catalog.services[name].meta]
    pairs, shortages = conflicting(catalog.services, names), overbooked(catalog, names)
    reasons = [*(f"{one} and {other} conflict" for one, other in pairs), *shortages]
    return f"does not fit: {reasons[0]}" if reasons else ""


class _Rules:
    """What the manifests say about who cannot be active together. Meta-services take part in no contest."""

    def __init__(self, catalog: Catalog) -> None:
        self.services = {name: service for name, service in catalog.services.items() if not service.meta}
        self.units = catalog.policy.resources
        """Resource -> how many units there are, if it is not one."""
        self.rivals: dict[str, list[str]] = {}
        for one, other in conflicting(self.services, self.services):
            self.rivals.setdefault(one, []).append(other)
            self.rivals.setdefault(other, []).append(one)
        self.contested = [name for name, service in self.services.items() if service.exclusive or name in self.rivals]
        self.dependants: dict[str, list[str]] = {}
        for name, service in self.services.items():
            for need in service.needs:
                self.dependants.setdefault(need, []).append(name)

    def with_dependants(self, names: Iterable[str]) -> dict[str, str]:
        """Return these services and all that need them -> the one of these that it is about."""
        found = {name: name for name in names if name in self.services}
        pending = list(found)
        for name in pending:
            more = [n for n in self.dependants.get(name, ()) if n not in found]
            found |= dict.fromkeys(more, found[name])
            pending += more
        return found

    def losses(self, active: Collection[str]) -> dict[str, list[Loss]]:
        """Return what cannot be active beside these services."""
        users: dict[str, list[str]] = {}
        for name in sorted(n for n in active if n in self.services):
            for resource in self.services[name].exclusive:
                users.setdefault(resource, []).append(name)
        found = {n: self._losses(n, active, users) for n in self.contested if n not in active}
        return {name: losses for name, losses in found.items() if losses}

    def _losses(self, name: str, active: Collection[str], users: Mapping[str, list[str]]) -> list[Loss]:
        losses = [Loss("", (rival,)) for rival in self.rivals.get(name, ()) if rival in active]
        for resource, units in sorted(self.services[name].exclusive.items()):
            there, others = self.units.get(resource, 1), users.get(resource, [])
            if units > there:
                losses.append(Loss(resource, ()))
            elif units > there - sum(self.services[other].exclusive[resource] for other in others):
                losses.append(Loss(resource, tuple(others)))
        return losses

    def outranked(self, ranks: Ranks, lowest: Ranks, certain: Collection[str]) -> dict[str, list[str]]:
        """Return the services that others may keep out -> these. `lowest` are ranks that each has at least."""
        uncertain = sorted((n for n in self.contested if n in ranks and n not in certain), key=ranks.__getitem__)
        found = {n: [r for r in self.rivals.get(n, ()) if r in ranks and ranks[r] < lowest[n]] for n in uncertain}
        for resource in sorted({r for n in uncertain for r in self.services[n].exclusive}):
            users = [n for n in uncertain if resource in self.services[n].exclusive]
            places = [ranks[n] for n in users]
            taken = sum(self.services[n].exclusive.get(resource, 0) for n in self.contested if n in certain)
            used = list(accumulate((self.services[n].exclusive[resource] for n in users), initial=taken))
            for name in users:
                place = bisect(places, lowest[name])  # its own rank is at least this
                if used[place] > self.units.get(resource, 1):
                    found[name] += [n for n in users[:place] if n != name]
        return {name: above for name, above in found.items() if above}


def _chosen_in_ring(
    catalog: Catalog, possible: Wanted, ranks: Ranks, outranked: Mapping[str, Collection[str]], certain: Collection[str]
) -> str:
    """Return the service that becomes certain when each candidate is outranked. Candidates are always on, or wanted by
    a service that is certain.

    Nobody gives way to what it requests itself: its request would vanish, the winner with it, and the two would
    alternate for ever. The candidate that depends on the fewest others comes first, then the highest.
    """

    def depends_on(name: str) -> int:
        reached, pending = {name}, [name]
        for one in pending:
            others = {*outranked.get(one, ()), *catalog.services[one].needs, *(c.by for c in possible[one])}
            more = {n for n in others - reached if n in possible and n not in certain}
            pending += more
            reached |= more
        return len(reached)

    candidates = [
        name
        for name, causes in possible.items()
        if name not in certain and any(c.kind in ROOTS or c.by in certain for c in causes)
    ]
    return min(candidates, key=lambda name: (depends_on(name), ranks[name]))


def _reasons(
    rules: _Rules, excluded: Mapping[str, str], admitted: Wanted, asked: Wanted, ranks: Ranks
) -> tuple[dict[str, str], dict[str, tuple[str, ...]]]:
    """Return what would be wanted if nothing stood against it -> what does, and -> the services that do."""
    losses = rules.losses(admitted)
    first = {n: _first(losses[n], ranks) for n in asked if n in losses and n not in excluded}
    texts = {n: _text(n, loss, asked, ranks) for n, loss in first.items()} | dict(excluded)
    about = {n: of for n, of in rules.with_dependants(texts).items() if n in asked}
    reasons = {n: texts[of] if n == of else f"{of} {texts[of]}" for n, of in about.items()}
    return reasons, {n: first[of].winners for n, of in about.items() if of in first and first[of].winners}


def _first(losses: Iterable[Loss], ranks: Ranks) -> Loss:
    """Return the reason that counts most: that with the highest winner."""
    return min(losses, key=lambda one: min((ranks[w] for w in one.winners), default=(-PROTECTED - 1, "")))


def _text(loser: str, loss: Loss, asked: Wanted, ranks: Ranks) -> str:
    if not loss.winners:
        return f"waits for {loss.resource}, which has fewer units than it uses"
    what = f"waits for {loss.resource}, which is taken by" if loss.resource else "conflicts with"
    lower = [w for w in loss.winners if ranks[w] > ranks[loser]]
    if not lower:
        suffix = "" if loss.resource else ", which has priority"
    else:
        suffix = ", for which it was requested" if loser in wanted_by(asked, lower) else ""
    return f"{what} {', '.join(loss.winners)}{suffix}"
