"""Probes that ask about a file. Its time is by the clock as it was then, which may have been set since."""

from __future__ import annotations

import os
import time

from rorg.host.clock import run_start
from rorg.host.container_root import modified
from rorg.model.probe import Probe
from rorg.model.units import parse_time
from rorg.probes.answer import YES, Answer, no

NEVER = float("inf")


class FileProbes:
    """Asks about files, again and again: it remembers when each one was modified, by the monotonic clock."""

    def __init__(self) -> None:
        self._modified: dict[tuple[str, str, int], tuple[float, float]] = {}
        """Question -> the file's time, and when that was new."""

    def ask(self, key: tuple[str, str, int], probe: Probe, pid: int, isolated: bool, started_at: str) -> Answer:
        """Ask for (service, role, question). `pid` is the first process of the container, 0 if there is none. Its file
        system is used if the engine isolates containers (`isolated`)."""
        path, role = str(probe.target), key[1]
        try:
            written = modified(f"/proc/{pid}/root", path) if pid and isolated else os.stat(path).st_mtime
        except OSError as error:
            return no(f"file {path}: {error.strerror}")
        # If the clock was set ahead since, the process seems to have begun after it wrote its file.
        noted = parse_time(started_at) if started_at else NEVER
        if role == "ready" and pid and written < run_start(pid, noted) - 0.05:
            return no(f"file {path} is older than this run")
        age = self._age(key, written)
        if role == "live" and age > probe.interval:
            return no(f"file {path} was last modified {age:.0f} s ago")
        return YES

    def _age(self, key: tuple[str, str, int], written: float) -> float:
        """Return the seconds since a file was modified. Only at the first look does the file's time tell that."""
        now, known = time.monotonic(), self._modified.get(key)
        if known is None:
            at = now - max(0.0, time.time() - written)
        else:
            at = known[1] if known[0] == written else now
        self._modified[key] = written, at
        return now - at
