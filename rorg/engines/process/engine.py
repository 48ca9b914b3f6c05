"""The built-in engine: each service is a tree of processes of this machine. Needs nothing, isolates nothing.

A container is a record on disk. While it runs it is also a tree of processes below a small shell, which waits for the
service, ends what it left, and writes down how it ended, so that a restart of rorg loses nothing.
"""

from __future__ import annotations

import builtins
import contextlib
import os
import shutil
import signal
import threading
import time
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rorg.core.observed import LABEL_OWNER, Container, from_labels
from rorg.engines.log_lines import LogLine, Reading
from rorg.engines.places import copy
from rorg.engines.process.events import Changes
from rorg.engines.process.launch import folder_of, hear_signals, launched, run_attached, run_beside
from rorg.engines.process.log import follow_lines, read_lines, read_log_from, trim_log
from rorg.engines.process.records import Record, Records
from rorg.engines.process.table import facts_of, leader_of, pids
from rorg.engines.protocol import NONE, Usage
from rorg.errors import EngineError, RorgError
from rorg.model.engines import ENGINES
from rorg.model.options import LIVE
from rorg.model.units import stamp


class ProcessEngine:
    """Services as sessions of plain processes; see Engine."""

    name = "process"
    local, address = True, ""
    capabilities = ENGINES[name]

    def __init__(self, owner: str, directory: Path) -> None:
        hear_signals()
        self.owner = owner
        self.records = Records(directory)
        self.changes = Changes(self.list, self.inspect, self._trim_logs)
        self._naming = threading.Lock()
        self._beginning: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
        """Container -> held while a run begins, so that its processes are not taken for what the previous run left."""
        self._names: dict[str, str] | None = None
        """Container -> name, read once: only the rorg that owns the robot creates and renames."""

    def ping(self) -> str:
        return "built in"

    def close(self) -> None:
        pass

    def _write(self, record: Record) -> None:
        self.records.write(record)
        if self._names is not None:
            self._names[record["id"]] = record["name"]
        self.changes.tell(record["id"])

    def _trim_logs(self) -> None:
        for container in self.records.ids():
            trim_log(self.records.log(container))

    # -- observing ---------------------------------------------------------------------------------------------

    def list(self, known: Mapping[str, Container] = NONE) -> builtins.list[Container]:
        return [c for i in self.records.ids() if (c := self.inspect(i)) is not None]

    def inspect(self, container: str) -> Container | None:
        try:
            record = self.records.read(container)
        except EngineError as error:
            if error.kind == "gone":
                return None
            return Container(container, container[:12], service="", state="dead", error=error.why)
        labels = record["labels"]
        if labels.get(LABEL_OWNER) != self.owner:
            return None
        state, code = self.records.state(record)
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

    def events(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        for container, state in self.changes.follow(stop):
            for each in [container] if container else self.records.ids():
                with self._beginning[each], contextlib.suppress(RorgError):
                    self.records.clear_killed(each)
            yield container, state

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        """One look at the process table for all. The CPU time of ended children is lost, as in ps."""
        leaders = {c.pid: c.id for c in containers if c.pid}
        totals: dict[str, tuple[float, int]] = dict.fromkeys(leaders.values(), (0.0, 0))
        table = facts_of(pids())
        for pid, facts in table.items():
            if container := leaders.get(leader_of(pid, leaders, table)):
                cpu, memory = totals[container]
                totals[container] = cpu + facts.cpu, memory + facts.memory
        return {c: Usage(cpu, memory) for c, (cpu, memory) in totals.items()}

    # -- acting ------------------------------------------------------------------------------------------------

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",
        defaults: Collection[str] = (),
    ) -> str:
        with self._naming:
            if self._names is None:
                self._names = {c.id: c.name for c in self.list()}
            if name in self._names.values():
                raise EngineError(f"create {name}", "the name is taken", "another container_name", "name_taken")
            container = os.urandom(32).hex()
            record = {
                "id": container,
                "name": name,
                "spec": {**spec},
                "labels": {**labels},
                "live": {k: v for k, v in spec.items() if k in LIVE and k != "container_name"},
                "created_at": stamp(time.time()),
            }
            self.records.folder(container).mkdir(mode=0o700)
            try:
                self._write(record)
            except EngineError:
                self.records.folder(container).rmdir()
                raise
            return container

    def start(self, container: str) -> None:
        with self._beginning[container]:
            record = self.records.read(container)
            if self.records.state(record)[0] in ("running", "paused"):
                raise EngineError(f"start {record['name']}", "it already started", kind="conflict")
            self.records.clear(record)
            with launched(self.records, record) as run:
                self._write(run)
            self.changes.tell(container)  # only now does it run

    def pause(self, container: str) -> None:
        self.records.switch(self.records.read(container), "pause", signal.SIGSTOP, "running", "paused")
        self.changes.tell(container)

    def resume(self, container: str) -> None:
        self.records.switch(self.records.read(container), "resume", signal.SIGCONT, "paused", "running")
        self.changes.tell(container)

    def stop(self, container: str, signal: str, grace: float) -> None:
        record = self.records.read(container)
        if record.get("pid"):
            self.records.end(record, signal, grace)
            self.changes.tell(container)

    def signal(self, container: str, name: str) -> None:
        self.records.send(self.records.read(container), signal.Signals[name].value)

    def remove(self, container: str, volumes: bool = False) -> None:
        with self._beginning[container]:  # a start that is under way would write the record again
            try:
                record = self.records.read(container)
            except EngineError:
                return
            if self.records.state(record)[0] in ("running", "paused"):
                raise EngineError(f"remove {record['name']}", "it runs", "to stop it first", "conflict")
            self.records.clear(record)
            self.records.children.pop(container, None)
            shutil.rmtree(self.records.folder(container), ignore_errors=True)
        if self._names is not None:
            self._names.pop(container, None)
        self.changes.tell(container)

    def rename(self, container: str, name: str) -> None:
        self._write({**self.records.read(container), "name": name})

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        record = self.records.read(container)
        self._write({**record, "live": {**record["live"], **options}})

    # -- looking inside ----------------------------------------------------------------------------------------

    def log_lines(self, container: str, tail: int | None, since: float | None, whole: bool) -> Iterator[LogLine]:
        """Files of programs have no times, so `since` is ignored; see Capabilities."""
        self.records.read(container)
        return read_lines(self.records.log(container), tail, whole)

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        self.records.read(container)
        offset = int(place) if place.isdigit() else 0
        return follow_lines(self.records.log(container), offset, lambda: not self._alive(container), reading)

    def _alive(self, container: str) -> bool:
        inspection = self.inspect(container)
        return inspection is not None and inspection.alive

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        """The place is an offset in the log, after the last whole line: a line that is being written comes again."""
        offset = int(place or self.records.read(container).get("log_from", 0))
        for text, after in read_log_from(self.records.log(container), offset):
            yield text, str(after)

    def exec(
        self, container: str, command: Sequence[str], timeout: float, stop: threading.Event | None = None
    ) -> tuple[int, bytes]:
        return run_beside(self.records, self.records.read(container), command, timeout, stop)

    def attach(self, container: str, command: Sequence[str], terminal: bool, stdin: bool) -> int:
        return run_attached(self.records, self.records.read(container), command, stdin)

    def fetch(self, container: str, path: str, place: Path) -> None:
        copy(os.path.join(folder_of(self.records.read(container)), path), str(place))

    def put(self, container: str, source: Path, path: str) -> None:
        copy(str(source), os.path.join(folder_of(self.records.read(container)), path))
