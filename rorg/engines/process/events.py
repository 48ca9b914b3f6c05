"""Changes as they happen: those made through the engine, and exits, by waiting on process descriptors; no polling of
processes."""

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
"""Seconds until somebody who follows sees that he should stop."""


class Changes:
    """Who makes a change tells; one at a time follows. `now_and_then` is called while somebody does, every NOW_AND_THEN
    seconds."""

    def __init__(self, containers: Callable[[], Iterable[Container]], now_and_then: Callable[[], None]) -> None:
        self.containers, self.now_and_then = containers, now_and_then
        self._lock = threading.Lock()
        self._changed: list[str] = []
        self._wake_read, self._wake_write = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)

    def tell(self, container: str) -> None:
        with self._lock:
            self._changed.append(container)
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b".")

    def follow(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        watched: dict[int, tuple[str, int]] = {}
        poller, due = select.poll(), time.monotonic() + NOW_AND_THEN
        poller.register(self._wake_read, select.POLLIN)
        self._watch_all(poller, watched)
        yield "", ""
        try:
            while not stop.is_set():
                for descriptor, _ in poller.poll(TURN * 1000):
                    if stop.is_set():
                        return  # what there is to read is for the next one who looks
                    if descriptor == self._wake_read:
                        changed = self._take()
                        self._watch_all(poller, watched)
                        yield from ((container, "") for container in changed)
                    else:
                        container, _ = watched.pop(descriptor)
                        poller.unregister(descriptor)
                        os.close(descriptor)
                        yield container, ""
                if time.monotonic() >= due:
                    due = time.monotonic() + NOW_AND_THEN
                    self.now_and_then()
        finally:
            for descriptor in watched:
                os.close(descriptor)

    def _take(self) -> list[str]:
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 65536)
        with self._lock:
            changed, self._changed = list(dict.fromkeys(self._changed)), []
        return changed

    def _watch_all(self, poller: select.poll, watched: dict[int, tuple[str, int]]) -> None:
        """`watched` holds (container, pid) by descriptor: a run that began before the end of the one before it was told
        has a pid of its own."""
        for container in self.containers():
            if container.pid and (container.id, container.pid) not in watched.values():
                try:
                    descriptor = os.pidfd_open(container.pid)
                except OSError:
                    self.tell(container.id)
                    continue
                watched[descriptor] = container.id, container.pid
                poller.register(descriptor, select.POLLIN)
