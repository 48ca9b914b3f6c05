"""Contests: which services give way when not all can be active at once, because they conflict or use the same exclusive
resource. The higher effective priority wins, then the name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from rorg.core.priorities import effective_priorities
from rorg.core.wanted import Wanted, wanted
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import conflicting


@dataclass(frozen=True, slots=True)
class Contest:
    """One service that cannot be active because of others."""

    loser: str
    why: str
    winners: tuple[str, ...]


Loss = tuple[int, Contest]
"""The loser's negated priority, and the contest."""


def settle_contests(
    catalog: Catalog, requests: Collection[Request], excluded: Mapping[str, str]
) -> tuple[Wanted, dict[str, str], Mapping[str, int]]:
    """Return (who may be active, who is preempted and why, effective priorities). `excluded` are services that must not
    be active, with the reason.

    First the losers of each contest go out, one contest after another. Then they come back, highest effective priority
    first, if there is room for them after all: a winner may have been preempted itself.
    """
    preempted: dict[str, str] = {}
    for name, why in excluded.items():
        _give_way(catalog, preempted, name, why)
    initial = dict(preempted)
    admitted, priority, losses = _losers_go_out(catalog, requests, preempted)
    undone, pending = set[Contest](), _in_vain(losses, admitted)
    while pending:
        loss = pending.pop(0)
        retried = _all_out(catalog, dict(initial), [c for _, c in losses if c is not loss[1]])
        candidate, its_priority, others = _losers_go_out(catalog, requests, retried)
        returns, displaces = loss[1].loser in candidate, not admitted.keys() <= candidate.keys()
        new = loss[1] not in undone
        # The loser returns, and others may now lose to it. It displaces them only once: in a ring, each would displace
        # the next for ever. If another contest keeps it out, that one becomes the reason.
        if (returns and (new or not displaces)) or (others and new and not displaces):
            undone.add(loss[1])
            losses = [*(one for one in losses if one is not loss), *others]
            admitted, priority, preempted = candidate, its_priority, retried
            pending = _in_vain(losses, admitted)
    if _in_vain(losses, admitted):
        preempted = _all_out(catalog, dict(initial), [_as_it_stands(catalog, c, admitted, priority) for _, c in losses])
    asked = wanted(catalog, requests) if preempted else admitted
    return admitted, {n: why for n, why in preempted.items() if n in asked}, priority


def _in_vain(losses: Iterable[Loss], admitted: Wanted) -> list[Loss]:
    """Return the losses to services that are not active either, those of highest priority first."""
    vain = [loss for loss in losses if not all(w in admitted for w in loss[1].winners)]
    return sorted(vain, key=lambda loss: (loss[0], loss[1].loser))


def _as_it_stands(catalog: Catalog, contest: Contest, admitted: Wanted, priority: Mapping[str, int]) -> Contest:
    """Return the contest with those that are active in the end, if the winners are not."""
    if all(w in admitted for w in contest.winners):
        return contest
    beside, last = {**admitted, contest.loser: ()}, {**priority, contest.loser: -1}
    return next((c for c in _contested(catalog, beside, last) if c.loser == contest.loser), contest)


def _losers_go_out(
    catalog: Catalog, requests: Collection[Request], preempted: dict[str, str]
) -> tuple[Wanted, Mapping[str, int], list[Loss]]:
    """Settle one contest after another, and add the losers to `preempted`. Return (who is left, their effective
    priorities, the losses)."""
    losses: list[Loss] = []
    while True:
        admitted = wanted(catalog, requests, preempted)
        priority = effective_priorities(catalog, admitted, requests)
        contests = _contested(catalog, admitted, priority)
        if not contests:
            return admitted, priority, losses
        ranks = _ranks(catalog, requests, _all_out(catalog, dict(preempted), contests))
        # Losers are sorted by priority: of several that request the winner, the last one is the first to go out.
        self_defeating = next((c for c in reversed(contests) if _lent(c, ranks, priority)), None)
        if self_defeating:
            contests = [_turned_round(catalog, requests, preempted, self_defeating, priority)]
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


def _all_out(catalog: Catalog, out: dict[str, str], contests: Iterable[Contest]) -> dict[str, str]:
    for contest in contests:
        _give_way(catalog, out, contest.loser, contest.why)
    return out


def _ranks(catalog: Catalog, requests: Collection[Request], out: Collection[str]) -> Mapping[str, int]:
    """Return effective priorities of what is wanted while these are out."""
    return effective_priorities(catalog, wanted(catalog, requests, out), requests)


def _lent(contest: Contest, ranks: Mapping[str, int], priority: Mapping[str, int]) -> str:
    """Return a winner that would not win without the loser; "" if there is none. `ranks` are priorities without it.

    Nobody is preempted by what it requests itself: its request would vanish, the winner would no longer be wanted, or
    matter less, and the two would alternate for ever.
    """
    own = -priority[contest.loser], contest.loser
    return next((w for w in contest.winners if w not in ranks or (-ranks[w], w) > own), "")


def _turned_round(
    catalog: Catalog,
    requests: Collection[Request],
    preempted: dict[str, str],
    contest: Contest,
    priority: Mapping[str, int],
) -> Contest:
    """Return the contest decided the other way if the winner wins only because of the loser."""
    winner = _lent(contest, _ranks(catalog, requests, _all_out(catalog, dict(preempted), [contest])), priority)
    if not winner:
        return contest  # the winner also depends on other losers; the next round handles those
    holder, loser = catalog.services[contest.loser], catalog.services[winner]
    shared = sorted(set(holder.exclusive) & set(loser.exclusive))
    why = f"waits for {shared[0]}, which is taken by" if shared else "conflicts with"
    turned = Contest(winner, f"{why} {holder.name}, for which it was requested", (holder.name,))
    # If each requests the other, the one that is left is the one that others request too.
    return turned if holder.name in wanted(catalog, requests, _all_out(catalog, dict(preempted), [turned])) else contest


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
