"""Starts the program of a container, or a command beside it: with which words, environment and folder."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from typing import IO, Any

from rorg.engines.process import lead
from rorg.engines.process.records import ENDED, EXIT, Record, Records
from rorg.engines.process.table import EXEC, MARK, await_program, boot_id, facts_of, marked, pids, signal_one, stat
from rorg.errors import EngineError
from rorg.host.commands import TURN, Exceeded, Output, end, listen
from rorg.model.units import stamp
from rorg.store.files import open_private
from rorg.store.state_dir import read_json

SUPERVISE = """trap : HUP INT QUIT USR1 USR2 ALRM TERM
exec 3>&2 2> /dev/null; (exec "$@" 2>&3 3>&-)
code=$?; umask 077; echo $code > "$RORG_EXIT.new"
while left=; read -r left < /proc/$$/task/$$/children; [ "$left" ]; do
  by=; read -r by < "${RORG_EXIT%exit}stopping"
  [ "$by" ] && [ -d "/proc/$by" ] || kill -KILL $left || break
  command -p sleep 0.02
done
mv "$RORG_EXIT.new" "$RORG_EXIT"
"""
"""The shell that leads a container's session, and adopts the processes of it that lose their parent. It survives the
signals of its group until the service has ended. Then it kills what is left, unless an rorg that lives is stopping the
run and gives it time. It writes the exit code in one step, when nothing is left. The service runs in the foreground,
because background jobs of a shell ignore SIGINT. Its own messages, such as "Killed", do not go into the log."""

UMASK = 0o022
"""Of services, as in a container; rorg's own does not matter."""
OWN = frozenset(("NOTIFY_SOCKET", "WATCHDOG_PID", "WATCHDOG_USEC", "LISTEN_PID", "LISTEN_FDS", "LISTEN_FDNAMES"))
"""Variables that systemd sets for rorg alone."""
Child = subprocess.Popen[bytes]
MOST_OF_A_LINE = 256
"""Bytes of the first line of a script that the kernel reads."""


