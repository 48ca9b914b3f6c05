"""Services that are made active before they are requested, since it is likely that they soon will be: `idle.prewarm`.

They are wanted by a cause of their own, which is no request: nothing else goes for them, they come last, and what they
were is restored as if nobody had wanted them. See docs/explanation/planning.md for the rule and its numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from rorg.core.admission import Admission, over_budget
from rorg.core.desired import Desired
from rorg.core.foresight import LOOK, RESUME, START, Foresight, Warm, asked_for, foresee, timed
from rorg.core.learning import Learning, observe_requests
from rorg.core.memory import Memory
from rorg.core.observed import Container, Observed
from rorg.core.wanted import Cause, Wanted
from rorg.model.catalog import Catalog, Request, Service
from rorg.model.graph import closure
from rorg.model.learned import Learned, Likelihood

GIVE_UP = 0.5
"""What is warm stays so while its probability is at least this part of what it takes to begin,"""
HOLD = 5.0
"""and so many seconds longer: a guess that comes and goes does not make it come and go."""
FAILED = 600.0
"""Seconds for which a service that ended while it was warm is not warmed again."""


@dataclass(frozen=True, slots=True)
class Prewarmed:
    """`wanted` is what requests want, and `names` besides. `look`: when to look again."""

    wanted: Wanted
    names: frozenset[str] = frozenset()
    look: float | None = None


def prewarm(
    memory: Memory,
    learned: Learned | None,
    desired: Desired,
    admission: Admission,
    requests: tuple[Request, ...],
    observed: Observed,
    barred: Collection[str],
    now: float,
    off: bool,
) -> tuple[Memory, Prewarmed]:
    """Learns from the requests of now, and says who is warm. `learned` is where that begins; None: nothing of it is
    done. `barred` must not be active now; `off`: nothing is to be warm."""
    before = memory.foresight
    if learned is None:
        return (memory if before == Foresight() else replace(memory, foresight=Foresight())), Prewarmed(
            admission.wanted
        )
    learning = before.learning or Learning(learned)
    if before.learning is None or requests != before.requests:
        learning = observe_requests(learning, now, requests, before.learning is None)
    learning, begun = _timed(learning, before, desired.catalog, memory, now)
    foresight = replace(before, learning=learning, requests=requests, begun=begun)
    names = [n for n, s in desired.catalog.services.items() if s.idle.prewarm and n not in admission.wanted]
    if off or not names:
        foresight = replace(foresight, warm={})
        return _kept(memory, foresight), Prewarmed(admission.wanted)
    room = _Room(memory, learning, desired, admission, requests, observed, barred, now)
    likely, look = foresee(learning, desired.catalog, {n: room.lead(n) + LOOK for n in names}, now)
    foresight = _noticed(foresight, room, now)
    warm, wanted = room.filled(foresight, likely)
    ends = [w.until for w in warm.values() if w.until > now]
    look = min((at for at in (look, *ends) if at is not None), default=None)
    added = frozenset(wanted.keys() - admission.wanted.keys())
    return _kept(memory, replace(foresight, warm=warm)), Prewarmed(wanted if added else admission.wanted, added, look)


def _kept(memory: Memory, foresight: Foresight) -> Memory:
    return memory if foresight == memory.foresight else replace(memory, foresight=foresight)


def _timed(
    learning: Learning, before: Foresight, catalog: Catalog, memory: Memory, now: float
) -> tuple[Learning, Mapping[str, tuple[str, float]]]:
    """Takes note of what is ready now, and how long that took. What ended before that tells nothing."""
    begun, learned = dict(before.begun), learning.learned
    for name, (verb, since) in before.begun.items():
        step = memory.of(name)
        if name in memory.in_flight:
            continue
        if step.ready and step.running_since is not None and step.running_since >= since:
            learned = timed(learned, name, verb, now - since, catalog.services)
        if step.ready or step.running_since is None:
            del begun[name]
    if len(begun) == len(before.begun):
        return learning, before.begun
    return replace(learning, learned=learned), begun


def _noticed(foresight: Foresight, room: _Room, now: float) -> Foresight:
    """With what was seen of those that are warm: one that runs no more has ended by itself, and is left alone."""
    warm, failed = dict(foresight.warm), {n: at for n, at in foresight.failed.items() if at > now}
    for name, one in foresight.warm.items():
        current = room.current(name)
        active = current is not None and current.active
        if one.ran and not active and name not in room.memory.in_flight:
            del warm[name]
            failed[name] = now + FAILED
        elif active and not one.ran:
            warm[name] = replace(one, ran=True)
    return replace(foresight, warm=warm, failed=failed)


class _Room:
    """What there is room for, in one pass."""

    def __init__(
        self,
        memory: Memory,
        learning: Learning,
        desired: Desired,
        admission: Admission,
        requests: tuple[Request, ...],
        observed: Observed,
        barred: Collection[str],
        now: float,
    ) -> None:
        self.memory, self.learning, self.desired, self.admission = memory, learning, desired, admission
        self.services, self.containers, self.now = desired.catalog.services, observed.by_service(), now
        self._leads = dict[str, float]()
        self.barred = {*barred, *admission.preempted, *(r.requester for r in requests)}

    def current(self, name: str) -> Container | None:
        return next(iter(self.containers.get(name, ())), None)

    def lead(self, name: str) -> float:
        """Seconds until it would be ready, with what it needs first."""
        if name not in self._leads:
            self._leads[name] = self._lead(name)
        return self._leads[name]

    def _lead(self, name: str) -> float:
        step, service, current = self.memory.of(name), self.services[name], self.current(name)
        if service.meta or step.ready:
            return 0.0
        took = self.learning.learned.took.get(name, {})
        paused = current is not None and current.state == "paused"
        own = took.get("resume", RESUME) if paused else took.get("start", START)
        return own + max((self.lead(n) for n in service.needs if n in self.services), default=0.0)

    def filled(
        self, foresight: Foresight, likely: Mapping[str, Likelihood]
    ) -> tuple[dict[str, Warm], dict[str, tuple[Cause, ...]]]:
        """Who is warm, the likeliest first, as far as there is room; and all that is wanted then."""
        found, wanted = dict[str, Warm](), dict(self.admission.wanted)
        chances = {**{n: 0.0 for n in foresight.warm}, **{n: p.probability for n, p in likely.items()}}
        for name in sorted(chances, key=lambda n: (-chances[n], n)):
            if name in self.admission.wanted or name not in self.services:
                continue
            one = self.considered(name, chances[name], foresight.warm.get(name), likely.get(name))
            brought = closure(self.services, [name]) - self.admission.wanted.keys()
            if one is None or not all(self.may(n, foresight) for n in brought) or not self.fits({*wanted, *brought}):
                continue
            found[name] = one
            wanted[name] = (Cause("prewarmed", one.likely.requester, likely=one.likely),)
            for other in brought:
                for need in (n for n in self.services[other].needs if n in brought):
                    wanted[need] = tuple(dict.fromkeys((*wanted.get(need, ()), Cause("needed", other))))
        return found, wanted

    def considered(self, name: str, chance: float, before: Warm | None, likely: Likelihood | None) -> Warm | None:
        """Whether it is likely enough to begin, or to go on."""
        enough = self.services[name].idle.prewarm
        if not enough:
            return None
        if before is not None:
            until = self.now + HOLD if chance >= GIVE_UP * enough else before.until
            return replace(before, until=until) if until > self.now else None
        return Warm(likely, self.now + HOLD) if likely is not None and chance >= enough else None

    def may(self, name: str, foresight: Foresight) -> bool:
        """Whether it may be active without anybody's request: it may be touched, takes nothing from others and asks
        for nothing itself, it is all there, and nothing is wrong with it."""
        service, containers, step = self.services[name], self.containers.get(name, ()), self.memory.of(name)
        if not harmless(service) or name in self.barred or foresight.failed.get(name, 0.0) > self.now:
            return False
        if len(containers) != 1 or containers[0].digest != self.desired.digests.get(name):
            return False
        if containers[0].state not in ("created", "exited", "paused", "running"):
            return False
        if step.exits or step.update.failed or any(t.error or t.at > self.now for t in step.attempts.values()):
            return False
        rivals = self.desired.conflicts.get(name, ())
        return not rivals or not (self.ever_asked() | self.admission.wanted.keys() | self.active()) & set(rivals)

    def ever_asked(self) -> frozenset[str]:
        """What somebody may ask for: it must not have to wait until something warm has ended."""
        return asked_for(self.desired.catalog, tuple(self.learning.learned.names))

    def active(self) -> set[str]:
        return {n for n, cs in self.containers.items() if any(c.active for c in cs)}

    def fits(self, names: set[str]) -> bool:
        return not over_budget(self.desired.catalog, names)


def harmless(service: Service) -> bool:
    """Its running alone does nothing that somebody would have to be asked for, or be told of; and nobody has to wait
    for its end."""
    task = service.ready is not None and service.ready.completed
    return not (service.meta or service.interlock or service.exclusive or service.calls or task or service.spec is None)
