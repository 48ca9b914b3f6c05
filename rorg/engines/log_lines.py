"""Lines of a container's log, and the reader of a stream that can be ended."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import NamedTuple


class LogLine(NamedTuple):
    """A line, or a piece of a long one."""

    time: str
    """When the engine received it: RFC 3339 in UTC with nine digits after the second; empty if the engine keeps no
    times."""
    text: bytes
    """With its line end; a piece that is not the last of its line has none."""
    place: str
    """Where to continue after it."""


class Reading(threading.Event):
    """A reader of a log or of events, until any thread sets this event. That also ends the calls that it waits for."""

    def __init__(self) -> None:
        super().__init__()
        self._lock = threading.Lock()
        self._closers: list[Callable[[], None]] = []

    def set(self) -> None:
        super().set()
        with self._lock:
            closers = tuple(self._closers)
        for close in closers:
            close()

    @contextlib.contextmanager
    def closing(self, close: Callable[[], None]) -> Iterator[None]:
        """Call `close` if the reading ends within the block, or has ended before."""
        with self._lock:
            self._closers.append(close)
        try:
            if self.is_set():
                close()
            yield
        finally:
            with self._lock:
                self._closers.remove(close)
