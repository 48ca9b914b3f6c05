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


def process_start(pid: int) -> float:
    """When a process began, seconds since the epoch. The engine's own time is later: the program may have written a
    file before."""
    with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
        ticks = int(file.read().rpartition(")")[2].split()[19])
    return time.time() - time.clock_gettime(time.CLOCK_BOOTTIME) + ticks / os.sysconf("SC_CLK_TCK")
