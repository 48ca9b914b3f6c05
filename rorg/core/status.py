"""How each service is: SYNC and HEALTH, and conditions with reasons. No phase."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rorg.core.conditions import CAUTIONS, Condition, occasional, requested, stalled
from rorg.core.observed import Container
from rorg.core.operations import Create, Rename
from rorg.core.plan import Action, Part, Plan
from rorg.core.situation import Situation
from rorg.core.wanted import Link, chain
from rorg.model.catalog import Service

SILENT = "EngineSilent"
"""Reason of a condition while the engine does not answer."""


@dataclass(frozen=True, slots=True)
class Status:
    """How one service is."""

    service: str
    state: str
    """The engine's word for its container, as it was seen last. `none` without one, `unknown` before the engine has
    answered, `meta` for a meta-service."""
    sync: str
    """Synced, OutOfSync or Unknown."""
    health: str
    """Healthy, Progressing, Degraded, Idle, Completed or Unknown."""
    wanted: bool
    why: str
    conditions: tuple[Condition, ...] = ()
    container: str = ""
    incarnation: str = ""
    started_at: str = ""
    exits: int = 0
    pid: int = 0
    crashes: int = 0
    """Unexpected ends since rorg runs."""
    effective_priority: int = 0
    """How much it matters now: its priority, or that of what wants it."""
    held: str = ""
    """Why a person keeps it from being active."""
    lowered: bool = False
    """It leaves the CPU to others, because of pressure."""
    ros_nodes: tuple[str, ...] = ()
    """ROS nodes that it runs: that of its readiness, and those in its label `ros_nodes`."""
    withheld: str = ""
    """Why it stays though no manifest declares it."""
    driver: bool = False
    """It moves hardware."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Of its manifest."""
    chain: tuple[Link, ...] = ()
    """Why it is wanted: from it to a root. Empty when it is not."""

    def condition(self, kind: str) -> Condition:
        """Its condition of this type; "Unknown" for one that it does not have."""
        return next((c for c in self.conditions if c.type == kind), Condition(kind, "Unknown", ""))

    @property
    def update_failed(self) -> str:
        """Why its last change did not come up; empty where none failed."""
        return next((c.message for c in self.conditions if c.type == "Updated" and c.status == "False"), "")

    @property
    def cautions(self) -> list[str]:
        """What to know of it though it is as it is wanted: what pausing it does, and which nodes of it another service
        has."""
        return [c.message for c in self.conditions if c.type in CAUTIONS and c.status == "False"]

    @property
    def trouble(self) -> str:
        """What keeps it from being as it is wanted: what its probe found, how it ended, what failed and when that is
        tried again. Empty where nothing does."""
        failed, ready = self.update_failed, self.condition("Ready")
        if ready.reason == SILENT:  # said once, of all services
            return ""
        if failed or not self.wanted or ready.status == "True":
            return f"its change failed: {failed}" if failed else ""
        return self.condition("Reconciling").message or ready.message

    def as_json(self) -> dict[str, Any]:
        return {
            "service": self.service,
            "state": self.state,
            "sync": self.sync,
            "health": self.health,
            "wanted": self.wanted,
            "why": self.why,
            "message": self.trouble,
            "container": self.container,
            "incarnation": self.incarnation,
            "started_at": self.started_at,
            "exits": self.exits,
            "pid": self.pid,
            "crashes": self.crashes,
            "effective_priority": self.effective_priority,
            "held": self.held,
            "lowered": self.lowered,
            "ros_nodes": list(self.ros_nodes),
            "withheld": self.withheld,
            "driver": self.driver,
            "labels": dict(self.labels),
            "conditions": [
                {"type": c.type, "status": c.status, "reason": c.reason, "message": c.message} for c in self.conditions
            ],
        }


def statuses(
    situation: Situation, plan: Plan, holds: Mapping[str, str] | None = None, only: Collection[str] | None = None
) -> dict[str, Status]:
    """Of every declared service, or `only` of these, by name. `holds` are those of the decision."""
    containers = situation.observed.by_service()
    pending = {a.service: a.verb for a in reversed(plan.actions)}
    waiting = {w.service: w.reason for w in plan.waitings}
    actions: dict[str, list[Action]] = {}
    for action in plan.actions:
        actions.setdefault(action.service, []).append(action)
    pending |= {name: flight.action.verb for name, flight in situation.memory.in_flight.items()}
    found = {
        name: _status(
            situation,
            service,
            next(iter(containers.get(name, ())), None),
            pending.get(name, ""),
            waiting.get(name, ""),
            (holds or {}).get(name, ""),
            actions.get(name, []),
        )
        for name, service in sorted(situation.desired.catalog.services.items())
        if only is None or name in only
    }
    for name, why in situation.withheld.items():
        if name in found:
            found[name] = replace(found[name], withheld=why, why=f"withheld: {why}")
        elif name in containers:  # nothing else is known of it
            current = containers[name][0]
            found[name] = Status(
                name,
                current.state,
                "OutOfSync",
                "Unknown",
                False,
                f"withheld: {why}",
                container=current.id,
                started_at=current.started_at,
                withheld=why,
            )
    return found


