"""What measures against pressure mean for the services of now."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from rorg.core.arbitrate import PROTECTED, Verdict
from rorg.core.desired import Desired
from rorg.core.memory import Memory
from rorg.core.observed import Observed
from rorg.core.pressure import Chances, Load, Victim, advance, without
from rorg.core.wanted import wanted

ALIVE = ("running", "restarting", "paused")


@dataclass(frozen=True, slots=True)
class Relief:
    """Measures in force, as the planner takes them; the fields are those of Situation."""

    lowered: frozenset[str] = frozenset()
    hurry: bool = False
    stop_paused: bool = False
    shed: frozenset[str] = frozenset()
    closed: str = ""


def relieve(memory: Memory, desired: Desired, verdict: Verdict, free: Verdict, observed: Observed,
            load: Load | None, barred: Collection[str], locked: Collection[str], suspended: bool
            ) -> tuple[Memory, Relief]:
    """Steps the state of pressure by a sample, and says what follows. `free` is the verdict as if nothing were shed;
    `barred` must not be active anyway; `locked` must not be touched now. While suspended nothing can be done, so
    nothing more is concluded."""
    policy = desired.catalog.policy
    if policy.pressure is None and not memory.pressure.engaged:
        return memory, Relief()
    states = {name: cs[0].state for name, cs in observed.by_service().items()}
    lower = _below_the_top(desired, verdict)
    before = state = memory.pressure
    if not suspended:
        victims = Victims(desired, verdict, free, barred, locked, states, load)
        # Shedding is for what is wanted but for this, and never for what is protected by now, or needed by that.
        state = without(state, [s.service for s in state.shed if not 0 <= free.ranks.get(s.service, -1) < PROTECTED])
        state = advance(state, policy.pressure, policy.budget, load, Chances(
            _useful(desired, verdict, lower, states), victims.next_one,
            any(states.get(s.service) in ALIVE for s in state.shed), victims.below))
    if state != before:
        memory = replace(memory, pressure=state)
    in_force = state.in_force
    closed = f"the machine is under pressure: {state.reason}" if in_force("close-admission") else ""
    return memory, Relief(lower if in_force("lower-shares") else frozenset(), in_force("end-lingering"),
                          in_force("stop-paused"), frozenset(s.service for s in state.shed), closed)


def _useful(desired: Desired, verdict: Verdict, lower: Collection[str], states: Mapping[str, str]) -> frozenset[str]:
    """Measures that would change something now."""
    limits = desired.catalog.policy.pressure
    unwanted = [n for n in states if n in desired.catalog.services and n not in verdict.wanted]
    useful = {
        "lower-shares": any(states.get(n) == "running" for n in lower),
        "end-lingering": any(states[n] == "running" for n in unwanted),
        "stop-paused": any(states[n] == "paused" for n in unwanted),
        "close-admission": limits is not None and any(r < limits.admit for r in verdict.ranks.values()),
    }
    return frozenset(name for name, is_useful in useful.items() if is_useful)


def _below_the_top(desired: Desired, verdict: Verdict) -> frozenset[str]:
    """Wanted services that matter less than the most important unprotected one, or than a protected one. Not those
    with an interlock, which would have to be asked for so little."""
    services = desired.catalog.services
    ranks = {n: r for n, r in verdict.ranks.items() if not services[n].meta}
    top = max(ranks.values(), default=0)
    return frozenset(n for n, r in ranks.items() if r < min(top, PROTECTED) and not services[n].interlock)


class Victims:
    """Services that could be shed: of those that run, and may be touched, nothing that is protected, that others need
    or that asked for others; and nothing with which a protected service would go."""

    def __init__(self, desired: Desired, verdict: Verdict, free: Verdict, barred: Collection[str],
                 locked: Collection[str], states: Mapping[str, str], load: Load | None) -> None:
        self.catalog, self.verdict, self.free, self.barred = desired.catalog, verdict, free, barred
        self.locked, self.states = locked, states
        self.measured = load.use if load else {}

    def use(self, name: str) -> tuple[float, int]:
        service = self.catalog.services[name]
        return self.measured.get(name, (service.cpu, service.memory))

    def names(self) -> list[str]:
        # What was shed counts as wanted here: what it needs, or who asked for it, does not go in its place.
        services, active = self.catalog.services, {**self.free.wanted, **self.verdict.wanted}
        askers = {r.requester for r in self.free.requests
                  if any(m in active for s in r.services for m in self.catalog.members(s))}
        needed = {need for name in active for need in services[name].needs}
        return [n for n, rank in self.verdict.ranks.items()
                if rank < PROTECTED and not services[n].meta and self.states.get(n) in ("running", "paused")
                and n not in askers and n not in needed and n not in self.locked]

    def victim(self, name: str) -> Victim | None:
        out = {*self.barred, name}
        gone = set(self.verdict.wanted) - set(wanted(self.catalog, self.verdict.requests, out))
        if any(self.catalog.services[n].protected for n in gone):
            return None
        uses = [self.use(n) for n in gone if self.states.get(n) == "running" and n not in self.locked]
        return name, sum(u[0] for u in uses), sum(u[1] for u in uses)

    def next_one(self, pressed: tuple[str, ...]) -> Victim | None:
        """The one that matters least; of several, that which uses most of what is short."""
        use = 0 if "cpu" in pressed else 1
        order = sorted(self.names(), key=lambda n: (self.verdict.ranks[n], -self.use(n)[use], n))
        return next((v for n in order if (v := self.victim(n))), None)

    def below(self, service: str) -> list[Victim]:
        """Those that matter less than a service that is out; who matters least comes first."""
        rank = self.free.ranks.get(service, -1)
        order = sorted((n for n in self.names() if self.verdict.ranks[n] < rank),
                       key=lambda n: (self.verdict.ranks[n], n))
        return [v for n in order if (v := self.victim(n))]
