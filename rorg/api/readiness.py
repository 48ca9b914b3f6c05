"""Whether services are ready, for a caller that waits for them or asks once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rorg.core.decide import Decision
from rorg.core.memory import Progress
from rorg.core.schedule import denied_since, told_since
from rorg.core.status import Status
from rorg.model.catalog import Service
from rorg.model.causes import causes
from rorg.model.codes import BLOCKED, NO_IMAGE
from rorg.model.graph import closure


@dataclass(frozen=True, slots=True, eq=False)
class Question:
    """A question about services, asked at `since` (clock of the loop) by a caller that knows of `generation`. If the
    caller `waits`, only answers of probes that were asked since then count; otherwise also recent ones."""

    names: tuple[str, ...]
    since: float
    generation: int
    waits: bool = True

    def since_of(self, service: Service) -> float:
        """From when on an answer of a service's probe counts."""
        interval = service.ready.interval if service.ready and not self.waits else 0.0
        return self.since - interval


@dataclass(frozen=True, slots=True)
class Ready:
    """Whether one service is ready, in which run; else why not, and whether waiting is hopeless."""

    ready: bool
    incarnation: str
    reason: str = ""
    hopeless: bool = False
    asking: bool = False
    """Only the answer of its probe is missing, which is being asked."""

    def as_json(self) -> dict[str, Any]:
        return {"ready": self.ready, "incarnation": self.incarnation, "reason": self.reason}


@dataclass(frozen=True, slots=True)
class Readiness:
    """The readiness of several services and all that they need."""

    services: Mapping[str, Ready]
    suspended: str = ""

    @property
    def ready(self) -> bool:
        return all(r.ready for r in self.services.values())

    @property
    def hopeless(self) -> bool:
        return not self.suspended and any(r.hopeless for r in self.services.values())

    @property
    def asking(self) -> bool:
        """Whether all that is missing are answers of probes that are being asked."""
        return any(r.asking for r in self.services.values())

    @property
    def reason(self) -> str:
        """The first reason why a service is not ready, with all services that have it; empty if all are ready."""
        reasons = causes((n, r.reason) for n, r in self.services.items() if not r.ready)
        return self.suspended or str(reasons[0]) if reasons else ""


def readiness(decision: Decision, statuses: Mapping[str, Status], question: Question) -> Readiness:
    """The readiness of the services asked for, then of what they need. A probe's answer from before the question counts
    only if the caller does not wait and the answer is younger than the probe's interval."""
    services = decision.situation.desired.catalog.services
    names = [n for n in question.names if n in services]
    closed = (*question.names, *sorted(closure(services, names) - set(question.names)))
    return Readiness(
        {name: _one(decision, statuses.get(name), question) for name in closed}, decision.situation.suspended
    )


def _one(decision: Decision, status: Status | None, question: Question) -> Ready:
    if status is None:
        return Ready(False, "", "is no longer declared", hopeless=True)
    name, situation = status.service, decision.situation
    ready = status.condition("Ready")
    if status.state == "meta":
        return Ready(True, "")
    if name in situation.desired.catalog.services and situation.desired.catalog.services[name].away:
        return _away(status, decision, question)
    if not situation.observed.complete:
        return Ready(False, status.incarnation, situation.observed.error or "the engine has not said yet what runs")
    if status.wanted and ready.status == "True":
        since = question.since_of(situation.desired.catalog.services[name])
        return _probed(situation.memory.of(name), since, status.incarnation, question.waits)
    waitings = [w for w in decision.plan.waitings if w.service == name]
    waiting = next(iter(decision.plan.reasons().get(name, ())), "")
    why = (
        status.held
        or situation.preempted.get(name)
        or (
            "nothing active requests it"
            if not status.wanted
            else waiting or ready.message or ready.reason or "not ready"
        )
    )
    # A new run of a service that kept crashing may do better than those before.
    tried = status.state == "running" and ready.reason != "Late"
    stalled = status.condition("Stalled").status == "True" and not tried
    settled = not waiting and status.condition("Reconciling").status == "False"
    over = status.wanted and settled and ready.reason in ("Failed", "OutOfMemory")
    missing = situation.memory.of(name).missing or any(w.code in (NO_IMAGE, BLOCKED) for w in waitings)
    failing = stalled or over or missing
    return Ready(False, status.incarnation, why, hopeless=failing or bool(status.held))


def _away(status: Status, decision: Decision, question: Question) -> Ready:
    """For a service of another machine: only what that one says about requests sent since the question counts for a
    caller that waits."""
    known, ready = decision.situation.peers, status.condition("Ready")
    since = known.said_at.get(status.machine)
    if question.waits and (since is None or since < question.since):
        return Ready(False, status.incarnation, ready.message or f"{status.machine} is being asked", asking=True)
    if not status.wanted:
        return Ready(False, status.incarnation, "nothing active requests it")
    return Ready(ready.status == "True", status.incarnation, ready.message)


def _probed(step: Progress, since: float, incarnation: str, waits: bool) -> Ready:
    """For a run that is ready as far as the loop knows: whether its probe has answered since."""
    told, denied = step.answered is None or told_since(step, since), denied_since(step, since)
    if told and (waits or not denied):
        return Ready(True, incarnation)
    reason = step.probe if denied else "its probe has not answered yet"
    return Ready(False, incarnation, reason, asking=not denied)
