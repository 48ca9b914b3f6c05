"""What measures against pressure mean for the services of now."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

from rorg.core.arbitrate import PROTECTED, Verdict
from rorg.core.desired import Desired
from rorg.core.memory import Memory
from rorg.core.observed import Observed
from rorg.core.pressure import Chances, Load, advance
from rorg.core.wanted import wanted
from rorg.manifest.catalog import Request


@dataclass(frozen=True, slots=True)
class Relief:
    """Measures in force, as the planner takes them; the fields are those of Situation."""

    lowered: frozenset[str] = frozenset()
    hurry: bool = False
    stop_paused: bool = False
    shed: frozenset[str] = frozenset()
    closed: str = ""


def relieve(memory: Memory, desired: Desired, verdict: Verdict, requests: Collection[Request],
            barred: Collection[str], observed: Observed, load: Load | None) -> tuple[Memory, Relief]:
    """Steps the state of pressure by a sample, and says what follows. `barred` must not be active anyway."""
    policy = desired.catalog.policy
    states = {name: cs[0].state for name, cs in observed.by_service().items()}
    lower = _below_the_top(desired, verdict)
    useful = set()
    if any(states.get(n) == "running" for n in lower):
        useful.add("lower-shares")
    unwanted = [n for n in states if n in desired.catalog.services and n not in verdict.wanted]
    if any(states[n] == "running" for n in unwanted):
        useful.add("end-lingering")
    if any(states[n] == "paused" for n in unwanted):
        useful.add("stop-paused")
    if policy.pressure and any(r < policy.pressure.admit for r in verdict.ranks.values()):
        useful.add("close-admission")
    chances = Chances(frozenset(useful), lambda pressed: _next_shed(
        desired, verdict, requests, barred, states, load, pressed))
    before = memory.pressure
    state = advance(before, policy.pressure, policy.budget, load, chances)
    if state != before:
        memory = replace(memory, pressure=state)
    in_force = state.in_force
    closed = f"the machine is under pressure: {state.reason}" if in_force("close-admission") else ""
    return memory, Relief(lower if in_force("lower-shares") else frozenset(), in_force("end-lingering"),
                          in_force("stop-paused"), frozenset(s.service for s in state.shed), closed)


def _below_the_top(desired: Desired, verdict: Verdict) -> frozenset[str]:
    """Wanted services that matter less than the most important unprotected one, or than a protected one."""
    ranks = {n: r for n, r in verdict.ranks.items() if not desired.catalog.services[n].meta}
    top = max(ranks.values(), default=0)
    return frozenset(n for n, r in ranks.items() if r < min(top, PROTECTED))


def _next_shed(desired: Desired, verdict: Verdict, requests: Collection[Request], barred: Collection[str],
               states: dict[str, str], load: Load | None, pressed: tuple[str, ...]) -> tuple[str, float, int] | None:
    """The service that matters least of those that run, with the cores and bytes that go with it: nothing that is
    protected, or that a wanted service of a higher rank asked for; nothing that others need or that asked for others;
    nothing with which a protected service would go. Of several the one that uses most of what is short."""
    services = desired.catalog.services
    askers = {r.requester for r in requests if any(m in verdict.wanted for s in r.services
                                                   for m in desired.catalog.members(s))}
    needed = {n for name in verdict.wanted for n in services[name].needs}

    def use(name: str) -> tuple[float, int]:
        return (load.use if load else {}).get(name, (services[name].cpu, services[name].memory))

    def weight(name: str) -> float:
        cpu, memory = use(name)
        return cpu if "cpu" in pressed else float(memory)

    chosen = [n for n, rank in verdict.ranks.items()
              if rank < PROTECTED and not services[n].meta and states.get(n) in ("running", "paused")
              and n not in askers and n not in needed]
    for name in sorted(chosen, key=lambda n: (verdict.ranks[n], -weight(n), n)):
        gone = set(verdict.wanted) - set(wanted(desired.catalog, verdict.requests, {*barred, name}))
        if not any(services[n].protected for n in gone):
            uses = [use(n) for n in gone if states.get(n) == "running"]
            return name, sum(u[0] for u in uses), sum(u[1] for u in uses)
    return None
