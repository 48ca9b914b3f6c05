"""The time, and when this machine and its processes began."""

from __future__ import annotations

import os
import time
from pathlib import Path

from rorg.core.holds import Moment
from rorg.model.units import stamp


def wall_clock() -> str:
    """Now, ISO 8601 in UTC, as the engine writes times."""
    return stamp(time.time())


def moment() -> Moment:
    """The present, by all clocks of this machine."""
    return Moment(time.time(), time.monotonic(), boot_id())


def boot_id() -> str:
    """The id of this boot of the kernel; "" where it has none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""


def process_age(pid: int) -> float:
    """For how many seconds a process has run. Setting the clock does not change that."""
    with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
        ticks = int(file.read().rpartition(")")[2].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


def process_start(pid: int) -> float:
    """When a process began, seconds since the epoch, by the present clock. The engine's own time is later: the program
    may have written a file before."""
    return time.time() - process_age(pid)


def run_start(pid: int, noted: float) -> float:
    """When a run began, seconds since the epoch: as `noted` then by the engine, or earlier, as the process tells by the
    present clock. They differ if the clock was set since. `pid` is 0 if there is no process."""
    try:
        return min(noted, process_start(pid)) if pid else noted
    except (OSError, IndexError, ValueError):
        return noted


def run_age(pid: int, noted: float) -> float:
    """For how many seconds a run has gone on, as its process tells; without one, by the clock since the engine `noted`
    its start."""
    try:
        return process_age(pid) if pid else max(0.0, time.time() - noted)
    except (OSError, IndexError, ValueError):
        return max(0.0, time.time() - noted)
