"""Events of services: what live requests lose, with the cause as a stable word for clients to act on; and changes of
state, for the journal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.memory import Progress
from rorg.core.observed import Container
from rorg.core.operations import Create
from rorg.core.plan import Action, Part
from rorg.core.wanted import chain
from rorg.model.graph import closure


@dataclass(frozen=True, slots=True)
class Loss:
    """A service used by live requests that is no longer ready."""

    service: str
    cause: str
    """held, shed, preempted, replaced, restarted, crashed, hung, unready, unreachable or ceased."""
    reason: str
    incarnation: str
    """The run that was ready."""
    requests: tuple[str, ...]
    """REQUESTER/ID of the requests that use it directly or by need."""


def ready_runs(decision: Decision) -> dict[str, str]:
    """Return runs that requests rely on and that no action is about to end."""
    memory, ending, known = decision.memory, _ending(decision), decision.situation.peers
    there = {n: r.incarnation for n, r in known.remotes.items() if r.ready and n in decision.situation.wanted}
    return there | {
        name: run for name in decision.situation.wanted if (run := memory.of(name).relied_on) and name not in ending
    }


def losses(before: Mapping[str, str], now: Mapping[str, str], decision: Decision) -> list[Loss]:
    """Return what is in `before` and no longer in `now`, if a live request uses it."""
    ended = {name: run for name, run in before.items() if now.get(name) != run}
    if not ended:
        return []
    catalog, wanted = decision.situation.desired.catalog, decision.situation.wanted
    ending = _ending(decision)
    holders: dict[str, list[str]] = {name: [] for name in ended}
    for request in (*catalog.requests, *decision.settled.requests):
        if request.requester in wanted:
            members = [m for s in request.services for m in catalog.members(s)]
            # A service that is no longer declared has no members, but its loss counts too.
            for name in ended.keys() & {*request.services, *closure(catalog.services, members)}:
                holders[name].append(f"{request.requester}/{request.id}")
    lost = []
    for name, requests in holders.items():
        if requests:
            cause, reason = _cause(decision, name, ended[name], ending.get(name))
            lost.append(Loss(name, cause, reason, ended[name], tuple(requests)))
    return lost


def _ending(decision: Decision) -> dict[str, Action | None]:
    """Return services whose run rorg is about to end -> the action, if there is one already. A run goes on at least
    until its next container is there, which the engine may be unable to make."""
    restarting: dict[str, Action | None] = dict.fromkeys(
        n for n, run in decision.situation.restarts.items() if run == decision.memory.of(n).incarnation
    )
    planned = () if decision.situation.suspended or decision.violations else decision.plan.actions
    under_way = [flight.action for flight in decision.memory.in_flight.values()]
    actions = (*planned, *under_way)
    to_be_made = {a.service for a in actions if isinstance(a.operation, Create)}
    return restarting | {
        a.service: a
        for a in actions
        if a.service not in to_be_made and a.ends_run(decision.memory.of(a.service).incarnation)
    }


def _cause(decision: Decision, name: str, run: str, action: Action | None) -> tuple[str, str]:
    situation, progress = decision.situation, decision.memory.of(name)
    if name not in situation.wanted:
        services = situation.desired.catalog.services
        # Either it is preempted itself, or the service that needs it is.
        first = next(
            (n for n in (name, *situation.preempted) if n in situation.preempted and name in closure(services, [n])), ""
        )
        if first:
            return _exclusion(decision, first), situation.preempted[first]
        return "ceased", "it is no longer wanted"
    if name in situation.peers.unknown:
        return "unreachable", f"it {situation.peers.unknown[name]}"
    if name in situation.peers.remotes:
        return "unready", f"it {situation.peers.trouble(situation.desired.catalog.services[name]) or 'runs anew'}"
    if action is not None and action.part_of and run != progress.hung:
        return ("replaced" if action.part_of is Part.REPLACE else "restarted"), action.reason
    if name in situation.restarts:
        return "restarted", "a restart was requested"
    return _by_itself(progress, run, action, situation.observed.current(name))


def _by_itself(progress: Progress, run: str, action: Action | None, current: Container | None) -> tuple[str, str]:
    if run == progress.exited and not progress.error:
        return "ceased", "it ended with exit code 0"
    if run in (progress.exited, progress.hung):
        return ("hung" if run == progress.hung else "crashed"), progress.error
    if action is not None:
        return "ceased", action.reason
    if not progress.incarnation and current is not None and current.ended and current.incarnation == run:
        return "crashed" if current.exit_code else "ceased", "it ended while no rorg ran"
    if progress.incarnation not in ("", run):
        return "restarted", "another run has begun"
    if progress.running_since is not None:
        return "unready", progress.probe or "its probe failed"
    return "ceased", "it no longer runs"


def _exclusion(decision: Decision, name: str) -> str:
    """Return why a service is preempted: it or one of its needs is held or shed; otherwise others have priority."""
    names = closure(decision.situation.desired.catalog.services, [name])
    if names & set(decision.holds):
        return "held"
    return "shed" if names & {s.service for s in decision.memory.pressure.shed} else "preempted"


NONE, READY = "none", "ready"
"""No container; running and ready. Every other state is the engine's word."""


@dataclass(frozen=True, slots=True)
class StateChange:
    """A service has entered another state."""

    service: str
    state: str
    reason: str
    """Why it is wanted, how its run ended, or what prevents it."""
    requests: tuple[str, ...] = ()
    """REQUESTER/ID of the requests that lead to it, from the root on."""
    failed: bool = False
    """Whether it ended on its own with an error."""

    def __str__(self) -> str:
        said = "has no container" if self.state == NONE else f"is {self.state}"
        return f"{self.service} {said}" + (f" ({self.reason})" if self.reason else "")


def state_of(decision: Decision, name: str) -> str:
    """Return the state of a service's current container on this machine."""
    containers = decision.situation.observed.by_service().get(name)
    if not containers:
        return NONE
    return READY if containers[0].active and decision.memory.of(name).ready else containers[0].state


def state_changes(before: Mapping[str, str], decision: Decision) -> list[StateChange]:
    """Return state changes among services that were planned in this pass."""
    services = decision.situation.desired.catalog.services
    names = {*services, *before} if decision.planned.whole else decision.planned.replanned
    return [
        _state_change(decision, name, now)
        for name in sorted(names)
        if (now := state_of(decision, name)) != before.get(name, NONE)
    ]


def _state_change(decision: Decision, name: str, now: str) -> StateChange:
    situation, progress = decision.situation, decision.memory.of(name)
    causes = situation.wanted.get(name, ())
    current = situation.observed.current(name)
    if causes and now == "exited" and current and progress.exited == current.incarnation:
        return StateChange(name, now, progress.error, failed=bool(progress.error))
    trail = [cause for _, cause in chain(situation.wanted, name)]
    requests = tuple(f"{cause.by}/{cause.request}" for cause in trail if cause.kind == "requested")
    if causes:
        return StateChange(name, now, str(causes[0]), requests)
    return StateChange(name, now, decision.holds.get(name) or situation.preempted.get(name) or "not wanted")
