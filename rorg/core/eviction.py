"""What measures against pressure mean for the services of now."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from rorg.core.admission import PROTECTED, Admission
from rorg.core.desired import Desired
from rorg.core.memory import Memory
from rorg.core.observed import Observed
from rorg.core.pressure import NONE, PATIENCE, Chances, Victim, advance, excess, helps, without
from rorg.core.wanted import wanted
from rorg.model.load import Load

ALIVE = ("running", "restarting", "paused")


@dataclass(frozen=True, slots=True)
class Eviction:
    """Measures in force, as the planner takes them; the fields are those of Situation."""

    lowered: frozenset[str] = frozenset()
    hurry: bool = False
    stop_paused: bool = False
    shed: frozenset[str] = frozenset()
    closed: str = ""


def evict(
    memory: Memory,
    desired: Desired,
    admission: Admission,
    free: Admission,
    back: Mapping[str, int],
    observed: Observed,
    load: Load | None,
    excluded: Collection[str],
    locked: Collection[str],
    suspended: bool,
) -> tuple[Memory, Eviction]:
    """Advance the state of pressure by one sample and say which measures follow.

    `free` is the admission as if nothing were shed. `back` holds the priority that each shed service would have if it
    came back, -1 if nobody would want it then. `excluded` services must not be active anyway; `locked` ones must not be
    touched now. While suspended nothing can be done, so no new conclusion is drawn. Without thresholds no measure is in
    force."""
    policy = desired.catalog.policy
    if policy.pressure is None:
        return replace(memory, pressure=NONE) if memory.pressure.engaged else memory, Eviction()
    states = {name: cs[0].state for name, cs in observed.by_service().items()}
    lower = _below_the_top(desired, admission)
    before = state = memory.pressure
    if not suspended:
        over = excess(policy.pressure, policy.budget, load) if load else {}
        victims = Victims(desired, admission, free, excluded, locked, states, load, over)
        # Shedding is for what is wanted but for this, and never for what is protected by now, or needed by that.
        state = without(state, [s.service for s in state.shed if not 0 <= back.get(s.service, -1) < PROTECTED])
        state = advance(
            state,
            policy.pressure,
            policy.budget,
            load,
            Chances(
                _useful(desired, admission, lower, states, victims.use, over),
                victims.next_one,
                any(states.get(s.service) in ALIVE for s in state.shed),
                load is not None and _beginning(memory, states, load),
                victims.below,
            ),
        )
    if state != before:
        memory = replace(memory, pressure=state)
    in_force = state.in_force
    closed = f"the machine is under pressure: {state.reason}" if in_force("close-admission") else ""
    return memory, Eviction(
        lower if in_force("lower-shares") else frozenset(),
        in_force("end-lingering"),
        in_force("stop-paused"),
        frozenset(s.service for s in state.shed),
        closed,
    )


def _beginning(memory: Memory, states: Mapping[str, str], load: Load) -> bool:
    """Whether a service uses something by now that the sample does not say of it."""
    calls = [f.since for f in memory.in_flight.values() if f.action.operation.begins]
    runs = [memory.of(n).running_since for n, state in states.items() if state == "running" and n not in load.use]
    return any(since is not None and load.at - since < PATIENCE for since in (*calls, *runs))


def _useful(
    desired: Desired,
    admission: Admission,
    lower: Collection[str],
    states: Mapping[str, str],
    use: Callable[[str], tuple[float, int]],
    over: Mapping[str, float],
) -> frozenset[str]:
    """Measures that would help now: they change something that uses what is short."""
    limits, services = desired.catalog.policy.pressure, desired.catalog.services
    unwanted = [n for n in states if n in services and n not in admission.wanted]
    lingering = [n for n in unwanted if states[n] == "running" and n not in admission.preempted]

    def helped(cpu: Iterable[str], memory: Iterable[str]) -> bool:
        return helps(over, sum(use(n)[0] for n in cpu), sum(use(n)[1] for n in memory))

    useful = {
        "lower-shares": helped([n for n in lower if states.get(n) == "running"], ()),
        "end-lingering": helped(lingering, [n for n in lingering if services[n].idle.action != "pause"]),
        "stop-paused": helped((), [n for n in unwanted if states[n] == "paused"]),
        "close-admission": limits is not None and any(r < limits.admit for r in admission.priorities.values()),
    }
    return frozenset(name for name, is_useful in useful.items() if is_useful)


def _below_the_top(desired: Desired, admission: Admission) -> frozenset[str]:
    """Wanted services that matter less than the most important unprotected one, or than a protected one. Not those
    with an interlock, which would have to be asked for so little."""
    services = desired.catalog.services
    priorities = {n: r for n, r in admission.priorities.items() if not services[n].meta}
    top = max(priorities.values(), default=0)
    return frozenset(n for n, r in priorities.items() if r < min(top, PROTECTED) and not services[n].interlock)


class Victims:
    """Services that could be shed: of those that run, and may be touched, nothing that is protected, that others need
    or that asked for others; and nothing with which a protected service would go."""

    def __init__(
        self,
        desired: Desired,
        admission: Admission,
        free: Admission,
        excluded: Collection[str],
        locked: Collection[str],
        states: Mapping[str, str],
        load: Load | None,
        over: Mapping[str, float],
    ) -> None:
        self.catalog, self.admission, self.free, self.excluded = desired.catalog, admission, free, excluded
        self.locked, self.states, self.over = locked, states, over
        self.measured = load.use if load else {}

    def use(self, name: str) -> tuple[float, int]:
        service = self.catalog.services[name]
        return self.measured.get(name, (service.cpu, service.memory))

    def names(self) -> list[str]:
        # What was shed counts as wanted here: what it needs, or who asked for it, does not go in its place.
        services, active = self.catalog.services, {**self.free.wanted, **self.admission.wanted}
        askers = {
            r.requester
            for r in self.free.requests
            if any(m in active for s in r.services for m in self.catalog.members(s))
        }
        needed = {need for name in active for need in services[name].needs}
        return [
            n
            for n, priority in self.admission.priorities.items()
            if priority < PROTECTED
            and not services[n].meta
            and self.states.get(n) in ("running", "paused")
            and n not in askers
            and n not in needed
            and n not in self.locked
        ]

    def victim(self, name: str) -> Victim | None:
        out = {*self.excluded, name}
        gone = set(self.admission.wanted) - set(wanted(self.catalog, self.admission.requests, out))
        if any(self.catalog.services[n].protected for n in gone):
            return None
        uses = [self.use(n) for n in gone if self.states.get(n) == "running" and n not in self.locked]
        return name, sum(u[0] for u in uses), sum(u[1] for u in uses)

    def next_one(self, pressed: tuple[str, ...]) -> Victim | None:
        """The one that matters least, of those with which enough of what is short would go; of several, that which
        uses most of it."""
        use = 0 if "cpu" in pressed else 1
        order = sorted(self.names(), key=lambda n: (self.admission.priorities[n], -self.use(n)[use], n))
        return next((v for n in order if (v := self.victim(n)) and helps(self.over, *v[1:])), None)

    def below(self, service: str) -> list[Victim]:
        """Those that matter less than a service that is out; who matters least comes first."""
        priority = self.free.priorities.get(service, -1)
        order = sorted(
            (n for n in self.names() if self.admission.priorities[n] < priority),
            key=lambda n: (self.admission.priorities[n], n),
        )
        return [v for n in order if (v := self.victim(n))]
