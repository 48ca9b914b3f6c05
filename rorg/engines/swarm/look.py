"""One look at the Swarm: its services, their tasks and its nodes, as containers.

A *container* of rorg is one spec of a Swarm service. The service has the spec of the current container; the specs of
others wait in Swarm configs ("parked"), such as the previous one, which is kept until the new one is proven. Starting
a container updates the service to its spec. So the planner's rules hold here too, and Swarm's own rolling update makes
the change.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rorg.core.diff import REPLICAS
from rorg.core.digest import declared_of
from rorg.core.observed import LABEL_DECLARED, LABEL_OWNER, LABEL_SERVICE, Container, from_labels
from rorg.engines.swarm.body import CONTAINER
from rorg.model.options import LIVE

STARTED, ENDED = "rorg.io/started", "rorg.io/exit-code"
"""Labels about the last run of a container that does not run: the Swarm forgets its tasks."""
NAMED = "rorg.io/name"
"""The label of a parked container with the name that it was created with."""
PARKED = "rorg.io/parked"
"""The label of a config that holds a parked spec; its value is the owner."""
OVER = ("complete", "shutdown", "failed", "rejected", "orphaned", "remove")
"""States of a task that has ended."""
BEGUN = ("starting", "running")
"""States of a task that may have a process."""
FAILED = ("failed", "rejected", "complete")
"""States of a task that ended on its own."""
NOT_BEGUN = 125
"""The exit code of what could not begin, as of `docker run`."""
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Parked:
    """A spec that waits in a config."""

    config: str
    """Id of the config."""
    spec: Mapping[str, Any]
    created_at: str
    """When it was parked. One that a later run took the place of again was started before that."""


@dataclass(frozen=True, slots=True)
class Task:
    """One attempt of the Swarm to run a service."""

    id: str
    service: str
    container: str
    """Id of the container whose spec it runs."""
    state: str
    desired: str
    created_at: str
    node: str
    error: str = ""
    exit_code: int | None = None

    @property
    def wanted(self) -> bool:
        """Whether the Swarm wants it to run; `ready` is one that waits for its turn."""
        return self.desired in ("running", "ready")


@dataclass(frozen=True, slots=True)
class Look:
    """The findings of one look."""

    began: float
    """When it began (monotonic)."""
    services: tuple[Row, ...] = ()
    parked: Mapping[str, Parked] = field(default_factory=dict)
    """By container."""
    tasks: Mapping[str, tuple[Task, ...]] = field(default_factory=dict)
    """By Swarm service, oldest first."""
    nodes: Mapping[str, Row] = field(default_factory=dict)

    def service_of(self, container: str) -> Row | None:
        """Return the Swarm service whose current spec this is."""
        return next((s for s in self.services if labels_of(s["Spec"]).get(CONTAINER) == container), None)

    def services_named(self, service: str) -> list[Row]:
        """Return the Swarm services of one service of rorg's: more than one while its name changes."""
        return [s for s in self.services if labels_of(s["Spec"]).get(LABEL_SERVICE) == service]

    def container(self, id: str) -> Container | None:
        service = self.service_of(id)
        if service is not None:
            return self._current(service)
        return _parked(id, self.parked[id]) if id in self.parked else None

    def containers(self) -> list[Container]:
        current = [self._current(service) for service in self.services]
        known = {c.id for c in current}
        return [*current, *(_parked(i, p) for i, p in self.parked.items() if i not in known)]

    def settling(self) -> bool:
        """Return whether a task is about to begin or end."""
        return any(t.wanted != (t.state == "running") for tasks in self.tasks.values() for t in tasks if not over(t))

    def down(self, node: str) -> bool:
        return bool(node) and self.nodes.get(node, {}).get("Status", {}).get("State") == "down"

    def alive(self, service: Row) -> list[Task]:
        """Return its tasks that run, or are about to begin or end, on nodes that answer."""
        return [t for t in self.tasks.get(service["ID"], ()) if not over(t) and not self.down(t.node)]

    def _current(self, service: Row) -> Container:
        spec, labels = service["Spec"], labels_of(service["Spec"])
        mine = [t for t in self.tasks.get(service["ID"], ()) if t.container == labels.get(CONTAINER)]
        if replicas_of(spec):
            since = [t for t in mine if not over(t) or t.created_at >= service["UpdatedAt"]]
            state, task = self._wanted(since, spec["TaskTemplate"].get("RestartPolicy") or {})
        else:
            task = next((t for t in self.alive(service) if t in mine and t.state in BEGUN), None)
            state = "running" if task else "exited" if STARTED in labels else "created"
        node = self.nodes.get(task.node, {}) if task else {}
        return Container(
            id=labels.get(CONTAINER, service["ID"]),
            name=spec["Name"],
            state=state,
            started_at=task.created_at if task else labels.get(STARTED, ""),
            exit_code=task.exit_code if task else _exit_code(labels) if state == "exited" else None,
            error=self._error(mine, task),
            created_at=service["CreatedAt"],
            live={**live_of(labels), REPLICAS: max(1, replicas_of(spec))},
            networks=dict.fromkeys(declared_of(labels.get(LABEL_DECLARED, "")).get("networks") or (), ""),
            health="healthy" if state == "running" and _has_check(spec) else "",
            node=str(node.get("Description", {}).get("Hostname", "")),
            address=str(node.get("Status", {}).get("Addr", "")),
            **from_labels(labels),
        )

    def _wanted(self, tasks: Sequence[Task], policy: Row) -> tuple[str, Task | None]:
        """Return the state of a container that is to run, and the task that tells it. `tasks` are those since it was
        started. After its program has ended it is `restarting` with the exit code until the Swarm's next task runs,
        if its `policy` makes one; while a node is lost, it is `restarting` until another one runs it."""
        alive = [t for t in tasks if not over(t) and not self.down(t.node) and t.wanted]
        for task in reversed(alive):
            if task.state == "running":
                return "running", task
        failed = [t for t in tasks if t.state in FAILED]
        lost = [t for t in tasks if not over(t) and self.down(t.node)]
        if not failed or (lost and lost[-1].created_at > failed[-1].created_at):
            return "restarting", alive[-1] if alive else None
        again = {"any": True, "on-failure": failed[-1].state != "complete"}.get(policy.get("Condition", "any"), False)
        return "restarting" if again else "exited", failed[-1]

    def _error(self, tasks: Sequence[Task], task: Task | None) -> str:
        """Return what people should know of it, in the Swarm's words where it has any."""
        lost = [t for t in tasks if not over(t) and self.down(t.node)]
        if lost and task and task.state == "running":
            name = self.nodes[lost[-1].node].get("Description", {}).get("Hostname", lost[-1].node)
            return f"it may run a second time on {name}, which does not answer"
        return task.error if task and task.state != "running" else ""


