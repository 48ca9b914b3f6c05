"""A thread that follows what happens to the requests of a client, and tells those that lose something."""

from __future__ import annotations

import os
import threading
from typing import TYPE_CHECKING, Iterable

from rorg_client import calls
from rorg_client.connection import Connection
from rorg_client.errors import Error, Forbidden, Invalid, NotFound, Unreachable
from rorg_client.loss import Loss

if TYPE_CHECKING:
    from rorg_client.client import Client
    from rorg_client.request import Kept, Request
    from rorg_client.types import Event, ServiceView

PAUSE = 0.5
"""Seconds until the next attempt to follow."""
LATELY = 20
"""The last losses of a service among which that of a run is searched."""


class Watcher:
    """Runs while there are requests to watch."""

    def __init__(self, client: Client) -> None:
        self.pid = os.getpid()
        self._client = client
        self._lock = threading.Lock()
        self._requests: list[Request] = []
        self._connections: dict[str | None, Connection] = {}
        self._followed: list[str | None] = []
        """Requesters whose events are counted on, each followed by a thread."""

    def add(self, request: Request) -> None:
        with self._lock:
            if request not in self._requests:
                self._requests.append(request)
            if request.requester not in self._followed:
                self._followed.append(request.requester)
                threading.Thread(target=self._run, args=(request.requester,), name="rorg-watch", daemon=True).start()

    def remove(self, request: Request) -> None:
        if self.pid != os.getpid():
            return
        with self._lock:
            if request in self._requests:
                self._requests.remove(request)
            if all(r.requester != request.requester for r in self._requests):
                connection = self._connections.get(request.requester)
                if connection:
                    connection.abort()

    def _of(self, requester: str | None) -> list[Request]:
        with self._lock:
            found = [r for r in self._requests if r.requester == requester]
            if not found:
                self._followed.remove(requester)
            return found

    def _run(self, requester: str | None) -> None:
        cursor: int | None = None
        over, client = threading.Event(), self._client.like(self._client.timeout, 0.0)
        while self._of(requester):
            try:
                cursor = self._follow(client, requester, cursor)
            except (Forbidden, Invalid):
                over.wait(10 * PAUSE)  # an rorg that does not report losses; another may replace it
            except (OSError, Error, ValueError):
                over.wait(PAUSE)
        client.close()

    def _follow(self, client: Client, requester: str | None, cursor: int | None) -> int | None:
        connection = Connection(client.address, client.timeout)
        with self._lock:
            self._connections[requester] = connection
        try:
            first = True
            for event in client.lines(connection, calls.events(cursor, True, 0, True, requester)):
                connection.socket.settimeout(None)
                cursor = event["seq"]
                if first:
                    self._look(client, requester)
                    first = False
                else:
                    self._tell(event, self._of_now(requester))
            return cursor
        except OSError:
            return cursor
        finally:
            with self._lock:
                del self._connections[requester]
            connection.close()

    def _of_now(self, requester: str | None) -> list[Request]:
        with self._lock:
            return [r for r in self._requests if r.requester == requester]

    def _look(self, client: Client, requester: str | None) -> None:
        """Finds losses from a time when the stream was not followed."""
        for request in self._of_now(requester):
            for name, run in list(request.runs.items()):
                try:
                    loss = lost_meanwhile(name, run, client.service(name))
                except NotFound:
                    loss = Loss(name, "ceased", f"{name} is no longer declared", run)
                if loss:
                    told = client.events(tail=LATELY, mine=True, requester=requester, only=losses_of(name))
                    loss = next((known for event in told if (known := loss_of(event, request))), loss)
                    request.runs.pop(name, None)
                    request.note(loss)

    @staticmethod
    def _tell(event: Event, requests: Iterable[Request]) -> None:
        for request in requests:
            loss = loss_of(event, request)
            if loss:
                request.note(loss)


def losses_of(service: str) -> dict[str, list[str]]:
    """The parameters of the events that say why a service was lost."""
    return {"kind": ["lost"], "service": [service]}


def lost_meanwhile(name: str, run: str, view: ServiceView) -> Loss | None:
    """Whether there is now another run or none, and the apparent reason; the journal may know a better one. Raises
    Unreachable while rorg does not know what runs."""
    if view["sync"] == "Unknown":
        raise Unreachable(f"cannot look at {name}", "the engine has not reported yet what runs", "again in a moment")
    if view["incarnation"] == run and view["state"] == "running":
        return None
    if view["incarnation"] not in ("", run):
        return Loss(name, "restarted", f"{name} is {view['state']}, in another run than before", run)
    crashed = view["state"] == "exited" and view["wanted"]
    cause = "held" if view["held"] else "crashed" if crashed else "ceased"
    return Loss(name, cause, f"{name} is {view['state']}", run)


def loss_of(event: Event, request: Kept) -> Loss | None:
    """The loss that an event means for a request, if any."""
    if event["kind"] == "request-dropped" and event.get("request") == request.id:
        return Loss("", "dropped", event["message"])
    if event["kind"] != "lost" or request.id not in event.get("requests", []):
        return None
    name, run = event.get("service", ""), event.get("incarnation", "")
    if name in request.runs and request.runs[name] not in ("", run):
        return None  # of a run before the one that was reported ready
    request.runs.pop(name, None)
    return Loss(name, event.get("cause", ""), event["message"], run)
