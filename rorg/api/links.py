"""The threads that carry messages to the other machines of the robot, over TLS with certificates on both sides.

Each link has two threads, so that what one waits for never delays the other: one sends renewals when they are due, one
waits for reports.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import ssl
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from pydantic import TypeAdapter, ValidationError

from rorg.api.limits import MOST_BODY
from rorg.api.machine_routes import ANSWER, LONGEST_POLL, REPORT
from rorg.api.tls import Tls
from rorg.core.links import Renewal
from rorg.daemon.machines import Machines
from rorg.model.machines import Machine

PATIENCE = 3.0
"""Seconds for an answer to a renewal; a lease of 10 s is renewed each 3.3 s."""
AGAIN = 1.0
"""Seconds until the next attempt after a failure."""
IDLE = 1.0
"""Seconds after which a thread looks whether there is something to do, if nothing wakes it."""
NICE = -10
"""Of threads that send renewals, where rorg may have it (root): load must not delay them."""
RENEWAL = TypeAdapter(Renewal)


class Links:
    """Keeps two threads for each other machine of the robot, until stop()."""

    def __init__(self, machines: Machines, tls: Tls) -> None:
        self.machines, self.tls = machines, tls
        self.stopping = threading.Event()
        self._running: dict[str, Machine] = {}

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
        peer = Peer(machine, self.tls, PATIENCE)
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
                    machine.name, ANSWER.validate_json(peer.ask("PUT", p, RENEWAL.dump_json(r)))
                ),
            )
        peer.close()

    def _listen(self, machine: Machine) -> None:
        """Takes reports of a machine as they come."""
        peer = Peer(machine, self.tls, LONGEST_POLL + PATIENCE)
        while not self._ended(machine):
            link = self.machines.links.get(machine.name)
            if link is None or link.confirmed_at is None:
                self.stopping.wait(AGAIN / 10)  # it has not answered yet
                continue
            incarnation, version = link.report.stamp if link.report else (-1, -1)
            path = f"/v1/machines/{self.machines.here}/report?after={version}&incarnation={incarnation}"
            self._try(machine, partial(self._report, machine, peer, path))
        peer.close()

    def _report(self, machine: Machine, peer: Peer, path: str) -> None:
        self.machines.reported(machine.name, REPORT.validate_json(peer.ask("GET", path)))

    def _try(self, machine: Machine, call: Callable[[], None]) -> None:
        """Makes a call to a machine; after a failure it waits, and the machine's link says why."""
        try:
            call()
            self.machines.trouble.pop(machine.name, None)
        except (OSError, http.client.HTTPException, ValidationError, ValueError) as error:
            self.machines.trouble[machine.name] = explanation(machine, error)
            self.stopping.wait(AGAIN)


def explanation(machine: Machine, error: Exception) -> str:
    """Why a call to a machine has failed."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"{machine.address}: its certificate is not accepted: {error.verify_message}"
    if isinstance(error, ValidationError):
        return f"{machine.address} answers what this version of rorg does not know"
    if isinstance(error, TimeoutError):
        return f"{machine.address} does not answer"
    return f"{machine.address}: {getattr(error, 'strerror', None) or error}"


class Refusal(OSError):
    """The other machine answered, with an error."""


class Peer:
    """A connection to the rorg of another machine, made again when it has broken."""

    def __init__(self, machine: Machine, tls: Tls, timeout: float) -> None:
        self.machine, self.tls, self.timeout = machine, tls, timeout
        self._connection: http.client.HTTPSConnection | None = None

    def ask(self, method: str, path: str, body: bytes | None = None) -> bytes:
        """Returns the body of the answer. Raises OSError or HTTPException."""
        began = time.monotonic()
        try:
            return self._ask(method, path, body)
        except (ConnectionError, http.client.BadStatusLine, ssl.SSLEOFError):
            if self._connection is None or time.monotonic() - began > AGAIN:
                raise
        finally:
            if self._broken:
                self.close()
        # The other side has closed a connection that was idle, or was restarted.
        self.close()
        return self._ask(method, path, body)

    _broken = False

    def _ask(self, method: str, path: str, body: bytes | None) -> bytes:
        self._broken = True
        connection = self.connected()
        connection.request(method, path, body, {"content-type": "application/json"} if body else {})
        answer = connection.getresponse()
        content = answer.read(MOST_BODY + 1)
        if len(content) > MOST_BODY:
            raise Refusal(f"answers with more than {MOST_BODY} bytes")
        self._broken = False
        if answer.status != 200:
            raise Refusal(_problem(content, answer.status))
        return content

    def connected(self) -> http.client.HTTPSConnection:
        """The connection, which is made if there is none. Raises OSError, also if another machine answers there."""
        if self._connection is None:
            host, _, port = self.machine.address.rpartition(":")
            made = http.client.HTTPSConnection(
                host.strip("[]"), int(port), timeout=self.timeout, context=self.tls.client
            )
            made.connect()
            self._connection = made
            name = common_name(made.sock.getpeercert())
            if name != self.machine.certificate:
                raise Refusal(f"its certificate is that of '{name}', not of {self.machine.certificate}")
        return self._connection

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def hang_up(self) -> None:
        """Ends what another thread waits for."""
        with contextlib.suppress(OSError, AttributeError):
            self._connection.sock.shutdown(socket.SHUT_RDWR)  # type: ignore[union-attr]


def common_name(certificate: Any) -> str:
    """The common name of a certificate, as the ssl module describes one."""
    return str(dict(pair for part in (certificate or {}).get("subject", ()) for pair in part).get("commonName", ""))


def _problem(content: bytes, status: int) -> str:
    with contextlib.suppress(ValueError, KeyError, TypeError):
        return str(json.loads(content)["cause"])
    return f"answers with status {status}"
