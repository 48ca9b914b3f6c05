"""Apply pressure measures to the current services: which ones leave the CPU, which ones are shed, and in which order.

pressure.py decides when to take a measure; this file knows what a measure would free.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import cached_property

from rorg.core.contests import Admission
from rorg.core.inputs import Inputs
from rorg.core.memory import Memory
from rorg.core.observed import ASLEEP
from rorg.core.pressure import NONE, PATIENCE, Chances, Victim, advance, excess, helps, without
from rorg.core.priorities import PROTECTED
from rorg.core.situation import Measures
from rorg.core.wanted import wanted
from rorg.model.catalog import Catalog
from rorg.model.load import Load
from rorg.model.policy import Thresholds

ALIVE = frozenset(("running", "restarting", *ASLEEP))


def evict(memory: Memory, victims: Victims, back: Mapping[str, int], suspended: bool) -> tuple[Memory, Measures]:
    """Advance the pressure state by one sample and return what follows from it.

    - `back`: the priority that each shed service would have if it came back, -1 if nothing would want it then;
    - `suspended`: rorg can do nothing now, so it concludes nothing either.

    Without thresholds in the Policy no measure is in force.
    """
    policy, load = victims.catalog.policy, victims.load
    if policy.pressure is None:
        return replace(memory, pressure=NONE) if memory.pressure.engaged else memory, Measures()
    lower = _below_the_top(victims.catalog, victims.admission)
    before = state = memory.pressure
    if not suspended:
        states = victims.states
        # Forget shed services that nothing wants any more, and those that have become protected since.
        state = without(state, [s.service for s in state.shed if not 0 <= back.get(s.service, -1) < PROTECTED])
        chances = Chances(
            _useful(victims, lower, policy.pressure),
            victims.next_one,
            any(states.get(s.service) in ALIVE for s in state.shed),
            load is not None and _beginning(memory, states, load),
            victims.below,
        )
        state = advance(state, policy.pressure, policy.budget, load, chances)
    if state != before:
        memory = replace(memory, pressure=state)
    in_force = state.in_force
    return memory, Measures(
        lower if in_force("lower-shares") else frozenset(),
        in_force("end-lingering"),
        in_force("stop-paused"),
        frozenset(s.service for s in state.shed),
        f"the machine is under pressure: {state.reason}" if in_force("close-admission") else "",
    )


def _beginning(memory: Memory, states: Mapping[str, str], load: Load) -> bool:
    """Return whether a service already uses resources that the sample does not attribute to it yet."""
    calls = [f.since for f in memory.in_flight.values() if f.action.operation.begins]
    runs = [memory.of(n).running_since for n, state in states.items() if state == "running" and n not in load.use]
    return any(since is not None and load.at - since < PATIENCE for since in (*calls, *runs))


def _useful(victims: Victims, lower: Collection[str], limits: Thresholds) -> frozenset[str]:
    """Return the measures that would help now: they change something that uses what is short. Closing
    admission helps the services that run: it holds back later requests."""
    services, admission, states, use = victims.catalog.services, victims.admission, victims.states, victims.use
    idle = [n for n in states if n in services and n not in admission.wanted]
    lingering = [n for n in idle if states[n] == "running" and n not in admission.preempted]

    def helped(cpu: Iterable[str], memory: Iterable[str]) -> bool:
        return helps(victims.over, sum(use(n)[0] for n in cpu), sum(use(n)[1] for n in memory))

    useful = {
        "lower-shares": helped([n for n in lower if states.get(n) == "running"], ()),
        "end-lingering": helped(lingering, [n for n in lingering if not services[n].idle.keeps_run]),
        "stop-paused": helped((), [n for n in idle if states[n] in ASLEEP]),
        "close-admission": limits.admit > 0,
    }
    return frozenset(name for name, is_useful in useful.items() if is_useful)


def _priorities(catalog: Catalog, admission: Admission) -> Mapping[str, int]:
    """Return the effective priorities of wanted services that have a container here."""
    return {n: r for n, r in admission.priorities.items() if catalog.services[n].spec is not None}


def _below_the_top(catalog: Catalog, admission: Admission) -> frozenset[str]:
    """Return wanted services that matter less than the most important one. Services with an interlock are left out:
    asking the hardware for permission is too much for a change of CPU shares."""
    priorities = _priorities(catalog, admission)
    top = max(priorities.values(), default=0)
    return frozenset(n for n, r in priorities.items() if r < min(top, PROTECTED) and not catalog.services[n].interlock)


class Victims:
    """Services that may be shed. They run, may be touched, are not protected, and no other service needs them or was
    requested by them; and shedding them takes no protected service along.

    - `free`: the admission as if nothing were shed;
    - `excluded`: services that must not be active anyway;
    - `locked`: services that must not be touched now.
    """

    def __init__(
        self, inputs: Inputs, admission: Admission, free: Admission, excluded: Collection[str], locked: Collection[str]
    ) -> None:
        self.catalog, self.admission, self.free = inputs.desired.catalog, admission, free
        self.excluded, self.locked, self.load = excluded, locked, inputs.load
        self.containers = inputs.observed.by_service()
        limits, budget = self.catalog.policy.pressure, self.catalog.policy.budget
        self.over = excess(limits, budget, inputs.load) if limits and inputs.load else {}
        self.measured = inputs.load.use if inputs.load else {}

    @cached_property
    def states(self) -> Mapping[str, str]:
        """Service -> state of its current container."""
        return {name: containers[0].state for name, containers in self.containers.items()}

    def use(self, name: str) -> tuple[float, int]:
        """Return the measured (cores, bytes) of a service, or what it declares if it was not measured."""
        service = self.catalog.services[name]
        return self.measured.get(name, (service.cpu, service.memory))

    def names(self) -> list[str]:
        """Return the services that may be shed, in no order."""
        # Shed services count as wanted here. Otherwise what they need, or who requested them, would be shed in their
        # place.
        services, active = self.catalog.services, {**self.free.wanted, **self.admission.wanted}
        askers = {
            r.requester
            for r in self.free.requests
            if any(m in active for s in r.services for m in self.catalog.members(s))
        }
        needed = {need for name in active for need in services[name].needs}
        return [
            n
            for n, priority in _priorities(self.catalog, self.admission).items()
            if priority < PROTECTED
            and self.states.get(n) in ("running", *ASLEEP)
            and n not in askers
            and n not in needed
            and n not in self.locked
        ]

    def victim(self, name: str) -> Victim | None:
        """Return a service with what shedding it would free, including services that go with it; None if a protected
        service would go too."""
        out = {*self.excluded, name}
        ceasing = set(self.admission.wanted) - set(wanted(self.catalog, self.admission.requests, out))
        if any(self.catalog.services[n].protected for n in ceasing):
            return None
        uses = [self.use(n) for n in ceasing if self.states.get(n) == "running" and n not in self.locked]
        return name, sum(u[0] for u in uses), sum(u[1] for u in uses)

    def next_one(self, pressed: tuple[str, ...]) -> Victim | None:
        """Return the next service to shed: the least important one that frees enough of what is short. Among equals,
        the one that uses most of what is short, so that as few services as possible are shed."""
        resource = 0 if "cpu" in pressed else 1
        candidates = sorted(self.names(), key=lambda n: (self.admission.priorities[n], -self.use(n)[resource], n))
        return next((v for n in candidates if (v := self.victim(n)) and helps(self.over, *v[1:])), None)

    def below(self, service: str) -> list[Victim]:
        """Return services that matter less than a given one, least important first."""
        priority = self.free.priorities.get(service, -1)
        candidates = sorted(
            (n for n in self.names() if self.admission.priorities[n] < priority),
            key=lambda n: (self.admission.priorities[n], n),
        )
        return [v for n in candidates if (v := self.victim(n))]
