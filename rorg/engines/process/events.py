"""Changes as they happen: those made through the engine, and exits, by waiting on process descriptors instead of
polling."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import selectors
import threading
import time
from collections.abc import Callable, Iterable, Iterator

from rorg.core.observed import Container
from rorg.engines.process.table import SHORT_OF, stat
from rorg.errors import Unreachable

NOW_AND_THEN = 2.0
TURN = 0.5
"""Seconds until a follower notices that it should stop, and between two looks at runs without a descriptor."""
SHARE = 4
"""The part of this process's descriptors that may wait for exits: one in four. All else needs the others."""
Run = tuple[str, int]
"""(container, pid)."""


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
        self._looked_at: set[Run] = set()
        """Runs without a descriptor."""
        self._wake_read, self._wake_write = os.pipe2(os.O_CLOEXEC | os.O_NONBLOCK)

    def tell(self, container: str) -> None:
        with self._lock:
            self._changed.append(container)
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b".")

    def follow(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        exits, due = selectors.PollSelector(), time.monotonic() + NOW_AND_THEN
        exits.register(self._wake_read, selectors.EVENT_READ)
        self._looked_at.clear()
        self._watch(exits, self.containers())
        yield "", ""
        try:
            while not stop.is_set():
                for key, _ in exits.select(TURN):
                    if stop.is_set():
                        return  # the next follower reads what is left
                    if key.data is None:
                        changed = self._take()
                        self._watch(exits, (c for name in changed if (c := self.container(name)) is not None))
                        yield from ((container, "") for container in changed)
                    else:
                        exits.unregister(key.fd)
                        os.close(key.fd)
                        yield key.data[0], ""
                yield from ((container, "") for container in self._ended())
                if time.monotonic() >= due:
                    due = time.monotonic() + NOW_AND_THEN
                    self.now_and_then()
        finally:
            for key in exits.get_map().values():
                if key.data is not None:
                    os.close(key.fd)
            exits.close()

    def _take(self) -> list[str]:
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 65536)
        with self._lock:
            changed, self._changed = list(dict.fromkeys(self._changed)), []
        return changed

    def _watch(self, exits: selectors.BaseSelector, containers: Iterable[Container]) -> None:
        """Wait for the exits of these runs: a new run can begin before the exit of the previous one is reported."""
        watched = {key.data for key in exits.get_map().values()}
        room, known = _descriptors() // SHARE - len(watched), watched | self._looked_at
        for container in containers:
            run = container.id, container.pid
            if not container.pid or run in known:
                continue
            try:
                if room <= 0:
                    raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
                exits.register(os.pidfd_open(container.pid), selectors.EVENT_READ, run)
                room -= 1
            except OSError as error:
                if error.errno in SHORT_OF:
                    self._looked_at.add(run)
                else:  # it has ended already
                    self.tell(container.id)

    def _ended(self) -> list[str]:
        """Containers whose run has ended, of those without a descriptor."""
        try:
            ended = {run for run in self._looked_at if (facts := stat(run[1])) is None or facts[0] in "ZX"}
        except Unreachable:  # not even one descriptor is left: at the next turn
            return []
        self._looked_at -= ended
        return [container for container, _ in ended]


def _descriptors() -> int:
    """How many files this process may have open."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return limit if limit != resource.RLIM_INFINITY else 1 << 30
