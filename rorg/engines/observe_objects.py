"""A cache of networks and volumes: fed by the engine's events, and checked with every full list of containers. A robot
without any needs one look when rorg begins, and none later."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection

from rorg.core.observed import FoundObjects
from rorg.engines.log_lines import Reading
from rorg.engines.protocol import Objects
from rorg.errors import RorgError, Unreachable

RETRY = 1.0
"""Seconds until an engine that did not answer is asked again."""


class ObjectObserver:
    """Keeps the cache in threads of its own. `wake` is called when it has changed. The engine is only asked while
    `answering` is set."""

    def __init__(self, engine: Objects, wake: Callable[[], None], answering: threading.Event | None = None) -> None:
        self.engine, self.wake, self.answering = engine, wake, answering or threading.Event()
        if answering is None:
            self.answering.set()
        self._lock, self._one = threading.Lock(), threading.Lock()
        self._keys: frozenset[str] = frozenset()
        self._found = FoundObjects()
        self._stop, self._doubt, self._matters = Reading(), threading.Event(), threading.Event()
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
        """Also find those with these names, besides all of this owner. Costs nothing if their state is known
        already."""
        with self._lock:
            new = not self._keys.issuperset(keys)
            if new:
                self._keys = frozenset(keys)
        if new:
            self._doubt.set()

    def sync(self) -> None:
        """Look at them immediately, so that the next pass sees the result of an action. One look at a time, so that no
        answer overtakes another."""
        with self._one:
            with self._lock:
                keys = self._keys
            try:
                objects = self.engine.find_objects(keys)
            except Unreachable:
                raise
            except RorgError as error:
                objects = FoundObjects(complete=True, error=str(error))
            self.looks += 1
            if keys or objects.found:
                self._matters.set()
            with self._lock:
                changed = objects != self._found
                self._found = objects if changed else self._found
        if changed:
            self.wake()

    def check(self) -> None:
        """Look at them the first time, and whenever there are any."""
        if self._matters.is_set() or not self.snapshot().complete:
            self.sync()

    def _look(self) -> None:
        """Look at them when a new tree has new names."""
        while not self._stop.is_set():
            self._doubt.wait()
            self._doubt.clear()
            self.answering.wait()
            try:
                self.sync()
            except Exception:  # the observer of containers reports an engine that does not answer
                self._doubt.set()
                self._stop.wait(RETRY)

    def _follow(self) -> None:
        self._matters.wait()
        while not self._stop.is_set():
            self.answering.wait()
            try:
                for _ in self.engine.object_events(self._stop):
                    self.sync()
            except Exception:  # without this thread no change would be noticed any more
                self._stop.wait(RETRY)
