"""The Swarm engine: see look.py for what a container is here."""

from __future__ import annotations

import base64
import builtins
import json
import os
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from rorg.core.diff import REPLICAS
from rorg.core.observed import LABEL_SERVICE, LABEL_STATE, Container, FoundObjects
from rorg.engines.docker.body import Body
from rorg.engines.docker.create import other_rorg
from rorg.engines.log_lines import Reading
from rorg.engines.protocol import LIST_EVERY, NONE, Usage, unsupported
from rorg.engines.swarm import networks
from rorg.engines.swarm.body import CONTAINER, service_spec
from rorg.engines.swarm.cluster import Cluster
from rorg.engines.swarm.files import Mounts, files_of, references, remove_unused
from rorg.engines.swarm.inside import Inside
from rorg.engines.swarm.look import (
    BEGUN,
    ENDED,
    NAMED,
    PARKED,
    STARTED,
    Look,
    Row,
    labels_of,
    replicas_of,
)
from rorg.engines.swarm.managers import Managers, Pinger
from rorg.errors import EngineError
from rorg.model.engines import ENGINES, SWARM
from rorg.model.objects import Kind
from rorg.model.volumes import OF_TREE

LABEL_MOUNTS = "rorg.io/mounts"
"""The label with the mounts of a service from the tree, as JSON. They are read when it starts."""
SOON = 0.2
"""Seconds between two looks while a task begins or ends."""
SWARM_STOPS = 12.0
"""Seconds beyond the grace period within which a task has ended: the Swarm waits for 2 s before it sends the signal."""


