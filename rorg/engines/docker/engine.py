"""The Docker engine, through its HTTP API. Podman's service speaks the same API."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rorg.core.observed import LABEL_OWNER, LABEL_STATE, Container, FoundObjects, from_labels
from rorg.engines.docker import objects
from rorg.engines.docker.answers import MOST_ANSWER, from_json
from rorg.engines.docker.body import Body
from rorg.engines.docker.client import API_TIMEOUT, Client
from rorg.engines.docker.connect import engine_host
from rorg.engines.docker.create import create_container, name_taken
from rorg.engines.docker.errors import docker_errors
from rorg.engines.docker.events import is_quiet, told_state
from rorg.engines.docker.images import Images
from rorg.engines.docker.inside import Inside
from rorg.engines.docker.inspection import read_container, state_of, update_body
from rorg.engines.docker.lacking import capabilities
from rorg.engines.docker.ping import Pinger
from rorg.engines.docker.release import version_text
from rorg.engines.docker.volumes import remove_container
from rorg.engines.log_lines import Reading
from rorg.engines.protocol import NONE, Usage, stop_sequence
from rorg.errors import EngineError, TimedOut, Unreachable
from rorg.host.cgroups import container_usage, end_processes
from rorg.model.engines import DEFAULT_ENGINE, ENGINES
from rorg.model.objects import Kind

if TYPE_CHECKING:
    import docker

QUICK = 2.0
"""Seconds for one inspection within a full list."""
CLOCK_SET = 1.0
"""Seconds by which the clock has been set if it differs by more from the monotonic one; slewing is slower."""
LAG = 5.0
"""Seconds by which events are late at most."""


class DockerEngine(Inside, Images):
    """Containers of one owner on one Docker engine."""

    name = DEFAULT_ENGINE

    def __init__(self, owner: str, base_url: str | None = None, state: str = "") -> None:
        """`state`: the owner's state directory, for the labels of what it makes."""
        self.owner, self.client = owner, Client(engine_host(base_url))
        self.labels = {LABEL_STATE: state} if state else {}
        self.capabilities = ENGINES[self.name]
        """All until the engine has answered; then those of its release."""
        self._clock_ahead = time.time() - time.monotonic()
        """Seconds by which the clock was ahead of the monotonic one at the last list."""
        self.address = self.client.host
        self.local = self.client.host.startswith(("unix://", "http+unix://"))

    def api(self) -> docker.APIClient:
        """A docker-py client of this engine, for images. Threads must not share one (docker-py#3229)."""
        import docker
        from docker.utils import kwargs_from_env

        with docker_errors("reach the engine"):
            # TLS by the same variables as ours
            options = kwargs_from_env({**os.environ, "DOCKER_HOST": self.client.host})
            return docker.APIClient(**options, version=version_text(self.client.release.api), timeout=int(API_TIMEOUT))

    def ping(self) -> str:
        with docker_errors("reach the engine"):
            self.client.forget()
            return str(self.client.release)

    def pinger(self) -> Pinger:
        return Pinger(self.client.ping())

    def close(self) -> None:
        self.client.close()

    # -- observing ---------------------------------------------------------------------------------------------

    def list(self, known: Mapping[str, Container] = NONE) -> list[Container]:
        """Inspecting each container takes long, so known ones without news are not inspected again."""
        filters = {"label": [f"{LABEL_OWNER}={self.owner}"]}
        with docker_errors("list containers"):
            asks_events = known and self.local and not self.client.release.podman  # Podman tells no past ones
            heard = self._heard_lately(known) if asks_events else set(known)
            rows = self.client.get("/containers/json", all=True, filters=filters)
            looked = (_as_before(known, row, heard) or self._look(row) for row in rows)
            return [c for c in looked if c is not None]

    def _heard_lately(self, known: Collection[str]) -> set[str]:
        """Ids of containers whose events may not have arrived at the observer yet, by the clock of this machine; of all
        that are `known` if it was set since the last list."""
        now, ids = time.time(), set()
        before, self._clock_ahead = self._clock_ahead, now - time.monotonic()
        if abs(self._clock_ahead - before) > CLOCK_SET:
            return {*known}
        filters = {"type": ["container"], "label": [f"{LABEL_OWNER}={self.owner}"]}
        with self.client.stream("GET", "/events", None, QUICK, filters=filters, since=now - LAG, until=now) as stream:
            for line in stream.lines(MOST_ANSWER):
                event = from_json(line)
                if not is_quiet(event):
                    ids.add(event["Actor"]["ID"])
        return ids

    def _look(self, row: Mapping[str, Any]) -> Container | None:
        """Inspect one row of the list. While a start or stop of a container hangs, the engine also blocks its
        inspection: then the row itself must do, so that one hung container does not hide the others."""
        try:
            return self.inspect(row["Id"], QUICK)
        except TimedOut:
            pass
        return Container(
            row["Id"],
            row["Names"][0].lstrip("/"),
            state=state_of(row["State"]),
            brief=True,
            **from_labels(row.get("Labels") or {}),
        )

    def inspect(self, container: str, timeout: float = API_TIMEOUT) -> Container | None:
        try:
            data = self._inspection(container, timeout)
        except EngineError as error:
            if error.kind == "gone":
                return None
            if error.kind != "ending":
                raise
            data = self._inspection(container, timeout)
        with docker_errors(f"inspect {container[:12]}"):
            labels = data["Config"].get("Labels") or {}
            return read_container(data, self.local) if labels.get(LABEL_OWNER) == self.owner else None

    def _inspection(self, container: str, timeout: float) -> Any:
        with docker_errors(f"inspect {container[:12]}"):
            return self.client.get(f"/containers/{container}/json", timeout)

    def events(self, stop: Reading) -> Iterator[tuple[str, str]]:
        filters = {"type": ["container"], "label": [f"{LABEL_OWNER}={self.owner}"]}
        with docker_errors("follow the engine's events"):
            self.client.forget()
            self.capabilities = capabilities(self.client)
        with (
            docker_errors("follow the engine's events"),
            self.client.stream("GET", "/events", filters=filters, since=self.client.just_now()) as stream,
            stop.closing(stream.close),
        ):
            yield "", ""
            for line in stream.lines():
                event = from_json(line)
                if not is_quiet(event):
                    yield event["Actor"]["ID"], told_state(event)
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
        with self._naming(name), docker_errors(f"create {name}"):
            return create_container(self.client, name, spec, {**labels, **self.labels}, before, defaults)

    @contextmanager
    def _naming(self, name: str) -> Iterator[None]:
        """If the name is taken, say in the error which other rorg has it."""
        try:
            yield
        except EngineError as error:
            if error.kind != "name_taken":
                raise
            raise name_taken(self.client, name, self.owner, error) from error

    def start(self, container: str) -> None:
        try:
            self._do("start", container)
        except EngineError as error:
            # It would run at the same time as the new one.
            if error.kind != "left_running" or not end_processes(container):
                raise
            self._do("start", container)

    def pause(self, container: str) -> None:
        self._do("pause", container)

    def resume(self, container: str) -> None:
        self._do("resume", container, "unpause")

    def _do(self, what: str, container: str, path: str = "", body: Body | None = None, **query: Any) -> None:
        with docker_errors(f"{what} {container[:12]}"):
            self.client.post(f"/containers/{container}/{path or what}", body, **query)

    def stop(self, container: str, signal: str, grace: float) -> None:
        """A signal that the engine refuses, such as a number that an image declares, is skipped."""
        why = EngineError(f"stop {container[:12]}", "it did not end after SIGKILL", "`dmesg` for a device that hangs")
        began = 0.0  # when the first signal was sent: an engine under load may take its time for that
        for name, until in stop_sequence(signal, grace):
            try:
                self._kill(container, name)
            except EngineError as error:
                if error.kind in ("conflict", "gone"):
                    return
                why = error
                continue
            began = began or time.monotonic()
            if self._ended(container, max(0.0, began + until - time.monotonic())):
                return
        raise why

    def _kill(self, container: str, signal: str) -> None:
        """A signal alone wakes a paused container of Docker (20.10 and later: kill thaws), but not one of Podman."""
        self._do("stop", container, "kill", signal=signal)
        if self.client.release.podman:
            try:
                self._do("stop", container, "unpause")
            except EngineError as error:
                if error.kind not in ("conflict", "gone"):
                    raise

    def signal(self, container: str, name: str) -> None:
        self._do("signal", container, "kill", signal=name)

    def _ended(self, container: str, seconds: float) -> bool:
        try:
            with docker_errors(f"wait for {container[:12]}"):
                self.client.post(f"/containers/{container}/wait", timeout=seconds, condition="not-running")
            return True
        except TimedOut:
            return False
        except EngineError as error:
            if error.kind == "gone":
                return True
            raise

    def remove(self, container: str, volumes: bool = False) -> None:
        try:
            with docker_errors(f"remove {container[:12]}"):
                remove_container(self.client, container, volumes)
        except EngineError as error:
            if error.kind != "gone":
                raise

    def rename(self, container: str, name: str) -> None:
        with self._naming(name):
            self._do("rename", container, name=name)

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        self._do("update", container, body=update_body(options))

    # -- networks and volumes ----------------------------------------------------------------------------------

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        with docker_errors("list networks and volumes"):
            return objects.find(self.client, self.owner, keys)

    def object_events(self, stop: Reading) -> Iterator[None]:
        with docker_errors("follow the engine's events"):
            yield from objects.events(self.client, stop)
        if not stop.is_set():
            raise Unreachable("follow the engine's events", "the engine closed the stream")

    def make_object(self, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        with docker_errors(f"create the {kind} {name}"):
            objects.make(self.client, kind, name, spec, {**labels, **self.labels})

    def remove_object(self, kind: Kind, name: str) -> None:
        with docker_errors(f"remove the {kind} {name}"):
            objects.remove(self.client, kind, name, self.owner)

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        usage = {}
        for container in containers if self.local else ():
            figures = container_usage(container.pid) if container.pid and container.alive else None
            if figures:
                usage[container.id] = Usage(*figures)
        return usage


def _as_before(known: Mapping[str, Container], row: Mapping[str, Any], heard: set[str]) -> Container | None:
    """The known container, if the list agrees and no event contradicts it."""
    before = known.get(row["Id"])
    if before is None or before.brief or row["Id"] in heard:
        return None
    return before if (before.name, before.state) == (row["Names"][0].lstrip("/"), state_of(row["State"])) else None
