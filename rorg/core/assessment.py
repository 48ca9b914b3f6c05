"""The first half of a pass: turn the inputs into a Situation. It settles requests, admission, progress, pressure
and restarts, in this order because each depends on the ones before."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace

from rorg.core.admission import admission_for, admit
from rorg.core.contests import Admission
from rorg.core.devices import unplugged
from rorg.core.eviction import Victims, evict
from rorg.core.holds import seconds_left
from rorg.core.inputs import Cache, Inputs
from rorg.core.memory import Memory
from rorg.core.requests import Settled, note_restarts, settle, tried_again
from rorg.core.rollout import pardoned, retried
from rorg.core.schedule import interlocks
from rorg.core.situation import Measures, Situation, Surroundings
from rorg.core.tracking import Facts, Tracked, renew_all, track
from rorg.core.wanted import urgent
from rorg.core.withheld import Withheld
from rorg.model.catalog import Hold
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


def assess(inputs: Inputs, cache: Cache | None, touched: Collection[str], withheld: Withheld) -> Assessed:
    """Assess all inputs of a pass. `touched` are services whose containers changed since the last pass."""
    assessment = _Assessment(inputs)
    tracked = assessment.track(cache, touched)
    measures = assessment.evict()
    memory, served = note_restarts(assessment.memory, inputs.restarts, inputs.observed, stamp(inputs.wall))
    admission, last = assessment.admission, cache.planned.situation if cache else None
    wanted = admission.wanted
    surroundings = {f.name: getattr(inputs, f.name) for f in fields(Surroundings)} | {"memory": memory}
    situation = Situation(
        **surroundings,
        wanted=wanted,
        urgent=last.urgent if last and last.wanted is wanted else urgent(inputs.desired.catalog, wanted),
        restarts={n: due.run for n, due in memory.restarts.items()},
        confirmed=frozenset(inputs.confirmed),
        preempted=admission.preempted,
        rivals=admission.rivals,
        asked=admission.asked,
        excluded=frozenset(assessment.holds),
        priorities=admission.priorities,
        interlocks=assessment.interlocks,
        measures=measures,
        suspended=assessment.suspended,
        unplugged=assessment.unplugged,
        withheld=withheld,
    )
    return Assessed(
        situation=situation,
        tracked=tracked,
        settled=assessment.settled,
        holds=assessment.holds,
        served=served,
    )


class _Assessment:
    """Settles requests and admits what they want; each method then does one more step and updates `memory`."""

    def __init__(self, inputs: Inputs) -> None:
        self.inputs, self.desired, self.catalog = inputs, inputs.desired, inputs.desired.catalog
        last, services, hold = inputs.memory, self.catalog.services, inputs.suspended
        self.settled = settle(self.catalog, inputs.requests, inputs.observed, last.leases, inputs.renewals, inputs.now)
        self.requests = (*self.catalog.requests, *self.settled.requests, *inputs.peers.requests)
        self.holds = {
            name: _until("held", held)
            for name, held in inputs.holds.items()
            if seconds_left(held, inputs.moment) > 0 and name in services and services[name].spec is not None
        }
        """Services held by a person -> the reason."""
        self.suspended = _until("suspended", hold) if hold and seconds_left(hold, inputs.moment) > 0 else ""
        self.unplugged = unplugged(self.desired, inputs.devices)
        self.interlocks = _interlocks(inputs)
        excluded = self.excluded(last)
        admitted = admission_for(last.admitted, self.catalog, self.requests, excluded)
        self.admission = admitted.admission
        # New requests and retries drop the back-off of what they name.
        memory = tried_again(last, self.catalog, admitted.requests)
        self.memory = retried(replace(memory, leases=self.settled.leases, admitted=admitted), inputs.retries)

    def excluded(self, memory: Memory) -> dict[str, str]:
        """Return services that are shed, held, or kept from running by their machine, each with the reason."""
        shed = {s.service: s.reason for s in memory.pressure.shed}
        return {**self.inputs.peers.excluded, **shed, **self.holds}

    def track(self, cache: Cache | None, touched: Collection[str]) -> Tracked | None:
        inputs = self.inputs
        if not inputs.observed.complete:
            memory = replace(self.memory, outage=None if self.memory.outage is None else True)
            self.memory = renew_all(pardoned(memory, self.desired, inputs.now), self.desired, inputs.now)
            return None
        facts = Facts(
            memory=self.memory,
            desired=self.desired,
            wanted=self.admission.wanted,
            observed=inputs.observed,
            results=inputs.results,
            now=inputs.now,
            unplugged=self.unplugged,
        )
        tracked = track(cache.tracked if cache else None, facts, touched)
        self.memory = tracked.facts.memory
        return tracked

    def evict(self) -> Measures:
        """Apply pressure. If it changes what is shed, admission must be repeated."""
        shed = self.memory.pressure.shed
        free = admit(self.catalog, self.requests, self.holds) if shed else self.admission
        locked = [n for n, why in self.interlocks.items() if why]
        victims = Victims(self.inputs, self.admission, free, self.excluded(self.memory), locked)
        back = {s.service: self.priority_if_back(s.service, free) for s in shed}
        off = bool(self.suspended) or not self.inputs.observed.complete
        self.memory, measures = evict(self.memory, victims, back, off)
        if self.memory.pressure.shed != shed:
            self.admission = admit(self.catalog, self.requests, self.excluded(self.memory))
        return measures

    def priority_if_back(self, name: str, free: Admission) -> int:
        """Return the priority that a shed service would have if it came back, -1 if nothing would want it. Of two
        services that exclude each other, the second is wanted only because the first is shed: with both back, admission
        would leave it out, so it stays shed."""
        if name in free.priorities:
            return free.priorities[name]
        out = {n: why for n, why in self.excluded(self.memory).items() if n != name or n in self.holds}
        return admit(self.catalog, self.requests, out).priorities.get(name, -1)


def _until(word: str, hold: Hold) -> str:
    return f"{word} until {format_time(hold.until)}" + (f": {hold.reason}" if hold.reason else "")


def _interlocks(inputs: Inputs) -> dict[str, str]:
    """Return why each interlock refuses; "" if it allows. An answer that is too old counts as a refusal, because the
    hardware may have moved since."""
    refusals = {}
    for name, interlock in interlocks(inputs.desired, inputs.observed).items():
        result = inputs.results.get((name, "interlock"))
        if result is None or inputs.now - result.at > interlock.interval + FRESH:
            refusals[name] = f"{interlock} is being asked"
        else:
            refusals[name] = "" if result.ok else result.message
    return refusals
