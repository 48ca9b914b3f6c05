"""The engine's HTTP API: one connection for each thread, kept open.

docker-py takes four times the CPU of it for a call and 0.2 s to be loaded, on a computer that has other things to do.
"""

from __future__ import annotations

import http.client
import json
import os
import select
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Literal
from urllib.parse import quote, urlencode, urlsplit

from rorg.engines.docker import answers
from rorg.engines.docker.errors import NoAnswer, Refused
from rorg.engines.docker.ping import Ping, readable
from rorg.engines.docker.tls import through_tls
from rorg.errors import EngineError

DEFAULT = "unix:///var/run/docker.sock"
API_TIMEOUT = 120.0
"""Seconds without a byte from the engine. A start may take long on a loaded robot. A lost connection ends a call
immediately, and a read ends as soon as the engine does not answer a ping either."""
PATIENCE = 0.4
"""Seconds without an answer to a read after which the engine is pinged."""
ANSWER = 1.5
"""Seconds within which an engine that works answers a ping, however busy it is."""
READS = ("GET", "HEAD")

LOOK = 5.0
"""Seconds for which a thread outlives the stream that it would have ended."""
CHUNK = 1 << 16
"""Bytes that are read at once."""
Method = Literal["GET", "HEAD", "POST", "PUT", "DELETE"]
Body = Mapping[str, Any] | IO[bytes] | None
"""JSON, or a file that is sent as it is."""


def engine_host(given: str | None) -> str:
    """Where the engine is: as given, or by DOCKER_HOST, or where Docker has it."""
    return given or os.environ.get("DOCKER_HOST") or DEFAULT


