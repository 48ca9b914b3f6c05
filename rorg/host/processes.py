"""What the kernel says of processes."""

from __future__ import annotations

import os
import time


def process_start(pid: int) -> float:
    """When a process began, seconds since the epoch. The engine's own time is taken after the program has begun, when
    it may have written its file already."""
    with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
        ticks = int(file.read().rpartition(")")[2].split()[19])
    return time.time() - time.clock_gettime(time.CLOCK_BOOTTIME) + ticks / os.sysconf("SC_CLK_TCK")
