"""Containers to develop in, on a Docker engine, besides those of the robot's services."""

from __future__ import annotations

import builtins
from collections.abc import Mapping, Sequence
from typing import Any

from rorg.engines.docker.attach import attach
from rorg.engines.docker.body import create_body
from rorg.engines.docker.create import make
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.docker.errors import docker_errors
from rorg.model.dev import LABEL_DEV, DevContainer, from_row

COMING = ".new"
"""Suffix of the name of a container that will replace another."""
GRACE = 3.0
"""Seconds that a container has to end, with all shells in it."""


class DevContainers:
    """The dev containers of one robot. Raises what an engine raises."""

    def __init__(self, engine: DockerEngine) -> None:
        self._engine, self._client = engine, engine.client

    def list(self) -> builtins.list[DevContainer]:
        """By name."""
        filters = {"label": [f"{LABEL_DEV}={self._engine.owner}"]}
        with docker_errors("list containers"):
            rows = self._client.get("/containers/json", all=True, filters=filters)
        containers = [from_row(r["Id"], r["Names"][0].lstrip("/"), r["State"], r.get("Labels") or {}) for r in rows]
        return sorted(containers, key=lambda c: c.name)

    def image(self, reference: str) -> str:
        """The id of the image that a reference means; empty if there is none."""
        with docker_errors(f"look for {reference}"):
            return str((self._client.find(f"/images/{reference}/json") or {}).get("Id", ""))

    def make(
        self, name: str, spec: Mapping[str, Any], labels: Mapping[str, str], before: DevContainer | None = None
    ) -> DevContainer:
        """Make and start a container, which replaces `before` once it runs. If it does not start, nothing changes. Its
        unnamed volumes are its own, and are removed with it."""
        coming = f"{name}{COMING}"
        for left in self.list():
            if left.name == coming:  # of a command that was killed
                self.remove(left)
        first = name if before is None else coming
        with docker_errors(f"create {name}"):
            made = make(self._client, first, create_body(spec, labels), spec.get("platform"))
        container = from_row(made, name, "created", labels)
        try:
            self.start(container)
        except BaseException:
            self.remove(container)
            raise
        if before is not None:
            self.remove(before)
            self._engine.rename(made, name)
        return container

    def start(self, container: DevContainer) -> None:
        """Make it run, from any state."""
        if container.state == "paused":
            self._engine.resume(container.id)
        elif container.state != "running":
            with docker_errors(f"start {container.name}"):
                self._client.post(f"/containers/{container.id}/start")

    def run(self, container: DevContainer, command: Sequence[str], terminal: bool, folder: str) -> int:
        """Run a command in it with this process's standard streams; see Access.attach."""
        with docker_errors(f"run {command[0]} in {container.name}"):
            client, local = self._client, self._engine.local
            return attach(client, container.id, command, terminal=terminal, stdin=True, local=local, folder=folder)

    def remove(self, container: DevContainer) -> None:
        """End it with everything that runs in it."""
        if container.state in ("running", "paused", "restarting"):
            self._engine.stop(container.id, "SIGTERM", GRACE)
        with docker_errors(f"remove {container.name}"):
            self._client.delete(f"/containers/{container.id}", v=True, force=True)
