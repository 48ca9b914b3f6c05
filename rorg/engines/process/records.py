"""The records on disk, one folder for each container: the state of each, and signals that change it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rorg.engines.process.table import Run, has_begun, is_same, known, members, signal_group, signal_one, stat
from rorg.engines.protocol import stop_sequence
from rorg.errors import EngineError
from rorg.model.signals import signal_number
from rorg.store.files import make_directory, read_state, write_atomic

Record = Mapping[str, Any]
"""id, name, spec, labels, live and created_at; after a start also pid, ticks, boot, log_from and started_at."""
EXIT, ENDED, STOPPING = "exit", "exit.new", "stopping"
"""Files of a run: its exit code, when all its processes have ended; the same when its program has; the pid of the rorg
that is stopping it."""
EVERYONE = (signal.SIGSTOP, signal.SIGCONT)
"""Signals that reach every process of a run; all others are for its program's group."""
CLEARED = 5.0
"""Seconds for the processes that a killed leader left to end after SIGKILL."""
LISTS = ("entrypoint", "command", "inherit_environment")
FORMS = {"name": str, "spec": dict, "labels": dict, "live": dict}
STARTED = {"pid": int, "ticks": int, "boot": str, "log_from": int, "started_at": str}
MOST_PID = 1 << 22
"""Of Linux."""


