"""The Docker engine, through docker-py's low-level client. Podman's service speaks the same API."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

import docker

from rorg.core.observed import LABEL_OWNER, Container, from_labels
from rorg.engines.docker import log
from rorg.engines.docker.create import create_container, post
from rorg.engines.docker.errors import docker_errors
from rorg.engines.docker.exec import run
from rorg.engines.docker.live import update_body
from rorg.engines.docker.reading import began, read_container
from rorg.engines.docker.volumes import remove_container
from rorg.engines.protocol import Capabilities, Usage, stop_sequence
from rorg.errors import EngineError, TimedOut, Unreachable
from rorg.host.cgroups import container_usage
from rorg.host.commands import Output

TOLD = {"pause": "paused", "unpause": "running"}
"""Events that say all: nothing else of the container changes, so no look at it is needed."""
API_TIMEOUT = 120.0
"""Seconds. A start may take long on a loaded robot; a lost connection ends a call at once anyway."""
QUICK = 2.0
"""Seconds for one inspection within a full list."""


class DockerEngine:
    """Containers of one owner on one Docker engine. docker-py's client is not safe to share, so each thread has its
    own (docker-py#3229)."""

    name = "docker"
    capabilities = Capabilities(isolation=True, live_update=True, events="all")

    def __init__(self, owner: str, base_url: str | None = None) -> None:
        self.owner, self.base_url = owner, base_url
        self.local = (base_url or os.environ.get("DOCKER_HOST") or "unix://").startswith(("unix://", "http+unix://"))
        self._thread = threading.local()
        self._version = ""

    # -- plumbing ----------------------------------------------------------------------------------------------

    def api(self) -> docker.APIClient:
        """The client of this thread."""
        api = getattr(self._thread, "api", None)
        if api is None:
            api = self._thread.api = self._connect(API_TIMEOUT)
        return api

    def _connect(self, timeout: float | None) -> docker.APIClient:
        """A new client; the version is negotiated once."""
        with docker_errors("reach the engine"):
            options: dict[str, Any] = {"version": self._version or "auto", "timeout": timeout}
            api = docker.APIClient(self.base_url, **options) if self.base_url else docker.from_env(**options).api
            self._version = api.api_version
        return api

    def _call(self, what: str, call: Callable[[docker.APIClient], Any]) -> Any:
        with docker_errors(what):
            return call(self.api())

    def ping(self) -> str:
        return str(self._call("reach the engine", lambda api: api.version())["Version"])

    def close(self) -> None:
        api = getattr(self._thread, "api", None)
        if api is not None:
            api.close()
            self._thread.api = None

    # -- observing ---------------------------------------------------------------------------------------------

    def list(self) -> list[Container]:
        filters = {"label": [f"{LABEL_OWNER}={self.owner}"]}
        rows = self._call("list containers", lambda api: api.containers(all=True, filters=filters))
        return [c for row in rows if (c := self._look(row)) is not None]

    def _look(self, row: Mapping[str, Any]) -> Container | None:
        """One row of the list, inspected. While a start or stop of a container hangs, the engine holds back its
        inspection too: then the row itself must do, lest one hung container hide all others."""
        try:
            return self.inspect(row["Id"], self._quick())
        except TimedOut:
            pass
        return Container(
            row["Id"],
            row["Names"][0].lstrip("/"),
            state=row["State"],
            brief=True,
            **from_labels(row.get("Labels") or {}),
        )

    def _quick(self) -> docker.APIClient:
        """A second client of this thread, with little patience."""
        api = getattr(self._thread, "quick", None)
        if api is None:
            api = self._thread.quick = self._connect(QUICK)
        return api

    def inspect(self, container: str, api: docker.APIClient | None = None) -> Container | None:
        try:
            with docker_errors(f"inspect {container[:12]}"):
                data = (api or self.api()).inspect_container(container)
        except EngineError as error:
            if error.kind == "gone":
                return None
            raise
        labels = data["Config"].get("Labels") or {}
        return read_container(data, self.local) if labels.get(LABEL_OWNER) == self.owner else None

    def events(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        filters = {"type": "container", "label": f"{LABEL_OWNER}={self.owner}"}
        quiet = ("exec_", "health_status", "attach", "top", "resize", "copy", "export")
        api = self._connect(None)
        with docker_errors("follow the engine's events"):
            stream = api.events(decode=True, filters=filters)

        def close() -> None:
            stop.wait()
            stream.close()

        threading.Thread(target=close, daemon=True, name="events-closer").start()
        yield "", ""
        with docker_errors("follow the engine's events"):
            for event in stream:
                if stop.is_set():
                    return
                if not event.get("Action", "").startswith(quiet):
                    yield event["Actor"]["ID"], TOLD.get(event["Action"], "")
        if not stop.is_set():
            raise Unreachable("follow the engine's events", "the engine closed the stream")

    # -- acting ------------------------------------------------------------------------------------------------

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",
        defaults: Collection[str] = (),
    ) -> str:
        return str(
            self._call(f"create {name}", lambda api: create_container(api, name, spec, labels, before, defaults))
        )

    def start(self, container: str) -> None:
        self._call(f"start {container[:12]}", lambda api: api.start(container))

    def pause(self, container: str) -> None:
        self._call(f"pause {container[:12]}", lambda api: api.pause(container))

    def resume(self, container: str) -> None:
        self._call(f"resume {container[:12]}", lambda api: api.unpause(container))

    def stop(self, container: str, signal: str, grace: float) -> None:
        """Signals of a paused container wake it by themselves (Docker 20.10 and later: kill thaws). One that the engine
        refuses, such as a number that an image declares, is passed over."""
        why = EngineError(f"stop {container[:12]}", "it outlived SIGKILL", "to look for a hung device")
        for name, seconds in stop_sequence(signal, grace):
            try:
                self._kill("stop", container, name)
            except EngineError as error:
                if error.kind in ("conflict", "gone"):
                    return
                why = error
                continue
            if self._ended(container, seconds):
                return
        raise why

    def signal(self, container: str, name: str) -> None:
        self._kill("signal", container, name)

    def _kill(self, why: str, container: str, name: str) -> None:
        self._call(f"{why} {container[:12]}", lambda api: api.kill(container, name))

    def _ended(self, container: str, seconds: float) -> bool:
        try:
            with docker_errors(f"wait for {container[:12]}"):
                self.api().wait(container, timeout=seconds, condition="not-running")  # type: ignore[arg-type]
            return True
        except TimedOut:
            return False
        except EngineError as error:
            if error.kind == "gone":
                return True
            raise

    def remove(self, container: str, volumes: bool = False) -> None:
        try:
            self._call(f"remove {container[:12]}", lambda api: remove_container(api, container, volumes))
        except EngineError as error:
            if error.kind != "gone":
                raise

    def rename(self, container: str, name: str) -> None:
        self._call(f"rename {container[:12]} to {name}", lambda api: api.rename(container, name))

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        body = update_body(options)
        self._call(f"update {container[:12]}", lambda api: post(api, "/containers/{0}/update", container, body))

    def logs(self, container: str, follow: bool, tail: int | None) -> Iterator[bytes]:
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.read(self.api(), container, follow, tail)

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        """The place is the engine's time of the last line, so that line comes again."""
        if not place:
            found = self.inspect(container)
            place = str(began(found)) if found else "0"
        with docker_errors(f"read the logs of {container[:12]}"):
            yield from log.since(self.api(), container, place)

    def exec(
        self, container: str, command: Sequence[str], timeout: float, stop: threading.Event | None = None
    ) -> tuple[int, bytes]:
        with docker_errors(f"run {command[0]} in {container[:12]}"):
            return run(self.api(), container, command, Output(timeout, stop), self.local)

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        found = {}
        for container in containers if self.local else ():
            figures = container_usage(container.pid) if container.pid and container.alive else None
            if figures:
                found[container.id] = Usage(*figures)
        return found
