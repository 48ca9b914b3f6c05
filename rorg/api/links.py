"""The threads that carry messages to the other machines of the robot, over TLS with certificates on both sides.

Each link has two threads, so that what one waits for never delays the other: one sends renewals when they are due, one
waits for reports.
"""

from __future__ import annotations

import contextlib
import http.client
import os
import threading
import time
from collections.abc import Callable
from functools import partial

from pydantic import TypeAdapter

from rorg.api.machine_routes import ANSWER, LONGEST_POLL, REPORT
from rorg.api.peer import Peer, explanation
from rorg.api.tls import Tls
from rorg.core.links import Renewal
from rorg.daemon.machines import Machines
from rorg.host.deadline import Deadline
from rorg.model.machines import Machine

PATIENCE = 3.0
"""Seconds for an answer to a renewal; a lease of 10 s is renewed each 3.3 s."""
AGAIN = 1.0
"""Seconds until the next attempt after a failure."""
IDLE = 1.0
"""Seconds after which a thread looks whether there is something to do, if nothing wakes it."""
POLL, BURST = 0.2, 20
"""Seconds between two questions for a report, after so many at once: a machine may have something new each time."""
REMINDER = 60.0
"""Seconds between two events about wrong answers of a machine."""
NICE = -10
"""Of threads that send renewals, where rorg may have it (root): load must not delay them."""
RENEWAL = TypeAdapter(Renewal)


class Pace:
    """Lets through `burst` calls at once, and then one each `interval` seconds."""

    def __init__(self, burst: int, interval: float) -> None:
        self.interval, self._saved, self._free_at = interval, burst * interval, 0.0

    def delay(self, now: float) -> float:
        """Return the seconds to wait before the next call; `now` is monotonic."""
        self._free_at = max(self._free_at, now - self._saved) + self.interval
        return max(0.0, self._free_at - now)


class Links:
    """Keeps two threads for each other machine of the robot, until stop()."""

    def __init__(self, machines: Machines, tls: Tls) -> None:
        self.machines, self.tls = machines, tls
        self.stopping = threading.Event()
        self._running: dict[str, Machine] = {}
        self._told: dict[str, float] = {}
        """Machine -> when an event said that its answers are wrong."""

    def start(self) -> None:
        threading.Thread(target=self._keep, name="links", daemon=True).start()

    def stop(self) -> None:
        self.stopping.set()
        with self.machines.changed:
            self.machines.changed.notify_all()

    def _keep(self) -> None:
        """Starts threads for machines that the manifests name now. Those of other machines end by themselves."""
        while not self.stopping.is_set():
            with self.machines.changed:
                declared = {n: self.machines.catalog.machines[n] for n in self.machines.links}
                for name, machine in declared.items():
                    if self._running.get(name) != machine:
                        self._running[name] = machine
                        for task in (self._renew, self._listen):
                            threading.Thread(target=task, args=(machine,), name=f"link {name}", daemon=True).start()
                self._running = {n: m for n, m in self._running.items() if n in declared}
                self.machines.changed.wait(IDLE)

    def _ended(self, machine: Machine) -> bool:
        return self.stopping.is_set() or self._running.get(machine.name) != machine

    def _renew(self, machine: Machine) -> None:
        """Sends renewals to a machine, each third of its lease and whenever there is something new to say."""
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        peer = Peer(machine, self.tls)
        while not self._ended(machine):
            with self.machines.changed:
                due = self.machines.due(machine.name)
                if due is None or due > 0:
                    self.machines.changed.wait(min(IDLE, IDLE if due is None else due))
                    continue
                renewal = self.machines.renewal(machine.name)
            path = f"/v1/machines/{self.machines.here}/renewal"
            self._try(
                machine,
                lambda p=path, r=renewal: self.machines.answered(  # type: ignore[misc]
                    machine.name,
                    ANSWER.validate_json(peer.ask("PUT", p, Deadline.within(PATIENCE), RENEWAL.dump_json(r))),
                ),
            )
        peer.close()

    def _listen(self, machine: Machine) -> None:
        """Takes reports of a machine as they come."""
        peer, pace = Peer(machine, self.tls), Pace(BURST, POLL)
        while not self._ended(machine):
            link = self.machines.links.get(machine.name)
            if link is None or link.confirmed_at is None:
                self.stopping.wait(AGAIN / 10)  # it has not answered yet
                continue
            incarnation, version = link.report.stamp if link.report else (-1, -1)
            path = f"/v1/machines/{self.machines.here}/report?after={version}&incarnation={incarnation}"
            self._try(machine, partial(self._report, machine, peer, path))
            self.stopping.wait(pace.delay(time.monotonic()))
        peer.close()

    def _report(self, machine: Machine, peer: Peer, path: str) -> None:
        self.machines.reported(
            machine.name, REPORT.validate_json(peer.ask("GET", path, Deadline.within(LONGEST_POLL + PATIENCE)))
        )

    def _try(self, machine: Machine, call: Callable[[], None]) -> None:
        """Makes a call to a machine; after a failure it waits, and the machine's link says why. An answer that is wrong
        in itself is an event too, and whatever comes of it ends here: the machine may be hostile."""
        try:
            call()
            self.machines.trouble.pop(machine.name, None)
        except Exception as error:
            why = self.machines.trouble[machine.name] = explanation(machine, error)
            if not isinstance(error, (OSError, http.client.HTTPException)):
                self._tell(machine.name, why)
            self.stopping.wait(AGAIN)

    def _tell(self, machine: str, why: str) -> None:
        now = time.monotonic()
        if now - self._told.get(machine, -REMINDER) >= REMINDER:
            self._told[machine] = now
            self.machines.tell("link-refused", f"what {machine} answers counts for nothing: {why}")