def over(task: Task) -> bool:
    """Return whether a task has ended."""
    return task.state in OVER


def labels_of(spec: Row) -> Mapping[str, str]:
    """Return the labels of a service's spec."""
    return spec.get("Labels") or {}


def replicas_of(spec: Row) -> int:
    """Return how many tasks a service is to have: 0 or 1, unless a person has scaled it."""
    return int((spec.get("Mode", {}).get("Replicated") or {}).get("Replicas") or 0)


def live_of(labels: Mapping[str, str]) -> Mapping[str, Any]:
    """Return its live options: here they never change in place, so they are those that it was made with."""
    declared = declared_of(labels.get(LABEL_DECLARED, ""))
    return {name: value for name, value in declared.items() if name in LIVE and name != "container_name"}


def _has_check(spec: Row) -> bool:
    test: list[str] = (spec["TaskTemplate"]["ContainerSpec"].get("HealthCheck") or {}).get("Test") or []
    return bool(test) and test[0] != "NONE"


def _parked(id: str, parked: Parked) -> Container:
    labels = labels_of(parked.spec)
    started = labels.get(STARTED, "")
    return Container(
        id=id,
        name=labels.get(NAMED) or parked.spec["Name"],
        state="exited" if started else "created",
        started_at=started,
        exit_code=_exit_code(labels),
        created_at=parked.created_at,
        live=live_of(labels),
        **from_labels(labels),
    )


def _exit_code(labels: Mapping[str, str]) -> int | None:
    code = labels.get(ENDED, "")
    return int(code) if code.isdecimal() else None


def read_parked(configs: Iterable[Row]) -> dict[str, Parked]:
    """Read the specs that wait in configs. Configs that cannot be read are not ours."""
    parked: dict[str, Parked] = {}
    for config in configs:
        try:
            spec = json.loads(base64.b64decode(config["Spec"]["Data"]))
            parked[labels_of(spec)[CONTAINER]] = Parked(config["ID"], spec, config["CreatedAt"])
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            continue
    return parked


def read_tasks(rows: Iterable[Row]) -> dict[str, tuple[Task, ...]]:
    """Read tasks, by Swarm service, oldest first."""
    tasks: dict[str, list[Task]] = {}
    for row in sorted(rows, key=lambda row: (row["CreatedAt"], row["ID"])):
        status = row.get("Status") or {}
        ran = status.get("ContainerStatus") or {}
        code = ran.get("ExitCode") if ran.get("ContainerID") and status.get("State") != "rejected" else None
        task = Task(
            id=row["ID"],
            service=row["ServiceID"],
            container=(row["Spec"].get("ContainerSpec", {}).get("Labels") or {}).get(CONTAINER, ""),
            state=status.get("State", ""),
            desired=row.get("DesiredState", ""),
            created_at=row["CreatedAt"],
            node=row.get("NodeID", ""),
            error=status.get("Err") or "",
            exit_code=None if status.get("State") not in FAILED else NOT_BEGUN if code is None else code,
        )
        tasks.setdefault(task.service, []).append(task)
    return {service: tuple(found) for service, found in tasks.items()}


def owned(owner: str) -> dict[str, list[str]]:
    """The filter for what this owner has made."""
    return {"label": [f"{LABEL_OWNER}={owner}"]}
