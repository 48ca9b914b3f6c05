"""Looks at single containers again, until a look at each began after the moment that the loop asked for."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

RETRY = (0.2, 0.5, 1.0, 2.0)
"""Seconds between attempts to reach an engine that does not answer; the last one repeats."""


def retry_after(attempt: int) -> float:
    """Seconds until the next attempt, after so many failed ones in a row."""
    return RETRY[min(attempt, len(RETRY) - 1)]


class Looks:
    """Works in a thread of its own. `look` looks at one container; `looked` returns when the last look at it began, by
    the loop's clock; `wake` is called when the loop has what it asked for. Nothing is asked until `answering` is set.
    """

    def __init__(
        self,
        look: Callable[[str], None],
        looked: Callable[[str], float],
        wake: Callable[[], None],
        answering: threading.Event,
    ) -> None:
        self._look, self._looked, self._wake, self._answering = look, looked, wake, answering
        self._wanted: Mapping[str, float] = {}
        """Containers, each with the moment after which a look must begin."""
        self._asked, self._stop = threading.Event(), threading.Event()

    def start(self) -> None:
        threading.Thread(target=self._run, name="looks", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()
        self._asked.set()

    def ask(self, looks: Mapping[str, float]) -> None:
        """Look at each of these containers, unless a look at it began after that moment. Replaces earlier wishes."""
        self._wanted = self._left(looks)
        if self._wanted:
            self._asked.set()

    def _left(self, looks: Mapping[str, float]) -> dict[str, float]:
        return {c: at for c, at in looks.items() if self._looked(c) < at}

    def _run(self) -> None:
        attempt = 0
        while not self._stop.is_set():
            self._asked.wait()
            self._asked.clear()
            self._answering.wait()
            looks = dict(self._wanted)
            for container in looks:
                self._look(container)
            wanted = self._wanted
            left = self._left({c: at for c, at in looks.items() if c in wanted})
            if len(left) < len(looks):
                attempt = 0
                self._wake()
            if left and not self._stop.wait(retry_after(attempt)):
                attempt += 1
                self._asked.set()