class Client:
    """Calls of one engine's API, from any thread. Raises Refused where the engine says no; OSError and HTTPException
    where it does not answer. Addresses and TLS are told by the same variables as to Docker's own commands."""

    def __init__(self, host: str) -> None:
        self.host = host
        self._kept = threading.local()
        self._version = ""

    @property
    def version(self) -> str:
        """Of the API; the engine's newest."""
        if not self._version:
            with self._answer("GET", "/_ping", None, API_TIMEOUT) as answer:
                answers.whole(answer, self.host)
                self._version = answer.getheader("Api-Version") or "1.41"
        return self._version

    def get(self, path: str, timeout: float = API_TIMEOUT, **query: Any) -> Any:
        """The answer, from JSON. What is true, a number or a mapping in the query is said as the engine wants it, and
        each of a tuple by itself."""
        return self._call("GET", path, None, timeout, query)

    def post(self, path: str, body: Mapping[str, Any] | None = None, timeout: float = API_TIMEOUT, **query: Any) -> Any:
        return self._call("POST", path, body, timeout, query)

    def put(self, path: str, file: IO[bytes], /, **query: Any) -> None:
        self._call("PUT", path, file, API_TIMEOUT, query)

    def header(self, path: str, name: str, /, **query: Any) -> str:
        """One header of what a GET would answer; empty where it has none of that name."""
        with self._answer("HEAD", self._url(path, query), None, API_TIMEOUT) as answer:
            answers.whole(answer, self.host)
            return _checked(answer).getheader(name) or ""

    def delete(self, path: str, **query: Any) -> None:
        self._call("DELETE", path, None, API_TIMEOUT, query)

    def ping(self) -> Ping:
        """Asks whether the engine answers; for one thread."""
        return Ping(lambda seconds: _connect(self.host, seconds), self.host, ANSWER)

    def close(self) -> None:
        """Closes the connection of this thread."""
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
        `both_ways`: something is sent, too, whose end is told."""
        url, connection = self._url(path, query), _connect(self.host, ANSWER, both_ways)
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
        return answers.from_json(text) if text else None

    def _url(self, path: str, query: Mapping[str, Any]) -> str:
        said = {k: v if isinstance(v, tuple) else _said(v) for k, v in query.items() if v is not None}
        return f"/v{self.version}{quote(path, safe='/:@')}" + (f"?{urlencode(said, doseq=True)}" if said else "")

    @contextmanager
    def _answer(self, method: Method, url: str, body: Body, timeout: float) -> Iterator[http.client.HTTPResponse]:
        """On the connection of this thread, which is closed unless the answer is read to its end."""
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
            connection = self._kept.connection = _connect(self.host, ANSWER)
        if connection.sock is not None and readable(connection, 0.0):
            connection.close()  # what comes before anything is asked is the end: the engine was restarted
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
        """The head of the answer, within so many seconds. A read is only waited for while the engine answers pings. A
        change is not given up, since the engine may still make it. Raises NoAnswer."""
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
    """What comes of one answer."""

    def __init__(self, answer: http.client.HTTPResponse, taken: socket.socket, host: str) -> None:
        self.answer, self._taken, self._host = answer, taken, host

    def close(self) -> None:
        """Ends it, from any thread: whoever reads it sees its end."""
        with suppress(OSError):  # it has ended by itself
            self._taken.shutdown(socket.SHUT_RDWR)

    @contextmanager
    def until(self, stop: threading.Event) -> Iterator[None]:
        """Closes the stream when `stop` is set within the block."""
        over = threading.Event()

        def close() -> None:
            while not stop.wait(LOOK):
                if over.is_set():
                    return
            self.close()

        threading.Thread(target=close, daemon=True, name="stream-closer").start()
        try:
            yield
        finally:
            over.set()

    def send(self, content: bytes) -> None:
        """Says something to whom the stream leads, from any thread; waits while nobody takes it."""
        writable = select.poll()
        writable.register(self._taken, select.POLLOUT)
        while content:
            writable.poll()
            with suppress(TimeoutError, BlockingIOError):  # the reader sets the time-out of both
                content = content[self._taken.send(content) :]

    def end_of_input(self) -> None:
        """Says that nothing more is sent."""
        self._taken.shutdown(socket.SHUT_WR)

    def read(self) -> bytes:
        """What is there, as it comes; empty at the end."""
        return self.answer.read1(CHUNK)

    def in_turns(self, turn: Callable[[], float]) -> Iterator[bytes]:
        """What comes, as it comes, of an answer without a stated length. `turn` is asked how many seconds to wait for
        the next of it, again and again; what it raises ends this."""
        self._taken.settimeout(0)
        with suppress(OSError):  # what came together with the head of the answer
            yield self.answer.fp.read1(CHUNK) or b""
        while True:
            self._taken.settimeout(turn())
            with suppress(TimeoutError):
                chunk = self._taken.recv(CHUNK)
                if not chunk:
                    return
                yield chunk

    def lines(self, most: int | None = None) -> Iterator[bytes]:
        """Each line as it comes; `most`: bytes of all of them, where they have an end."""
        return answers.lines(self.answer, self._host, most)


class _Unix(http.client.HTTPConnection):
    def __init__(self, path: str, timeout: float) -> None:
        super().__init__("docker", timeout=timeout)
        self.path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(self.path)


class _Tls(http.client.HTTPConnection):
    def connect(self) -> None:
        super().connect()
        self.sock = through_tls(self.sock, _tls(), self.host)


def _connect(host: str, timeout: float, both_ways: bool = False) -> http.client.HTTPConnection:
    scheme, _, rest = host.rpartition("://")
    if scheme in ("unix", "http+unix"):
        return _Unix(rest, timeout)
    if scheme not in ("", "tcp", "http", "https"):
        remedy = f"`ssh -nNT -L /tmp/engine.sock:/var/run/docker.sock {rest}` and DOCKER_HOST=unix:///tmp/engine.sock"
        raise EngineError("reach the engine", f"{host}: {scheme} is not spoken", remedy if scheme == "ssh" else "")
    where, verified = urlsplit(f"//{rest}"), bool(os.environ.get("DOCKER_TLS_VERIFY"))
    name = where.hostname or "localhost"
    if both_ways and (scheme == "https" or verified):
        return _Tls(name, where.port or 2376, timeout=timeout)
    if scheme == "https" or verified:
        return http.client.HTTPSConnection(name, where.port or 2376, timeout=timeout, context=_tls())
    return http.client.HTTPConnection(name, where.port or 2375, timeout=timeout)


def _tls() -> ssl.SSLContext:
    """As Docker's own commands: the authority and our certificate are files of DOCKER_CERT_PATH."""
    folder = Path(os.environ.get("DOCKER_CERT_PATH") or Path.home() / ".docker")
    authority = folder / "ca.pem"
    context = ssl.create_default_context(cafile=authority if authority.exists() else None)
    if (folder / "cert.pem").exists():
        context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return context


def _ask(connection: http.client.HTTPConnection, method: Method, url: str, body: Body) -> None:
    if isinstance(body, Mapping):
        connection.request(method, url, json.dumps(body).encode(), {"Content-Type": "application/json"})
    else:
        connection.request(method, url, body, {"Content-Type": "application/x-tar"} if body else {})


def _checked(answer: http.client.HTTPResponse) -> http.client.HTTPResponse:
    """Raises Refused for an answer that says no."""
    if answer.status < 400:
        return answer
    text = answers.refusal_text(answer)
    raise Refused(answer.status, text, cut=not answer.isclosed())


def _said(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, Mapping) else str(value)
