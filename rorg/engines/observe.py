"""A cache of the engine's containers: fed by its events, and checked by a full list now and then."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace

from rorg.core.observed import Container, Observed, Silence
from rorg.engines.heartbeat import Heartbeat, retry_after
from rorg.engines.log_lines import Reading
from rorg.engines.observe_objects import ObjectObserver
from rorg.engines.protocol import Daemon, Objects, Observation
from rorg.errors import RorgError, Unreachable

REMEDY = "`systemctl status docker`, or `rorg doctor`"
PROMPT = 1.0
"""Seconds for a current answer. An engine that took longer may have been frozen, and answered before it noticed what
happened meanwhile."""


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
        self.engine, self.wake, self.resync, self.clock = engine, wake, resync, clock
        self.heartbeat = Heartbeat(engine, self._heard, heard) if isinstance(engine, Daemon) else None
        """None for an engine that cannot fall silent."""
        self._answering = threading.Event()
        """Cleared while the engine is silent: then rorg asks it nothing."""
        self._answering.set()
        self.objects = ObjectObserver(engine, wake, self._answering) if isinstance(engine, Objects) else None
        """Of networks and volumes; None for an engine without them."""
        self._lock = threading.Lock()
        self._containers: dict[str, Container] = {}
        self._clock = itertools.count(1)
        self._began: dict[str, int] = {}
        """When, by that clock, the look began whose result the cache shows. Answers can overtake each other."""
        self._looked: dict[str, float] = {}
        """When, by the loop's clock, the last look began that the engine answered promptly."""
        self._looking = False
        """Whether looks that the loop asked for are under way."""
        self._acting: dict[str, list[str]] = {}
        """Containers with a call under way, with the states in events about them meanwhile."""
        self._snapshot = Observed(complete=False)
        self._changed = False
        """The cache is ahead of the snapshot, which is made on demand."""
        self._silence: Silence | None = None
        self._stop, self._doubt = threading.Event(), threading.Event()
        self._stream_end = Reading()
        """Set to end the current stream of events."""
        self.lists = 0
        """Full lists made so far."""

    def start(self) -> None:
        for target in (self._follow, self._resync_now_and_then):
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
        with self._lock:
            self._silence = silence
            self._publish(False, str(silence or ""))
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
        with self._lock:
            if self._changed or self._snapshot.objects is not objects:
                told, self._changed = self._snapshot, False
                known, looked = tuple(self._containers.values()), {**self._looked}
                self._snapshot = Observed(known, told.complete, told.error, objects, looked, self._silence)
            found = self._snapshot
        return replace(found, complete=False) if objects and not objects.complete else found

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
        began, since = next(self._clock), self.clock()
        try:
            found = self.engine.inspect(container)
        except RorgError as error:
            self._lost(error)
            self._doubt.set()
            return
        with self._lock:
            if self._began.get(container, 0) > began:
                return  # a later look has answered already
            self._began[container] = began
            old = self._containers.get(container)
            if found is None:
                self._containers.pop(container, None)
            else:
                self._containers[container] = found
            self._note_look([container] if found else [], since)
            if old != found:
                self._publish(self._snapshot.complete, self._snapshot.error)

    def _told(self, container: str, state: str) -> None:
        """Handle an event. It may be older than the cache, because the stream lags behind the calls: so a state that
        differs is looked up, not believed."""
        with self._lock:
            if container in self._acting:
                self._acting[container].append(state)
                return
            known = self._containers.get(container)
            if state and known is not None and known.state == state:
                return
        self.refresh(container)
        self.wake()

    @contextlib.contextmanager
    def acting(self, container: str) -> Iterator[None]:
        """Leave events of this container to done(), which the caller calls after the block."""
        with self._lock:
            self._acting[container] = []
        try:
            yield
        except BaseException:
            with self._lock:
                self._acting.pop(container, None)
            raise

    def done(self, container: str, state: str) -> None:
        """A call succeeded. A container that was alive is now in this state and the same run, or only a look can tell
        (""). Events of other changes meanwhile lead to a look too."""
        with self._lock:
            beside = [told for told in self._acting.pop(container, []) if told != state]
            known = self._containers.get(container)
            if state and not beside and known is not None and known.alive and not known.brief:
                self._began[container] = next(self._clock)
                if known.state != state:
                    self._containers[container] = replace(known, state=state)
                    self._publish(self._snapshot.complete, self._snapshot.error)
                return
        self.refresh(container)

    def sync(self, anew: bool = True) -> None:
        """Make one full list. Looks at single containers that began later take precedence. Unless `anew`, containers of
        which the engine has nothing new to say are not inspected again. Raises Unreachable."""
        if silence := self._silence:
            raise Unreachable("look at the engine", str(silence), REMEDY)
        if self.objects:
            self.objects.check()
        began, since = next(self._clock), self.clock()
        with self._lock:
            before = {**self._containers} if self._snapshot.complete and not anew else {}
        found = {c.id: c for c in self.engine.list(before)}
        self.lists += 1
        with self._lock:
            self._note_look([c for c, new in found.items() if not new.brief and new is not before.get(c)], since)
            found = {c: self._seen(new, before) for c, new in found.items()}
            for container in [c for c, at in self._began.items() if at > began]:
                found.pop(container, None)
                if container in self._containers:
                    found[container] = self._containers[container]
            self._began = {
                c: max(began, self._began.get(c, 0))
                for c in {*found, *self._began}
                if c in found or self._began[c] > began
            }
            changed = found != self._containers or not self._snapshot.complete
            # Unchanged containers stay the same object, which is how a pass recognizes them.
            found = {c: known if (known := self._containers.get(c)) == new else new for c, new in found.items()}
            self._containers = found
            self._looked = {c: at for c, at in self._looked.items() if c in found}
            if changed:
                self._publish(True, "")
        if changed:
            self.wake()

    def _note_look(self, containers: Collection[str], since: float) -> None:
        """Note that the engine was asked about these containers then, and has answered now."""
        if self.clock() - since <= PROMPT:
            self._looked.update((c, since) for c in containers if since > self._looked.get(c, 0.0))
            self._changed = self._changed or bool(containers)

    def look(self, looks: Mapping[str, float]) -> None:
        """Look at each of these containers in a thread, unless a look at it began after that moment, and then wake the
        loop. The loop asks in every pass, so what could not be looked at now is asked for again."""
        left = {c: at for c, at in looks.items() if self._last_look(c) < at}
        if left and not self._looking and self._answering.is_set():
            self._looking = True
            threading.Thread(target=self._look_at, args=(left,), name="looks", daemon=True).start()

    def _look_at(self, looks: Mapping[str, float]) -> None:
        for container in looks:
            self.refresh(container)
        if all(self._last_look(c) < at for c, at in looks.items()):
            self._stop.wait(retry_after(1))  # the engine does not answer, or not promptly
        self._looking = False
        self.wake()

    def _last_look(self, container: str) -> float:
        """When the last look at it began, by the loop's clock."""
        with self._lock:
            return self._looked.get(container, -1.0)

    def _seen(self, found: Container, before: Mapping[str, Container]) -> Container:
        """If the engine reported only the state of a container, or nothing new, combine that with what is known of
        it."""
        known = self._containers.get(found.id)
        if found is before.get(found.id):
            return known or found
        if known is None or not found.brief:
            return found
        return replace(known, state=found.state) if known.alive and found.alive else known

    def _publish(self, complete: bool, error: str) -> None:
        """Publish a change. As long as the engine is silent the snapshot stays incomplete."""
        self._changed = True
        if self._silence:
            complete, error = False, str(self._silence)
        if (complete, error) != (self._snapshot.complete, self._snapshot.error):
            self._snapshot = Observed((), complete, error)

    def _lost(self, error: Exception) -> None:
        with self._lock:
            self._publish(False, str(error) if isinstance(error, RorgError) else f"{type(error).__name__}: {error}")
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
                    if container:
                        self._told(container, state)
                    else:
                        self.sync()
            except Exception as error:  # without this thread no change would be noticed any more
                self._lost(error)
            ended.set()
            self._stop.wait(retry_after(attempt))
            attempt += 1

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
