"""From what a pass has read to what its plan is made from: who is asked for and admitted, what runs, what is shed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from rorg.core.admission import Admission, Admitted, admission_for, admit
from rorg.core.cache import Cache
from rorg.core.desired import Desired
from rorg.core.devices import unplugged
from rorg.core.eviction import Eviction, evict
from rorg.core.follow import Followed, follow, renew_all
from rorg.core.inputs import Inputs
from rorg.core.memory import Memory
from rorg.core.prewarm import Prewarmed, prewarm
from rorg.core.requests import Settled, settle, tried_again
from rorg.core.restarts import note_restarts
from rorg.core.rollout import retried
from rorg.core.schedule import interlocks
from rorg.core.situation import Situation
from rorg.core.wanted import Wanted, urgent
from rorg.core.withheld import Withheld
from rorg.model.catalog import Hold, Request
from rorg.model.units import format_time, stamp

FRESH = 1.0
"""Seconds for which the answer of an interlock counts, beyond its interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessed:
    """What a plan is made from, and what was found on the way to it."""

    situation: Situation
    followed: Followed | None
    settled: Settled
    holds: Mapping[str, str]
    served: Mapping[str, str]
    warm: Prewarmed


def assess(inputs: Inputs, cache: Cache | None, touched: Collection[str], withheld: Withheld) -> Assessed:
    """All that the plan depends on; what became of requests; who is held; which restarts are done."""
    desired, now = inputs.desired, inputs.now
    settled = settle(desired.catalog, inputs.requests, inputs.observed, inputs.memory.leases, inputs.renewals, now)
    requests = (*desired.catalog.requests, *settled.requests)
    (holds, suspended), locks = _held(inputs), _interlocks(inputs)
    out = _excluded(inputs.memory, holds)
    admitted = admission_for(inputs.memory.admitted, desired.catalog, requests, out)
    admission = admitted.admission
    memory = _asked_for(inputs, admitted, settled)
    memory, followed = _followed(memory, admission.wanted, inputs, cache, touched)
    blocked = [n for n, why in locks.items() if why]
    memory, eviction, admission = _evicted(memory, inputs, admission, requests, holds, blocked, bool(suspended))
    memory, warm = _prewarmed(memory, inputs, admission, requests, _excluded(memory, holds), bool(suspended))
    memory, served = note_restarts(memory, inputs.restarts, inputs.observed, stamp(inputs.wall))
    situation = Situation(
        desired=desired,
        wanted=warm.wanted,
        urgent=_urgent(desired, admission.wanted, cache),
        observed=inputs.observed,
        memory=memory,
        now=now,
        owner=inputs.owner,
        restarts={n: due.run for n, due in (memory.restarts or {}).items()},
        removals=inputs.removals,
        confirmed=frozenset(inputs.confirmed),
        preempted=admission.preempted,
        prewarmed=warm.names,
        excluded=frozenset(holds),
        priorities=admission.priorities,
        interlocks=locks,
        lowered=eviction.lowered,
        hurry=eviction.hurry,
        stop_paused=eviction.stop_paused,
        shed=eviction.shed,
        closed=eviction.closed,
        suspended=suspended,
        purge=inputs.purge,
        withheld=withheld,
        **_found(inputs),
    )
    return Assessed(situation=situation, followed=followed, settled=settled, holds=holds, served=served, warm=warm)


def _held(inputs: Inputs) -> tuple[dict[str, str], str]:
    """Services that a person holds now, and why nothing is done at all; each with the reason."""
    held = {n: h for n, h in inputs.holds.items() if h.until > inputs.wall and _can_cease(inputs.desired, n)}
    holds, suspension = {n: _until("held", h) for n, h in held.items()}, inputs.suspended
    return holds, _until("suspended", suspension) if suspension and suspension.until > inputs.wall else ""


def _asked_for(inputs: Inputs, admitted: Admitted, settled: Settled) -> Memory:
    """Notes what requests and retries ask for now, without the back-off of what is new among it."""
    memory = tried_again(inputs.memory, inputs.desired.catalog, admitted.requests)
    return retried(replace(memory, leases=settled.leases, admitted=admitted), inputs.retries)


