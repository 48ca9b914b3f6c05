"""The embedded engine: each service is a process group of this machine. Needs nothing, isolates nothing.

What a container is here: a record on disk, and, when it runs, a session of processes led by a small shell that waits
for the service and writes down how it ended, so that a restart of rorg loses nothing.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rorg.core.observed import LABEL_OWNER, Container, from_labels
from rorg.engines.process.log import read_log, read_log_from
from rorg.engines.process.table import MARK, boot_id, is_same, members, signal_group, stat
from rorg.engines.protocol import Capabilities, Usage, stop_sequence
from rorg.errors import EngineError
from rorg.manifest.container import ContainerOptions
from rorg.model.live import LIVE
from rorg.model.signals import signal_number
from rorg.model.units import stamp
from rorg.store.files import write_atomic
from rorg.store.state_dir import read_json

HONOURED = {
    "entrypoint",
    "environment",
    "working_dir",
    "stop_signal",
    "stop_grace_period",
    "container_name",
    "labels",
    "init",
    "network_mode",
    "logging",
}
"""Options with an effect here, or whose effect a plain process has anyway."""
SUPERVISE = 'trap : INT TERM HUP QUIT; "$@"; echo $? > "$RORG_EXIT.new" && mv "$RORG_EXIT.new" "$RORG_EXIT"'
"""The shell that leads a container's session. It outlives the signals of its group until the service has ended, then
writes the exit code in one step. The service runs in the foreground: a shell's background jobs ignore SIGINT."""


