"""Which processes of this machine are whose: identity that survives a restart of rorg and the reuse of pids."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import time
from functools import cache
from pathlib import Path

from rorg.errors import Unreachable

MARK = "RORG_CONTAINER"
"""Environment variable that every process we start inherits: the id of its container."""
BEGIN = 5.0
"""Seconds within which a program has begun, however busy the machine is."""
PROCESS_GROUP = 4
"""PIDFD_SIGNAL_PROCESS_GROUP (Linux 6.9): signal a whole group through a descriptor that cannot be reused."""
SHORT_OF = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
"""Errors that say nothing about a file or process: no descriptor or memory is left to look at it."""


def known(error: OSError, what: str) -> None:
    """Raises Unreachable for an error that leaves open what it is about; any other one tells that it is gone."""
    if error.errno in SHORT_OF:
        raise Unreachable(f"look at {what}", error.strerror or str(error), "a higher limit of open files") from error


@cache
def boot_id() -> str:
    """Identity of this boot: pids and start times mean nothing after another one."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def stat(pid: int) -> tuple[str, int, int, float, int] | None:
    """(state letter, session, start time in clock ticks since boot, CPU seconds, resident bytes); None when gone.
    Raises Unreachable."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")  # names are bytes, and cut anywhere
    except OSError as error:
        known(error, f"process {pid}")
        return None
    fields = text[text.rindex(")") + 2 :].split()
    cpu = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return fields[0], int(fields[3]), int(fields[19]), cpu, int(fields[21]) * os.sysconf("SC_PAGE_SIZE")


def is_same(pid: int, started: int, boot: str, container: str) -> bool:
    """Whether that pid is still the process that began at `started` for this container, and not dead. Start times
    have a grain of 10 ms, so the mark is looked at too."""
    found = stat(pid) if boot == boot_id() else None
    return found is not None and found[2] == started and found[0] not in "ZX" and _marked(pid, container)


def members(leader: int, container: str) -> list[int]:
    """Live processes of a container: those of its session that carry its mark. The mark is checked, so a stranger
    that got a reused number is never among them."""
    found = []
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            facts = stat(int(entry.name))
            if facts and facts[1] == leader and facts[0] not in "ZX" and _marked(int(entry.name), container):
                found.append(int(entry.name))
    return found


def _marked(pid: int, container: str) -> bool:
    try:
        environment = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError as error:
        known(error, f"process {pid}")
        return False
    return f"{MARK}={container}".encode() in environment


def await_program(child: subprocess.Popen[bytes], container: str) -> None:
    """Returns when the shell that was just started has begun its program, or has ended. Before its exec is over the
    shell has no environment to be known by: its run would be taken for ended. And a signal that comes before the exec
    of its program is over meets the handlers of the shell and is lost; a SIGSTOP then leaves the shell waiting for a
    child that cannot go on, and neither is ever paused."""
    deadline = time.monotonic() + BEGIN
    while child.poll() is None and time.monotonic() < deadline:
        if _marked(child.pid, container) and _begun(child.pid):
            return
        time.sleep(0.001)


def _begun(leader: int) -> bool:
    """Whether the shell has a child that is not the shell itself any more. True where the kernel does not tell."""
    try:
        own = Path(f"/proc/{leader}/cmdline").read_bytes()
        children = Path(f"/proc/{leader}/task/{leader}/children").read_text().split()
    except OSError:
        return not os.path.exists(f"/proc/{leader}/task/{leader}/children")
    return any(_command_line(child) not in (b"", own) for child in children)


def _command_line(pid: str) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def signal_group(leader: int, started: int, boot: str, container: str, number: int) -> bool:
    """Signals all processes of a container; False when none of them is left."""
    try:
        descriptor = os.pidfd_open(leader)
    except OSError as error:
        known(error, f"process {leader}")
        descriptor = -1
    try:
        # With the descriptor open the pid cannot come to mean another process between the check and the signal.
        if descriptor >= 0 and is_same(leader, started, boot, container):
            try:
                signal.pidfd_send_signal(descriptor, number, None, PROCESS_GROUP)
            except OSError:
                os.killpg(leader, number)
            return True
    except ProcessLookupError:
        pass
    finally:
        if descriptor >= 0:
            os.close(descriptor)
    left = members(leader, container) if boot == boot_id() else []
    for pid in left:
        _signal_one(pid, container, number)
    return bool(left)


def _signal_one(pid: int, container: str, number: int) -> None:
    try:
        descriptor = os.pidfd_open(pid)
    except OSError as error:
        known(error, f"process {pid}")
        return
    try:
        if _marked(pid, container):
            signal.pidfd_send_signal(descriptor, number)
    except OSError:
        pass
    finally:
        os.close(descriptor)
