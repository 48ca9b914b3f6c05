"""Watches the engine's containers: follows its events, and checks them by a full list now and then."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace

from rorg.core.observed import Container, Observed, Silence
from rorg.engines.container_cache import ContainerCache
from rorg.engines.heartbeat import Heartbeat, retry_after
from rorg.engines.log_lines import Reading
from rorg.engines.observe_objects import ObjectObserver
from rorg.engines.protocol import SIGNALLED, Daemon, Objects, Observation
from rorg.engines.vanished import EVERY, Vanished
from rorg.errors import RorgError, Unreachable

REMEDY = "`systemctl status docker`, or `rorg doctor`"


class Observer:
    """Keeps the cache in threads of its own, so that a pass never waits for the engine."""

    def __init__(
        self,
        engine: Observation,
        wake: Callable[[], None],
        resync: Callable[[], float],
        clock: Callable[[], float] = time.monotonic,
        heard: Callable[[], None] = lambda: None,
    ) -> None:
        """`clock` is the loop's, in seconds. `heard` is called after an answer that ask() wanted."""
        self.engine, self.wake, self.resync = engine, wake, resync
        self._cache = ContainerCache(clock)
        self.heartbeat = Heartbeat(engine, self._heard, heard) if isinstance(engine, Daemon) else None
        """None for an engine that cannot fall silent."""
        self._answering = threading.Event()
        """Cleared while the engine is silent: then rorg asks it nothing."""
        self._answering.set()
        self.objects = ObjectObserver(engine, wake, self._answering) if isinstance(engine, Objects) else None
        """Of networks and volumes; None for an engine without them."""
        self._vanished = Vanished() if isinstance(engine, Daemon) and engine.local else None
        """None if the engine runs elsewhere, or looks at the processes itself."""
        self._looking = False
        """Whether looks that the loop asked for are under way."""
        self._stop, self._doubt = threading.Event(), threading.Event()
        self._stream_end = Reading()
        """Set to end the current stream of events."""
        self.lists = 0
        """Full lists made so far."""

    def start(self) -> None:
        for target in (self._follow, self._resync_now_and_then, *([self._find_vanished] if self._vanished else [])):
            threading.Thread(target=target, name=f"observe-{target.__name__}", daemon=True).start()
        for part in (self.objects, self.heartbeat):
            if part:
                part.start()

    def stop(self) -> None:
        self._stop.set()
        for part in (self.objects, self.heartbeat):
            if part:
                part.stop()
        for event in (self._doubt, self._stream_end, self._answering):
            event.set()

    def ask(self) -> None:
        """Check whether the engine answers, and wake the loop when it has."""
        if self.heartbeat:
            self.heartbeat.ask()

    def heard_since(self, asked: float) -> bool:
        """Whether the engine answered a ping that was sent after `asked` (monotonic)."""
        return self.heartbeat is None or self.heartbeat.answered >= asked

    def _heard(self, silence: Silence | None) -> None:
        """The engine fell silent, or answers again (None). In the second case everything is listed again, and events
        are followed on a new stream, because the old one may have ended unnoticed."""
        self._cache.hear(silence)
        if silence:
            self._answering.clear()
            self._stream_end.set()
        else:
            self._answering.set()
            self._doubt.set()
        self.wake()

    def snapshot(self) -> Observed:
        """Complete once the containers are known, and the networks and volumes if the engine has any."""
        objects = self.objects.snapshot() if self.objects else None
        observed = self._cache.snapshot(objects)
        return replace(observed, complete=False) if objects and not objects.complete else observed

    def look_for(self, keys: Collection[str]) -> None:
        """Also find networks and volumes with these names."""
        if self.objects:
            self.objects.look_for(keys)

    def refresh_objects(self) -> None:
        """Look at networks and volumes immediately, so that the next pass sees the result of an action."""
        if self.objects:
            try:
                self.objects.sync()
            except RorgError as error:
                self._lost(error)
                self._doubt.set()

    def refresh(self, container: str) -> None:
        """Look at one container immediately, so that the next pass sees the result of an action. If the engine does not
        answer, the whole snapshot is incomplete until the next full list."""
        look = self._cache.begin()
        try:
            inspection = self.engine.inspect(container)
            self._check_ends([inspection] if inspection else ())
        except RorgError as error:
            self._lost(error)
            self._doubt.set()
            return
        self._cache.show(container, inspection, look)

    def acting(self, container: str) -> AbstractContextManager[None]:
        """Leave events of this container to done(), which the caller calls after the block."""
        return self._cache.acting(container)

    def done(self, container: str, state: str) -> None:
        """A call succeeded. A container that was alive is now in this state and the same run, or only a look can tell
        (""). Events of other changes meanwhile lead to a look too."""
        if not self._cache.done(container, state):
            self.refresh(container)

    def sync(self, anew: bool = True) -> None:
        """Make one full list. Looks at single containers that began later take precedence. Unless `anew`, containers of
        which the engine has nothing new to say are not inspected again. Raises Unreachable."""
        if silence := self._cache.silence:
            raise Unreachable("look at the engine", str(silence), REMEDY)
        if self.objects:
            self.objects.check()
        look, before = self._cache.begin(), {} if anew else self._cache.known()
        listed = self.engine.list(before)
        self._check_ends(listed)
        self.lists += 1
        if self._cache.show_all(listed, before, look):
            self.wake()

    def _check_ends(self, found: Iterable[Container]) -> None:
        """If a run has ended, check that the engine goes on. One that ends itself stops its containers and still
        answers on open connections, but takes no new one. Raises Unreachable then: no program is to blame."""
        if isinstance(self.engine, Daemon) and self._cache.has_ended(found):
            pinger = self.engine.pinger()
            try:
                pinger.ask()
            finally:
                pinger.close()

    def look(self, looks: Mapping[str, float]) -> None:
        """Look at each of these containers in a thread, unless a look at it began after that moment, and then wake the
        loop. The loop asks in every pass, so what could not be looked at now is asked for again."""
        left = {c: at for c, at in looks.items() if self._cache.looked_at(c) < at}
        if left and not self._looking and self._answering.is_set():
            self._looking = True
            threading.Thread(target=self._look_at, args=(left,), name="looks", daemon=True).start()

    def _look_at(self, looks: Mapping[str, float]) -> None:
        for container in looks:
            self.refresh(container)
        if all(self._cache.looked_at(c) < at for c, at in looks.items()):
            self._stop.wait(retry_after(1))  # the engine does not answer, or not promptly
        self._looking = False
        self.wake()

    def _lost(self, error: Exception) -> None:
        self._cache.doubt(str(error) if isinstance(error, RorgError) else f"{type(error).__name__}: {error}")
        self.ask()
        self.wake()

    def _follow(self) -> None:
        attempt = 0
        while not self._stop.is_set():
            self._answering.wait()
            ended = self._stream_end = Reading()
            if self._stop.is_set() or not self._answering.is_set():
                continue
            try:
                for container, state in self.engine.events(ended):
                    attempt = 0
                    if not container:
                        self.sync()
                    elif state == SIGNALLED:
                        self._cache.note_signal(container)
                    elif self._cache.is_news(container, state):
                        self.refresh(container)
                        self.wake()
            except Exception as error:  # without this thread no change would be noticed any more
                self._lost(error)
            ended.set()
            self._stop.wait(retry_after(attempt))
            attempt += 1

    def _find_vanished(self) -> None:
        """Compare the engine's word with the processes of this machine now and then."""
        while self._vanished and not self._stop.wait(EVERY):
            known = self.snapshot()
            if not known.complete:
                continue
            try:
                runs = self._vanished.look(known.containers)
            except Unreachable:  # no descriptor is left to look
                continue
            for container in known.containers:
                if container.incarnation in runs and not container.vanished:
                    self.refresh(container.id)  # the engine may just know by now
            if self._cache.show_vanished(runs):
                self.wake()

    def _resync_now_and_then(self) -> None:
        last, attempt = time.monotonic(), 0
        while not self._stop.is_set():
            doubted = self._doubt.wait(max(0.05, last + self.resync() - time.monotonic()))
            if not self._answering.is_set():
                self._answering.wait()
                attempt = 0
            if doubted and self._stop.wait(retry_after(attempt)):
                return
            self._doubt.clear()
            last = time.monotonic()
            if doubted or self.snapshot().complete:
                try:
                    self.sync()
                    attempt = 0
                except Exception as error:
                    attempt += 1
                    self._lost(error)
                    self._doubt.set()
