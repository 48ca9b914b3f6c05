"""Readiness probes, run off the pass by a few workers."""

from __future__ import annotations

import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor

from rorg.core.memory import Probe
from rorg.manifest.catalog import Ready

TIMEOUT = 1.0
"""Seconds for one attempt."""


def probe_once(ready: Ready) -> str:
    """Empty when ready, else what was found."""
    try:
        if ready.probe == "tcp":
            host, _, port = str(ready.target).rpartition(":")
            with socket.create_connection((host, int(port)), timeout=TIMEOUT):
                return ""
        with urllib.request.urlopen(str(ready.target), timeout=TIMEOUT):
            return ""
    except urllib.error.HTTPError as error:
        return f"{ready.target} answers {error.code}"
    except OSError as error:
        reason = getattr(error, "reason", error)
        return f"{ready.probe} {ready.target}: {getattr(reason, 'strerror', None) or reason}"


class Prober:
    """Probes what it was last told to, each service every `interval` seconds, and wakes the loop when it learns
    something. Times are of `clock`, seconds."""

    def __init__(self, clock: Callable[[], float], wake: Callable[[], None], workers: int = 4) -> None:
        self.clock, self.wake = clock, wake
        self._pool = ThreadPoolExecutor(workers, thread_name_prefix="probe")
        self._condition = threading.Condition()
        self._targets: dict[str, tuple[str, Ready]] = {}
        self._due: dict[str, float] = {}
        self._busy: set[str] = set()
        self._results: dict[str, Probe] = {}
        self._stopped = False

    def start(self) -> None:
        threading.Thread(target=self._run, name="prober", daemon=True).start()

    def stop(self) -> None:
        with self._condition:
            self._stopped = True
            self._condition.notify()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def results(self) -> Mapping[str, Probe]:
        with self._condition:
            return dict(self._results)

    def watch(self, targets: Mapping[str, tuple[str, Ready]]) -> None:
        """What to probe from now on: service -> (incarnation, probe)."""
        with self._condition:
            if targets == self._targets:
                return
            for name in targets:
                if self._targets.get(name) != targets[name]:
                    self._due[name] = self.clock()
            self._targets = dict(targets)
            self._due = {n: t for n, t in self._due.items() if n in targets}
            self._condition.notify()

    def _run(self) -> None:
        with self._condition:
            while not self._stopped:
                now = self.clock()
                for name in [n for n, t in self._due.items() if t <= now and n not in self._busy]:
                    self._busy.add(name)
                    self._pool.submit(self._probe, name, *self._targets[name])
                waits = [t - now for n, t in self._due.items() if n not in self._busy]
                self._condition.wait(max(0.0, min(waits)) if waits else None)

    def _probe(self, name: str, incarnation: str, ready: Ready) -> None:
        began = self.clock()
        message = probe_once(ready)
        with self._condition:
            old = self._results.get(name)
            self._results[name] = new = Probe(incarnation, not message, began, message)
            self._busy.discard(name)
            if name in self._due:
                self._due[name] = began + ready.interval
            self._condition.notify()
        if new.ok or old is None or (old.message, old.incarnation) != (new.message, new.incarnation):
            self.wake()
