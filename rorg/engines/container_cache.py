"""The known state of the engine's containers, from looks that may overtake each other, events and calls under way. The
cache never asks the engine; its observer does."""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, replace

from rorg.core.observed import Container, FoundObjects, Observed, Silence

PROMPT = 1.0
"""Seconds for a current answer. An engine that took longer may have been frozen, and answered before it noticed what
happened meanwhile."""


@dataclass(frozen=True, slots=True)
class Look:
    """The beginning of a question to the engine."""

    number: int
    """Later looks have higher numbers. Their answers can overtake each other."""
    since: float
    """When it began, by the loop's clock."""


class ContainerCache:
    """Used by several threads. Each method takes the lock, and none waits for the engine."""

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock` is the loop's, in seconds."""
        self.clock = clock
        self._lock = threading.Lock()
        self._containers: dict[str, Container] = {}
        self._numbers = itertools.count(1)
        self._shown: dict[str, int] = {}
        """The number of the look whose result the cache shows."""
        self._looked: dict[str, float] = {}
        """When, by the loop's clock, the last look began that the engine answered promptly."""
        self._acting: dict[str, list[str]] = {}
        """Containers with a call under way, with the states in events about them meanwhile."""
        self._starts = itertools.count(1)
        self._listed = False
        """Whether the containers that were there before this rorg are known."""
        self._vanished: Set[str] = frozenset()
        """Incarnations whose process has ended although the engine calls them running."""
        self._snapshot = Observed(complete=False)
        self._changed = False
        """The cache is ahead of the snapshot, which is made on demand."""
        self._silence: Silence | None = None

    def begin(self) -> Look:
        """Begin a look, before the engine is asked."""
        return Look(next(self._numbers), self.clock())

    def show(self, container: str, inspection: Container | None, look: Look) -> None:
        """Take what a look at one container found, unless a later look has answered already. None: it is gone."""
        with self._lock:
            if self._shown.get(container, 0) > look.number:
                return
            self._shown[container] = look.number
            old = self._containers.get(container)
            if inspection is None:
                self._containers.pop(container, None)
            else:
                inspection = self._containers[container] = self._completed(inspection)
            self._note([container] if inspection else [], look)
            if old != inspection:
                self._publish(self._snapshot.complete, self._snapshot.error)

    def known(self) -> Mapping[str, Container]:
        """Return the containers that a list need not inspect again if nothing has changed; none after a doubt."""
        with self._lock:
            return {**self._containers} if self._snapshot.complete else {}

    def has_ended(self, found: Iterable[Container]) -> bool:
        """Return whether the run of one of these goes on as far as is known, but has ended."""
        with self._lock:
            return any(c.ended and (known := self._containers.get(c.id)) is not None and known.alive for c in found)

    def show_all(self, listed: Iterable[Container], before: Mapping[str, Container], look: Look) -> bool:
        """Take a full list, and return whether it changed anything. Looks at single containers that began later take
        precedence. `before` are the containers that the list did not inspect again."""
        containers = {c.id: c for c in listed}
        with self._lock:
            self._note([c for c, new in containers.items() if not new.brief and new is not before.get(c)], look)
            containers = {c: self._completed(self._merged(new, before)) for c, new in containers.items()}
            self._listed = True
            later = {c: number for c, number in self._shown.items() if number > look.number}
            for container in later:
                containers.pop(container, None)
                if container in self._containers:
                    containers[container] = self._containers[container]
            self._shown = {c: later.get(c, look.number) for c in {*containers, *later}}
            changed = containers != self._containers or not self._snapshot.complete
            # Unchanged containers stay the same object, which is how a pass recognizes them.
            self._containers = {
                c: known if (known := self._containers.get(c)) == new else new for c, new in containers.items()
            }
            self._looked = {c: at for c, at in self._looked.items() if c in containers}
            if changed:
                self._publish(True, "")
        return changed

    def note_signal(self, container: str) -> None:
        """A run was sent a signal that ends programs, unless a call of rorg's did it."""
        with self._lock:
            known = self._containers.get(container)
            if container not in self._acting and known is not None and known.alive:
                self._containers[container] = replace(known, signalled=True)
                self._publish(self._snapshot.complete, self._snapshot.error)

    def is_news(self, container: str, state: str) -> bool:
        """Return whether an event calls for a look. It may be older than the cache, because the stream lags behind the
        calls: so a state that differs is looked up, not believed."""
        with self._lock:
            if container in self._acting:
                self._acting[container].append(state)
                return False
            known = self._containers.get(container)
            return not state or known is None or known.state != state

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

    def done(self, container: str, state: str) -> bool:
        """A call succeeded: a container that was alive is now in this state and the same run. Return whether that is
        all that happened; if not, or if `state` is "", only a look can tell."""
        with self._lock:
            beside = [told for told in self._acting.pop(container, []) if told != state]
            known = self._containers.get(container)
            if not state or beside or known is None or not known.alive or known.brief:
                return False
            self._shown[container] = next(self._numbers)
            if known.state != state:
                self._containers[container] = replace(known, state=state)
                self._publish(self._snapshot.complete, self._snapshot.error)
            return True

    def looked_at(self, container: str) -> float:
        """Return when the last look at it began, by the loop's clock; -1 for none."""
        with self._lock:
            return self._looked.get(container, -1.0)

    @property
    def silence(self) -> Silence | None:
        """Why the engine is asked nothing; None while it answers."""
        return self._silence

    def hear(self, silence: Silence | None) -> None:
        """The engine fell silent, or answers again (None). Either way it has to be listed again."""
        with self._lock:
            self._silence = silence
            self._publish(False, str(silence or ""))

    def doubt(self, error: str) -> None:
        """The engine did not answer: the snapshot is incomplete until the next full list."""
        with self._lock:
            self._publish(False, error)

    def snapshot(self, objects: FoundObjects | None) -> Observed:
        """Return what is known, with these networks and volumes."""
        with self._lock:
            if self._changed or self._snapshot.objects is not objects:
                told, self._changed = self._snapshot, False
                known, looked = tuple(self._containers.values()), {**self._looked}
                self._snapshot = Observed(known, told.complete, told.error, objects, looked, self._silence)
            return self._snapshot

    def _note(self, containers: Collection[str], look: Look) -> None:
        """Note that the engine was asked about these containers then, and has answered now."""
        if self.clock() - look.since <= PROMPT:
            self._looked.update((c, look.since) for c in containers if look.since > self._looked.get(c, 0.0))
            self._changed = self._changed or bool(containers)

    def _merged(self, container: Container, before: Mapping[str, Container]) -> Container:
        """If the engine reported only the state of a container, or nothing new, combine that with what is known of
        it."""
        known = self._containers.get(container.id)
        if container is before.get(container.id):
            return known or container
        if known is None or not container.brief:
            return container
        return replace(known, state=container.state) if known.alive and container.alive else known

    def show_vanished(self, runs: Set[str]) -> bool:
        """Take the incarnations whose process has ended, and return whether that changed anything."""
        with self._lock:
            self._vanished = runs
            completed = {c: self._completed(known) for c, known in self._containers.items()}
            changed = any(completed[c] is not known for c, known in self._containers.items())
            if changed:
                self._containers = completed
                self._publish(self._snapshot.complete, self._snapshot.error)
            return changed

    def _completed(self, container: Container) -> Container:
        """Add what the engine does not say: the number of a run that began after the first list, whether its process
        has ended, and whether someone else told it to end."""
        known = self._containers.get(container.id)
        if known is not None and (known.brief or known.started_at == container.started_at):
            number = known.start_number
        else:
            number = next(self._starts) if self._listed and (container.started_at or container.brief) else 0
        vanished = container.state == "running" and container.incarnation in self._vanished
        signalled = known is not None and known.signalled and known.started_at == container.started_at
        if (container.start_number, container.vanished, container.signalled) == (number, vanished, signalled):
            return container
        return replace(container, start_number=number, vanished=vanished, signalled=signalled)

    def _publish(self, complete: bool, error: str) -> None:
        """Publish a change. As long as the engine is silent the snapshot stays incomplete."""
        self._changed = True
        if self._silence:
            complete, error = False, str(self._silence)
        if (complete, error) != (self._snapshot.complete, self._snapshot.error):
            self._snapshot = Observed((), complete, error)
