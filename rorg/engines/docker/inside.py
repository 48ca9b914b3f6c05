"""Looking into one container: its log, commands and files. The part of DockerEngine that changes no container."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from rorg.core.observed import Container
from rorg.engines.docker import archive, log
from rorg.engines.docker.attach import attach
from rorg.engines.docker.client import Client
from rorg.engines.docker.errors import docker_errors
from rorg.engines.docker.exec import run
from rorg.engines.docker.inspection import began
from rorg.engines.log_lines import LogLine, Reading
from rorg.host.commands import Output


class Inside:
    """See Inspection and Access."""

    client: Client
    local: bool

    def inspect(self, container: str) -> Container | None:
        """See Observation."""
        raise NotImplementedError

    def log_lines(
        self,
        container: str,
        tail: int | None,
        since: float | None,
        whole: bool,  # noqa: ARG002 - of Engine
    ) -> Iterator[LogLine]:
        """The engine gives whole lines, and long ones in pieces."""
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.lines(self.client, f"/containers/{container}", tail, since)

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.follow(self.client, f"/containers/{container}", place, reading)

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        """The place is the engine's time of the last line, so that line comes again."""
        if not place:
            inspection = self.inspect(container)
            place = str(began(inspection)) if inspection else "0"
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.since(self.client, f"/containers/{container}", place)

    def exec(
        self, container: str, command: Sequence[str], timeout: float, stop: threading.Event | None = None
    ) -> tuple[int, bytes]:
        with docker_errors(f"run {command[0]} in {container[:12]}"):
            return run(self.client, container, command, Output(timeout, stop), self.local)

    def attach(self, container: str, command: Sequence[str], terminal: bool, stdin: bool) -> int:
        with docker_errors(f"run {command[0]} in {container[:12]}"):
            return attach(self.client, container, command, terminal=terminal, stdin=stdin, local=self.local)

    def fetch(self, container: str, path: str, place: Path) -> None:
        with docker_errors(f"copy {path}"):
            archive.fetch(self.client, container, path, place)

    def put(self, container: str, source: Path, path: str) -> None:
        with docker_errors(f"copy {source}"):
            archive.put(self.client, container, source, path)
