"""Checks whether the engine answers: a ping twice a second on a connection of its own. Other calls cannot tell, because
some rightly take minutes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rorg.core.observed import Silence
from rorg.engines.protocol import Daemon
from rorg.errors import Unreachable

RETRY = (0.2, 0.5, 1.0, 2.0)
"""Seconds between attempts to reach an engine that does not answer; the last one repeats."""
EVERY = 0.5
"""Seconds between two pings. A silent engine is noticed within this and the time that a ping may take."""


def retry_after(attempt: int) -> float:
    """Seconds until the next attempt, after so many failed ones in a row."""
    return RETRY[min(attempt, len(RETRY) - 1)]


class Heartbeat:
    """Pings in a thread of its own, which calls `tell` when the engine falls silent, and with None when it answers
    again; and `heard` after each answer to ask()."""

    def __init__(self, engine: Daemon, tell: Callable[[Silence | None], None], heard: Callable[[], None]) -> None:
        self.engine, self.tell, self.heard = engine, tell, heard
        self.silence: Silence | None = None
        self.answered = float("-inf")
        """When the last ping that was answered began (monotonic)."""
        self._asked, self._stop = threading.Event(), threading.Event()

    def start(self) -> None:
        threading.Thread(target=self._run, name="heartbeat", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()
        self._asked.set()

    def ask(self) -> None:
        """Ping soon."""
        self._asked.set()

    def _run(self) -> None:
        ping = self.engine.pinger()
        while not self._stop.is_set():
            asked = self._asked.is_set()
            self._asked.clear()
            began, wall = time.monotonic(), time.time()
            try:
                ping.ask()
            except Unreachable as error:
                self._failed(wall, error)
            else:
                self.answered = began
                self._changed(None)
                if asked:
                    self.heard()
            self._asked.wait(EVERY)
        ping.close()

    def _failed(self, wall: float, error: Unreachable) -> None:
        since = self.silence.since if self.silence else wall
        self._changed(Silence(self.engine.address, since, error.why))

    def _changed(self, silence: Silence | None) -> None:
        if silence != self.silence and not self._stop.is_set():
            self.silence = silence
            self.tell(silence)
