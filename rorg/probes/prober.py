"""Runs probes beside the loop, in a few workers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

from rorg.core.assessment import FRESH
from rorg.core.memory import ProbeResult, together
from rorg.core.schedule import Target
from rorg.probes.answer import Answer, cannot_ask

LONGEST = 3600.0
"""Seconds of sleep at most."""
WORKERS = 8
"""Attempts at the same time."""
SLOW = 1.5
"""Seconds after which an attempt no longer counts among these: hanging attempts must not keep others waiting."""
MOST = 64
"""Attempts at the same time, hanging ones included."""
SHARE = 0.05
"""Share of a core that one probe may take: one that has much to read is asked less often."""

Key = tuple[str, str]
"""(service, role)"""
Question = tuple[str, str, int]
"""(service, role, which of its questions)"""
Ask = Callable[[Key, Target], Answer]
"""Asks once."""


class Prober:
    """Probes the current targets, each every `every` seconds, and wakes the loop when it learns something. `ask` makes
    one attempt. Times are of `clock`, in seconds. A probe with several questions has an attempt for each, so that a
    slow one does not hold up the others."""

    def __init__(
        self, clock: Callable[[], float], wake: Callable[[], None], ask: Ask, stopping: threading.Event | None = None
    ) -> None:
        """`stopping` is set when attempts under way must end."""
        self.clock, self.wake, self.ask = clock, wake, ask
        self._pool = ThreadPoolExecutor(MOST, thread_name_prefix="probe")
        self._condition = threading.Condition()
        self._whole: Mapping[Key, Target] = {}
        self._targets: dict[Question, Target] = {}
        self._due: dict[Question, float] = {}
        self._busy: dict[Question, float] = {}
        """Attempts under way, and when each began."""
        self._answers: dict[Question, ProbeResult] = {}
        self._results: dict[Key, ProbeResult] = {}
        self._stopping = stopping or threading.Event()
        self.hung = 0
        """Attempts that were still under way after join()."""

    def start(self) -> None:
        threading.Thread(target=self._run, name="prober", daemon=True).start()

    def stop(self) -> None:
        with self._condition:
            self._stopping.set()
            self._condition.notify_all()
        self._pool.shutdown(wait=False)

    def join(self, patience: float) -> None:
        """Wait at most `patience` seconds for attempts under way."""
        with self._condition:
            self._condition.wait_for(lambda: not self._busy, patience)
            self.hung = len(self._busy)

    def results(self) -> Mapping[Key, ProbeResult]:
        with self._condition:
            return dict(self._results)

    def watch(self, targets: Mapping[Key, Target]) -> None:
        """Probe these from now on. Anything else is forgotten: if it comes back it begins afresh."""
        with self._condition:
            asked = {(*key, part.part): part for key, target in targets.items() for part in target.parts()}
            again = [k for k, t in asked.items() if self._asked_anew(k, t)]
            if asked == self._targets and not again:
                return
            now, fresh = self.clock(), [k for k, t in asked.items() if self._targets.get(k) != t]
            for index, key in enumerate(fresh):
                # Ask for readiness now. Liveness that was just seen can wait, and not all are asked at the same time.
                wait = asked[key].every * (1 + index / len(fresh)) if key[1] == "live" else 0.0
                self._due[key] = now + wait
                self._answers.pop(key, None)
                self._results.pop(key[:2], None)
            self._due.update(dict.fromkeys(again, now))
            self._targets, self._whole = asked, dict(targets)
            self._due = {k: t for k, t in self._due.items() if k in asked}
            self._answers = {k: f for k, f in self._answers.items() if k in asked}
            self._results = {k: f for k, f in self._results.items() if k in targets}
            self._condition.notify()

    def _asked_anew(self, key: Question, target: Target) -> bool:
        """Whether someone has begun to wait since it was last asked."""
        before = self._targets.get(key)
        return before == target and target.asked is not None and (before.asked or 0.0) < target.asked

    def _run(self) -> None:
        with self._condition:
            while not self._stopping.is_set():
                now = self.clock()
                due = sorted((at, key) for key, at in self._due.items() if at <= now and key not in self._busy)
                for _, key in due[: self._free(now)]:
                    self._busy[key] = now
                    self._pool.submit(self._probe, key, self._targets[key])
                waits = [at + SLOW - now for at in self._busy.values() if at + SLOW > now]
                if self._free(now) > 0:
                    waits += [t - now for k, t in self._due.items() if k not in self._busy]
                self._condition.wait(min(max(0.0, min(waits)), LONGEST) if waits else None)

    def _free(self, now: float) -> int:
        """How many attempts may begin."""
        return max(0, min(WORKERS - sum(now < at + SLOW for at in self._busy.values()), MOST - len(self._busy)))

    def _probe(self, key: Question, target: Target) -> None:
        began, used = self.clock(), time.thread_time()
        try:
            answer = self.ask(key[:2], target)
        except Exception as bug:  # a broken probe must end neither the probing nor the service
            answer = cannot_ask(f"{type(bug).__name__}: {bug}")
        with self._condition:
            del self._busy[key]
            now = self._targets.get(key)
            rested = began + (time.thread_time() - used) / SHARE
            told = now is not None and now == target and self._learn(key, now, answer, began, rested)
            self._condition.notify_all()
        if told:
            self.wake()

    def _learn(self, key: Question, target: Target, answer: Answer, began: float, rested: float) -> bool:
        """Note a finding; return whether it is news. A question that could not be asked is no failure of the service.
        The next attempt begins when the probe has `rested`."""
        old = self._answers.get(key)
        failures = 0 if answer.ok else (old.failures if old else 0) + answer.asked
        self._answers[key] = new = ProbeResult(
            target.incarnation, answer.ok, began, answer.message, failures, target.probe
        )
        self._tell(key[:2])
        since = target.asked or 0.0
        self._due[key] = max(rested, began + target.next_after(failures) if began >= since else self.clock())
        if old is None or old.ok != new.ok or old.message != new.message or old.at < since <= began:
            return True
        if key[1] == "interlock":
            # The loop ignores an answer that is too old, so then the same answer is news.
            return bool(self.clock() - old.at > target.probe.interval + FRESH)
        return failures != old.failures and failures == target.probe.failures

    def _tell(self, key: Key) -> None:
        """Combine the answers of a probe's questions."""
        probe = self._whole[key].probe
        answer = together(probe, [self._answers.get((*key, part)) for part in range(len(probe.questions))])
        if answer is not None:
            self._results[key] = answer
