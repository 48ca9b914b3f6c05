"""A cache of the networks and volumes that are there: fed by the engine's events, and checked with every full list of
containers. A robot without any costs one look when rorg begins, and nothing after that."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

from rorg.core.found_objects import FoundObjects
from rorg.engines.protocol import Objects
from rorg.errors import RorgError, Unreachable

RETRY = 1.0
"""Seconds until the engine is asked again that did not answer."""


class ObjectObserver:
    """Keeps the cache in threads of its own. `wake` is called when it has changed. The engine is asked nothing until
    `answering` is set."""

    def __init__(self, engine: Objects, wake: Callable[[], None], answering: threading.Event | None = None) -> None:
        self.engine, self.wake, self.answering = engine, wake, answering or threading.Event()
        if answering is None:
            self.answering.set()
        self._lock, self._one = threading.Lock(), threading.Lock()
        self._keys: frozenset[str] = frozenset()
        self._found = FoundObjects()
        self._stop, self._doubt, self._matters = threading.Event(), threading.Event(), threading.Event()
        self.looks = 0
        """Looks at the engine so far."""

    def start(self) -> None:
        for target in (self._look, self._follow):
            threading.Thread(target=target, name=f"objects-{target.__name__}", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()
        self._doubt.set()
        self._matters.set()

    def snapshot(self) -> FoundObjects:
        with self._lock:
            return self._found

    def look_for(self, keys: Collection[str]) -> None:
        """What is to be found by its name, besides all of ours. Costs nothing where that is known already."""
        with self._lock:
            new = not self._keys.issuperset(keys)
            if new:
                self._keys = frozenset(keys)
        if new:
            self._doubt.set()

    def sync(self) -> None:
        """One look, at once: the next pass sees what an action did. One after another, so that none overtakes."""
        with self._one:
            with self._lock:
                keys = self._keys
            try:
                found = self.engine.find_objects(keys)
            except Unreachable:
                raise
            except RorgError as error:
                found = FoundObjects(complete=True, error=str(error))
            self.looks += 1
            if keys or found.found:
                self._matters.set()
            with self._lock:
                changed = found != self._found
                self._found = found if changed else self._found
        if changed:
            self.wake()

    def check(self) -> None:
        """A look, where there was none yet, or anything is there to be looked for."""
        if self._matters.is_set() or not self.snapshot().complete:
            self.sync()

    def _look(self) -> None:
        """Looks for what a new tree names."""
        while not self._stop.is_set():
            self._doubt.wait()
            self._doubt.clear()
            self.answering.wait()
            try:
                self.sync()
            except Exception:  # what is unreachable is told by whoever looks at containers
                self._doubt.set()
                self._stop.wait(RETRY)

    def _follow(self) -> None:
        self._matters.wait()
        while not self._stop.is_set():
            self.answering.wait()
            try:
                for _ in self.engine.object_events(self._stop):
                    self.sync()
            except Exception:  # without this thread nothing would be seen any more
                self._stop.wait(RETRY)
