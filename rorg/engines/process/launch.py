"""Starting a container's program, and running a command beside it: with which words, environment and folder."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import IO, Any

from rorg.engines.process.program import check_program
from rorg.engines.process.records import Record, Records
from rorg.engines.process.table import MARK, await_program, boot_id, stat
from rorg.errors import EngineError
from rorg.host.commands import TURN, Exceeded, Output, end, listen
from rorg.model.units import stamp
from rorg.store.files import open_private
from rorg.store.state_dir import read_json

SUPERVISE = (
    'trap : INT TERM HUP QUIT; "$@"; code=$?; umask 077; '
    'echo $code > "$RORG_EXIT.new" && mv "$RORG_EXIT.new" "$RORG_EXIT"'
)
"""The shell that leads a container's session. It outlives the signals of its group until the service has ended, then
writes the exit code in one step. The service runs in the foreground: a shell's background jobs ignore SIGINT."""

UMASK = 0o022
"""Of services, as in a container: whatever rorg's own is."""
OWN = frozenset(("NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC", "LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES"))
"""What systemd says to rorg alone."""
Child = subprocess.Popen[bytes]


def hear_signals() -> None:
    """What a process ignores is ignored by all that it starts, and a shell ignores SIGINT for what it runs in the
    background: services would not hear their stop signal. What has a handler begins anew in a child."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_IGN:
                signal.signal(number, lambda *_: None)


def launch(records: Records, record: Record) -> dict[str, Any]:
    """Begins a run, and returns the record with what tells this run from others."""
    container = record["id"]
    (records.folder(container) / "exit").unlink(missing_ok=True)
    command = [*record["spec"].get("entrypoint", []), *record["spec"].get("command", [])]
    environment = _environment(records, record)
    check_program(record["name"], folder_of(record), command, environment["PATH"])
    with open(_log_of(records, record), "ab") as log:
        log_from = log.tell()
        child = _supervised(record, command, environment, log)
    records.children[container] = child
    await_program(child, container)
    facts = stat(child.pid)
    return {
        **record,
        "pid": child.pid,
        "log_from": log_from,
        "ticks": facts[2] if facts else 0,
        "boot": boot_id(),
        "started_at": stamp(time.time()),
    }


def _supervised(record: Record, command: Sequence[str], environment: dict[str, str], log: IO[bytes]) -> Child:
    """The shell that leads the run. Raises EngineError."""
    try:
        return subprocess.Popen(
            ["/bin/sh", "-c", SUPERVISE, "rorg", *command],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
            cwd=folder_of(record),
            umask=UMASK,
        )
    except OSError as error:
        why = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        raise EngineError(f"start {record['name']}", why, "fixing that") from error


def _log_of(records: Records, record: Record) -> int:
    """A descriptor of its log. Raises EngineError."""
    try:
        return open_private(records.log(record["id"]), os.O_WRONLY | os.O_APPEND)
    except OSError as error:
        raise EngineError(f"start {record['name']}", f"{error.filename}: {error.strerror}", "moving it") from error


def run_beside(
    records: Records, record: Record, command: Sequence[str], timeout: float, stop: threading.Event | None = None
) -> tuple[int, bytes]:
    """Exit code and output of a command in the container's environment; see Inspection.exec. 127 where there is no such
    program."""
    try:
        child = subprocess.Popen(
            command,
            env=_environment(records, record),
            cwd=folder_of(record),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            umask=UMASK,
        )
    except OSError as error:
        return 127, str(error).encode()
    output = Output(timeout, stop)
    try:
        return listen(child, output), output.text()
    except Exceeded as why:
        end(child, signal.SIGKILL)
        return why.code, output.text(why)


def run_attached(records: Records, record: Record, command: Sequence[str], stdin: bool) -> int:
    """Runs a command in the container's environment, with our own outputs and terminal; see Access.attach. Ctrl-C and
    what else the terminal says is the command's; what we are told goes on to it."""
    environment = _environment(records, record)
    told: list[int] = []
    # What is ignored would be ignored by the command too; a handler is not passed on.
    before = {n: signal.signal(n, lambda *_: None) for n in (signal.SIGINT, signal.SIGQUIT)}
    before[signal.SIGTERM] = signal.signal(signal.SIGTERM, lambda number, _: told.append(number))
    try:
        child = subprocess.Popen(
            command,
            executable=shutil.which(command[0], path=environment["PATH"]) or command[0],
            env=environment,
            cwd=folder_of(record),
            stdin=None if stdin else subprocess.DEVNULL,
            umask=UMASK,
        )
        while True:
            try:
                code = child.wait(TURN)
                return code if code >= 0 else 128 - code
            except subprocess.TimeoutExpired:
                while told:
                    child.send_signal(told.pop())
    except (FileNotFoundError, PermissionError) as error:
        return 127 if isinstance(error, FileNotFoundError) else 126
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _environment(records: Records, record: Record) -> dict[str, str]:
    """Folders of programs that an image of the tree stands for come first in PATH; `rorg build` notes them."""
    path, spec = os.environ.get("PATH", os.defpath), record["spec"]
    return {
        **_inherited(spec.get("inherit_environment", ())),
        "HOME": os.environ.get("HOME", "/"),
        "LANG": os.environ.get("LANG", "C.UTF-8"),
        "PATH": os.pathsep.join([*_image_path(records, spec["image"]), path]),
        **spec.get("environment", {}),
        MARK: record["id"],
        "RORG_EXIT": str(records.folder(record["id"]) / "exit"),
    }


def _inherited(patterns: Sequence[str]) -> dict[str, str]:
    """What a service asks for of the environment of this rorg."""
    return {
        name: value
        for name, value in os.environ.items()
        if name not in OWN and any(fnmatchcase(name, pattern) for pattern in patterns)
    }


def _image_path(records: Records, image: str) -> list[str]:
    noted = (read_json(records.directory.parent / "process-images.json") or {}).get(image)
    return [str(folder) for folder in noted] if isinstance(noted, list) else []


def folder_of(record: Record) -> str:
    """The working directory of a container's programs."""
    return str(record["spec"].get("working_dir") or "/")
