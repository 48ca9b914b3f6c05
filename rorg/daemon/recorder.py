"""Records events: as lines for people, and in the journal. reporter.py finds the events of each pass."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from rorg.core.masking import Masker
from rorg.core.memory import Memory
from rorg.core.plan import Action
from rorg.daemon.history import Historian
from rorg.history.database import Database
from rorg.history.journal import Journal
from rorg.host.shared_memory import Removed
from rorg.model.causes import common_cause
from rorg.model.units import counted, format_memory
from rorg.store.state_dir import StateDir

ALWAYS = ("tree", "requests", "engine")
"""Keys whose first value is an event, even if it is empty."""
QUIET_AT_FIRST = ("engine", "pressure")
"""Keys whose first value is not worth a line of its own when the loop begins."""
REPEATED = ("crashed", "done")
"""Kinds of events that a service which ends again and again repeats."""
LONG = 60
"""Characters of an error that is not repeated for each service in the lines for people."""
LATELY = 60.0
"""Seconds for which such a line may be referred to."""


class Recorder:
    """`say` gets one line for each event; `wall` gives ISO 8601 in UTC. Lines and journal omit what `masker` hides. Any
    thread may call event(), tell() and what is built on them."""

    def __init__(self, state: StateDir, say: Callable[[str], None], wall: Callable[[], str], masker: Masker) -> None:
        self.masker, self.say, self.wall = masker, say, wall
        self.history = Database(state.journal, wall)
        self.journal = Journal(self.history)
        self.historian = Historian(self.history, wall, masker, self.revision_failed)
        self.told: Callable[[str], None] = lambda _: None
        """Called with the kind of each event, after it is in the journal."""
        self._errors: dict[str, tuple[str, float]] = {}
        """Long error -> the service that told it first lately, and when it last did."""
        self._said: dict[str, Any] = {}
        self._folded: set[str] = set()
        """Services of which REPEATED events get no line."""
        self._lock = threading.Lock()

    def begin(self, memory: Memory) -> None:
        """Do not repeat what the previous rorg reported."""
        for name, step in memory.progress.items():
            known = {"crashes": step.crashes, "stalled": step.stalled, "update": step.update.failed}
            self._said.update({f"{word} {name}": value for word, value in known.items()})

    def event(self, kind: str, message: str, person: bool = False, **more: Any) -> None:
        """`person`: a person did it."""
        with self._lock:
            if kind not in REPEATED or more.get("service") not in self._folded:
                self.tell(self._line(message, str(more.get("error") or ""), str(more.get("service") or "")))
            masker = self.masker.of(more.get("service"))
            self.journal.append(self.wall(), kind, masker.text(message), person, **masker.value(more))
        self.told(kind)

    def fold(self, service: str, folded: bool) -> None:
        """Whether exits and calls of a service are only in the journal, because it does the same again and again."""
        (self._folded.add if folded else self._folded.discard)(service)

    def _line(self, message: str, error: str, service: str) -> str:
        """The line of an event for people: a long error that another service has just told is not repeated."""
        if len(error) < LONG or not service:
            return message
        now, cause = time.monotonic(), common_cause(error)
        self._errors = {known: told for known, told in self._errors.items() if now - told[1] < LATELY}
        first, _ = self._errors.get(cause, (service, now))
        if first == service:
            self._errors[cause] = service, now
            return message
        return message.replace(error, f"same error as {first}")

    def tell(self, message: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # our output is closed
            self.say(self.masker.text(message))

    def is_news(self, key: str, value: Any) -> bool:
        """Whether the value of a key has changed since the last call, and is worth an event."""
        first = key not in self._said
        if not first and self._said[key] == value:
            return False
        self._said[key] = value
        return not first or key in ALWAYS or bool(value and key not in QUIET_AT_FIRST)

    def when_new(self, key: str, value: Any, kind: str, message: str) -> None:
        """Record an event, unless the last one of this key had the same value."""
        if self.is_news(key, value):
            self.event(kind, message)

    def forget(self, keys: Iterable[str]) -> None:
        """The next value of these keys is a first one again."""
        for key in keys:
            self._said.pop(key, None)

    def revision_failed(self, number: int, why: str, was_good: bool) -> None:
        """A revision of the manifests has failed; what it changed runs as before."""
        text = "was good, and fails now" if was_good else "failed"
        self.event("revision-failed", f"revision {number} of the manifests {text}: {why}", revision=number)

    def purged(self, node: str) -> None:
        """A ROS node's registration was taken out of the master."""
        text = f"the stale registration of the ROS node {node} was taken out of the master"
        self.event("ros-purged", text, node=node)

    def parameters_set(self, service: str, master: str, names: list[str]) -> None:
        """ROS parameters of a service were set at its master; their values are not recorded."""
        text = f"{counted(len(names), 'ROS parameter')} of {service} set at {master}: {', '.join(names)}"
        self.event("parameters-set", text, service=service, master=master, parameters=names)

    def shm_purged(self, removed: Removed) -> None:
        """Files that dead ROS 2 participants left were removed."""
        files = f"{counted(removed.files, 'file')} ({format_memory(removed.size)})"
        text = f"{files} of dead ROS 2 participants removed from shared memory"
        self.event("shm-purged", text, files=removed.files, bytes=removed.size)

    def outcome(self, action: Action, error: str, seconds: float) -> None:
        text = f"{action}: " + (f"failed: {error}" if error else f"done in {seconds * 1000:.0f} ms")
        self.event(
            "failed" if error else "done",
            text,
            verb=action.verb,
            service=action.service,
            container=action.container[:12],
            reason=action.reason,
            fields=list(action.fields),
            error=error,
            seconds=round(seconds, 4),
        )
