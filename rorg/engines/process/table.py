"""Which processes belong to which container: an identity that survives a restart of rorg and the reuse of pids."""

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
"""Environment variable that every process of a container inherits: the container's id."""
BEGIN = 5.0
"""Seconds within which a program has started, however busy the machine is."""
PROCESS_GROUP = 4
"""PIDFD_SIGNAL_PROCESS_GROUP (Linux 6.9): signal a whole group through a descriptor that cannot be reused."""
SHORT_OF = (errno.EMFILE, errno.ENFILE, errno.ENOMEM)
"""Errors that say nothing about a file or process, only that no descriptor or memory is left to look at it."""


def known(error: OSError, what: str) -> None:
    """Raises Unreachable for an error that says nothing about `what`; every other error means that it is gone."""
    if error.errno in SHORT_OF:
        raise Unreachable(f"look at {what}", error.strerror or str(error), "a higher limit of open files") from error


@cache
def boot_id() -> str:
    """Identity of this boot: pids and start times have no meaning after another boot."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def stat(pid: int) -> tuple[str, int, int, float, int] | None:
    """(state letter, session, start time in clock ticks since boot, CPU seconds, resident bytes); None when gone.
    Raises Unreachable."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")  # names are bytes, cut anywhere
    except OSError as error:
        known(error, f"process {pid}")
        return None
    fields = text[text.rindex(")") + 2 :].split()
    cpu = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return fields[0], int(fields[3]), int(fields[19]), cpu, int(fields[21]) * os.sysconf("SC_PAGE_SIZE")


def is_same(pid: int, started: int, boot: str, container: str) -> bool:
    """Whether this pid is still the process that began at `started` for this container, and alive. Start times have a
    resolution of 10 ms, so the mark is checked too."""
    facts = stat(pid) if boot == boot_id() else None
    return facts is not None and facts[2] == started and facts[0] not in "ZX" and _marked(pid, container)


def members(leader: int, container: str) -> list[int]:
    """Live processes of a container: those of its session that carry its mark, so that a foreign process with a reused
    number is never among them."""
    pids = []
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            facts = stat(int(entry.name))
            if facts and facts[1] == leader and facts[0] not in "ZX" and _marked(int(entry.name), container):
                pids.append(int(entry.name))
    return pids


def _marked(pid: int, container: str) -> bool:
    try:
        environment = Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    except OSError as error:
        known(error, f"process {pid}")
        return False
    return f"{MARK}={container}".encode() in environment


def await_program(child: subprocess.Popen[bytes], container: str) -> None:
    """Return when the shell that was just started has started its program, or has ended. Before its own exec the shell
    has no environment to be recognized by, so its run would look ended. And a signal before the exec of its program
    meets the handlers of the shell and is lost; after a SIGSTOP then the shell waits for a child that cannot go on, and
    neither is ever paused."""
    deadline = time.monotonic() + BEGIN
    while child.poll() is None and time.monotonic() < deadline:
        if _marked(child.pid, container) and _begun(child.pid):
            return
        time.sleep(0.001)


def _begun(leader: int) -> bool:
    """Whether the shell has a child that is no longer the shell itself. True if the kernel does not say."""
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
    """Send a signal to all processes of a container; False if none is left."""
    try:
        descriptor = os.pidfd_open(leader)
    except OSError as error:
        known(error, f"process {leader}")
        descriptor = -1
    try:
        # While the descriptor is open the pid cannot come to mean another process.
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
