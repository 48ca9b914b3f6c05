"""The first half of a pass: turn the inputs into a Situation. It settles requests, admission, progress, pressure,
prewarming and restarts, in this order because each depends on the ones before."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from rorg.core.admission import Admission, Admitted, admission_for, admit
from rorg.core.desired import Desired
from rorg.core.devices import unplugged
from rorg.core.eviction import Eviction, evict
from rorg.core.inputs import Cache, Inputs
from rorg.core.memory import Memory
from rorg.core.prewarm import Prewarmed, prewarm
from rorg.core.requests import Settled, note_restarts, settle, tried_again
from rorg.core.rollout import retried
from rorg.core.schedule import interlocks
from rorg.core.situation import Situation
from rorg.core.tracking import Tracked, renew_all, track
from rorg.core.wanted import Wanted, urgent
from rorg.core.withheld import Withheld
from rorg.model.catalog import Hold, Request
from rorg.model.units import format_time, stamp

FRESH = 1.0
"""Seconds for which an interlock's answer stays valid beyond its interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Assessed:
    """The situation that the plan is made from, and by-products of finding it."""

    situation: Situation
    tracked: Tracked | None
    settled: Settled
    holds: Mapping[str, str]
    served: Mapping[str, str]
    warm: Prewarmed


def assess(inputs: Inputs, cache: Cache | None, touched: Collection[str], withheld: Withheld) -> Assessed:
    """Assess all inputs of a pass. `touched` are services whose containers changed since the last pass."""
    desired, now = inputs.desired, inputs.now
    settled = settle(desired.catalog, inputs.requests, inputs.observed, inputs.memory.leases, inputs.renewals, now)
    requests = (*desired.catalog.requests, *settled.requests)
    (holds, suspended), locks = _held(inputs), _interlocks(inputs)
    out = _excluded(inputs.memory, holds)
    admitted = admission_for(inputs.memory.admitted, desired.catalog, requests, out)
    admission = admitted.admission
    memory = _with_new_requests(inputs, admitted, settled)
    memory, tracked = _tracked(memory, admission.wanted, inputs, cache, touched)
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
        **_surroundings(inputs),
    )
    return Assessed(situation=situation, tracked=tracked, settled=settled, holds=holds, served=served, warm=warm)


def _held(inputs: Inputs) -> tuple[dict[str, str], str]:
    """Return services held by a person, each with the reason, and why rorg is suspended ("" if it is not)."""
    held = {n: h for n, h in inputs.holds.items() if h.until > inputs.wall and _can_cease(inputs.desired, n)}
    holds, suspension = {n: _until("held", h) for n, h in held.items()}, inputs.suspended
    return holds, _until("suspended", suspension) if suspension and suspension.until > inputs.wall else ""


def _with_new_requests(inputs: Inputs, admitted: Admitted, settled: Settled) -> Memory:
    """Return the memory after new requests and retries, which drop the back-off of what they name."""
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
    """Apply pressure. If it changes what is shed, admission must be repeated."""
    catalog, shed = inputs.desired.catalog, memory.pressure.shed
    free = admit(catalog, requests, holds) if shed else admission
    memory, eviction = evict(
        memory,
        inputs,
        admission,
        free,
        {s.service: _priority_if_back(s.service, memory, inputs, free, requests, holds) for s in shed},
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
    """Return the priority that a shed service would have if it came back, -1 if nothing would want it. Of two services
    that exclude each other, the second is wanted only because the first is shed: with both back, admission would leave
    it out, so it stays shed."""
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
    """Choose what to prewarm: after requests and pressure, so that prewarming never takes anything from them."""
    barred = {*excluded, *unplugged(inputs.desired, inputs.devices)}
    off = suspended or memory.pressure.engaged or not inputs.observed.complete
    return prewarm(memory, inputs, admission, requests, barred, off)


def _surroundings(inputs: Inputs) -> dict[str, Any]:
    """Return the fields of a Situation about the engine, images, devices and ROS graphs."""
    unplugged_now = unplugged(inputs.desired, inputs.devices)
    fields = {"images": inputs.images, "devices": inputs.devices, "ros": inputs.ros, "engine": inputs.engine}
    return {**fields, "unplugged": unplugged_now}


def _tracked(
    memory: Memory, wanted: Wanted, inputs: Inputs, cache: Cache | None, touched: Collection[str]
) -> tuple[Memory, Tracked | None]:
    if not inputs.observed.complete:
        return renew_all(memory, inputs.desired, inputs.now), None
    return track(
        cache.tracked if cache else None,
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


def _urgent(desired: Desired, wanted_now: Wanted, cache: Cache | None) -> frozenset[str]:
    last = cache.planned.situation if cache else None
    return last.urgent if last and last.wanted is wanted_now else urgent(desired.catalog, wanted_now)


def _can_cease(desired: Desired, name: str) -> bool:
    service = desired.catalog.services.get(name)
    return service is not None and not service.meta


def _until(word: str, hold: Hold) -> str:
    return f"{word} until {format_time(hold.until)}" + (f": {hold.reason}" if hold.reason else "")


def _interlocks(inputs: Inputs) -> dict[str, str]:
    """Return why each interlock refuses; "" if it allows. An answer that is too old counts as a refusal, because the
    hardware may have moved since."""
    refusals = {}
    for name, interlock in interlocks(inputs.desired, inputs.observed).items():
        result = inputs.results.get((name, "interlock"))
        fresh = result is not None and inputs.now - result.at <= interlock.interval + FRESH
        answer = result.message if result and fresh else f"{interlock} is being asked"
        refusals[name] = "" if result and fresh and result.ok else answer
    return refusals