def _status(
    situation: Situation,
    service: Service,
    current: Container | None,
    pending: str,
    waiting: str,
    held: str,
    actions: Sequence[Action],
) -> Status:
    name = service.name
    causes = situation.wanted.get(name, ())
    links = tuple(Link(s, c) for s, c in reversed(chain(situation.wanted, name)))
    why = str(causes[0]) + (f" and {len(causes) - 1} more" if len(causes) > 1 else "") if causes else ""
    why = why or held or situation.preempted.get(name, "")
    if service.meta:
        return Status(name, "meta", "Synced", "Healthy", True, why, labels=service.labels, chain=links)
    step, known = situation.memory.of(name), situation.observed.complete
    ready, reason, message = _readiness(situation, service, current, waiting, actions)
    sync = "Unknown" if not known else "OutOfSync" if pending or waiting else "Synced"
    conditions = (
        Condition("Ready", "Unknown" if not known else str(ready), reason, message),
        requested(links),
        Condition("Reconciling", str(bool(pending)), pending.capitalize() or "Settled", waiting),
        Condition("Stalled", str(step.stalled), stalled(step), step.error),
        *occasional(situation, service),
    )
    health = _health(bool(causes), ready, reason, step.stalled) if known else "Unknown"
    return Status(
        name,
        current.state if current else "none" if known else "unknown",
        sync,
        health,
        bool(causes),
        why,
        conditions,
        current.id if current else "",
        current.incarnation if current and current.alive else "",
        current.started_at if current else "",
        step.exits,
        current.pid if current else 0,
        step.crashes,
        situation.priorities.get(name, service.priority),
        held,
        name in situation.lowered,
        ros_nodes(service),
        driver=service.driver,
        labels=service.labels,
        chain=links,
    )


def ros_nodes(service: Service) -> tuple[str, ...]:
    """Names of the ROS nodes that it runs, as far as they are declared."""
    asked = service.ready.questions if service.ready else ()
    ready = [str(probe.target) for probe in asked if probe.kind == "ros_node"]
    return tuple(dict.fromkeys([*ready, *service.labels.get("ros_nodes", "").split()]))


def _health(is_wanted: bool, ready: bool, reason: str, stalled: bool) -> str:
    if not is_wanted:
        return "Idle"
    if ready:
        return "Completed" if reason == "Completed" else "Healthy"
    return "Degraded" if stalled or reason in ("Late", "Failed", "OutOfMemory", "NoDevice") else "Progressing"


def ends(action: Action, run: str) -> bool:
    """Whether a run (an incarnation) of the action's service does not go on after it. Where a container takes another
    one's place, that one's run is over from the first call on: while one is under way, nothing else is planned."""
    if action.part_of is Part.REPLACE and isinstance(action.operation, (Create, Rename)):
        return True
    return action.operation.ends and action.container[:12] == run.partition("@")[0]


def _ending(situation: Situation, service: Service, current: Container | None, actions: Sequence[Action]) -> str:
    """Why the run of now is about to end, though it answers still; empty when it goes on."""
    flight = situation.memory.in_flight.get(service.name)
    planned = () if situation.suspended else actions
    for action in (*([flight.action] if flight else []), *planned):
        if current is not None and ends(action, current.incarnation):
            return f"{action.verb}: {action.reason}"
    asked = situation.restarts.get(service.name)
    return "restart requested" if current is not None and asked == current.incarnation else ""


def _readiness(
    situation: Situation, service: Service, current: Container | None, waiting: str, actions: Sequence[Action]
) -> tuple[bool, str, str]:
    step = situation.memory.of(service.name)
    if situation.observed.silence:
        return False, SILENT, str(situation.observed.silence)
    if step.ready:
        ending = _ending(situation, service, current, actions)
        return (False, "Ending", ending) if ending else (True, "Ready", "")
    if service.name in situation.unplugged and not (current is not None and current.active):
        return False, "NoDevice", situation.unplugged[service.name]
    if current is None:
        return False, "NoContainer", waiting or step.error
    if current.state == "exited" and step.exited == current.incarnation and not waiting:
        if current.exit_code == 0 and step.over(service, current):
            return True, "Completed", "it ended with exit code 0"
        return False, "OutOfMemory" if current.oom_killed else "Failed", step.error
    if step.doubted_since is not None:
        return False, "Ending", "it was being stopped when rorg was"
    if current.state == "running" and step.running_since is not None:
        ran = situation.now - step.running_since
        late = service.ready is not None and ran > service.ready.timeout
        return False, "Late" if late else "Probing", step.probe
    if step.error and step.exits:
        return False, "Failed", step.error
    return False, current.state.capitalize(), waiting or step.error
