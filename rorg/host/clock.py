"""What time it is, and when this machine booted."""

from __future__ import annotations

import time

from rorg.model.units import stamp


def wall_clock() -> str:
    """Now, ISO 8601 in UTC, as the engine writes times."""
    return stamp(time.time())


def booted_at() -> str:
    """When this machine booted, ISO 8601 in UTC (btime of /proc/stat)."""
    with open("/proc/stat", encoding="ascii") as file:
        seconds = next(int(line.split()[1]) for line in file if line.startswith("btime "))
    return stamp(seconds)
