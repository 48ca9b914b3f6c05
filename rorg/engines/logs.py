"""The logs of several services: past lines merged by time, then new lines, each exactly once, across runs and
containers."""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

from rorg.core.observed import Container
from rorg.engines.log_lines import LogLine, Reading
from rorg.engines.protocol import Engine
from rorg.errors import EngineError, Invalid, RorgError, Unreachable
from rorg.host.clock import run_start
from rorg.model.units import nano_stamp, parse_time

HELD = 1000
"""Lines that are kept for a slow reader; then the threads that read the logs wait."""
LOOK = 0.2
"""Seconds between two checks whether a service runs again."""

Find = Callable[[str], Container | None]
"""Returns the current container of a service."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Which lines to read."""

    services: Sequence[str]
    follow: bool = False
    tail: int | None = None
    """Of each service; None for all."""
    since: float | None = None
    """Seconds since the epoch."""
    until: float | None = None
    """Seconds since the epoch: only earlier lines."""
    previous: bool = False
    """Only lines from before the current, or last, run of each service."""
    after: Mapping[str, str] = field(default_factory=dict)
    """Service -> the cursor of the last line that the caller has: only later ones are read."""


class Entry(NamedTuple):
    """A line of a service. Without text it only says where the log ends, or why it cannot be read."""

    service: str
    cursor: str = ""
    """CONTAINER:PLACE."""
    time: str = ""
    text: bytes = b""
    error: str = ""


class Entries:
    """Lines that threads have read, for one consumer. `tell` is called, from any thread, when there are some."""

    def __init__(self, tell: Callable[[], None]) -> None:
        self.reading = Reading()
        self._tell = tell
        self._found: deque[Entry] = deque()
        self._room = threading.Condition()
        self._over = False

    def put(self, entry: Entry) -> bool:
        """Add an entry; wait while there is no room. False if the consumer has gone."""
        with self._room:
            self._room.wait_for(lambda: len(self._found) < HELD or self.reading.is_set())
            self._found.append(entry)
        self._tell()
        return not self.reading.is_set()

    def finish(self) -> None:
        """Nothing more will come."""
        self._over = True
        self._tell()

    def take(self) -> tuple[list[Entry], bool]:
        """Return (new entries, whether these are the last)."""
        with self._room:
            over, entries = self._over, list(self._found)
            self._found.clear()
            self._room.notify_all()
        return entries, over

    def end(self) -> None:
        """The consumer has gone."""
        self.reading.set()
        with self._room:
            self._room.notify_all()


def check(engine: Engine, asked: Asked) -> None:
    """Raises Invalid if this engine cannot answer the question."""
    timed = asked.since is not None or asked.until is not None or asked.previous
    if timed and not engine.capabilities.log_times:
        raise Invalid(
            "show lines by their time", f"the {engine.name} engine keeps no times of lines", "-n 100 for the last ones"
        )


def gather(engine: Engine, find: Find, asked: Asked, tell: Callable[[], None]) -> Entries:
    """Start to read in threads. Raises Invalid."""
    check(engine, asked)
    entries = Entries(tell)
    threading.Thread(target=_gather, args=(engine, find, asked, entries), name="logs", daemon=True).start()
    return entries


def _gather(engine: Engine, find: Find, asked: Asked, entries: Entries) -> None:
    cursors = dict(asked.after)
    try:
        for entry in _past(engine, find, asked):
            cursors[entry.service] = entry.cursor
            if not entries.put(entry):
                return
        if asked.follow:
            threads = [
                threading.Thread(target=_follow, args=(engine, find, name, cursors.get(name, ""), entries), daemon=True)
                for name in asked.services
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    except RorgError as error:
        entries.put(Entry("", error=str(error)))
    finally:
        entries.finish()


def _past(engine: Engine, find: Find, asked: Asked) -> Iterator[Entry]:
    """Past lines by time, or service by service if the engine has no times."""
    streams = [_of_one(engine, name, find(name), asked) for name in asked.services if name not in asked.after]
    return heapq.merge(*streams, key=lambda entry: entry.time)


def _of_one(engine: Engine, name: str, container: Container | None, asked: Asked) -> Iterator[Entry]:
    if container is None:
        return
    ends = [asked.until] if asked.until is not None else []
    end = min([*ends, *([_began(container)] if asked.previous else [])], default=None)
    tail = asked.tail if end is None else None
    try:
        lines = engine.log_lines(container.id, tail, asked.since, asked.follow)
        yield from (
            _entry(name, container, line) for line in (lines if end is None else _before(end, asked.tail, lines))
        )
    except EngineError as error:
        if error.kind != "gone":
            raise


def _began(container: Container) -> float:
    """When its current, or last, run began, in seconds since the epoch. The engine notes the start only after the first
    output of the program; a process that runs on this machine knows better."""
    return run_start(container.pid, parse_time(container.started_at) if container.started_at else 0.0)


def _before(end: float, tail: int | None, lines: Iterable[LogLine]) -> Iterable[LogLine]:
    """The last lines before a time, or all of them."""
    text = nano_stamp(int(end * 1e9))
    earlier_lines = takewhile(lambda line: line.time < text, lines)
    return earlier_lines if tail is None else deque(earlier_lines, maxlen=tail)


def _entry(service: str, container: Container, line: LogLine) -> Entry:
    return Entry(service, f"{container.id[:12]}:{line.place}", line.time, line.text)


def _follow(engine: Engine, find: Find, name: str, cursor: str, entries: Entries) -> None:
    """Follow one service through its runs and containers, until the consumer goes."""
    reading, followed, told = entries.reading, "", ""
    while not reading.is_set():
        try:
            container = find(name)
            if container and container.started_at and container.incarnation != followed:
                known, _, place = cursor.partition(":")
                place = place if container.id.startswith(known) else ""
                for line in engine.log_follow(container.id, place, reading):
                    entry = _entry(name, container, line)
                    cursor = entry.cursor
                    if not entries.put(entry):
                        return
                followed = container.incarnation
        except Unreachable as error:  # it may come back
            if str(error) != told:
                told = str(error)
                entries.put(Entry(name, error=told))
        except EngineError as error:
            if error.kind != "gone":
                entries.put(Entry(name, error=str(error)))
                return
        reading.wait(LOOK)
