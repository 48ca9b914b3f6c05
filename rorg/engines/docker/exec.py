"""Runs a command in a container, and ends it when it takes too long."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rorg.engines.docker.answers import Frames
from rorg.engines.docker.client import Client
from rorg.host.commands import Exceeded, Output

MARK = "RORG_EXEC"
"""Environment variable that marks a command and everything that it started."""
STARTING = 2.0
"""Seconds that the engine may take, besides the command's own time, to report its end."""
ENDING = 2.0
"""Seconds for which rorg tries to end a command that took too long."""
NOT_BEGUN = (126, 127)
"""Exit codes of a command that did not start."""
LAST_LINE = re.compile(rb"(?<=\n)Error: read unixpacket \S+: read: connection reset by peer\n\Z")
"""What Podman may add to the reason why a command did not start."""
KILL = """for f in /proc/[0-9]*/environ; do
while IFS= read -r line || [ -n "$line" ]; do case $line in *%s*) p=${f#/proc/}; kill -9 ${p%%/environ};; esac; done <$f
done 2>/dev/null"""
"""Kills the processes with a mark, in any shell, without another program: its `read` skips NULs."""


def run(client: Client, container: str, command: Sequence[str], output: Output, local: bool) -> tuple[int, bytes]:
    """Run a command and return its exit code and output; see Inspection.exec. `local`: the engine's processes are those
    of this machine. Raises the client's errors, also if the engine itself takes too long."""
    mark = f"{MARK}={uuid.uuid4().hex}"
    made = _create(client, container, command, mark, output.timeout)
    try:
        _listen(client, made, output)
        code = int(inspect(client, made)["ExitCode"] or 0)
        return code, LAST_LINE.sub(b"", output.text()) if code in NOT_BEGUN else output.text()
    except Exceeded as why:
        end(client, container, made, mark, local)
        return why.code, output.text(why)


def _create(client: Client, container: str, command: Sequence[str], mark: str, timeout: float) -> str:
    said = {"Cmd": list(command), "AttachStdout": True, "AttachStderr": True, "Env": [mark] if mark else []}
    return str(client.post(f"/containers/{container}/exec", said, timeout + STARTING)["Id"])


def inspect(client: Client, made: str) -> dict[str, Any]:
    """The state of a command."""
    return dict(client.get(f"/exec/{made}/json", STARTING))


def _listen(client: Client, made: str, output: Output) -> None:
    """Start a command, and read its output until it ends. Raises Exceeded."""
    frames, patience = Frames(), output.left() + STARTING
    with client.stream("POST", f"/exec/{made}/start", {"Tty": False, "Detach": False}, patience) as stream:
        for chunk in stream.in_turns(output.turn):
            for text in frames.texts(chunk):
                output.take(text)


def end(client: Client, container: str, made: str, mark: str, local: bool) -> None:
    """End a command with everything that it started. Waits briefly for one that has not started yet."""
    deadline = time.monotonic() + ENDING
    while time.monotonic() < deadline:
        state = inspect(client, made)
        if state["ExitCode"] is not None and not state["Running"]:
            return
        if not local:
            kill = _create(client, container, ["/bin/sh", "-c", KILL % mark], "", STARTING)
            with contextlib.suppress(Exceeded):
                _listen(client, kill, Output(STARTING))
        else:
            for pid in (int(entry.name) for entry in os.scandir("/proc") if entry.name.isdigit()):
                _kill(pid, container, mark, known=pid == state["Pid"])
        time.sleep(0.02)


def _kill(pid: int, container: str, mark: str, known: bool) -> None:
    """Kill a process that carries the mark; or the one that is `known` by its number as the command, if it is in the
    container. Its descriptor is open during the check, so that the number cannot come to mean another process."""
    if not known and not _marked(pid, mark):
        return
    with contextlib.suppress(OSError):
        descriptor = os.pidfd_open(pid)
        try:
            if _marked(pid, mark) or (known and container in Path(f"/proc/{pid}/cgroup").read_text()):
                signal.pidfd_send_signal(descriptor, signal.SIGKILL)
        finally:
            os.close(descriptor)


def _marked(pid: int, mark: str) -> bool:
    try:
        return mark.encode() in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError:
        return False
