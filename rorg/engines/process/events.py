"""Changes as they happen: those made through the engine, and exits, by waiting on process descriptors instead of
polling."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
from collections.abc import Callable, Iterable, Iterator

from rorg.core.observed import Container

NOW_AND_THEN = 2.0
TURN = 0.5
"""Seconds until a follower notices that it should stop."""


class Changes:
    """Changes for one follower at a time. `containers` returns all, `container` one of them; `now_and_then` is called
    every NOW_AND_THEN seconds while someone follows."""

    def __init__(
        self,
        containers: Callable[[], Iterable[Container]],
        container: Callable[[str], Container | None],
        now_and_then: Callable[[], None],
    ) -> None:
        self.containers, self.container, self.now_and_then = containers, container, now_and_then
        self._lock = threading.Lock()
        self._changed: list[str] = []
        self._wake_read, self._wake_write = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)

    def tell(self, container: str) -> None:
        with self._lock:
            self._changed.append(container)
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b".")

    def follow(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        exits, due = _Exits(), time.monotonic() + NOW_AND_THEN
        exits.poller.register(self._wake_read, select.POLLIN)
        self._watch(exits, self.containers())
        yield "", ""
        try:
            while not stop.is_set():
                for descriptor, _ in exits.poller.poll(TURN * 1000):
                    if stop.is_set():
                        return  # the next follower reads what is left
                    if descriptor == self._wake_read:
                        changed = self._take()
                        self._watch(exits, (c for name in changed if (c := self.container(name)) is not None))
                        yield from ((container, "") for container in changed)
                    else:
                        yield exits.ended(descriptor), ""
                if time.monotonic() >= due:
                    due = time.monotonic() + NOW_AND_THEN
                    self.now_and_then()
        finally:
            exits.close()

    def _take(self) -> list[str]:
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 65536)
        with self._lock:
            changed, self._changed = list(dict.fromkeys(self._changed)), []
        return changed

    def _watch(self, exits: _Exits, containers: Iterable[Container]) -> None:
        for container in containers:
            if container.pid and not exits.watch(container.id, container.pid):
                self.tell(container.id)


class _Exits:
    """Runs whose exit is awaited, by (container, pid): a new run can begin before the exit of the previous one is
    reported."""

    def __init__(self) -> None:
        self.poller = select.poll()
        self._runs: dict[int, tuple[str, int]] = {}
        """By descriptor."""
        self._known: set[tuple[str, int]] = set()

    def watch(self, container: str, pid: int) -> bool:
        """False if it has ended already."""
        if (container, pid) in self._known:
            return True
        try:
            descriptor = os.pidfd_open(pid)
        except OSError:
            return False
        self._runs[descriptor] = container, pid
        self._known.add((container, pid))
        self.poller.register(descriptor, select.POLLIN)
        return True

    def ended(self, descriptor: int) -> str:
        """Return the container of a run that has ended."""
        run = self._runs.pop(descriptor)
        self._known.discard(run)
        self.poller.unregister(descriptor)
        os.close(descriptor)
        return run[0]

    def close(self) -> None:
        for descriptor in self._runs:
            os.close(descriptor)
