"""What an operation would change, before anyone carries it out. The planner answers, not rules of a client: `rorg`
decides twice on the same inputs, once as they are and once with the operation, and compares both decisions.

The page asks for this through POST /v1/preview. Nothing is changed, and nothing is remembered.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from rorg.core.affected import dependants
from rorg.core.decide import Decision, decide, unlocked
from rorg.core.inputs import Inputs
from rorg.core.operations import Activate, Deactivate, Pause, Resume, Start, Stop
from rorg.core.plan import Action, Part, Reason, Waiting, printed


class Effect(StrEnum):
    """What happens to a running or idle service."""

    START = "start"
    RESUME = "resume"
    """It is paused, or its managed nodes are inactive, and goes on."""
    PAUSE = "pause"
    STOP = "stop"
    RESTART = "restart"


@dataclass(frozen=True, slots=True)
class Preempted:
    """A service that something wants, and that must not be active."""

    service: str
    by: tuple[str, ...]
    """The active services that have what it waits for; empty if a hold, pressure or the budget keeps it out."""
    reason: str


@dataclass(frozen=True, slots=True)
class Wait:
    """Something that rorg would not do at once."""

    service: str
    reason: str
    code: str
    """As of Waiting."""


@dataclass(frozen=True, slots=True)
class Consequences:
    """The difference between two decisions. Services are named in the order of their names."""

    effects: Mapping[str, Effect]
    """Service -> what rorg would do to it, as soon as it may."""
    wanted: tuple[str, ...]
    """Services that something would want, and nothing wants now."""
    unwanted: tuple[str, ...]
    """Services that nothing would want any more. They idle as their manifests say."""
    preempted: tuple[Preempted, ...]
    waits: tuple[Wait, ...]
    interlocked: tuple[str, ...] = ()
    """Services with an effect whose interlock has to allow it first."""

    def of(self, effect: Effect) -> list[str]:
        """Return the services with one effect."""
        return [name for name, found in self.effects.items() if found is effect]


def consequences(inputs: Inputs, changed: Inputs) -> Consequences:
    """Return what differs if `changed` were the inputs of the next pass."""
    before, after = _supposed(inputs), _supposed(changed)
    old = _effects(before)
    restarted = {n for n, effect in _effects(after).items() if effect is Effect.RESTART and old.get(n) is not effect}
    # A restart takes others along in later passes, and the requests of a run end with it.
    restarted = _restarted_with(after, restarted)
    left = tuple(r for r in changed.requests if r.requester not in restarted or r.standing or r.incarnation is None)
    if left != changed.requests:
        after = _supposed(replace(changed, requests=left))
    every = {**_effects(after), **dict.fromkeys(restarted, Effect.RESTART)}
    effects = {name: effect for name, effect in sorted(every.items()) if old.get(name) is not effect}
    services = inputs.desired.catalog.services
    asked, asked_then = _asked(before), _asked(after)
    return Consequences(
        effects,
        tuple(sorted(asked_then - asked)),
        tuple(sorted(asked - asked_then)),
        tuple(
            Preempted(name, after.situation.rivals.get(name, ()), reason)
            for name, reason in sorted(after.situation.preempted.items())
            if before.situation.preempted.get(name) != reason
        ),
        _waits(before, after, restarted),
        tuple(name for name in effects if services[name].interlock),
    )


def _supposed(inputs: Inputs) -> Decision:
    """Return a whole decision, with every interlock open: rorg asks them only before it does something."""
    results = {**inputs.results, **unlocked(inputs.desired, inputs.now)}
    return decide(replace(inputs, results=results, asked={}, cache=None))


def _effects(decision: Decision) -> dict[str, Effect]:
    """Return what rorg would do now. It does nothing while it is suspended, or if the plan is wrong."""
    return {} if decision.violations or decision.situation.suspended else _planned(decision)


def _planned(decision: Decision) -> dict[str, Effect]:
    services = decision.situation.desired.digests
    plans = {name: plan.actions for name, plan in decision.planned.plans.items() if name in services}
    return {name: effect for name, actions in plans.items() if (effect := _effect(decision, name, actions))}


def _effect(decision: Decision, name: str, actions: Collection[Action]) -> Effect | None:
    """Return the effect of a chain of actions on one service."""
    kinds = {type(action.operation) for action in actions}
    parts = {action.part_of for action in actions}
    if Part.RESTART in parts or (Start in kinds and any(c.active for c in decision.situation.observed.of(name))):
        return Effect.RESTART
    for effect, operations in (
        (Effect.START, {Start}),
        (Effect.RESUME, {Resume, Activate}),
        (Effect.PAUSE, {Pause, Deactivate}),
        (Effect.STOP, {Stop}),
    ):
        if kinds & operations:
            return effect
    return None


def _restarted_with(decision: Decision, names: Collection[str]) -> set[str]:
    """Return these services and those that restart with them, as far as they run."""
    services, observed = decision.situation.desired.catalog.services, decision.situation.observed
    found = dependants({n: s.restarts_with for n, s in services.items()}, names)
    return {n for n in found if n in names or (n in decision.situation.wanted and any(c.alive for c in observed.of(n)))}


def _asked(decision: Decision) -> set[str]:
    """Return all services that something wants, also those that are kept out."""
    services = decision.situation.desired.catalog.services
    names = {*decision.situation.wanted, *decision.situation.preempted}
    return {n for n in names if n in services and not services[n].meta}


def _waits(before: Decision, after: Decision, restarted: Collection[str]) -> tuple[Wait, ...]:
    """Return what would wait and does not wait now for the same reason."""
    known, now = set(_waitings(before)), after.situation.now
    new = [w for w in _waitings(after) if w not in known and w.service not in restarted]
    return tuple(sorted((Wait(w.service, printed(w.reason, now), w.code) for w in new), key=lambda w: w.service))


def _waitings(decision: Decision) -> list[Waiting]:
    """Return everything that waits, with what no plan mentions: all that is planned while rorg is suspended, and
    services that must become active while a call on them is under way or the engine does not answer."""
    situation, memory = decision.situation, decision.memory
    services = situation.desired.digests
    found = [w for w in decision.plan.waitings if w.service in services and w.code != "preempted"]
    if situation.suspended:
        found += [Waiting(name, situation.suspended, code="suspended") for name in _planned(decision)]
    for name in situation.wanted.keys() & services.keys():
        reason: Reason = ""
        flight = memory.in_flight.get(name)
        if not situation.observed.complete:
            reason = str(situation.observed.silence or situation.observed.error or "the engine has not answered yet")
        elif flight and flight.action.operation.idles:
            reason = f"{flight.action.verb} is under way"
        found += [Waiting(name, reason)] if reason else []
    return found
