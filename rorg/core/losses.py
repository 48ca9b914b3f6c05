"""What live requests lose: services that were ready, and are so no more; and why, as a stable word."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.memory import Progress
from rorg.core.plan import Action, Part
from rorg.core.status import ends
from rorg.model.graph import closure


@dataclass(frozen=True, slots=True)
class Loss:
    """A service of live requests that is ready no more."""

    service: str
    cause: str
    """held, shed, preempted, replaced, restarted, crashed, hung, unready or ceased."""
    reason: str
    incarnation: str
    """The run that was ready."""
    requests: tuple[str, ...]
    """REQUESTER/ID of those that name it, or something that needs it."""


def ready_runs(decision: Decision) -> dict[str, str]:
    """The runs that requests rely on, and that nothing is about to end."""
    memory, ending = decision.memory, _ending(decision)
    return {
        name: run for name in decision.situation.wanted if (run := memory.of(name).relied_on) and name not in ending
    }


def losses(before: Mapping[str, str], now: Mapping[str, str], decision: Decision) -> list[Loss]:
    """What was in `before` and is not in `now`, as far as a request that counts names it."""
    gone = {name: run for name, run in before.items() if now.get(name) != run}
    if not gone:
        return []
    catalog, wanted = decision.situation.desired.catalog, decision.situation.wanted
    ending = _ending(decision)
    holders: dict[str, list[str]] = {name: [] for name in gone}
    for request in (*catalog.requests, *decision.settled.requests):
        if request.requester in wanted:
            members = [m for s in request.services for m in catalog.members(s)]
            # What is not declared any more has no members, and is lost all the same.
            for name in gone.keys() & {*request.services, *closure(catalog.services, members)}:
                holders[name].append(f"{request.requester}/{request.id}")
    found = []
    for name, requests in holders.items():
        if requests:
            cause, reason = _cause(decision, name, gone[name], ending.get(name))
            found.append(Loss(name, cause, reason, gone[name], tuple(requests)))
    return found


def _ending(decision: Decision) -> dict[str, Action | None]:
    """Services whose run is about to end by what rorg does, each with the action where there is one yet."""
    found: dict[str, Action | None] = dict.fromkeys(
        n for n, run in decision.situation.restarts.items() if run == decision.memory.of(n).incarnation
    )
    planned = () if decision.situation.suspended or decision.violations else decision.plan.actions
    under_way = [flight.action for flight in decision.memory.in_flight.values()]
    return found | {a.service: a for a in (*planned, *under_way) if ends(a, decision.memory.of(a.service).incarnation)}


def _cause(decision: Decision, name: str, run: str, action: Action | None) -> tuple[str, str]:
    situation, step = decision.situation, decision.memory.of(name)
    if name not in situation.wanted:
        services = situation.desired.catalog.services
        # It is preempted itself, or what it is needed for does.
        first = next(
            (n for n in (name, *situation.preempted) if n in situation.preempted and name in closure(services, [n])), ""
        )
        if first:
            return _exclusion(decision, first), situation.preempted[first]
        return "ceased", "it is no longer wanted"
    if action is not None and action.part_of:
        return ("replaced" if action.part_of is Part.REPLACE else "restarted"), action.reason
    if name in situation.restarts:
        return "restarted", "a restart was requested"
    return _by_itself(step, run, action)


def _by_itself(step: Progress, run: str, action: Action | None) -> tuple[str, str]:
    if run in (step.exited, step.hung):
        return ("hung" if run == step.hung else "crashed"), step.error
    if action is not None:
        return "ceased", action.reason
    if step.incarnation not in ("", run):
        return "restarted", "another run has begun"
    if step.running_since is not None:
        return "unready", step.probe or "its probe says no"
    return "ceased", "it no longer runs"


def _exclusion(decision: Decision, name: str) -> str:
    """Why a service is preempted: it, or something that it needs, is held or was shed; else others go first."""
    names = closure(decision.situation.desired.catalog.services, [name])
    if names & set(decision.holds):
        return "held"
    return "shed" if names & {s.service for s in decision.memory.pressure.shed} else "preempted"
