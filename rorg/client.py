"""Talk to rorg from a Python program. Standard library only.

    import rorg.client as rorg

    with rorg.request("navigation", wait=30):
        drive()

The request is kept by a heartbeat while the block runs, through restarts of rorg too, and released at its end. When the
program dies, rorg drops it: at once with its container, or when the lease runs out.
"""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from typing import Any, TypeVar
from urllib.parse import quote, urlencode

PATIENCE = 30.0
"""Seconds for which a call is tried again while nobody answers: a restart of rorg takes less."""
TTL = 10.0
"""Seconds of a lease; it is renewed three times as often."""
T = TypeVar("T")


class Error(Exception):
    """rorg said no, or did not answer: `cannot {what}: {cause}; try {remedy}`."""

    def __init__(self, what: str, cause: str, remedy: str = "", code: str = "", status: int = 0) -> None:
        self.what, self.cause, self.remedy, self.code, self.status = what, cause, remedy, code, status
        super().__init__(f"{what}: {cause}" + (f"; try {remedy}" if remedy else ""))


class Unreachable(Error):
    """Nobody answers on the socket."""


class Forbidden(Error):
    """This caller may not."""


class NotFound(Error):
    """There is nothing of that name."""


class Refused(Error):
    """It conflicts with what is, or does not fit."""


class Invalid(Error):
    """The call is wrong in itself."""


class NotReady(Error):
    """It did not become ready in time; the cause says what is missing."""


_CODES = {"forbidden": Forbidden, "not-found": NotFound, "refused": Refused, "invalid": Invalid, "not-ready": NotReady,
          "unreachable": Unreachable}


def default_socket() -> str:
    """RORG_SOCKET (set in containers that may request something), else that of the machine's robot."""
    if os.environ.get("RORG_SOCKET"):
        return os.environ["RORG_SOCKET"]
    folder = os.environ.get("RORG_RUN_DIR") or (
        f"{os.environ['RORG_STATE_DIR']}/run" if os.environ.get("RORG_STATE_DIR") else "/run/rorg")
    return f"{folder}/rorg.sock"


