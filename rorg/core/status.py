"""The status of each service: sync, health, and conditions with reasons. There is no phase: as in Kubernetes, several
conditions can hold at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any

from rorg.core.conditions import CAUTIONS, Condition, occasional, reconciling, requested, runs_once, stalled
from rorg.core.health import health_of, is_synced, kept_out
from rorg.core.links import Remote
from rorg.core.observed import PROCESS_GONE, Container
from rorg.core.operations import Stop
from rorg.core.plan import Action, Plan, printed
from rorg.core.situation import Situation
from rorg.core.wanted import Cause, Link, chain
from rorg.model.catalog import Service
from rorg.model.codes import IMAGE, NO_IMAGE, REMOVAL, VANISHED
from rorg.model.health import Health

STOPPING = "stopping"
SILENT = "EngineSilent"
"""Condition reason while the engine does not answer."""


@dataclass(frozen=True, slots=True)
class Status:
    """The status of one service."""

    service: str
    state: str
    """The engine's last known word for its container; `stopping` while a stop is under way, `none` without a container,
    `unknown` before the engine has answered, `meta` for a meta-service."""
    sync: str
    """Synced, OutOfSync or Unknown: whether its container is as its manifest declares it."""
    health: Health
    wanted: bool
    """It must be active now."""
    why: str
    """Who wants it, even if it is kept out; otherwise what keeps it idle."""
    conditions: tuple[Condition, ...] = ()
    container: str = ""
    incarnation: str = ""
    started_at: str = ""
    exits: int = 0
    pid: int = 0
    crashes: int = 0
    """Unexpected ends since rorg began."""
    effective_priority: int = 0
    """How much it matters now: its own priority or that of what wants it."""
    held: str = ""
    """Why a person holds it."""
    lowered: bool = False
    """It leaves the CPU to others because of pressure."""
    ros_nodes: tuple[str, ...] = ()
    """ROS nodes that it runs: that of its readiness probe, its managed ones, and those in its label `ros_nodes`."""
    withheld: str = ""
    """Why it stays although it is no longer declared."""
    driver: bool = False
    """It moves hardware."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """From its manifest."""
    machine: str = ""
    """The computer that it belongs to, if the robot has several."""
    chain: tuple[Link, ...] = ()
    """Who wants it, from the service to a root, even if it is kept out; empty if nothing does."""
    rivals: tuple[str, ...] = ()
    """Active services that have what it waits for."""

    def condition(self, kind: str) -> Condition:
        """Return the condition of this type, or one with status Unknown."""
        return next((c for c in self.conditions if c.type == kind), Condition(kind, "Unknown", ""))

    @property
    def update_failed(self) -> str:
        """Why its last change did not come up; "" if none failed."""
        return next((c.message for c in self.conditions if c.type == "Updated" and c.status == "False"), "")

    @property
    def cautions(self) -> list[str]:
        """Risks while nothing is wrong: effects of pausing it, and node names taken over by another service."""
        return [c.message for c in self.conditions if c.type in CAUTIONS and c.status == "False"]

    @property
    def trouble(self) -> str:
        """What keeps it from being as wanted: probe failure, exit, failed action and its next attempt, a change that
        waits; otherwise a container that the engine does not remove; "" if there is nothing."""
        failed, ready = self.update_failed, self.condition("Ready")
        if ready.reason == SILENT:  # shown once for all services
            return ""
        if failed:
            return f"its change failed: {failed}"
        well = ready.status == "True" and self.health not in (Health.PROGRESSING, Health.DEGRADED)
        waits = self.condition("Reconciling")
        if well and self.sync == "OutOfSync" and waits.status == "False":
            return waits.message or self.condition("Updated").message  # a change that is not made yet, or on trial
        if well or not (self.wanted or self.health.kept_out):
            return self.condition("Cleared").message
        return waits.message or ready.message

    def as_json(self) -> dict[str, Any]:
        plain = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "chain"}
        plain |= {"health": str(self.health), "rivals": list(self.rivals)}
        conditions = [asdict(condition) for condition in self.conditions]
        return {**plain, "message": self.trouble, "ros_nodes": list(self.ros_nodes), "conditions": conditions}


class Statuses(Mapping[str, Status]):
    """The status of every declared service, and of those that are withheld. Each is found when it is first asked for:
    most questions are about a few services. `holds` comes from the decision."""

    def __init__(self, situation: Situation, plan: Plan, holds: Mapping[str, str]) -> None:
        services = situation.desired.catalog.services
        gone = (n for n in situation.withheld if n not in services and situation.observed.current(n))
        self._names = dict.fromkeys((*sorted(services), *gone))
        self._services, self._assessed = services, _Assessed(situation, plan, holds)
        self._found: dict[str, Status] = {}

    def __getitem__(self, name: str) -> Status:
        if name not in self._names:
            raise KeyError(name)
        if (found := self._found.get(name)) is None:
            found = self._found[name] = self._find(name)
        return found

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def _find(self, name: str) -> Status:
        situation = self._assessed.s
        why = situation.withheld.get(name)
        if name in self._services:
            status = self._assessed.status(self._services[name])
            return replace(status, withheld=why, why=f"withheld: {why}") if why else status
        current = situation.observed.current(name)  # its manifest is gone, so nothing else is known
        state = self._assessed.state(name, current)
        gone = Status(name, state, "OutOfSync", Health.UNKNOWN, False, f"withheld: {why}", withheld=why or "")
        return replace(gone, container=current.id, started_at=current.started_at) if current else gone


class _Assessed:
    """Finds the status of services in one situation."""

    def __init__(self, situation: Situation, plan: Plan, holds: Mapping[str, str]) -> None:
        self.s, self.holds = situation, holds
        self.not_removed = {name: reasons[-1] for name, reasons in plan.reasons(REMOVAL).items()}
        self.waiting = {w.service: printed(w.reason, plan.now) for w in plan.waitings if w.code != REMOVAL}
        self.images = {w.service: w.code for w in plan.waitings if w.code in (IMAGE, NO_IMAGE)}
        """Services that wait for an image, with the code."""
        self.actions: dict[str, list[Action]] = {}
        """Service -> the action under way and those in the plan."""
        for action in (*(flight.action for flight in situation.memory.in_flight.values()), *plan.actions):
            self.actions.setdefault(action.service, []).append(action)

    def status(self, service: Service) -> Status:
        name, wanted = service.name, service.name in self.s.wanted
        asked = self.s.asked if name in self.s.preempted else self.s.wanted
        links = tuple(Link(s, c) for s, c in reversed(chain(asked, name)))
        held, waiting = self.holds.get(name, ""), self.waiting.get(name, "")
        why = _causes(asked.get(name, ())) or held or self.s.preempted.get(name, "")
        if service.meta:
            return Status(name, "meta", "Synced", Health.HEALTHY, True, why, labels=service.labels, chain=links)
        if service.away:
            return self.away(service, why, links)
        progress, known, current = self.s.memory.of(name), self.s.observed.complete, self.s.observed.current(name)
        ready, reason, message = self.readiness(service, current)
        conditions = (
            Condition("Ready", "Unknown" if not known else str(ready), reason, message),
            requested(links),
            reconciling(self.actions.get(name, ()), waiting),
            Condition("Stalled", str(progress.stalled), stalled(progress), progress.error),
            *occasional(self.s, service, self.not_removed.get(name, "")),
        )
        status = Status(
            name,
            self.state(name, current),
            "Unknown" if not known else "Synced" if is_synced(self.s, service, current) else "OutOfSync",
            health_of(self.s, name, ready, reason, self.images.get(name)) if known else Health.UNKNOWN,
            wanted,
            why,
            conditions,
            exits=progress.exits,
            crashes=progress.crashes,
            effective_priority=self.s.priorities.get(name, service.priority),
            held=held,
            lowered=name in self.s.measures.lowered,
            ros_nodes=ros_nodes(service),
            driver=service.driver,
            labels=service.labels,
            machine=service.machine,
            chain=links,
            rivals=self.s.rivals.get(name, ()),
        )
        return status if current is None else _with_container(status, current)

    def state(self, name: str, current: Container | None) -> str:
        """Return the state of a service's container. Engines call it running while it stops."""
        if current is None:
            return "none" if self.s.observed.complete else "unknown"
        flight = self.s.memory.in_flight.get(name)
        operation = flight.action.operation if flight else None
        ends = isinstance(operation, Stop) and operation.container == current.id and current.alive
        return STOPPING if ends else current.state

    def away(self, service: Service, why: str, links: tuple[Link, ...]) -> Status:
        """Return the status of another machine's service, as that one told."""
        name, there = service.name, self.s.peers.remotes.get(service.name)
        unready = self.s.peers.trouble(service)
        known = "Unknown" if there is None else str(not unready)
        conditions = (
            Condition("Ready", known, "NoAnswer" if there is None else "Ready" if not unready else "NotReady", unready),
            requested(links),
            *runs_once(self.s, service),
        )
        there = there or Remote("unknown", False, False, Health.UNKNOWN, "Unknown")
        return Status(
            name,
            there.state,
            there.sync,
            Health(there.health) if there.health in list(Health) else Health.UNKNOWN,
            service.name in self.s.wanted,
            why,
            conditions,
            incarnation=there.incarnation,
            started_at=there.incarnation.partition("@")[2],
            effective_priority=self.s.priorities.get(name, service.priority),
            driver=service.driver,
            labels=service.labels,
            machine=service.machine,
            chain=links,
        )

    def ending(self, name: str, current: Container | None) -> str:
        """Return why the current run is about to end; "" if it goes on."""
        actions = self.actions.get(name, [])
        if self.s.suspended:  # then only a call under way goes on
            actions = actions[: name in self.s.memory.in_flight]
        for action in actions:
            if current is not None and action.ends_run(current.incarnation):
                return f"{action.verb}: {action.reason}"
        asked = self.s.restarts.get(name)
        return "restart requested" if current is not None and asked == current.incarnation else ""

    def readiness(self, service: Service, current: Container | None) -> tuple[bool, str, str]:
        """Return whether a service is ready, with reason and message."""
        situation, name, waiting = self.s, service.name, self.waiting.get(service.name, "")
        progress = situation.memory.of(name)
        if situation.observed.silence:
            return False, SILENT, str(situation.observed.silence)
        if out := kept_out(situation, name):
            return False, out, situation.preempted[name]
        if progress.ready:
            ending = self.ending(name, current)
            return (False, "Ending", ending) if ending else (True, "Ready", "")
        if name in situation.unplugged and not (current is not None and current.active):
            return False, "NoDevice", situation.unplugged[name]
        if current is None:
            return False, "NoContainer", waiting or progress.error
        failed = "OutOfMemory" if current.oom_killed else "Failed"
        if current.state == "exited" and progress.exited == current.incarnation and not waiting:
            if situation.completed(name):
                return True, "Completed", "it ended with exit code 0"
            return False, failed, progress.error
        if current.vanished:
            return False, VANISHED, PROCESS_GONE
        if progress.doubted_since is not None:
            return False, "Ending", "rorg was ended while stopping it"
        if current.state == "running" and progress.running_since is not None:
            ran = situation.now - progress.running_since
            ready = situation.with_probes_in_force(name).ready
            late = ready is not None and ran > ready.timeout
            return False, "Late" if late else "Probing", progress.probe
        if progress.error and progress.exits:
            return False, failed, progress.error
        return False, current.state.capitalize(), waiting or progress.error or current.error


def _causes(causes: Sequence[Cause]) -> str:
    more = f" and {len(causes) - 1} more" if len(causes) > 1 else ""
    return f"{causes[0]}{more}" if causes else ""


def _with_container(status: Status, current: Container) -> Status:
    run = current.incarnation if current.alive else ""
    return replace(status, container=current.id, incarnation=run, started_at=current.started_at, pid=current.pid)


def ros_nodes(service: Service) -> tuple[str, ...]:
    """Return the names of its ROS nodes, as far as declared."""
    asked = service.ready.questions if service.ready else ()
    ready = [str(probe.target) for probe in asked if probe.kind == "ros_node"]
    return tuple(dict.fromkeys([*ready, *service.managed, *service.labels.get("ros_nodes", "").split()]))
