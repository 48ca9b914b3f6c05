"""What services used while they ran, and the machine all the time: by minute and run, added up as it is measured. Later
the minutes of ten are added up."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rorg.history.damage import check_types
from rorg.history.database import Database

UPSERT = (
    "INSERT INTO usage (hour, service, run, seconds, cpu, byte_seconds, peak) VALUES (?, ?, ?, ?, ?, ?, ?)"
    " ON CONFLICT (hour, service, run) DO UPDATE SET seconds = seconds + excluded.seconds, cpu = cpu + excluded.cpu,"
    " byte_seconds = byte_seconds + excluded.byte_seconds, peak = max(peak, excluded.peak)"
)
TOTALS = (
    "SELECT service, count(DISTINCT run), sum(seconds), sum(cpu), sum(byte_seconds), max(peak) FROM usage"
    " WHERE hour >= ? AND service <> '' GROUP BY service ORDER BY service"
)
SLOTS = (
    "SELECT hour, service, sum(cpu), sum(byte_seconds) FROM usage WHERE hour >= ? AND hour <= ?"
    " GROUP BY hour, service ORDER BY hour"
)
OLD = (
    "length(hour) = 16 AND hour < (SELECT substr(strftime('%Y-%m-%dT%H:%M', max(hour), '-2 hours'), 1, 15) FROM usage)"
)
"""Minutes that are added up; of the newest two hours each is kept."""
FOLD = (
    "INSERT INTO usage SELECT substr(hour, 1, 15), service, run, sum(seconds), sum(cpu), sum(byte_seconds), max(peak)"
    f" FROM usage WHERE {OLD} GROUP BY 1, 2, 3 ON CONFLICT DO UPDATE SET seconds = seconds + excluded.seconds,"
    " cpu = cpu + excluded.cpu, byte_seconds = byte_seconds + excluded.byte_seconds, peak = max(peak, excluded.peak)",
    f"DELETE FROM usage WHERE {OLD}",
)
SLOT = 16
"""Characters of a time (ISO 8601) up to the minute."""
SECONDS = {16: 60.0, 15: 600.0, 13: 3600.0}
"""The time that a row stands for, by the length of its own: an older rorg added up hours."""
TIME = re.compile(r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}(:[0-9]{1,2})?")
MOST = 1e30
"""More than any use."""
MACHINE = ""
"""In the place of a service: the whole machine."""


@dataclass(frozen=True, slots=True)
class Measured:
    """A service that ran for some seconds, without paused time."""

    service: str
    run: str
    """Its incarnation."""
    seconds: float
    cpu: float
    """CPU seconds that it used in them."""
    memory: int
    """Bytes at their end."""


class Slot(NamedTuple):
    """The mean use of a service, or of the MACHINE, in some seconds from a time on."""

    at: str
    """ISO 8601 in UTC, as far as it is known."""
    seconds: float
    service: str
    cores: float
    memory: float


class UsageTable:
    """Written by one thread at a time."""

    def __init__(self, database: Database) -> None:
        self.database = database

    def note(self, at: str, measurements: Sequence[Measured]) -> None:
        """Add the measurements up to a time (ISO 8601 in UTC). If the disk refuses them, they are lost."""
        rows = [(at[:SLOT], m.service, m.run, m.seconds, m.cpu, m.seconds * m.memory, m.memory) for m in measurements]
        if rows:
            self.database.write([(UPSERT, rows)], keep=False)

    def since(self, time: str) -> list[dict[str, Any]]:
        """For each service since the minute of a time: the number of runs, seconds in all, average cores and bytes, and
        the most bytes seen. Empty for an older file without that table."""
        if not self.database.rows("SELECT 1 FROM sqlite_master WHERE name = 'usage'"):
            return []
        totals = self.database.read(_total, TOTALS, (time[:SLOT],))
        return [total for total in totals if total]

    def slots(self, begin: str, end: str) -> list[Slot]:
        """Return the use from `begin` to `end` (ISO 8601 in UTC), in order of time. Empty for an older file."""
        if not self.database.rows("SELECT 1 FROM sqlite_master WHERE name = 'usage'"):
            return []
        return self.database.read(_slot, SLOTS, (begin[:SLOT], end[:SLOT]))


def _total(service: str, runs: int, seconds: float, cpu: float, byte_seconds: float, peak: int) -> dict[str, Any]:
    """Empty if nothing was measured. Raises ValueError and TypeError if it is damaged."""
    _check(service, seconds, cpu, byte_seconds, peak)
    return (
        {
            "service": service,
            "runs": runs,
            "seconds": round(seconds, 1),
            "cpu": round(cpu / seconds, 4),
            "memory": round(byte_seconds / seconds),
            "peak_memory": peak,
        }
        if seconds > 0
        else {}
    )


def _slot(hour: str, service: str, cpu: float, byte_seconds: float) -> Slot:
    """Raises ValueError and TypeError if it is damaged."""
    _check(service, cpu, byte_seconds)
    if not TIME.fullmatch(hour):
        raise ValueError(f"{hour!r} is no minute")
    length = SECONDS[len(hour)]
    return Slot(hour, length, service, cpu / length, byte_seconds / length)


def _check(service: str, *numbers: float) -> None:
    check_types((service, *numbers), str, *[int | float] * len(numbers))
    if any(not 0 <= number < MOST for number in numbers):
        raise ValueError(f"{service} used {numbers}")
