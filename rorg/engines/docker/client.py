"""The engine's HTTP API: one connection for each thread, kept open.

docker-py needs four times the CPU for a call and 0.2 s to load, on a computer that has other work to do.
"""

from __future__ import annotations

import http.client
import json
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from email.utils import parsedate_to_datetime
from typing import IO, Any, Literal
from urllib.parse import quote, urlencode

from rorg.engines.docker import answers
from rorg.engines.docker.connect import connect
from rorg.engines.docker.errors import NoAnswer, Refused
from rorg.engines.docker.ping import Ping, readable
from rorg.engines.docker.release import Release, release, version_text

API_TIMEOUT = 120.0
"""Seconds without a byte from the engine. A start may take long on a loaded robot. A lost connection ends a call
immediately, and a read also ends as soon as the engine does not answer a ping."""
PATIENCE = 0.4
"""Seconds without an answer to a read after which the engine is pinged."""
ANSWER = 1.5
"""Seconds within which a working engine answers a ping, however busy it is."""
READS = ("GET", "HEAD")

CHUNK = 1 << 16
"""Bytes that are read in one piece."""
Method = Literal["GET", "HEAD", "POST", "PUT", "DELETE"]
Body = Mapping[str, Any] | IO[bytes] | None
"""JSON, or a file that is sent unchanged."""


class Client:
    """Calls of one engine's API, from any thread. Raises Refused if the engine refuses; OSError and HTTPException if it
    does not answer. Addresses and TLS come from the same variables as for Docker's own commands."""

    def __init__(self, host: str) -> None:
        self.host = host
        self._kept = threading.local()
        self._release: Release | None = None

    @property
    def release(self) -> Release:
        """The engine's release. It is asked once, and again after forget()."""
        known = self._release
        if known is None:
            known = self._release = release(self._ping_headers())
        return known

    def forget(self) -> None:
        """The engine may be another release now: it was restarted."""
        self._release = None

    def just_now(self) -> int | None:
        """The beginning of the present second by the engine's clock; None if it does not say. For streams of events: an
        engine answers before it has subscribed, so an event in between is lost unless it is asked for."""
        date = self._ping_headers().get("date", "")
        return int(parsedate_to_datetime(date).timestamp()) if date else None

    def _ping_headers(self) -> dict[str, str]:
        with self._answer("GET", "/_ping", None, API_TIMEOUT) as answer:
            answers.whole(answer, self.host)
            return {name.lower(): value for name, value in _checked(answer).getheaders()}

    def get(self, path: str, timeout: float = API_TIMEOUT, **query: Any) -> Any:
        """Return the answer, parsed from JSON. Booleans, numbers and mappings in the query are written as the engine
        wants them; a tuple becomes one parameter for each item."""
        return self._call("GET", path, None, timeout, query)

    def find(self, path: str, timeout: float = API_TIMEOUT) -> Any:
        """The same; None if there is nothing at this path (404)."""
        try:
            return self.get(path, timeout)
        except Refused as refused:
            if refused.status == 404:
                return None
            raise

    def post(self, path: str, body: Mapping[str, Any] | None = None, timeout: float = API_TIMEOUT, **query: Any) -> Any:
        return self._call("POST", path, body, timeout, query)

    def put(self, path: str, file: IO[bytes], /, **query: Any) -> None:
        self._call("PUT", path, file, API_TIMEOUT, query)

    def header(self, path: str, name: str, /, **query: Any) -> str:
        """One header of the answer to a GET; empty if it is missing."""
        with self._answer("HEAD", self._url(path, query), None, API_TIMEOUT) as answer:
            answers.whole(answer, self.host)
            return _checked(answer).getheader(name) or ""

    def delete(self, path: str, **query: Any) -> None:
        self._call("DELETE", path, None, API_TIMEOUT, query)

    def ping(self) -> Ping:
        """A pinger for one thread."""
        return Ping(lambda seconds: connect(self.host, seconds), self.host, ANSWER)

    def close(self) -> None:
        """Close the connection of this thread."""
        connection = getattr(self._kept, "connection", None)
        if connection is not None:
            connection.close()

    @contextmanager
    def stream(
        self,
        method: Method,
        path: str,
        /,
        body: Body = None,
        timeout: float | None = None,
        both_ways: bool = False,
        **query: Any,
    ) -> Iterator[Stream]:
        """An answer that is read as it comes, on a connection of its own. `timeout`: seconds without a byte;
        `both_ways`: data is sent too, and its end must be signalled."""
        url, connection = self._url(path, query), connect(self.host, ANSWER, both_ways)
        self._open(connection)
        try:
            with suppress(BrokenPipeError):  # the engine does not want the rest of a file, and its answer says why
                _ask(connection, method, url, body)
            answer = _checked(self._first(connection, method, timeout or API_TIMEOUT))
            taken = connection.sock or answer.fp.raw._sock  # type: ignore[attr-defined]
            taken.settimeout(timeout)
            yield Stream(answer, taken, self.host)
        finally:
            connection.close()

    def _call(self, method: Method, path: str, body: Body, timeout: float, query: Any) -> Any:
        with self._answer(method, self._url(path, query), body, timeout) as answer:
            text = answers.whole(_checked(answer), self.host)
            plain = (answer.getheader("Content-Type") or "").startswith("text/plain")
        # Where Docker answers nothing, Podman may say OK, or end an empty answer with a newline.
        return answers.from_json(text) if text.strip() and not plain else None

    def _url(self, path: str, query: Mapping[str, Any]) -> str:
        said = {k: v if isinstance(v, tuple) else _said(v) for k, v in query.items() if v is not None}
        whole = f"/v{version_text(self.release.api)}{quote(path, safe='/:@')}"
        return f"{whole}?{urlencode(said, doseq=True)}" if said else whole

    @contextmanager
    def _answer(self, method: Method, url: str, body: Body, timeout: float) -> Iterator[http.client.HTTPResponse]:
        """Use the connection of this thread, and close it unless the answer is read completely."""
        connection = self._connection()
        try:
            _ask(connection, method, url, body)
            yield self._first(connection, method, timeout)
        except Refused as refused:
            if refused.cut:
                connection.close()
            raise
        except BaseException:
            connection.close()
            raise

    def _connection(self) -> http.client.HTTPConnection:
        connection: http.client.HTTPConnection | None = getattr(self._kept, "connection", None)
        if connection is None:
            connection = self._kept.connection = connect(self.host, ANSWER)
        if connection.sock is not None and readable(connection, 0.0):
            connection.close()  # data before any question is the end of the connection: the engine was restarted
        if connection.sock is None:
            self._open(connection)
        connection.sock.settimeout(API_TIMEOUT)
        return connection

    def _open(self, connection: http.client.HTTPConnection) -> None:
        """Raises NoAnswer."""
        try:
            connection.connect()
        except OSError as error:
            connection.close()
            raise NoAnswer(self.host, ANSWER) from error
        connection.sock.settimeout(API_TIMEOUT)

    def _first(
        self, connection: http.client.HTTPConnection, method: Method, timeout: float
    ) -> http.client.HTTPResponse:
        """The head of the answer, within so many seconds. A read waits only while the engine answers pings. A change is
        not given up, because the engine may still make it. Raises NoAnswer."""
        end = time.monotonic() + timeout
        if method in READS and timeout > PATIENCE:
            ping = self.ping()
            try:
                while not readable(connection, PATIENCE) and time.monotonic() < end:
                    ping.ask()
            finally:
                ping.close()
        connection.sock.settimeout(max(0.001, end - time.monotonic()))
        return connection.getresponse()