class _Connection(http.client.HTTPConnection):
    """HTTP over a unix socket, reached by way of its open directory: its path may be longer than 107 bytes."""

    def __init__(self, path: str, timeout: float) -> None:
        super().__init__("rorg", timeout=timeout)
        self.path = path

    def connect(self) -> None:
        folder = os.open(os.path.dirname(os.path.abspath(self.path)), os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            self.sock.settimeout(self.timeout)
            self.sock.connect(f"/proc/self/fd/{folder}/{os.path.basename(self.path)}")
        finally:
            os.close(folder)


class Client:
    """A connection to one rorg; one for each thread that calls at the same time. Every call may be repeated without
    harm, and is, for `patience` seconds, while nobody answers."""

    def __init__(self, socket: str | None = None, timeout: float = 10.0, patience: float = PATIENCE) -> None:
        self.socket, self.timeout, self.patience = socket or default_socket(), timeout, patience
        self._local = threading.local()

    def close(self) -> None:
        connection = self._connection()
        if connection:
            connection.close()
        self._local.kept = None

    def _connection(self) -> _Connection | None:
        """This thread's; a child after fork() must not speak on that of its parent."""
        pid, connection = getattr(self._local, "kept", None) or (0, None)
        return connection if pid == os.getpid() else None

    def _unreachable(self, error: Exception) -> Unreachable:
        return Unreachable(f"cannot reach rorg on {self.socket}", str(error) or type(error).__name__, "`rorg run`",
                           "unreachable")

    # -- requests ----------------------------------------------------------------------------------------------

    def request(self, *services: str, id: str | None = None, wait: float | None = None, ttl: float | None = TTL,
                reason: str = "", priority: int | None = None, requester: str | None = None) -> Request:
        """Requests services at once and keeps the request until release(), or the end of a `with` block.

        `wait`: seconds to wait until they, and all that they need, are ready; raises NotReady with the reason, having
        released the request. `id`: the same one again replaces the request. `ttl`: seconds of the lease; None for none,
        and then only release() ends it (or the end of the container that asked).
        """
        if not services:
            raise Invalid("cannot request", "no service is named", "one at least", "invalid", 422)
        check_id(id or "request")
        made = Request(self, services, id or f"{services[0]}-{os.getpid()}-{id_number()}", ttl, reason, priority,
                       requester)
        made.put()
        if wait is not None:
            try:
                self.wait(*services, timeout=wait)
            except BaseException:
                made.release()
                raise
        return made

    def wait(self, *services: str, timeout: float = 30.0) -> None:
        """Returns when the services and all that they need are ready; raises NotReady with what is missing."""
        query = urlencode([("services", s) for s in services] + [("timeout", str(timeout))])
        self.call("GET", f"/v1/wait?{query}", patience=timeout, timeout=timeout + self.timeout)

    def requests(self) -> list[dict[str, Any]]:
        return self.call("GET", "/v1/requests")

    def release(self, id: str, requester: str | None = None) -> None:
        self.call("DELETE", f"/v1/requests/{quote(id, safe='')}{_as(requester)}")

    # -- services ----------------------------------------------------------------------------------------------

    def services(self) -> list[dict[str, Any]]:
        return self.call("GET", "/v1/services")

    def service(self, name: str) -> dict[str, Any]:
        return self.call("GET", f"/v1/services/{quote(name)}")

    def why(self, name: str) -> list[dict[str, Any]]:
        return self.call("GET", f"/v1/services/{quote(name)}/why")

    def usage(self) -> dict[str, Any]:
        return self.call("GET", "/v1/usage")

    def status(self) -> dict[str, Any]:
        return self.call("GET", "/v1/status")

    def plan(self) -> dict[str, Any]:
        return self.call("GET", "/v1/plan")

    def restart(self, name: str, force: bool = False) -> list[str]:
        """Stops and starts a service, or each of a group; returns their names. Drivers only with `force`."""
        return self.call("POST", f"/v1/services/{quote(name)}/restart" + ("?force=true" if force else ""))["services"]

    def hold(self, name: str, seconds: float, reason: str = "") -> list[str]:
        """Keeps a service, or each of a group, from being active, whoever requests it; returns their names."""
        body = {"duration": _seconds(seconds), "reason": reason}
        return self.call("PUT", f"/v1/holds/{quote(name)}", body)["services"]

    def unhold(self, name: str) -> None:
        self.call("DELETE", f"/v1/holds/{quote(name)}")

    def suspend(self, seconds: float, reason: str = "") -> None:
        self.call("PUT", "/v1/suspension", {"duration": _seconds(seconds), "reason": reason})

    def unsuspend(self) -> None:
        self.call("DELETE", "/v1/suspension")

    # -- manifests ---------------------------------------------------------------------------------------------

    def manifests(self) -> list[dict[str, Any]]:
        return self.call("GET", "/v1/manifests")

    def manifest(self, kind: str, name: str) -> str:
        """Its text."""
        return self.call("GET", f"/v1/manifests/{kind}/{quote(name)}")

    def put_manifest(self, kind: str, name: str, text: str, base: str | None, message: str = "") -> dict[str, Any]:
        """Writes a manifest; `base` is the digest of the version that was edited, None for a new one."""
        return self.call("PUT", f"/v1/manifests/{kind}/{quote(name)}", {"text": text, "base": base, "message": message})

    def delete_manifest(self, kind: str, name: str, base: str, message: str = "") -> None:
        self.call("DELETE", f"/v1/manifests/{kind}/{quote(name)}?{urlencode({'base': base, 'message': message})}")

    # -- events ------------------------------------------------------------------------------------------------

    def events(self, cursor: int | None = None, follow: bool = False, tail: int = 0) -> Iterator[dict[str, Any]]:
        """What happened, each with its number `seq`. When following, goes on across restarts of rorg, without a gap."""
        while True:
            query: dict[str, Any] = {"follow": str(follow).lower(), "tail": tail}
            if cursor is not None:
                query["cursor"] = cursor
            connection = _Connection(self.socket, timeout=None if follow else self.timeout)  # type: ignore[arg-type]
            try:
                connection.request("GET", f"/v1/events?{urlencode(query)}")
                response = connection.getresponse()
                if response.status != 200:
                    _raise(response.status, response.read())
                if cursor is None:
                    # From here on it is known what was missed, though nothing has been seen yet.
                    cursor = int(response.getheader("rorg-cursor") or 0)
                for line in response:
                    event = json.loads(line)
                    cursor = event["seq"]
                    yield event
                if not follow:
                    return
            except (OSError, http.client.HTTPException) as error:
                if not follow:
                    raise self._unreachable(error) from error
            finally:
                connection.close()
            time.sleep(0.2)

    # -- plumbing ----------------------------------------------------------------------------------------------

    def call(self, method: str, path: str, body: Any = None, patience: float | None = None,
             timeout: float | None = None) -> Any:
        """One call of the API; JSON (or text) back. Raises a subclass of Error."""
        end = time.monotonic() + (self.patience if patience is None else patience)
        pause = 0.02
        while True:
            # One that was kept may have been closed meanwhile, which says nothing of who is there now.
            fresh = self._connection() is None
            try:
                return self._once(method, path, body, timeout or self.timeout)
            except (OSError, http.client.HTTPException) as error:
                self.close()
                if fresh and time.monotonic() + pause > end:
                    raise self._unreachable(error) from error
            if fresh:
                time.sleep(pause)
                pause = min(2 * pause, 0.5)

    def _once(self, method: str, path: str, body: Any, timeout: float) -> Any:
        connection = self._connection()
        if connection is None:
            connection = _Connection(self.socket, timeout)
            self._local.kept = (os.getpid(), connection)
        if connection.sock is not None:
            connection.sock.settimeout(timeout)
        connection.timeout = timeout
        data = None if body is None else json.dumps(body)
        connection.request(method, path, data, {"content-type": "application/json"} if data else {})
        response = connection.getresponse()
        text = response.read()
        if response.status == 503:
            raise OSError(text.decode(errors="replace")[:200])  # it has just begun, or is full: later, then
        if response.status >= 400:
            _raise(response.status, text)
        kind = response.getheader("content-type", "")
        if kind.startswith("application/json"):
            return json.loads(text)
        return text.decode(errors="replace") if text else None


class Request:
    """A request that this program holds. A context manager; release() may be called twice."""

    def __init__(self, client: Client, services: Sequence[str], id: str, ttl: float | None, reason: str,
                 priority: int | None, requester: str | None) -> None:
        self.client, self.services, self.id, self.ttl = client, tuple(services), id, ttl
        self._address = f"/v1/requests/{quote(id, safe='')}", _as(requester)
        self._body = {"services": list(services), "reason": reason, "priority": priority,
                      "ttl": None if ttl is None else _seconds(ttl)}
        self._over, self._given_up = threading.Event(), False
        self._beat: threading.Thread | None = None

    def put(self) -> None:
        """Sends it, and keeps it alive from now on."""
        path, query = self._address
        self.client.call("PUT", path + query, self._body)
        if self.ttl is not None and self._beat is None:
            self._beat = threading.Thread(target=self._heartbeat, name=f"rorg-{self.id}", daemon=True)
            self._beat.start()

    def _heartbeat(self) -> None:
        path, query = self._address
        # A beat must not wait for ever for one that does not answer: the next one may reach a rorg that was restarted.
        pause = (self.ttl or TTL) / 3
        client = Client(self.client.socket, timeout=min(pause, self.client.timeout), patience=0.0)
        while not self._over.wait(pause):
            try:
                client.call("POST", f"{path}/renew{query}")
            except NotFound:
                with contextlib.suppress(Error):
                    if not self._over.is_set():
                        client.call("PUT", path + query, self._body)
            except Error:
                continue
        client.close()

    def wait(self, timeout: float = 30.0) -> Request:
        self.client.wait(*self.services, timeout=timeout)
        return self

    def release(self) -> None:
        """Gives it up. While nobody answers it is tried again, like every call; should that fail, call it again."""
        if self._given_up:
            return
        self._over.set()
        if self._beat is not None and self._beat is not threading.current_thread():
            self._beat.join()
        path, query = self._address
        self.client.call("DELETE", path + query)
        self._given_up = True

    def abandon(self) -> None:
        """Lets go of it without releasing: for a request that another one with the same id has replaced."""
        self._given_up = True
        self._over.set()

    def __enter__(self) -> Request:
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()


class AsyncClient:
    """The same for asyncio: each call of Client, awaited, in a thread. `async with client.request("navigation"):`"""

    def __init__(self, socket: str | None = None, timeout: float = 10.0, patience: float = PATIENCE) -> None:
        self.sync = Client(socket, timeout, patience)

    async def run(self, call: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Any method of `sync` in a thread: `await client.run(client.sync.services)`."""
        import asyncio

        return await asyncio.to_thread(call, *args, **kwargs)

    async def wait(self, *services: str, timeout: float = 30.0) -> None:
        await self.run(self.sync.wait, *services, timeout=timeout)

    async def service(self, name: str) -> dict[str, Any]:
        return await self.run(self.sync.service, name)

    @contextlib.asynccontextmanager
    async def request(self, *services: str, **kwargs: Any) -> AsyncIterator[Request]:
        """As Client.request. When the task is cancelled while it waits, the request is released all the same."""
        lock, state = threading.Lock(), {"cancelled": False, "made": None}

        def ask() -> Request:
            made = self.sync.request(*services, **kwargs)
            with lock:
                state["made"] = made
                if not state["cancelled"]:
                    return made
            made.release()
            return made

        try:
            made = await self.run(ask)
        except BaseException:
            with lock:
                state["cancelled"], late = True, state["made"]
            if late is not None:
                threading.Thread(target=late.release, daemon=True).start()
            raise
        try:
            yield made
        finally:
            await self.run(made.release)


_shared: Client | None = None
_numbers = iter(range(1, 1 << 62))


def id_number() -> int:
    """Tells the requests of one program apart."""
    return next(_numbers)


def client() -> Client:
    """The client of this program, on the default socket."""
    global _shared
    if _shared is None:
        _shared = Client()
    return _shared


def request(*services: str, **kwargs: Any) -> Request:
    """Client.request on the default socket."""
    return client().request(*services, **kwargs)


def check_id(id: str) -> None:
    """Raises Invalid for what cannot be the id of a request."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}", id):
        raise Invalid(f"cannot request as '{id}'", "an id begins with a letter or digit, and has at most 64 of "
                      "letters, digits and _ . : -", "another id", "invalid", 422)


def _seconds(value: float) -> str:
    return f"{value:.6f}".rstrip("0").rstrip(".") + "s"


def _as(requester: str | None) -> str:
    return f"?requester={quote(requester)}" if requester else ""


def _raise(status: int, text: bytes) -> None:
    try:
        told = json.loads(text)
    except ValueError:
        told = {}
    kind = _CODES.get(told.get("code", ""), Error)
    raise kind(told.get("title", f"HTTP {status}"), told.get("cause", text.decode(errors="replace")[:200]),
               told.get("remedy", ""), told.get("code", ""), status)