class Records:
    """`children` are the leaders that this rorg itself started: the kernel keeps their exit codes until they are waited
    for."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory.absolute()  # programs have another working directory
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        make_directory(directory)

    def ids(self) -> list[str]:
        """Ids of all records. Raises Unreachable."""
        try:
            return sorted(p.name for p in self.directory.iterdir() if os.path.lexists(p / "record.json"))
        except OSError as error:
            known(error, str(self.directory))
            raise

    def folder(self, container: str) -> Path:
        return self.directory / container

    def log(self, container: str) -> Path:
        return self.folder(container) / "log"

    def read(self, container: str) -> dict[str, Any]:
        """Raises EngineError: of kind gone if it is missing, other if it is not a record; Unreachable if it cannot be
        read at the moment."""
        path = self.folder(container) / "record.json"
        if not os.path.lexists(path):
            raise EngineError(f"find {container}", "no such container", kind="gone")
        record = _json(path)
        if not isinstance(record, dict) or record.get("id") != container or not _whole(record):
            raise EngineError(
                f"find {container}", f"{path} cannot be read", "to end its processes and remove its folder"
            )
        return record

    def write(self, record: Record) -> None:
        """Raises EngineError of kind no_space if the disk does not take it."""
        try:
            write_atomic(self.folder(record["id"]) / "record.json", json.dumps(record), mode=0o600)
        except OSError as error:
            why = error.strerror or str(error)
            raise EngineError(
                f"write the record of {record['name']}", why, "to free space there", "no_space"
            ) from error

    def state(self, record: Record) -> tuple[str, int | None]:
        """(created, running, paused or exited; the exit code of the last run). Raises Unreachable."""
        if not record.get("pid"):
            return "created", None
        child = self.children.get(record["id"])
        if child is not None:
            child.poll()
        if is_same(_run(record)):
            if not has_begun(record["pid"]):
                return "created", None  # if its rorg was killed, it never will
            facts = stat(record["pid"])
            return ("paused" if facts and facts.state == "T" else "running"), None
        try:
            return "exited", int(read_state(self.folder(record["id"]) / EXIT))
        except OSError as error:
            known(error, f"the exit code of {record['id'][:12]}")
        except ValueError:
            pass
        return "exited", 137

    def send(self, record: Record, number: int) -> bool:
        """Send a signal to a run; False if nothing of it is left. SIGKILL spares the leader, which ends with the last
        process and writes down the exit code."""
        if not record.get("pid"):
            return False
        run = _run(record)
        grouped = number != signal.SIGKILL and signal_group(run, number)
        if grouped and number not in EVERYONE:
            return True
        return self._send_each(run, number, grouped) or grouped or is_same(run)

    def _send_each(self, run: Run, number: int, grouped: bool) -> bool:
        """Send a signal to each process of a run besides its leader; `grouped`: its group has received it. False if
        there is none."""
        left = members(run)
        for pid, facts in left.items():
            if not grouped or facts.group != run.leader:
                signal_one(pid, facts.started, number)
        return bool(left)

    def switch(self, record: Record, verb: str, number: int, before: str, after: str) -> None:
        """Send a signal that changes the state of a container, and return when it has changed. Raises EngineError
        (conflict)."""
        if (now := self.state(record)[0]) != before:
            raise EngineError(f"{verb} {record['name']}", f"it is {now}, not {before}", kind="conflict")
        self.send(record, number)
        deadline = time.monotonic() + 2.0
        while (now := self.state(record)[0]) != after:
            if now == "exited" or time.monotonic() > deadline:
                raise EngineError(f"have {record['name']} {after}", f"it is {now}", kind="conflict")
            time.sleep(0.002)

    def end(self, record: Record, name: str, grace: float) -> None:
        """End a run. A stopped group receives signals only when it continues: so first the signal, then SIGCONT. A
        signal that the kernel does not have is skipped. Raises EngineError if something of it still runs at the
        end."""
        note, began = self.folder(record["id"]) / STOPPING, time.monotonic()
        write_atomic(note, str(os.getpid()), mode=0o600)
        try:
            for step, until in stop_sequence(name, grace):
                try:
                    number = signal_number(step)
                except ValueError:
                    continue
                if number == signal.SIGKILL:  # also for the leader, which kills what begins meanwhile
                    note.unlink(missing_ok=True)
                if not self.send(record, number):
                    break
                self.send(record, signal.SIGCONT)
                if self._ended(record, number, began + until):
                    break
        finally:
            note.unlink(missing_ok=True)
        if self.state(record)[0] != "exited":
            raise EngineError(
                f"stop {record['name']}", "it did not end after SIGKILL", "`dmesg` for a device that hangs"
            )
        self.clear(record)

    def _ended(self, record: Record, number: int, until: float) -> bool:
        """Return whether everything of a run ends until this monotonic time. What is outside of its program's group,
        such as a node of a launcher, receives the signal when the program has ended: until then that is the program's
        task."""
        ended, received = self.folder(record["id"]) / ENDED, number == signal.SIGKILL
        while time.monotonic() < until:
            if self.state(record)[0] == "exited":
                return True
            if not received and ended.exists():
                self._send_each(_run(record), number, grouped=True)
                received = True
            time.sleep(0.005)
        return False

    def clear(self, record: Record) -> None:
        """End what is left of a run whose leader has ended. Raises EngineError if something does not end."""
        deadline = time.monotonic() + CLEARED
        while record.get("pid") and self._send_each(_run(record), signal.SIGKILL, grouped=False):
            if time.monotonic() > deadline:
                pids = " ".join(map(str, members(_run(record))))
                raise EngineError(f"end {record['name']}", f"it left processes that do not end: {pids}", "`dmesg`")
            time.sleep(0.005)

    def clear_killed(self, container: str) -> None:
        """Kill what is left if the leader of a run was killed; otherwise it has done so itself."""
        record = self.read(container)
        if self.state(record)[0] == "exited" and not (self.folder(container) / EXIT).exists():
            self._send_each(_run(record), signal.SIGKILL, grouped=False)


def _run(record: Record) -> Run:
    return Run(record["pid"], record["ticks"], record["boot"], record["id"])


def _json(path: Path) -> Any:
    """The content of a file, or None if it has none. Raises Unreachable if it cannot be read at the moment."""
    try:
        return json.loads(read_state(path))
    except OSError as error:
        known(error, str(path))
    except (ValueError, RecursionError):
        pass
    return None


def _whole(record: Record) -> bool:
    """Whether this is a record that write() could have written."""
    sound = all(isinstance(record.get(key), form) for key, form in FORMS.items())
    sound = sound and all(isinstance(text, str) for text in record["labels"].values()) and _startable(record["spec"])
    if not sound or "pid" not in record:
        return sound
    return all(type(record.get(key)) is form for key, form in STARTED.items()) and 0 < record["pid"] <= MOST_PID


def _startable(spec: Mapping[str, Any]) -> bool:
    """Whether the fields of a spec that a start needs have the right types."""
    environment, words = spec.get("environment", {}), (spec.get(key, []) for key in LISTS)
    return (
        isinstance(spec.get("image"), str)
        and isinstance(environment, dict)
        and all(isinstance(text, str) for text in environment.values())
        and all(isinstance(listed, list) and all(isinstance(word, str) for word in listed) for listed in words)
    )