class Stream:
    """The body of one answer."""

    def __init__(self, answer: http.client.HTTPResponse, taken: socket.socket, host: str) -> None:
        self.answer, self._taken, self._host = answer, taken, host

    def close(self) -> None:
        """End it, from any thread: its reader sees the end."""
        with suppress(OSError):  # it has ended already
            self._taken.shutdown(socket.SHUT_RDWR)

    def send(self, content: bytes) -> None:
        """Send data to the other end, from any thread; wait while it is not taken."""
        writable = select.poll()
        writable.register(self._taken, select.POLLOUT)
        while content:
            writable.poll()
            with suppress(TimeoutError, BlockingIOError):  # the reader sets the timeout of both directions
                content = content[self._taken.send(content) :]

    def end_of_input(self) -> None:
        """Signal that nothing more will be sent."""
        self._taken.shutdown(socket.SHUT_WR)

    def read(self) -> bytes:
        """The next piece that is there; empty at the end."""
        return self.answer.read1(CHUNK)

    def in_turns(self, turn: Callable[[], float]) -> Iterator[bytes]:
        """The pieces of an answer without a stated length. `turn` returns how many seconds to wait for the next one,
        and is called repeatedly; an exception that it raises ends this."""
        self._taken.settimeout(0)
        with suppress(OSError):  # data that came together with the head of the answer
            yield self.answer.fp.read1(CHUNK) or b""
        while True:
            self._taken.settimeout(turn())
            with suppress(TimeoutError):
                chunk = self._taken.recv(CHUNK)
                if not chunk:
                    return
                yield chunk

    def lines(self, most: int | None = None) -> Iterator[bytes]:
        """Each line as it comes; `most`: bytes of all lines together, for an answer that ends."""
        return answers.lines(self.answer, self._host, most)


def _ask(connection: http.client.HTTPConnection, method: Method, url: str, body: Body) -> None:
    if isinstance(body, Mapping):
        connection.request(method, url, json.dumps(body).encode(), {"Content-Type": "application/json"})
    else:
        connection.request(method, url, body, {"Content-Type": "application/x-tar"} if body else {})


def _checked(answer: http.client.HTTPResponse) -> http.client.HTTPResponse:
    """Raises Refused for a refusal."""
    if answer.status < 400:
        return answer
    text = answers.refusal_text(answer)
    raise Refused(answer.status, text, cut=not answer.isclosed())


def _said(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, Mapping) else str(value)
