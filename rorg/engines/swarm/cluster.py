"""What rorg asks of a Swarm, whichever of its managers answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import docker_errors
from rorg.engines.swarm.look import PARKED, Look, Row, owned, read_parked, read_tasks, replicas_of
from rorg.engines.swarm.managers import Managers

STATES = ("running", "ready", "accepted", "remove")
"""States that the Swarm desires of tasks that are not history. After a service is scaled down it is `remove`."""
T = TypeVar("T")


class Cluster:
    """One owner's part of a Swarm, from any thread."""

    def __init__(self, owner: str, managers: Sequence[str]) -> None:
        self.owner, self.managers = owner, Managers(managers)
        self._looking, self.last = threading.Lock(), Look(float("-inf"))

    def ask(self, what: str, call: Callable[[Client], T]) -> T:
        with docker_errors(what):
            return self.managers.ask(call)

    def nodes(self) -> list[dict[str, Any]]:
        with docker_errors("list the nodes of the Swarm"):
            return self.managers.nodes()

    def look(self) -> Look:
        """Return what a look has found that began after this call. Callers that wait together share one."""
        asked = time.monotonic()
        with self._looking:
            if self.last.began < asked:
                self.last = self._looked()
            return self.last

    def _looked(self) -> Look:
        began, nodes = time.monotonic(), {node["ID"]: node for node in self.nodes()}
        with docker_errors("list the services of the Swarm"):
            services = self.managers.ask(lambda c: c.get("/services", filters=owned(self.owner)))
            parked = {"label": [f"{PARKED}={self.owner}"]}
            configs = self.managers.ask(lambda c: c.get("/configs", filters=parked))
            tasks = self._tasks(services, [n for n, node in nodes.items() if node["Status"]["State"] == "down"])
        return Look(began, tuple(services), read_parked(configs), read_tasks(tasks), nodes)

    def _tasks(self, services: list[Row], down: list[str]) -> list[Row]:
        """Return the tasks that are to run, those that are about to end, those on nodes that are `down`; and how the
        others of services ended that are to run and do not. The Swarm keeps five of each service, so that all of them
        would be a megabyte each second."""

        def found(name: str, values: Sequence[str]) -> list[Row]:
            return self.managers.ask(lambda c: c.get("/tasks", filters={name: values})) if values else []

        tasks = {t["ID"]: t for t in [*found("desired-state", STATES), *found("node", down)]}
        running = {t["ServiceID"] for t in tasks.values() if t["Status"]["State"] == "running"}
        absent = [s["ID"] for s in services if replicas_of(s["Spec"]) and s["ID"] not in running]
        tasks |= {t["ID"]: t for t in found("service", absent)}
        ours = {service["ID"] for service in services}
        return [task for task in tasks.values() if task["ServiceID"] in ours]
