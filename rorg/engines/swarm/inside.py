"""Looking into a service of the Swarm: the log of its tasks. Its managers reach nothing else inside."""

# ruff: noqa: ARG002 - what refuses everything uses no argument

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from rorg.core.observed import LABEL_SERVICE
from rorg.engines.docker import log
from rorg.engines.docker.errors import docker_errors
from rorg.engines.docker.inspection import epoch_seconds
from rorg.engines.log_lines import LogLine, Reading
from rorg.engines.protocol import unsupported
from rorg.engines.swarm.cluster import Cluster
from rorg.engines.swarm.look import labels_of
from rorg.errors import EngineError


class Inside:
    """See Inspection and Access."""

    name: str
    cluster: Cluster

    def _log(self, container: str) -> str:
        """Return where the Swarm has the log of all tasks of its service."""
        look = self.cluster.look()
        service, parked = look.service_of(container), look.parked.get(container)
        if service is None and parked:
            there = look.services_named(labels_of(parked.spec)[LABEL_SERVICE])
            service = there[0] if there else None
        if service is None:
            raise EngineError(f"read the logs of {container[:12]}", "it is gone", kind="gone")
        return f"/services/{service['ID']}"

    def log_lines(self, container: str, tail: int | None, since: float | None, whole: bool) -> Iterator[LogLine]:
        path = self._log(container)
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.lines(self.cluster.managers.answering(), path, tail, since)

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        path = self._log(container)
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.follow(self.cluster.managers.answering(), path, place, reading)

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        path = self._log(container)
        if not place:
            found = self.cluster.look().container(container)
            place = str(epoch_seconds(found.started_at)) if found and found.started_at else "0"
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.since(self.cluster.managers.answering(), path, place)

    def exec(
        self,
        container: str,
        command: Sequence[str],
        timeout: float,
        stop: threading.Event | None = None,
    ) -> tuple[int, bytes]:
        raise unsupported(self.name, f"run {command[0]} in", container)

    def attach(self, container: str, command: Sequence[str], terminal: bool, stdin: bool) -> int:
        raise unsupported(self.name, f"run {command[0]} in", container)

    def fetch(self, container: str, path: str, place: Path) -> None:
        raise unsupported(self.name, "copy files out of", container)

    def put(self, container: str, source: Path, path: str) -> None:
        raise unsupported(self.name, "copy files into", container)