class ProcessEngine:
    """Services as sessions of plain processes; see Engine."""

    name = "process"
    capabilities = Capabilities(
        isolation=False,
        live_update=True,
        events="exits",
        ignored_options=frozenset(ContainerOptions.model_fields) - frozenset(HONOURED),
    )

    def __init__(self, owner: str, directory: Path) -> None:
        self.owner, self.directory = owner, directory
        self._lock = threading.RLock()
        self._changed: list[str] = []
        self._wake_read, self._wake_write = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        directory.mkdir(parents=True, exist_ok=True)

    def ping(self) -> str:
        return "built in"

    def close(self) -> None:
        pass

    # -- records -----------------------------------------------------------------------------------------------

    def _folder(self, container: str) -> Path:
        return self.directory / container

    def _record(self, container: str) -> dict[str, Any]:
        record = read_json(self._folder(container) / "record.json") or {}
        if not {"id", "name", "spec", "labels", "live"} <= set(record):
            raise EngineError(f"find {container}", "no such container", kind="gone")
        return record

    def _write(self, record: Mapping[str, Any]) -> None:
        write_atomic(self._folder(record["id"]) / "record.json", json.dumps(record), mode=0o600)
        self._tell(record["id"])

    def _tell(self, container: str) -> None:
        with self._lock:
            self._changed.append(container)
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b".")

    # -- observing ---------------------------------------------------------------------------------------------

    def list(self) -> list[Container]:
        ids = [p.name for p in self.directory.iterdir() if (p / "record.json").exists()]
        return [c for i in sorted(ids) if (c := self.inspect(i)) is not None]

    def inspect(self, container: str) -> Container | None:
        try:
            record = self._record(container)
        except EngineError:
            return None
        labels = record["labels"]
        if labels.get(LABEL_OWNER) != self.owner:
            return None
        state, code = self._state(record)
        return Container(
            id=record["id"],
            name=record["name"],
            state=state,
            started_at=record.get("started_at", ""),
            exit_code=code,
            live=record["live"],
            pid=record.get("pid", 0) if state in ("running", "paused") else 0,
            created_at=record.get("created_at", ""),
            **from_labels(labels),
        )

    def _state(self, record: Mapping[str, Any]) -> tuple[str, int | None]:
        if not record.get("pid"):
            return "created", None
        child = self._children.get(record["id"])
        if child is not None:
            child.poll()
        if is_same(record["pid"], record["ticks"], record["boot"], record["id"]):
            facts = stat(record["pid"])
            return ("paused" if facts and facts[0] == "T" else "running"), None
        try:
            return "exited", int((self._folder(record["id"]) / "exit").read_text())
        except (OSError, ValueError):
            return "exited", 137

    def events(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        """Changes made through this engine, and exits, by waiting on process descriptors; no polling of processes."""
        watched: dict[int, tuple[str, int]] = {}
        poller = select.poll()
        poller.register(self._wake_read, select.POLLIN)
        self._watch_all(poller, watched)
        yield "", ""
        try:
            while not stop.is_set():
                for descriptor, _ in poller.poll(500):
                    if stop.is_set():
                        return  # what there is to read is for the next one who looks
                    if descriptor == self._wake_read:
                        with contextlib.suppress(BlockingIOError):
                            os.read(descriptor, 65536)
                        with self._lock:
                            changed, self._changed = list(dict.fromkeys(self._changed)), []
                        self._watch_all(poller, watched)
                        yield from ((container, "") for container in changed)
                    else:
                        container, _ = watched.pop(descriptor)
                        poller.unregister(descriptor)
                        os.close(descriptor)
                        yield container, ""
        finally:
            for descriptor in watched:
                os.close(descriptor)

    def _watch_all(self, poller: select.poll, watched: dict[int, tuple[str, int]]) -> None:
        """`watched` holds (container, pid) by descriptor: a run that began before the end of the one before it was told
        has a pid of its own."""
        for container in self.list():
            if container.pid and (container.id, container.pid) not in watched.values():
                try:
                    descriptor = os.pidfd_open(container.pid)
                except OSError:
                    self._tell(container.id)
                    continue
                watched[descriptor] = container.id, container.pid
                poller.register(descriptor, select.POLLIN)

    # -- acting ------------------------------------------------------------------------------------------------

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",
        defaults: Collection[str] = (),
    ) -> str:
        with self._lock:
            if any(c.name == name for c in self.list()):
                raise EngineError(f"create {name}", "the name is taken", "another container_name", "name_taken")
            container = os.urandom(32).hex()
            self._folder(container).mkdir(mode=0o700)
            live = {k: v for k, v in spec.items() if k in LIVE and k != "container_name"}
            self._write(
                {
                    "id": container,
                    "name": name,
                    "spec": {**spec},
                    "labels": {**labels},
                    "live": live,
                    "created_at": stamp(time.time()),
                }
            )
            return container

    def start(self, container: str) -> None:
        record = self._record(container)
        if self._state(record)[0] in ("running", "paused"):
            raise EngineError(f"start {record['name']}", "it already started", kind="conflict")
        (self._folder(container) / "exit").unlink(missing_ok=True)
        command, environment = self._command(record)
        with (self._folder(container) / "log").open("ab") as log:
            log_from = log.tell()
            child = subprocess.Popen(
                ["/bin/sh", "-c", SUPERVISE, "rorg", *command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
                cwd=self._cwd(record),
            )
        self._children[container] = child
        facts = stat(child.pid)
        self._write(
            {
                **record,
                "pid": child.pid,
                "log_from": log_from,
                "ticks": facts[2] if facts else 0,
                "boot": boot_id(),
                "started_at": stamp(time.time()),
            }
        )

    def _command(self, record: Mapping[str, Any]) -> tuple[Sequence[str], Mapping[str, str]]:
        spec = record["spec"]
        path = os.environ.get("PATH", os.defpath)
        folders = self._image_path(spec["image"])
        environment = {
            "HOME": os.environ.get("HOME", "/"),
            "LANG": os.environ.get("LANG", "C.UTF-8"),
            "PATH": os.pathsep.join([*folders, path]),
            **spec.get("environment", {}),
            MARK: record["id"],
            "RORG_EXIT": str(self._folder(record["id"]) / "exit"),
        }
        command = [*spec.get("entrypoint", []), *spec.get("command", [])]
        program = command[0] if command else ""
        if shutil.which(program, path=environment["PATH"]) is None:
            raise EngineError(
                f"start {record['name']}",
                f"no program '{program}' on this machine",
                "`rorg build`, or --engine docker",
                "missing_image",
            )
        return command, environment

    def _image_path(self, image: str) -> Sequence[str]:
        """Folders of programs that an image of the tree stands for here; `rorg build` notes them."""
        images: Mapping[str, Sequence[str]] = read_json(self.directory.parent / "process-images.json") or {}
        return images.get(image, ())

    def _signal(self, container: str, number: int) -> bool:
        record = self._record(container)
        return bool(record.get("pid")) and signal_group(
            record["pid"], record["ticks"], record["boot"], container, number
        )

    def pause(self, container: str) -> None:
        self._need(container, "pause", "running")
        self._signal(container, signal.SIGSTOP)
        self._await(container, "paused", 2.0)

    def resume(self, container: str) -> None:
        self._need(container, "resume", "paused")
        self._signal(container, signal.SIGCONT)
        self._await(container, "running", 2.0)

    def _need(self, container: str, verb: str, state: str) -> None:
        record = self._record(container)
        if (now := self._state(record)[0]) != state:
            raise EngineError(f"{verb} {record['name']}", f"it is {now}, not {state}", kind="conflict")

    def _await(self, container: str, state: str, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        record = self._record(container)
        while (now := self._state(record)[0]) != state:
            if now == "exited" or time.monotonic() > deadline:
                raise EngineError(f"have {record['name']} {state}", f"it is {now}", kind="conflict")
            time.sleep(0.002)
        self._tell(container)

    def stop(self, container: str, signal_name: str, grace: float) -> None:
        """Signals of a stopped group are delivered when it continues: first the signal, then SIGCONT."""
        record = self._record(container)
        if not record.get("pid"):
            return
        for name, seconds in stop_sequence(signal_name, grace):
            number = signal_number(name)
            if not self._signal(container, number):
                break
            self._signal(container, signal.SIGCONT)
            if self._ended(record, seconds):
                break
        self._tell(container)

    def signal(self, container: str, name: str) -> None:
        self._signal(container, signal.Signals[name].value)

    def _ended(self, record: Mapping[str, Any], seconds: float) -> bool:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if self._state(record)[0] == "exited" and not members(record["pid"], record["id"]):
                return True
            time.sleep(0.005)
        return False

    def remove(self, container: str, volumes: bool = False) -> None:
        try:
            record = self._record(container)
        except EngineError:
            return
        if self._state(record)[0] in ("running", "paused"):
            raise EngineError(f"remove {record['name']}", "it runs", "to stop it first", "conflict")
        self._children.pop(container, None)
        shutil.rmtree(self._folder(container), ignore_errors=True)
        self._tell(container)

    def rename(self, container: str, name: str) -> None:
        self._write({**self._record(container), "name": name})

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        record = self._record(container)
        self._write({**record, "live": {**record["live"], **options}})

    def logs(self, container: str, follow: bool, tail: int | None) -> Iterator[bytes]:
        self._record(container)
        return read_log(self._folder(container) / "log", follow, tail)

    def log_since(self, container: str, place: str) -> tuple[bytes, str]:
        """The place is an offset in its log, behind the last whole line: a line that is being written comes again."""
        offset = int(place or self._record(container).get("log_from", 0))
        text = read_log_from(self._folder(container) / "log", offset)
        return text, str(offset + text.rfind(b"\n") + 1)

    def exec(self, container: str, command: Sequence[str], timeout: float) -> tuple[int, bytes]:
        record = self._record(container)
        _, environment = self._command(record)
        try:
            done = subprocess.run(
                command,
                env=environment,
                cwd=self._cwd(record),
                timeout=timeout,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
        except subprocess.TimeoutExpired:
            return 124, f"no end within {timeout:g} s".encode()
        except OSError as error:
            return 127, str(error).encode()
        return done.returncode, done.stdout

    def _cwd(self, record: Mapping[str, Any]) -> str:
        return folder if os.path.isdir(folder := record["spec"].get("working_dir") or "") else "/"

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        """One look at the process table for all. CPU of ended children is lost with them, as in ps."""
        sessions = {c.pid: c.id for c in containers if c.pid}
        totals: dict[str, list[float]] = {c: [0.0, 0] for c in sessions.values()}
        for entry in os.scandir("/proc"):
            facts = stat(int(entry.name)) if entry.name.isdigit() else None
            if facts and facts[1] in sessions:
                totals[sessions[facts[1]]][0] += facts[3]
                totals[sessions[facts[1]]][1] += facts[4]
        return {c: Usage(cpu, int(memory)) for c, (cpu, memory) in totals.items()}
