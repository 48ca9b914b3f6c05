"""Workers carry out actions, one engine call each, off the pass. They decide nothing; every action has an outcome."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import nullcontext, suppress

from rorg.core.operations import ObjectOperation, Pause, Remove
from rorg.core.outcomes import Outcome
from rorg.core.plan import Action
from rorg.daemon.recorder import Recorder
from rorg.engines.execute import failure, perform
from rorg.engines.observe import Observer
from rorg.engines.protocol import Engine
from rorg.errors import RorgError

WORDS = 4096
"""Bytes of what a container said last that are noted."""


class Workers:
    """`wake` is called when there is an outcome; `paused` after every pause that went well,
    `ceasing` before a pause or a stop. `clock` gives seconds."""

    def __init__(
        self,
        engine: Engine,
        observer: Observer,
        recorder: Recorder,
        clock: Callable[[], float],
        wake: Callable[[], None],
        paused: Callable[[str], None],
        ceasing: Callable[[str], None],
        most: int,
    ) -> None:
        self.engine, self.observer, self.recorder = engine, observer, recorder
        self.clock, self.wake, self.paused, self.ceasing = clock, wake, paused, ceasing
        self._pool = ThreadPoolExecutor(most, thread_name_prefix="worker")
        self._lock = threading.Lock()
        self._outcomes: list[Outcome] = []
        self._calls: set[Future[None]] = set()
        self.hung: set[Future[None]] = set()
        """Calls that were still under way when the loop had ended."""

    def begin(self, action: Action) -> None:
        """Hands an action to a worker. Whatever happens, an outcome comes of it."""
        try:
            call = self._pool.submit(self._work, action)
        except RuntimeError as error:  # no thread can be started now
            self._finished(Outcome(action, str(error)))
            return
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)

    def take(self) -> list[Outcome]:
        """Outcomes since the last time."""
        with self._lock:
            found, self._outcomes = self._outcomes, []
        return found

    def stop(self, patience: float) -> None:
        """Calls under way are waited for, but no longer than `patience` seconds: what they do is observed next time."""
        _, self.hung = wait(tuple(self._calls), timeout=patience)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _finished(self, outcome: Outcome) -> None:
        with self._lock:
            self._outcomes.append(outcome)
        self.wake()

    def _work(self, action: Action) -> None:
        began, made, outcome = self.clock(), "", Outcome(action)
        self._last_words(action)
        try:
            if action.operation.idles:
                self.ceasing(action.service)
            with self.observer.acting(action.container) if action.container else nullcontext():
                made = perform(self.engine, action.operation)
        except RorgError as failed:
            outcome = failure(action, failed)
        except Exception as bug:  # a worker's bug must not lose the outcome, or the service stays in flight for ever
            outcome = Outcome(action, f"internal error: {type(bug).__name__}: {bug}")
        try:
            if isinstance(action.operation, ObjectOperation):
                self.observer.refresh_objects()
            elif action.container and not outcome.error:
                self.observer.done(action.container, action.operation.leaves)
            elif made or action.container:
                self.observer.refresh(made or action.container)
            self.recorder.outcome(action, outcome.error, self.clock() - began)
        finally:
            self._finished(outcome)
        if isinstance(action.operation, Pause) and not outcome.error:
            self.paused(action.service)

    def _last_words(self, action: Action) -> None:
        """What a container said that did not come up, before it is gone."""
        if not (isinstance(action.operation, Remove) and action.operation.last_words):
            return
        with suppress(RorgError):
            said = b""
            for piece in self.engine.logs(action.container, False, 10):
                said = (said + piece)[-WORDS:]
            if said := said.strip():
                self.recorder.event(
                    "last-words",
                    f"the container of {action.service} that failed printed last:\n{said.decode(errors='replace')}",
                    service=action.service,
                    container=action.container[:12],
                )
