"""The Docker engine, through docker-py's low-level client. Podman's service speaks the same API."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import docker
import requests
import urllib3
from docker.errors import APIError, DockerException
from docker.utils.socket import frames_iter

from rorg.core.observed import LABEL_OWNER, Container, from_labels
from rorg.engines.docker.body import live_options, update_body
from rorg.engines.docker.create import create_container, post
from rorg.engines.docker.volumes import remove_container
from rorg.engines.protocol import Capabilities, Usage, stop_sequence
from rorg.errors import EngineError, TimedOut, Unreachable
from rorg.host.cgroups import container_usage
from rorg.host.processes import process_start

NEVER = "0001-01-01T00:00:00Z"
"""What the engine calls the start of a container that never started."""
KINDS = (
    ("missing_image", r"no such image", "`rorg build` first"),
    ("name_taken", r"is already in use by container", "to remove or rename that container; rorg did not make it"),
    ("missing_device", r"gathering device information|no such file or directory.*dev", "to plug the device in"),
    ("forbidden", r"operation not permitted|permission denied", "an engine that may do this, or to drop the option"),
    ("forbidden", r"could not select device driver", "an engine with that runtime, or to drop gpus"),
    ("gone", r"no such container", ""),
    ("conflict", r"is paused|not running|already (started|paused)|is not paused", ""),
)
"""What the engine says, as a stable kind with a remedy."""
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
        self._local = threading.local()
        self._version = ""

    # -- plumbing ----------------------------------------------------------------------------------------------

    def api(self) -> docker.APIClient:
        """The client of this thread."""
        api = getattr(self._local, "api", None)
        if api is None:
            api = self._local.api = self._connect(API_TIMEOUT)
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
        api = getattr(self._local, "api", None)
        if api is not None:
            api.close()
            self._local.api = None

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
        api = getattr(self._local, "quick", None)
        if api is None:
            api = self._local.quick = self._connect(QUICK)
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
        return _container(data, labels) if labels.get(LABEL_OWNER) == self.owner else None

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
        """Signals of a paused container wake it by themselves (Docker 20.10 and later: kill thaws)."""
        for name, seconds in stop_sequence(signal, grace):
            try:
                self._kill("stop", container, name)
            except EngineError as error:
                if error.kind in ("conflict", "gone"):
                    return
                raise
            if self._ended(container, seconds):
                return
        raise EngineError(f"stop {container[:12]}", "it outlived SIGKILL", "to look for a hung device")

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
            found = self.api().logs(container, stream=True, follow=follow, tail="all" if tail is None else tail)
            yield from found

    def log_since(self, container: str, place: str) -> tuple[bytes, str]:
        """The place is the engine's time of the last line, so that line comes again."""
        if not place:
            found = self.inspect(container)
            place = str(_began(found)) if found else "0"
        lines = self._call(
            f"read the logs of {container[:12]}", lambda api: api.logs(container, timestamps=True, since=float(place))
        ).splitlines()
        stamps, texts = zip(*(line.partition(b" ")[::2] for line in lines), strict=True) if lines else ((), ())
        return b"\n".join(texts), str(_seconds(stamps[-1].decode())) if stamps else place

    def exec(self, container: str, command: Sequence[str], timeout: float) -> tuple[int, bytes]:
        with docker_errors(f"run {command[0]} in {container[:12]}"):
            api = self.api()
            made = api.exec_create(container, list(command))["Id"]
            stream: Any = api.exec_start(made, socket=True)
            stream._sock.settimeout(timeout)
            try:
                output = b"".join(chunk for _, chunk in frames_iter(stream, tty=False))
            except TimeoutError:
                # It would go on for ever, and the next attempt would come on top. An engine that hangs raises here.
                program = api.exec_inspect(made)["Pid"]
                with contextlib.suppress(OSError):
                    os.kill(program, signal.SIGKILL)
                return 124, f"no end within {timeout:g} s".encode()
            finally:
                stream.close()
            return int(api.exec_inspect(made)["ExitCode"] or 0), output

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        found = {}
        for container in containers:
            figures = container_usage(container.pid) if container.pid and container.alive else None
            if figures:
                found[container.id] = Usage(*figures)
        return found


def _seconds(stamp: str) -> float:
    """The engine's times have nine digits after the second; Python reads six."""
    return datetime.fromisoformat(
        re.sub(r"(\.\d{1,6})\d*Z?$", r"\1+00:00", stamp.rstrip("Z") + "Z").replace("Z", "+00:00")
    ).timestamp()


def _began(container: Container) -> float:
    """When its run of now began. The engine notes its start after the program's first words; the process knows."""
    try:
        return process_start(container.pid)
    except (OSError, IndexError, ValueError):
        return _seconds(container.started_at)


def _container(data: Mapping[str, Any], labels: Mapping[str, str]) -> Container:
    state = data["State"]
    started = state.get("StartedAt") or NEVER
    return Container(
        id=data["Id"],
        name=data["Name"].lstrip("/"),
        state=state["Status"],
        started_at="" if started.startswith("0001-") else started,
        exit_code=state.get("ExitCode") if state["Status"] == "exited" else None,
        oom_killed=bool(state.get("OOMKilled")),
        error=state.get("Error") or "",
        created_at=data.get("Created") or "",
        live=live_options(data.get("HostConfig") or {}),
        pid=state.get("Pid") or 0,
        health=(state.get("Health") or {}).get("Status", ""),
        stop_signal=data["Config"].get("StopSignal") or "",
        **from_labels(labels),
    )


@contextlib.contextmanager
def docker_errors(what: str) -> Iterator[None]:
    """The engine's errors as ours."""
    try:
        yield
    except APIError as error:
        text = str(error.explanation or error)
        for kind, pattern, remedy in KINDS:
            if re.search(pattern, text, re.I):
                raise EngineError(what, text, remedy, kind) from error
        raise EngineError(what, text) from error
    except (DockerException, requests.RequestException, urllib3.exceptions.HTTPError, OSError, ValueError) as error:
        remedy = "`docker info` to see whether the engine runs"
        if _timed_out(error):
            raise TimedOut(what, "timed out", remedy) from error
        raise Unreachable(what, _reason(error), remedy) from error


def _timed_out(error: BaseException) -> bool:
    """Whether an error of the library means that the engine took too long. What it wraps may be its cause or context,
    or only an argument."""
    pending, seen = [error], set()
    while pending:
        found = pending.pop()
        if isinstance(found, requests.Timeout | urllib3.exceptions.TimeoutError | TimeoutError):
            return True
        if id(found) not in seen:
            seen.add(id(found))
            more = (found.__cause__, found.__context__, getattr(found, "reason", None), *found.args)
            pending += [e for e in more if isinstance(e, BaseException)]
    return False


def _reason(error: BaseException) -> str:
    text = str(error)
    match = re.search(r"(FileNotFoundError|ConnectionRefusedError|PermissionError)", text)
    known = {
        "FileNotFoundError": "its socket is not there",
        "ConnectionRefusedError": "it refuses the connection",
        "PermissionError": "no permission for its socket",
    }
    return known[match[1]] if match else text or type(error).__name__
