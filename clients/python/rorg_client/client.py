"""The blocking client."""

from __future__ import annotations

import json
import os
import threading
import time
from typing import TYPE_CHECKING, Any, Callable, Iterator, Mapping, TypeVar

from rorg_client import calls
from rorg_client.address import Address
from rorg_client.calls import PATIENCE, TTL, Attempts, Call, Failed, Newest
from rorg_client.connection import Connection
from rorg_client.errors import Error, NotReady, Unreachable, problem, unreachable
from rorg_client.names import check_id, check_names
from rorg_client.readiness import not_restarted, readiness_of
from rorg_client.request import Request, new_id
from rorg_client.watch import Watcher
from rorg_client.wire import Answer, asking, reading, reading_body, reading_chunk, reading_head

if TYPE_CHECKING:
    from rorg_client.types import (
        Event,
        GroupView,
        Loss,
        ManifestView,
        Readiness,
        RequestView,
        ServiceView,
        Spec,
        Usage,
        Why,
    )

T = TypeVar("T")
RESTART_PAUSE = 0.05
"""Seconds between two checks whether a new run has begun."""


class Client:
    """Calls one rorg, from any thread. A call is repeated for `patience` seconds while rorg does not answer, so that a
    restart of rorg only takes longer. Reads are never older than this client's own changes.

    `address`: the path of a socket, unix:///PATH or https://HOST:PORT; by default RORG_SOCKET, RORG_ADDRESS, or the
    machine's own rorg. `ca`, `cert`, `key`: files for https, by default RORG_CA, RORG_CERT, RORG_KEY.
    """

    def __init__(
        self,
        address: str | None = None,
        timeout: float = 10.0,
        patience: float = PATIENCE,
        *,
        ca: str = "",
        cert: str = "",
        key: str = "",
    ) -> None:
        self.address, self.timeout, self.patience = Address(address or "", ca, cert, key), timeout, patience
        self._newest = Newest()
        self._local = threading.local()
        self._watcher: Watcher | None = None
        self._latest: Connection | None = None
        self._hung_up = False

    def close(self) -> None:
        """Closes this thread's connection; the next call opens another."""
        connection = self._kept()
        if connection:
            connection.close()
        self._local.kept = None

    def _kept(self) -> Connection | None:
        """This thread's connection; a forked child must not use its parent's."""
        pid, connection = getattr(self._local, "kept", None) or (0, None)
        return connection if pid == os.getpid() else None

    def hang_up(self) -> None:
        """Ends the current and all later calls with Unreachable. For a client that a single thread uses."""
        self._hung_up = True
        if self._latest is not None:
            self._latest.abort()

    def like(self, timeout: float, patience: float) -> Client:
        """Another client of the same rorg that knows of the same changes."""
        made = Client(str(self.address), timeout, patience)
        made.address, made._newest = self.address, self._newest
        return made

    # -- requests ----------------------------------------------------------------------------------------------

    def request(
        self,
        *services: str,
        id: str | None = None,
        wait: float | None = None,
        ttl: float | None = TTL,
        reason: str = "",
        priority: int | None = None,
        requester: str | None = None,
        on_lost: Callable[[Loss], None] | None = None,
    ) -> Request:
        """Requests services immediately, and keeps the request until release() or the end of a `with` block.

        `wait`: seconds to wait until they and all that they need are ready; otherwise raises NotReady with the reason,
        and releases the request. `id`: the same id again replaces the request. `ttl`: seconds of the lease; with None,
        only release() ends the request (or the end of the container that asked). `on_lost`: called in a thread of the
        client when a service that was ready is no longer.
        """
        check_names("request", services)
        check_id(id or "request")
        made = Request(self, services, id or new_id(services[0]), ttl, reason, priority, requester)
        try:
            if on_lost is not None:
                made.on_lost(on_lost)
            made.put(wait)
        except Error:
            if made.arrived:
                made.give_up()
            raise
        except BaseException:
            made.give_up()
            raise
        return made

    def wait(self, *services: str, timeout: float = 30.0) -> dict[str, Readiness]:
        """Returns the readiness of each service when they and all that they need are ready; raises NotReady with what
        is missing."""
        told = self.do(calls.wait(services, timeout))
        found: dict[str, Readiness] | None = told.get("services")
        return found or {name: {"ready": True, "incarnation": "", "reason": ""} for name in services}

    def readiness(self, *services: str) -> dict[str, Readiness]:
        """The current readiness of each service, without waiting."""
        try:
            return self.wait(*services, timeout=0.0)
        except NotReady as error:
            return error.services or {name: readiness_of(self.service(name)) for name in services}

    def requests(self) -> list[RequestView]:
        return self.do(calls.requests())

    def release(self, id: str, requester: str | None = None) -> None:
        self.do(calls.release(id, requester))

    @property
    def watcher(self) -> Watcher:
        """Tells requests of this client when they lose something."""
        if self._watcher is None or self._watcher.pid != os.getpid():
            self._watcher = Watcher(self)
        return self._watcher

    # -- services ----------------------------------------------------------------------------------------------

    def services(self) -> list[ServiceView]:
        return self.do(calls.services())

    def groups(self) -> list[GroupView]:
        return self.do(calls.groups())

    def service(self, name: str) -> ServiceView:
        return self.do(calls.service(name))

    def why(self, name: str) -> list[Why]:
        return self.do(calls.why(name))

    def usage(self) -> Usage:
        return self.do(calls.usage())

    def status(self) -> dict[str, Any]:
        return self.do(calls.status())

    def plan(self) -> dict[str, Any]:
        return self.do(calls.plan())

    def restart(self, name: str, force: bool = False, wait: float | None = None) -> list[str]:
        """Stops and starts a service, or each of a group; returns their names. Drivers only with `force`. `wait`:
        seconds to wait until the wanted ones are ready again in a new run."""
        if wait is None:
            return self.do(calls.restart(name, force))
        end = time.monotonic() + wait
        before = {s["service"]: s for s in self.services()}
        names = self.do(calls.restart(name, force))
        runs = {n: before[n]["incarnation"] for n in names if n in before and before[n]["wanted"]}
        while runs:
            self.wait(*runs, timeout=max(0.0, end - time.monotonic()))
            old = [n for n, run in runs.items() if self.service(n)["incarnation"] == run]
            if not old:
                break
            if time.monotonic() > end:
                raise not_restarted(old[0], wait)
            time.sleep(RESTART_PAUSE)
        return names

    def hold(self, name: str, seconds: float, reason: str = "", force: bool = False) -> list[str]:
        """Keeps a service, or those of a group, from being active, regardless of requests; returns their names. Without
        `force`, raises Refused if that stops a driver or other services, which are in `confirm`."""
        return self.do(calls.hold(name, seconds, reason, force))

    def unhold(self, name: str) -> None:
        self.do(calls.unhold(name))

    def suspend(self, seconds: float, reason: str = "") -> None:
        self.do(calls.suspend(seconds, reason))

    def unsuspend(self) -> None:
        self.do(calls.unsuspend())

    # -- manifests ---------------------------------------------------------------------------------------------

    def manifests(self) -> list[ManifestView]:
        return self.do(calls.manifests())

    def manifest(self, kind: str, name: str) -> str:
        """The text of a manifest."""
        return self.do(calls.manifest(kind, name))

    def put_manifest(self, kind: str, name: str, text: str, base: str | None, message: str = "") -> ManifestView:
        """Writes a manifest; `base` is the digest of the version that was edited, None for a new one."""
        return self.do(calls.put_manifest(kind, name, text, base, message))

    def delete_manifest(self, kind: str, name: str, base: str, message: str = "") -> None:
        self.do(calls.delete_manifest(kind, name, base, message))

    def put_service(self, name: str, spec: Spec, message: str = "") -> ManifestView:
        """Creates a service with this `spec`, or changes it to that."""
        base = calls.digest_of(self.manifests(), "Service", name)
        return self.put_manifest("Service", name, calls.manifest_text("Service", name, spec), base, message)

    def remove_service(self, name: str, message: str = "") -> None:
        """Removes a service; removing twice is fine."""
        base = calls.digest_of(self.manifests(), "Service", name)
        if base is not None:
            self.delete_manifest("Service", name, base, message)

    # -- events ------------------------------------------------------------------------------------------------

    def events(
        self,
        cursor: int | None = None,
        follow: bool = False,
        tail: int = 0,
        mine: bool = False,
        requester: str | None = None,
        only: Mapping[str, Any] | None = None,
    ) -> Iterator[Event]:
        """Events, each with its number `seq`. `mine`: only about own requests and what they name, and a service sees no
        others; `only`: those of a `kind` or about a `service` (lists), `since`, `until`, or with a `text`. When
        following, it continues across restarts of rorg, without a gap."""
        while True:
            connection: Connection | None = None
            try:
                connection = Connection(self.address, None if follow else self.timeout)
                for event in self.lines(connection, calls.events(cursor, follow, tail, mine, requester, only)):
                    # Later losses are detected from here, even if nothing has been seen yet.
                    cursor = event["seq"]
                    if "kind" in event:
                        yield event
                if not follow:
                    return
            except (OSError, Unreachable) as error:
                if not follow:
                    raise error if isinstance(error, Error) else unreachable(str(self.address), error) from error
            finally:
                if connection:
                    connection.close()
            time.sleep(0.2)

    def lines(self, connection: Connection, path: str) -> Iterator[Event]:
        """Events of one connection; the first one has only the number where the stream begins."""
        connection.send(asking("GET", path, None, {}), connection.socket.gettimeout())
        head = connection.drive(reading_head())
        if head[0] != 200:
            raise problem(head[0], connection.drive(reading_body(head)))
        yield {"seq": int(head[1].get("rorg-cursor") or 0)}  # type: ignore[typeddict-item]
        rest = b""
        while True:
            piece = connection.drive(reading_chunk())
            if not piece:
                return
            *whole, rest = (rest + piece).split(b"\n")
            for line in whole:
                yield json.loads(line)

    # -- plumbing ----------------------------------------------------------------------------------------------

    def call(self, method: str, path: str, body: Any = None) -> Any:
        """Makes any call of the API; returns JSON or text. Raises a subclass of Error."""
        return self.do(Call(method, path, body))

    def do(self, call: Call[T]) -> T:
        """Makes a call, and repeats it while rorg does not answer."""
        attempts, deadline = Attempts(call, self.patience, str(self.address)), time.monotonic() + (call.wait or 0.0)
        while True:
            try:
                answer = self._once(call, deadline - time.monotonic())
            except Failed as failed:
                if self._hung_up:
                    raise unreachable(str(self.address), failed.error) from failed
                time.sleep(attempts.again(failed, time.monotonic()))
                continue
            self._newest.note(call, answer)
            return call.told(answer)  # type: ignore[no-any-return]

    def _once(self, call: Call[Any], left: float) -> Answer:
        connection = None if call.once else self._kept()
        stale = connection is not None
        timeout = self.timeout + max(0.0, left) + (calls.HELD if call.not_before(self._newest) else 0.0)
        try:
            connection = connection or Connection(self.address, timeout)
        except OSError as error:
            raise Failed(error, sent=False) from error
        whole, self._latest = False, connection
        try:
            if self._hung_up:  # hang_up() may have come too early for this connection
                connection.abort()
            connection.send(asking(call.method, call.at(left), call.body, call.headers(self._newest)), timeout)
            answer = connection.drive(reading())
            whole = True
        except (OSError, ValueError) as error:
            raise Failed(error, sent=True, stale=stale) from error
        finally:
            # Half an answer, for example after an interrupt, must not be read as the answer to the next call.
            if whole and not answer.last and not call.once:
                self._local.kept = (os.getpid(), connection)
            else:
                connection.close()
                if stale:
                    self._local.kept = None
        if failed := calls.not_now(answer):
            raise failed
        return answer
