"""Workers make the engine calls of actions, one each, beside the loop. They decide nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import nullcontext, suppress

from rorg.core.dispatch import DispatchLimits, Outcome
from rorg.core.operations import ObjectOperation, Pause, Remove
from rorg.core.plan import Action
from rorg.daemon.recorder import Recorder
from rorg.daemon.running import Running
from rorg.engines.execute import failure, perform
from rorg.engines.observe import Observer
from rorg.engines.protocol import ManagedNodes
from rorg.errors import RorgError

WORDS = 4096
"""Bytes of a failed container's last output that go into the journal."""


class Workers:
    """`wake` is called after each outcome, `ceasing` before a pause or a stop. `most` calls run at the same time."""

    def __init__(
        self,
        observer: Observer,
        recorder: Recorder,
        wake: Callable[[], None],
        running: Running,
        ceasing: Callable[[str], None],
        *,
        nodes: ManagedNodes,
        most: int = DispatchLimits().most,
    ) -> None:
        self.engine, self.observer, self.recorder, self.nodes = running.engine, observer, recorder, nodes
        self.wake, self.paused, self.ceasing = wake, running.paused, ceasing
        self._pool = ThreadPoolExecutor(most, thread_name_prefix="worker")
        self._lock = threading.Lock()
        self._outcomes: list[Outcome] = []
        self._calls: set[Future[None]] = set()
        self.hung: set[Future[None]] = set()
        """Calls that were still under way when the loop ended."""

    def begin(self, action: Action) -> None:
        """Hand an action to a worker. It has an outcome in every case."""
        try:
            call = self._pool.submit(self._work, action)
        except RuntimeError as error:  # no more threads
            self._finished(Outcome(action, str(error)))
            return
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)

    def take(self) -> list[Outcome]:
        """Outcomes since the previous call."""
        with self._lock:
            outcomes, self._outcomes = self._outcomes, []
        return outcomes

    def stop(self, patience: float) -> None:
        """Wait at most `patience` seconds for calls under way. The next rorg sees what the others did."""
        _, self.hung = wait(tuple(self._calls), timeout=patience)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _finished(self, outcome: Outcome) -> None:
        with self._lock:
            self._outcomes.append(outcome)
        self.wake()

    def _work(self, action: Action) -> None:
        began, made, outcome = time.monotonic(), "", Outcome(action)
        self._last_words(action)
        try:
            if action.operation.idles:
                self.ceasing(action.service)
            with self.observer.acting(action.container) if action.container else nullcontext():
                made = perform(self.engine, action.operation, self.nodes)
        except RorgError as failed:
            outcome = failure(action, failed)
        except Exception as bug:  # without an outcome the service would be in flight for ever
            outcome = Outcome(action, f"internal error: {type(bug).__name__}: {bug}")
        try:
            if isinstance(action.operation, ObjectOperation):
                self.observer.refresh_objects()
            elif action.container and not outcome.error:
                self.observer.done(action.container, action.operation.engine_leaves)
            elif made or action.container:
                self.observer.refresh(made or action.container)
            self.recorder.outcome(action, outcome.error, time.monotonic() - began)
        finally:
            self._finished(outcome)
        if isinstance(action.operation, Pause) and not outcome.error:
            self.paused(action.service)

    def _last_words(self, action: Action) -> None:
        """Record the last output of a container that failed, before it is removed."""
        if not (isinstance(action.operation, Remove) and action.operation.last_words):
            return
        with suppress(RorgError):
            said = b""
            for line in self.engine.log_lines(action.container, 10, None, False):
                said = (said + line.text)[-WORDS:]
            if said := said.strip():
                self.recorder.event(
                    "last-words",
                    f"the container of {action.service} that failed printed last:\n{said.decode(errors='replace')}",
                    service=action.service,
                    container=action.container[:12],
                )
