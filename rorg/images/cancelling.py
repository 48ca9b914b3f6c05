"""How one thread ends what another one is at."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from rorg.errors import NotReady


class Cancelling:
    """Ends what is under way, and whatever is begun after that."""

    def __init__(self) -> None:
        self._guard, self._called = threading.Lock(), False
        self._ends: list[Callable[[], object]] = []

    def cancel(self) -> None:
        """From any thread, any number of times."""
        with self._guard:
            self._called = True
            for end in self._ends:
                with contextlib.suppress(OSError):  # it has ended by itself
                    end()
            self._ends.clear()

    @contextlib.contextmanager
    def by(self, end: Callable[[], object]) -> Iterator[None]:
        """What ends the block, which fails then. Raises NotReady where it is over already."""
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