def _excluded(memory: Memory, holds: Mapping[str, str]) -> dict[str, str]:
    return {**{s.service: s.reason for s in memory.pressure.shed}, **holds}


def _evicted(
    memory: Memory,
    inputs: Inputs,
    admission: Admission,
    requests: tuple[Request, ...],
    holds: Mapping[str, str],
    locked: Collection[str],
    suspended: bool,
) -> tuple[Memory, Eviction, Admission]:
    """What pressure changes: who is shed has to be admitted anew."""
    catalog, shed = inputs.desired.catalog, memory.pressure.shed
    free = admit(catalog, requests, holds) if shed else admission
    memory, eviction = evict(
        memory,
        inputs.desired,
        admission,
        free,
        {s.service: _priority_if_back(s.service, memory, inputs, free, requests, holds) for s in shed},
        inputs.observed,
        inputs.load,
        _excluded(memory, holds),
        locked,
        suspended or not inputs.observed.complete,
    )
    if memory.pressure.shed != shed:
        admission = admit(catalog, requests, _excluded(memory, holds))
    return memory, eviction, admission


def _priority_if_back(
    name: str,
    memory: Memory,
    inputs: Inputs,
    free: Admission,
    requests: tuple[Request, ...],
    holds: Mapping[str, str],
) -> int:
    """The priority of a service if it were no longer shed, -1 if nobody would want it. Of two that exclude each other,
    the second is wanted only because the first is shed: with both back, admission would leave it out. It stays shed."""
    if name in free.priorities:
        return free.priorities[name]
    out = {n: why for n, why in _excluded(memory, holds).items() if n != name or n in holds}
    return admit(inputs.desired.catalog, requests, out).priorities.get(name, -1)


def _prewarmed(
    memory: Memory,
    inputs: Inputs,
    admission: Admission,
    requests: tuple[Request, ...],
    excluded: Collection[str],
    suspended: bool,
) -> tuple[Memory, Prewarmed]:
    """Comes after all that is asked for and all that pressure changes, and changes nothing of that."""
    desired, observed = inputs.desired, inputs.observed
    barred = {*excluded, *unplugged(desired, inputs.devices)}
    off = suspended or memory.pressure.engaged or not observed.complete
    return prewarm(memory, inputs.learned, desired, admission, requests, observed, barred, inputs.now, off)


def _found(inputs: Inputs) -> dict[str, Any]:
    """What there is beside containers, for a Situation."""
    missing = unplugged(inputs.desired, inputs.devices)
    there = {"images": inputs.images, "devices": inputs.devices, "ros": inputs.ros, "engine": inputs.engine}
    return {**there, "unplugged": missing}


def _followed(
    memory: Memory, wanted: Wanted, inputs: Inputs, cache: Cache | None, touched: Collection[str]
) -> tuple[Memory, Followed | None]:
    if not inputs.observed.complete:
        return renew_all(memory, inputs.desired, inputs.now), None
    return follow(
        cache.followed if cache else None,
        memory,
        inputs.desired,
        wanted,
        inputs.observed,
        inputs.results,
        inputs.now,
        inputs.booted_at,
        touched,
        unplugged(inputs.desired, inputs.devices),
    )


def _urgent(desired: Desired, found: Wanted, cache: Cache | None) -> frozenset[str]:
    before = cache.planned.situation if cache else None
    return before.urgent if before and before.wanted is found else urgent(desired.catalog, found)


def _can_cease(desired: Desired, name: str) -> bool:
    service = desired.catalog.services.get(name)
    return service is not None and not service.meta


def _until(word: str, hold: Hold) -> str:
    return f"{word} until {format_time(hold.until)}" + (f": {hold.reason}" if hold.reason else "")


def _interlocks(inputs: Inputs) -> dict[str, str]:
    """What each interlock said just now: empty where it allows."""
    found = {}
    for name, interlock in interlocks(inputs.desired, inputs.observed).items():
        said = inputs.results.get((name, "interlock"))
        fresh = said is not None and inputs.now - said.at <= interlock.interval + FRESH
        answer = said.message if said and fresh else f"{interlock} is being asked"
        found[name] = "" if said and fresh and said.ok else answer
    return found
