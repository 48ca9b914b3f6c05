"""Calls to the rorg of another machine, over TLS with certificates on both sides. It may answer anything, so each call
has one deadline, and its answer declares its length, which is limited."""

from __future__ import annotations

import contextlib
import http.client
import socket
import ssl
from typing import Any

from pydantic import TypeAdapter, ValidationError

from rorg.api.limits import MOST_BODY
from rorg.api.tls import Tls
from rorg.core.received import LONGEST_REASON
from rorg.host.bounded_http import HEAD, Connection, connect, secured
from rorg.host.deadline import Deadline
from rorg.model.machines import Machine

PROBLEM = TypeAdapter(dict[str, Any])


class Refusal(OSError):
    """The other machine answered, with an error or with nothing that counts as an answer."""


class Peer:
    """A connection to the rorg of another machine, made again when it has broken."""

    def __init__(self, machine: Machine, tls: Tls) -> None:
        self.machine, self.tls = machine, tls
        self._connection: http.client.HTTPConnection | None = None
        self._socket: Connection | None = None

    def ask(self, method: str, path: str, deadline: Deadline, body: bytes | None = None) -> bytes:
        """Returns the body of the answer. Raises OSError or HTTPException."""
        if self._connection is not None:
            with contextlib.suppress(ConnectionError, http.client.NotConnected, ssl.SSLEOFError):
                return self._ask(method, path, deadline, body)
            # The other side has closed a connection that was idle, or was restarted.
        return self._ask(method, path, deadline, body)

    def _ask(self, method: str, path: str, deadline: Deadline, body: bytes | None) -> bytes:
        try:
            answer = self.begin(method, path, deadline, body)
            length = answer.length
            if length is None or length > MOST_BODY:
                raise Refusal(f"answers without a length of at most {MOST_BODY} bytes")
            self.bound(deadline, length + HEAD)
            content = answer.read()
        except Exception:
            self.close()
            raise
        if answer.status != 200:
            raise Refusal(problem_of(content, answer.status))
        return content

    def begin(self, method: str, path: str, deadline: Deadline, body: bytes | None = None) -> http.client.HTTPResponse:
        """Makes a call, and returns its answer after the head. Raises OSError, also if another machine answers there,
        and HTTPException."""
        connection = self.connect(deadline)
        self.bound(deadline, HEAD)
        connection.request(method, path, body, {"content-type": "application/json"} if body else {})
        return connection.getresponse()

    def bound(self, deadline: Deadline, most: int) -> None:
        """The rest of an answer ends by a deadline and has at most so many bytes."""
        if self._socket is not None:
            self._socket.bound(deadline, most)

    def connect(self, deadline: Deadline) -> http.client.HTTPConnection:
        """The connection, which is made if there is none. Raises OSError."""
        if self._connection is None:
            place, _, port = self.machine.address.rpartition(":")
            host = place.strip("[]")
            made = http.client.HTTPConnection(host, int(port))
            made.auto_open = 0  # a connection that it made by itself would have no bounds and no proven name
            made.sock = self._socket = secured(connect(host, int(port), deadline), host, self.tls.client)
            self._connection = made
            name = common_name(made.sock.getpeercert())
            if name != self.machine.certificate:
                raise Refusal(f"its certificate is that of '{name}', not of {self.machine.certificate}")
        return self._connection

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = self._socket = None

    def hang_up(self) -> None:
        """Ends what another thread waits for."""
        with contextlib.suppress(OSError, AttributeError):
            self._socket.shutdown(socket.SHUT_RDWR)  # type: ignore[union-attr]


def explanation(machine: Machine, error: Exception) -> str:
    """Why a call to a machine has failed."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"{machine.address}: its certificate is not accepted: {error.verify_message}"
    if isinstance(error, ValidationError):
        return f"{machine.address} answers what this version of rorg does not know"
    if isinstance(error, TimeoutError):
        return f"{machine.address} does not answer"
    return f"{machine.address}: {getattr(error, 'strerror', None) or error}"[:LONGEST_REASON]


def common_name(certificate: Any) -> str:
    """The common name of a certificate, as the ssl module describes one."""
    return str(dict(pair for part in (certificate or {}).get("subject", ()) for pair in part).get("commonName", ""))


def problem_of(content: bytes, status: int) -> str:
    """Why a call was refused, by the body of the answer; it may be anything."""
    with contextlib.suppress(ValueError, KeyError):
        return str(PROBLEM.validate_json(content)["cause"])[:LONGEST_REASON]
    return f"answers with status {status}"
