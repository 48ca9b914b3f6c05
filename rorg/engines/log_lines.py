"""Lines of a container's log, and somebody who reads them until it is enough."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import NamedTuple


class LogLine(NamedTuple):
    """A line, or a piece of a long one."""

    time: str
    """When the engine took it, RFC 3339 in UTC with nine digits after the second; empty where the engine keeps no
    times."""
    text: bytes
    """With its line end; a piece that the line goes on after has none."""
    place: str
    """Where to go on reading after it."""


class Reading:
    """Goes on until it is ended, from any thread."""

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._closers: list[Callable[[], None]] = []

    @property
    def ended(self) -> bool:
        return self._ended.is_set()

    def wait(self, seconds: float) -> bool:
        """Waits so long at the most; whether it is ended."""
        return self._ended.wait(seconds)

    def end(self) -> None:
        """Ends it, and whatever it waits for."""
        self._ended.set()
        with self._lock:
            closers = tuple(self._closers)
        for close in closers:
            close()

    @contextlib.contextmanager
    def closing(self, close: Callable[[], None]) -> Iterator[None]:
        """Has `close` called where it ends within the block, which may be at once."""
        with self._lock:
            self._closers.append(close)
        try:
            if self.ended:
                close()
            yield
        finally:
            with self._lock:
                self._closers.remove(close)
