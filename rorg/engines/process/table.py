"""Which processes belong to which container: an identity that survives a restart of rorg and the reuse of pids."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import time
from collections.abc import Container, Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from rorg.engines.process import lead
from rorg.errors import Unreachable

MARK = "RORG_CONTAINER"
"""Environment variable that every process of a container inherits: the container's id."""
EXEC = "RORG_EXEC"
"""Environment variable that a command beside a service and everything that it starts inherit."""
BEGIN = 5.0
"""Seconds within which a program has started, however busy the machine is."""
EXEC_TAKES = 0.1
"""Seconds that a process may be without an environment, on a busy machine, while it becomes another program."""
PROCESS_GROUP = 4
"""PIDFD_SIGNAL_PROCESS_GROUP (Linux 6.9): signal a whole group through a descriptor that cannot be reused."""
DEAD = "ZX"
"""States of a process that has ended."""
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


class Process(NamedTuple):
    """What the kernel says of a process."""

    state: str
    """A letter, as in ps."""
    parent: int
    group: int
    started: int
    """Clock ticks since boot."""
    cpu: float
    """Seconds."""
    memory: int
    """Resident bytes."""


class Run(NamedTuple):
    """One run of a container, by the process that leads it."""

    leader: int
    started: int
    """Clock ticks since boot."""
    boot: str
    container: str


def stat(pid: int) -> Process | None:
    """None when it is gone. Raises Unreachable."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")  # names are bytes, cut anywhere
    except OSError as error:
        known(error, f"process {pid}")
        return None
    fields = text[text.rindex(")") + 2 :].split()
    cpu = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    memory = int(fields[21]) * os.sysconf("SC_PAGE_SIZE")
    return Process(fields[0], int(fields[1]), int(fields[2]), int(fields[19]), cpu, memory)


def pids() -> list[int]:
    """Numbers of all processes of this machine."""
    return [int(entry.name) for entry in os.scandir("/proc") if entry.name.isdigit()]


def facts_of(numbers: Iterable[int]) -> dict[int, Process]:
    """Those of these processes that live. Raises Unreachable."""
    return {pid: facts for pid in numbers if (facts := stat(pid)) and facts.state not in DEAD}


def leader_of(pid: int, leaders: Container[int], table: Mapping[int, Process]) -> int:
    """Return the nearest ancestor that is one of these, or the process itself; 0 if none is."""
    for _ in table:  # a number that was reused meanwhile could close a circle
        if pid in leaders:
            return pid
        if pid not in table:
            break
        pid = table[pid].parent
    return 0


def is_same(run: Run) -> bool:
    """Whether the leader of a run lives. Start times have a resolution of 10 ms, so the mark is checked too."""
    facts = stat(run.leader) if run.boot == boot_id() else None
    return facts is not None and facts.started == run.started and facts.state not in DEAD and _is_marked_leader(run)


def has_begun(leader: int) -> bool:
    """Whether a run's leader has become the shell: before that it waits for the word that its run is on record."""
    return lead.__file__ not in os.fsdecode(_command_line(str(leader))).split("\0")[:4]


def _is_marked_leader(run: Run) -> bool:
    """Whether a run's leader carries its mark. While it becomes the shell it has no environment for a moment."""
    deadline = time.monotonic() + EXEC_TAKES
    while not (environment := _environment(run.leader)) and time.monotonic() < deadline:
        time.sleep(0.001)
    return f"{MARK}={run.container}".encode() in environment


def members(run: Run) -> dict[int, Process]:
    """Live processes of a run besides its leader: all below it. If the leader was killed, those that carry the
    container's mark; commands beside a service do too. Raises Unreachable."""
    if run.boot != boot_id():
        return {}
    if is_same(run) and (below := _descendants(run.leader)) is not None:
        return facts_of(below)
    return facts_of(pid for pid in pids() if pid != run.leader and marked(pid, MARK, run.container))


def _descendants(leader: int) -> list[int] | None:
    """None if the kernel does not say."""
    found, left = list[int](), [leader]
    while left:
        pid = left.pop()
        try:
            threads = os.listdir(f"/proc/{pid}/task")
            children = [int(c) for t in threads for c in Path(f"/proc/{pid}/task/{t}/children").read_text().split()]
        except OSError as error:
            known(error, f"process {pid}")
            if pid == leader:
                return None
            continue  # it has ended, and the leader has its children
        found += children
        left += children
    return found


def marked(pid: int, name: str, value: str) -> bool:
    """Whether a process began with this variable in its environment. Raises Unreachable."""
    return f"{name}={value}".encode() in _environment(pid)


def _environment(pid: int) -> list[bytes]:
    """With what a process began; empty if it is gone. Raises Unreachable."""
    try:
        text = Path(f"/proc/{pid}/environ").read_bytes()
    except OSError as error:
        known(error, f"process {pid}")
        return []
    return text.split(b"\0") if text else []


def await_program(child: subprocess.Popen[bytes], container: str) -> None:
    """Return when the shell that was just started has started its program, or has ended. Before its own exec the shell
    has no environment to be recognized by, so its run would look ended. And a signal before the exec of its program
    meets the handlers of the shell and is lost; after a SIGSTOP then the shell waits for a child that cannot go on, and
    neither is ever paused."""
    deadline = time.monotonic() + BEGIN
    while child.poll() is None and time.monotonic() < deadline:
        if marked(child.pid, MARK, container) and _begun(child.pid):
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


def signal_group(run: Run, number: int) -> bool:
    """Send a signal to the group of a run's leader; False if the leader has ended."""
    try:
        descriptor = os.pidfd_open(run.leader)
    except OSError as error:
        known(error, f"process {run.leader}")
        return False
    try:
        # While the descriptor is open the pid cannot come to mean another process.
        if not is_same(run):
            return False
        try:
            signal.pidfd_send_signal(descriptor, number, None, PROCESS_GROUP)
        except OSError:
            os.killpg(run.leader, number)
        return True
    except ProcessLookupError:
        return False
    finally:
        os.close(descriptor)


def signal_one(pid: int, started: int, number: int) -> None:
    """Send a signal to the process that began at that time, if it lives."""
    try:
        descriptor = os.pidfd_open(pid)
    except OSError as error:
        known(error, f"process {pid}")
        return
    try:
        if (facts := stat(pid)) and facts.started == started:
            signal.pidfd_send_signal(descriptor, number)
    except OSError:
        pass
    finally:
        os.close(descriptor)
