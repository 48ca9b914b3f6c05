"""Prewarming: activate a service before it is requested, because it probably will be soon (`idle.prewarm`).

Prewarming has a cause of its own, which is not a request: it displaces nothing, comes last in every order, and when it
ends the service returns to the state it had. docs/explanation/planning.md explains the rule and its numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from rorg.core.admission import over_budget
from rorg.core.contests import Admission
from rorg.core.inputs import Inputs
from rorg.core.memory import Memory
from rorg.core.prediction import (
    LOOK,
    RESUME,
    START,
    Learning,
    PredictionState,
    Warm,
    asked_for,
    observe_requests,
    predict,
    with_duration,
)
from rorg.core.wanted import Cause, Wanted
from rorg.model.catalog import Catalog, Request, Service
from rorg.model.graph import closure
from rorg.model.learned import Likelihood

GIVE_UP = 0.5
"""A warm service stays warm while its probability is at least this share of what is needed to begin,"""
HOLD = 5.0
"""and this many seconds longer, so that a changing estimate does not start and stop it."""
FAILED = 600.0
"""Seconds for which a service that ended while warm is not prewarmed again."""


@dataclass(frozen=True, slots=True)
class Prewarmed:
    """`wanted` includes what requests want; `names` are prewarmed services; `look` is when to predict again."""

    wanted: Wanted
    names: frozenset[str] = frozenset()
    look: float | None = None


def prewarm(
    memory: Memory,
    inputs: Inputs,
    admission: Admission,
    requests: tuple[Request, ...],
    barred: Collection[str],
    off: bool,
) -> tuple[Memory, Prewarmed]:
    """Learn from the current requests and choose what is warm. `barred` services must not be active now; `off` means
    that nothing is prewarmed, but requests are still learnt from. Without `inputs.learned` both are turned off."""
    before, catalog, now = memory.prediction, inputs.desired.catalog, inputs.now
    if inputs.learned is None:
        return _kept(memory, PredictionState()), Prewarmed(admission.wanted)
    learning = before.learning or Learning(inputs.learned)
    if before.learning is None or requests != inputs.memory.asked:
        learning = observe_requests(learning, now, requests, before.learning is None)
    learning, begun = _timed(learning, before, catalog, memory, now)
    prediction = replace(before, learning=learning, begun=begun)
    names = [n for n, s in catalog.services.items() if s.idle.prewarm and n not in admission.wanted]
    if off or not names:
        prediction = replace(prediction, warm={})
        return _kept(memory, prediction), Prewarmed(admission.wanted)
    room = _Room(inputs, memory, learning, admission, {*barred, *(r.requester for r in requests)})
    likely, look = predict(learning, catalog, {n: room.lead(n) + LOOK for n in names}, now)
    prediction = _noticed(prediction, room, now)
    warm, wanted = room.filled(prediction, likely)
    ends = [w.until for w in warm.values() if w.until > now]
    look = min((at for at in (look, *ends) if at is not None), default=None)
    added = frozenset(wanted.keys() - admission.wanted.keys())
    return _kept(memory, replace(prediction, warm=warm)), Prewarmed(wanted if added else admission.wanted, added, look)


def _kept(memory: Memory, prediction: PredictionState) -> Memory:
    """Return the memory with this prediction state."""
    return memory if prediction == memory.prediction else replace(memory, prediction=prediction)


def _timed(
    learning: Learning, before: PredictionState, catalog: Catalog, memory: Memory, now: float
) -> tuple[Learning, Mapping[str, tuple[str, float]]]:
    """Measure how long services took to become ready. If a run ended before that, its time is ignored."""
    begun, learned = dict(before.begun), learning.learned
    for name, (verb, since) in before.begun.items():
        progress = memory.of(name)
        if name in memory.in_flight:
            continue
        if progress.ready and progress.running_since is not None and progress.running_since >= since:
            learned = with_duration(learned, name, verb, now - since, catalog.services)
        if progress.ready or progress.running_since is None:
            del begun[name]
    if len(begun) == len(before.begun):
        return learning, before.begun
    return replace(learning, learned=learned), begun


def _noticed(prediction: PredictionState, room: _Room, now: float) -> PredictionState:
    """Note which warm services run. A warm service that no longer runs has ended on its own, and is left alone for a
    while."""
    warm, failed = dict(prediction.warm), {n: at for n, at in prediction.failed.items() if at > now}
    for name, entry in prediction.warm.items():
        current = room.current(name)
        active = current is not None and current.active
        if entry.ran and not active and name not in room.memory.in_flight:
            del warm[name]
            failed[name] = now + FAILED
        elif active and not entry.ran:
            warm[name] = replace(entry, ran=True)
    return replace(prediction, warm=warm, failed=failed)


class _Room:
    """What may be prewarmed in one pass."""

    def __init__(
        self,
        inputs: Inputs,
        memory: Memory,
        learning: Learning,
        admission: Admission,
        barred: Collection[str],
    ) -> None:
        self.memory, self.learning, self.admission, self.desired = memory, learning, admission, inputs.desired
        self.services, self.now = inputs.desired.catalog.services, inputs.now
        self.containers, self.current = inputs.observed.by_service(), inputs.observed.current
        self._leads = dict[str, float]()
        self.barred = {*barred, *admission.preempted}

    def lead(self, name: str) -> float:
        """Return the seconds until a service would be ready, including what it needs."""
        if name not in self._leads:
            self._leads[name] = self._lead(name)
        return self._leads[name]

    def _lead(self, name: str) -> float:
        progress, service, current = self.memory.of(name), self.services[name], self.current(name)
        if service.meta or progress.ready:
            return 0.0
        took = self.learning.learned.took.get(name, {})
        asleep = current is not None and current.asleep
        own = took.get("resume", RESUME) if asleep else took.get("start", START)
        return own + max((self.lead(n) for n in service.needs if n in self.services), default=0.0)

    def filled(
        self, prediction: PredictionState, likely: Mapping[str, Likelihood]
    ) -> tuple[dict[str, Warm], dict[str, tuple[Cause, ...]]]:
        """Return the warm services and everything that is wanted with them. The most probable are tried first."""
        warm, wanted = dict[str, Warm](), dict(self.admission.wanted)
        chances = {**{n: 0.0 for n in prediction.warm}, **{n: p.probability for n, p in likely.items()}}
        for name in sorted(chances, key=lambda n: (-chances[n], n)):
            if name in self.admission.wanted or name not in self.services:
                continue
            entry = self.considered(name, chances[name], prediction.warm.get(name), likely.get(name))
            brought = closure(self.services, [name]) - self.admission.wanted.keys()
            if entry is None or not all(self.may(n, prediction) for n in brought):
                continue
            if over_budget(self.desired.catalog, {*wanted, *brought}):
                continue
            warm[name] = entry
            wanted[name] = (Cause("prewarmed", entry.likely.requester, likely=entry.likely),)
            for other in brought:
                for need in (n for n in self.services[other].needs if n in brought):
                    wanted[need] = tuple(dict.fromkeys((*wanted.get(need, ()), Cause("needed", other))))
        return warm, wanted

    def considered(self, name: str, chance: float, before: Warm | None, likely: Likelihood | None) -> Warm | None:
        """Return whether a service is probable enough to become or stay warm."""
        enough = self.services[name].idle.prewarm
        if not enough:
            return None
        if before is not None:
            until = self.now + HOLD if chance >= GIVE_UP * enough else before.until
            return replace(before, until=until) if until > self.now else None
        return Warm(likely, self.now + HOLD) if likely is not None and chance >= enough else None

    def may(self, name: str, prediction: PredictionState) -> bool:
        """Return whether a service may run without being requested: rorg may touch it, it takes nothing from others,
        its container is ready to start and nothing is wrong with it."""
        service, containers, progress = self.services[name], self.containers.get(name, ()), self.memory.of(name)
        if not harmless(service) or name in self.barred or name in prediction.failed:
            return False
        if len(containers) != 1 or containers[0].digest != self.desired.digests.get(name):
            return False
        if containers[0].state not in ("created", "exited", "inactive", "paused", "running"):
            return False
        if (
            progress.exits
            or progress.update.failed
            or any(t.error or t.at > self.now for t in progress.attempts.values())
        ):
            return False
        active = {n for n, cs in self.containers.items() if any(c.active for c in cs)}
        return not (self.ever_asked() | self.admission.wanted.keys() | active) & {*self.desired.conflicts[name]}

    def ever_asked(self) -> frozenset[str]:
        """Return services that someone may request. Such a request must not wait until a warm rival has ended."""
        return asked_for(self.desired.catalog, tuple(self.learning.learned.names))


def harmless(service: Service) -> bool:
    """Return whether merely running the service does nothing that a person would have to allow, and nothing waits for
    its end: no interlock, exclusive resource, calls to rorg, or task."""
    task = service.ready is not None and service.ready.completed
    return not (service.meta or service.interlock or service.exclusive or service.calls or task or service.spec is None)
