"""What services used while they ran: by hour and run, added up as it is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rorg.history.database import Database

UPSERT = (
    "INSERT INTO usage (hour, service, run, seconds, cpu, byte_seconds, peak) VALUES (?, ?, ?, ?, ?, ?, ?)"
    " ON CONFLICT (hour, service, run) DO UPDATE SET seconds = seconds + excluded.seconds, cpu = cpu + excluded.cpu,"
    " byte_seconds = byte_seconds + excluded.byte_seconds, peak = max(peak, excluded.peak)"
)
TOTALS = (
    "SELECT service, count(DISTINCT run), sum(seconds), sum(cpu), sum(byte_seconds), max(peak) FROM usage"
    " WHERE hour >= ? GROUP BY service ORDER BY service"
)
HOUR = 13
"""Characters of a time (ISO 8601) up to the hour."""


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


class UsageTable:
    """Written by one thread at a time."""

    def __init__(self, database: Database) -> None:
        self.database = database

    def note(self, at: str, measurements: Sequence[Measured]) -> None:
        """Add the measurements up to a time (ISO 8601 in UTC). If the disk refuses them, they are lost."""
        rows = [(at[:HOUR], m.service, m.run, m.seconds, m.cpu, m.seconds * m.memory, m.memory) for m in measurements]
        if rows:
            self.database.write([(UPSERT, rows)], keep=False)

    def since(self, time: str) -> list[dict[str, Any]]:
        """For each service since the hour of a time: the number of runs, seconds in all, average cores and bytes, and
        the most bytes seen. Empty for an older file without that table."""
        if not self.database.rows("SELECT 1 FROM sqlite_master WHERE name = 'usage'"):
            return []
        return [
            {
                "service": service,
                "runs": runs,
                "seconds": round(seconds, 1),
                "cpu": round(cpu / seconds, 4),
                "memory": round(byte_seconds / seconds),
                "peak_memory": peak,
            }
            for service, runs, seconds, cpu, byte_seconds, peak in self.database.rows(TOTALS, (time[:HOUR],))
            if seconds > 0
        ]
