"""Lets one thread end the work of another."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from rorg.errors import NotReady


class Cancellation:
    """Ends everything that is under way, and everything that starts afterwards."""

    def __init__(self) -> None:
        self._guard, self._called = threading.Lock(), False
        self._ends: list[Callable[[], object]] = []

    def cancel(self) -> None:
        """Cancels. Any thread may call it, any number of times."""
        with self._guard:
            self._called = True
            for end in self._ends:
                with contextlib.suppress(OSError):  # it has ended already
                    end()
            self._ends.clear()

    @contextlib.contextmanager
    def by(self, end: Callable[[], object]) -> Iterator[None]:
        """Calls `end` on cancel, which makes the block fail. Raises NotReady if it was cancelled before."""
        with self._guard:
            if self._called:
                end()
                raise NotReady("go on", "it is cancelled")
            self._ends.append(end)
        try:
            yield
        finally:
            with self._guard, contextlib.suppress(ValueError):
                self._ends.remove(end)