class SwarmEngine(Inside):
    """Services of one owner in one Swarm; see Engine. It has no pause, no exec and no events of tasks."""

    name = SWARM
    local = False
    capabilities = ENGINES[SWARM]

    def __init__(self, owner: str, managers: Sequence[str], state: str = "") -> None:
        self.owner, self.address = owner, ",".join(managers)
        self._labels = {LABEL_STATE: state} if state else {}
        self.cluster = Cluster(owner, managers)

    def ping(self) -> str:
        version, nodes = self.cluster.ask("reach the Swarm", lambda c: str(c.release)), self.cluster.nodes()
        return f"Swarm of {len(nodes)} nodes, {version}"

    def pinger(self) -> Pinger:
        return Pinger(Managers([client.host for client in self.cluster.managers.clients]))

    def close(self) -> None:
        self.cluster.managers.close()

    # -- observing ---------------------------------------------------------------------------------------------

    def list(self, known: Mapping[str, Container] = NONE) -> builtins.list[Container]:  # noqa: ARG002 - of Engine
        return self.cluster.look().containers()

    def inspect(self, container: str) -> Container | None:
        return self.cluster.look().container(container)

    def events(self, stop: Reading) -> Iterator[tuple[str, str]]:
        """The Swarm tells nothing of tasks, so they are listed: once a second, and more often while any begins or
        ends."""
        yield "", ""
        while not stop.wait(SOON if self.cluster.last.settling() else LIST_EVERY):
            yield "", ""

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:  # noqa: ARG002 - of Engine
        return {}

    # -- acting ------------------------------------------------------------------------------------------------

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",  # noqa: ARG002 - of Engine: there are no unnamed volumes
        defaults: Collection[str] = (),
    ) -> str:
        """Make a service that does not run; or park the spec beside the one of the service that exists."""
        container = os.urandom(32).hex()
        kept = {k: v for k, v in spec.items() if not (k == "stop_signal" and k in defaults)}
        mounts = [(v["source"], v["target"]) for v in spec.get("volumes", ()) if _of_tree(v)]
        marks = {**labels, **self._labels, LABEL_MOUNTS: json.dumps(mounts)}
        body = service_spec(name, kept, marks, container)
        there = [s["Spec"]["Name"] for s in self.cluster.look().services_named(labels[LABEL_SERVICE])]
        taken = next((own for own in there if name == own or name.startswith(f"{own}.")), "")
        if taken:  # its own name has a dot, which the Swarm refuses
            self._park({**body, "Name": taken}, {NAMED: name})
        else:
            self._make(body)
        return container

    def _make(self, body: Body) -> None:
        name = body["Name"]
        try:
            self.cluster.ask(f"create {name}", lambda c: c.post("/services/create", body))
        except EngineError as error:
            if error.kind != "name_taken":
                raise
            rows = self.cluster.ask(f"inspect {name}", lambda c: c.get("/services", filters={"name": [name]}))
            labels = next((labels_of(row["Spec"]) for row in rows if row["Spec"]["Name"] == name), {})
            whose = other_rorg(labels, self.owner)
            why = f"a service of that name belongs to {whose}" if whose else "the Swarm has a service of that name"
            raise EngineError(error.what, why, "another container_name", "name_taken") from error

    def _park(self, spec: Body, more: Mapping[str, str]) -> None:
        """Keep a spec in a config. If rorg is killed before the service has another spec, the container is both current
        and parked; the current one counts, and remove() ends both."""
        labels = {**labels_of(spec), **more}
        container = labels[CONTAINER]
        data = base64.b64encode(json.dumps({**spec, "Labels": labels}).encode()).decode()
        body = {"Name": f"rorg.{container[:40]}", "Labels": {PARKED: self.owner}, "Data": data}
        self.cluster.ask(f"keep {spec['Name']}", lambda c: c.post("/configs/create", body))

    def start(self, container: str) -> None:
        """Begin a run. The current container of the service ends by this: the Swarm stops its task first."""
        look = self.cluster.look()
        service, parked = look.service_of(container), look.parked.get(container)
        if service is None and parked is None:
            raise EngineError(f"start {container[:12]}", "it is gone", kind="gone")
        spec: Row = service["Spec"] if service else parked.spec if parked else {}
        if service and replicas_of(service["Spec"]) and any(t.wanted for t in look.alive(service)):
            return  # the Swarm is about to begin its next attempt
        there = [s for s in look.services_named(labels_of(spec)[LABEL_SERVICE]) if s is not service]
        target = service or next((s for s in there if s["Spec"]["Name"] == spec["Name"]), there[0] if there else None)
        for other in there:
            if other is not target and (replicas_of(other["Spec"]) or look.alive(other)):
                self._scale_down(look, other, 0.0)
        self._run(look, spec, target, container)
        if parked:
            self.cluster.ask(f"start {container[:12]}", lambda c: c.delete(f"/configs/{parked.config}"))

    def _run(self, look: Look, spec: Row, target: Row | None, container: str) -> None:
        """Give the Swarm service `target` this spec and one task; make a service if there is none any more."""
        mounts: Mounts = [(str(a), str(b)) for a, b in json.loads(labels_of(spec).get(LABEL_MOUNTS, "[]"))]
        files = files_of(mounts)
        parts = self.cluster.ask("send files to the Swarm", lambda c: references(c, self.owner, files))
        task = spec["TaskTemplate"]
        again = target["Spec"]["TaskTemplate"].get("ForceUpdate", 0) + 1 if target else 0
        labels = {k: v for k, v in labels_of(spec).items() if k != NAMED}
        body = {
            **spec,
            "Name": target["Spec"]["Name"] if target else spec["Name"],
            "Labels": labels,
            "TaskTemplate": {**task, "ContainerSpec": {**task["ContainerSpec"], **parts}, "ForceUpdate": again},
            "Mode": {"Replicated": {"Replicas": 1}},
        }
        if target is None:
            self._make(body)
            return
        if labels_of(target["Spec"]).get(CONTAINER) not in (container, None, *look.parked):
            self._park({**target["Spec"], "Mode": {"Replicated": {"Replicas": 0}}}, self._last_run(look, target))
        self._update(f"start {spec['Name']}", target, body)

    def _last_run(self, look: Look, service: Row) -> dict[str, str]:
        """Return labels about the last run of its current container."""
        found = look.container(labels_of(service["Spec"])[CONTAINER])
        code = {} if found is None or found.exit_code is None else {ENDED: str(found.exit_code)}
        return {STARTED: found.started_at, **code} if found and found.started_at else {}

    def _update(self, what: str, service: Row, spec: Mapping[str, Any]) -> None:
        """Change a service. An error of the kind `conflict` means that something else has changed it meanwhile."""
        path, version = f"/services/{service['ID']}/update", service["Version"]["Index"]
        self.cluster.ask(what, lambda c: c.post(path, spec, version=version))

    def stop(self, container: str, signal: str, grace: float) -> None:  # noqa: ARG002 - the spec has the signal
        """End its task by the signal and the grace period of its spec, and return when it has ended."""
        look = self.cluster.look()
        service = look.service_of(container)
        if service is not None:
            self._scale_down(look, service, grace)

    def _scale_down(self, look: Look, service: Row, grace: float) -> None:
        name, spec = service["Spec"]["Name"], service["Spec"]
        if replicas_of(spec):
            labels = {**labels_of(spec), **self._last_run(look, service)}
            self._update(f"stop {name}", service, {**spec, "Labels": labels, "Mode": {"Replicated": {"Replicas": 0}}})
        until = time.monotonic() + grace + SWARM_STOPS
        while self.cluster.look().alive(service):
            if time.monotonic() > until:
                raise EngineError(f"stop {name}", "its task has not ended", f"`docker service ps {name}`")
            time.sleep(SOON)

    def signal(self, container: str, name: str) -> None:  # noqa: ARG002 - of Engine
        raise unsupported(self.name, "signal", container)

    def remove(self, container: str, volumes: bool = False) -> None:  # noqa: ARG002 - of Engine
        look = self.cluster.look()
        service, parked = look.service_of(container), look.parked.get(container)
        if parked:
            self.cluster.ask(f"remove {container[:12]}", lambda c: c.delete(f"/configs/{parked.config}"))
        if service is not None:
            if replicas_of(service["Spec"]) or any(t.state in BEGUN for t in look.alive(service)):
                raise EngineError(f"remove {service['Spec']['Name']}", "it runs", "to stop it first", "conflict")
            self.cluster.ask(f"remove {service['Spec']['Name']}", lambda c: c.delete(f"/services/{service['ID']}"))
        left = self.cluster.look()
        specs = [*(s["Spec"] for s in left.services), *(p.spec for p in left.parked.values())]
        self.cluster.ask("remove unused files", lambda c: remove_unused(c, self.owner, specs))

    def pause(self, container: str) -> None:
        """moby#37809: a manager calls a paused task running for ever."""
        raise unsupported(self.name, "pause", container)

    def resume(self, container: str) -> None:
        raise unsupported(self.name, "resume", container)

    def rename(self, container: str, name: str) -> None:  # noqa: ARG002 - of Engine
        raise unsupported(self.name, "rename", container)

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        """Have one task again. No other option changes in place."""
        service = self.cluster.look().service_of(container)
        if options.keys() != {REPLICAS} or service is None:
            raise unsupported(self.name, "update", container)
        spec = {**service["Spec"], "Mode": {"Replicated": {"Replicas": options[REPLICAS]}}}
        self._update(f"scale {spec['Name']}", service, spec)

    # -- networks ----------------------------------------------------------------------------------------------

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        return self.cluster.ask("list networks", lambda c: networks.find(c, self.owner, keys))

    def object_events(self, stop: Reading) -> Iterator[None]:
        yield
        while not stop.wait(LIST_EVERY):
            yield

    def make_object(self, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        if kind != "network":
            raise unsupported(self.name, f"make the {kind}", name)
        marks = {**labels, **self._labels}
        self.cluster.ask(f"create the network {name}", lambda c: networks.make(c, name, spec, marks))

    def remove_object(self, kind: Kind, name: str) -> None:
        if kind == "network":
            self.cluster.ask(f"remove the network {name}", lambda c: networks.remove(c, name, self.owner))


def _of_tree(volume: Any) -> bool:
    return isinstance(volume, Mapping) and volume["type"] == OF_TREE