def hear_signals() -> None:
    """Stop ignoring signals: children inherit that a signal is ignored, as SIGINT is in the background jobs of a shell,
    and would not receive their stop signal. They do not inherit a handler."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
            if signal.getsignal(number) is signal.SIG_IGN:
                signal.signal(number, lambda *_: None)


@contextmanager
def launched(records: Records, record: Record) -> Iterator[dict[str, Any]]:
    """Begin a run: yield the record with what distinguishes this run from others, and start the program when the caller
    has written that down. If the caller fails, the program does not start. Raises EngineError."""
    container = record["id"]
    for name in (EXIT, ENDED):
        (records.folder(container) / name).unlink(missing_ok=True)
    command = [*record["spec"].get("entrypoint", []), *record["spec"].get("command", [])]
    environment = _environment(records, record)
    check_program(record["name"], folder_of(record), command, environment["PATH"])
    with open(_log_of(records, record), "ab") as log:
        log_from = log.tell()
        child = _supervised(record, command, environment, log)
    assert child.stdin is not None
    facts = stat(child.pid)
    try:
        yield {
            **record,
            "pid": child.pid,
            "log_from": log_from,
            "ticks": facts.started if facts else 0,
            "boot": boot_id(),
            "started_at": stamp(time.time()),
        }
    except BaseException:
        child.stdin.close()  # without a word the leader ends
        child.wait()
        raise
    records.children[container] = child
    with suppress(BrokenPipeError), child.stdin as gate:  # if the leader was killed, its state says so
        gate.write(b"\n")
    await_program(child, container)


def _supervised(record: Record, command: Sequence[str], environment: dict[str, str], log: IO[bytes]) -> Child:
    """Start the shell that leads the run. Raises EngineError."""
    try:
        return subprocess.Popen(
            [sys.executable, "-I", "-S", lead.__file__, "/bin/sh", "-c", SUPERVISE, "rorg", *command],
            stdin=subprocess.PIPE,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
            cwd=folder_of(record),
            umask=UMASK,
        )
    except OSError as error:
        why = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        raise EngineError(f"start {record['name']}", why) from error


def _log_of(records: Records, record: Record) -> int:
    """A descriptor of its log. Raises EngineError."""
    try:
        return open_private(records.log(record["id"]), os.O_WRONLY | os.O_APPEND)
    except OSError as error:
        raise EngineError(f"start {record['name']}", f"{error.filename}: {error.strerror}", "to move it") from error


def run_beside(
    records: Records, record: Record, command: Sequence[str], timeout: float, stop: threading.Event | None = None
) -> tuple[int, bytes]:
    """Run a command in the container's environment and return its exit code and output; see Inspection.exec. The code
    is 127 if there is no such program."""
    mark = uuid.uuid4().hex
    try:
        child = subprocess.Popen(
            command,
            env=_environment(records, record) | {EXEC: mark},
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
        for pid, facts in facts_of(pid for pid in pids() if marked(pid, EXEC, mark)).items():
            signal_one(pid, facts.started, signal.SIGKILL)
        return why.code, output.text(why)


def run_attached(records: Records, record: Record, command: Sequence[str], stdin: bool) -> int:
    """Run a command in the container's environment, with our own outputs and terminal; see Access.attach. Ctrl-C
    reaches the command through the terminal; signals to this process are passed on to it."""
    environment = _environment(records, record)
    told: list[int] = []
    # The command would inherit an ignored signal, but not a handler.
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
    """Folders of programs that an image of the tree stands for come first in PATH; `rorg build` records them."""
    path, spec = os.environ.get("PATH", os.defpath), record["spec"]
    return {
        **_inherited(spec.get("inherit_environment", ())),
        "HOME": os.environ.get("HOME", "/"),
        "LANG": os.environ.get("LANG", "C.UTF-8"),
        "PATH": os.pathsep.join([*_image_path(records, spec["image"]), path]),
        **spec.get("environment", {}),
        MARK: record["id"],
        "RORG_EXIT": str(records.folder(record["id"]) / EXIT),
    }


def _inherited(patterns: Sequence[str]) -> dict[str, str]:
    """The variables of rorg's own environment that a service asks for."""
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


def check_program(service: str, folder: str, command: Sequence[str], path: str) -> None:
    """Check before a start whether the program can run: a shell would only say 127 afterwards. Raises EngineError if
    its directory or program is missing or not permitted."""
    what, program = f"start {service}", command[0] if command else ""
    if not os.path.isdir(folder):
        raise EngineError(what, f"no directory {folder}", "to create it, or use another `working_dir`")
    if not os.access(folder, os.X_OK):
        raise EngineError(what, f"rorg has no permission for {folder}", f"chmod +x {folder}", "forbidden")
    if "/" not in program:
        executable = shutil.which(program, path=path)
        if executable is None:
            why = f"no program '{program}' on this machine" if program else "no program is named"
            raise EngineError(what, why, "`rorg build`, or --engine docker", "missing_image")
    else:
        executable = os.path.normpath(os.path.join(folder, program))
        if not os.path.isfile(executable):
            raise EngineError(
                what, f"no program {executable}", "to create it, or use another `command`", "missing_image"
            )
        if not os.access(executable, os.X_OK):
            raise EngineError(what, f"{executable} is not executable", f"chmod +x {executable}", "forbidden")
    interpreter = _interpreter(executable)
    if interpreter.startswith("/") and not os.access(interpreter, os.X_OK):
        raise EngineError(
            what, f"{executable} is a script for {interpreter}, which is not installed", "to install that"
        )


def _interpreter(path: str) -> str:
    """The interpreter in the first line of a script; empty for other programs, and if it cannot be read."""
    try:
        with open(path, "rb") as file:
            line = file.readline(MOST_OF_A_LINE)
    except OSError:
        return ""
    words = line[2:].split() if line.startswith(b"#!") else []
    return os.fsdecode(words[0]) if words else ""
