"""The connection to the running rorg of a place, and what that publishes."""

from __future__ import annotations

import json
import os
import socket
import struct
import time
from collections.abc import Callable
from typing import Any

from rorg_client import Client
from rorg_client import Error as ClientError
from rorg_client.connection import Connection as Socket
from rorg_client.wire import asking, reading

from rorg.cli.output import Notices
from rorg.cli.places import NAME, Place, may_connect, nobody
from rorg.errors import NotReady, Unreachable, advice
from rorg.store.state_dir import read_json

HELD_BACK = 2.0
"""Seconds that the running rorg may hold back an answer until there is nothing to wait for."""
ANSWER = 2.0
"""Seconds within which a working rorg answers, however busy it is."""
STARTING = 10.0
"""Seconds within which `rorg run` serves. A pasted script goes on right after `rorg run &`."""


class Connection:
    """The running rorg of a place, if one runs there."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self.remote, self.state = place
        self._client: Client | None = None
        self._unanswered: Unreachable | None = None
        """Why the running rorg did not answer; then it is not asked again."""
        self._reached = False
        """Whether the first call was answered."""
        self.silence = ""
        """Why the running rorg does not know what runs, if it was asked: its engine does not answer."""
        self.notices = Notices()

    def last(self) -> dict[str, Any] | None:
        """What an rorg published last, whether it still runs or not."""
        return read_json(self.state.status)

    def live(self, settled: float = 0.0) -> dict[str, Any] | None:
        """The answer of the running rorg once everything is at rest, or after `settled` seconds. A user who may not
        call it can still read what it publishes."""
        try:
            client = self.client()
        except Unreachable as error:
            return self._published_before(error)
        if client:
            try:
                status: dict[str, Any] = client.call("GET", f"/v1/status?settled={settled:g}")
                return status
            except ClientError:
                if self.remote:
                    raise
        return self.published()

    def published(self) -> dict[str, Any] | None:
        """What the running rorg publishes, slightly later but at no cost to it; None if none runs or it has published
        nothing."""
        if self.remote:
            return None
        owner, status = self.state.owner(), self.last()
        if not (owner and status and status.get("pid") == owner.get("pid")):
            return None
        from rorg.api.status_models import is_status

        return status if is_status(status) else None

    def _published_before(self, error: Unreachable) -> dict[str, Any]:
        """The last publication of a running rorg that does not answer. Raises the error if it published nothing."""
        publication = self.published()
        if publication is None:
            raise error
        at = time.strftime("%H:%M:%S", time.gmtime(os.stat(self.state.status).st_mtime))
        self.notices.say(f"{error.why}; this is what it published at {at} UTC{advice(error.remedy)}")
        return publication

    def last_text(self, *keys: str) -> str:
        """A text of what an rorg published last; empty if it has none."""
        value: Any = self.last()
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        return value if isinstance(value, str) else ""

    def client(self) -> Client | None:
        """A client of the rorg at a socket or an address, or of the one that runs on this state directory; None if none
        serves. Notes if its engine does not answer. Raises Refused if this user may not call it, and Unreachable if it
        does not answer itself."""
        path = self.state.run / NAME
        if not (self.remote or (self.state.served and os.path.exists(path))):
            return None
        if self._unanswered:
            raise self._unanswered
        if self._client is None:
            if self.remote and not self.place.elsewhere:
                may_connect(self.remote)
            client = Client(self.remote or str(path), patience=2.0)
            try:
                engine = handshake(client)
            except Unreachable as error:
                self._unanswered = error
                raise
            if engine.get("silent_since"):
                self.silence = str(engine["error"])
                self.notices.say(f"{self.silence}; states are those seen last")
            self._client, self._reached = client, bool(engine)
        return self._client

    def await_start(self, seconds: float) -> None:
        """Returns when an rorg serves here, or none is starting. Another robot's rorg that starts counts as well: until
        it is up, nothing tells them apart."""
        end = time.monotonic() + min(seconds, STARTING)
        while not self._answers() and is_starting() and time.monotonic() < end:
            time.sleep(0.05)

    def _answers(self) -> bool:
        """Whether an rorg answers here. One that was killed leaves its socket, until the next one has its own."""
        try:
            found = self.client() is not None
        except Unreachable:
            self._unanswered = None
            return False
        if not self._reached:
            self._client = None  # the next call tries again
        return found and self._reached

    def serving(self, what: str) -> Client:
        """The same; raises Unreachable if none serves."""
        client = self.client()
        if client is None:
            raise nobody(what, self.state)
        return client

    def wait(self, what: str, done: Callable[[dict[str, Any]], str], timeout: float) -> None:
        """Looks at the running rorg's status until `done` returns an empty text rather than what is missing. Raises
        NotReady."""
        begun = time.monotonic()
        why = "it has not reported anything yet"
        while (waited := time.monotonic() - begun) < timeout:
            view = self.live(min(HELD_BACK, timeout - waited))
            if view is None and self.state.owner() is None:
                raise nobody(f"wait for {what}", self.state)
            if view is not None:
                why = done(view)
                if not why:
                    return
            # Answers take time that rorg needs for what is waited for, so the pauses grow.
            time.sleep(min(max(0.01, 0.1 * waited), 0.25))
        raise NotReady(f"wait for {what}", f"not ready after {timeout:g} s: {why}", "`rorg describe` for details")


def is_starting() -> bool:
    """Whether a process on this machine began `rorg run` a moment ago."""
    import psutil

    for process in psutil.process_iter(["cmdline", "create_time"]):
        words = process.info["cmdline"] or []
        program = [os.path.basename(word) for word in words[:3]]
        if "rorg" in program and "run" in words[1:] and time.time() - process.info["create_time"] < STARTING:
            return True
    return False


def handshake(client: Client) -> dict[str, Any]:
    """What rorg answers about its engine (EngineView); empty if it cannot be reached: the next call tries for longer.
    Every command makes this call first, so that no one waits for an rorg that is stuck. Raises Unreachable if an rorg
    is there and does not answer."""
    connection = None
    try:
        connection = Socket(client.address, ANSWER)
        connection.send(asking("GET", "/v1/engine", None, {}), ANSWER)
        answer = connection.drive(reading())
        engine = json.loads(answer.body) if answer.status == 200 else {}
    except TimeoutError as error:
        raise _silent(str(client.address), connection.socket if connection else None) from error
    except (OSError, ValueError):
        return {}
    finally:
        if connection:
            connection.close()
    return engine if isinstance(engine, dict) else {}


def _silent(where: str, connection: socket.socket | None) -> Unreachable:
    pid = _pid(connection)
    who = f"rorg (pid {pid}) has not answered" if pid else "it has not answered"
    if pid and _stopped(pid):
        return Unreachable(f"reach rorg on {where}", f"{who} within {ANSWER:g} s: it is stopped", f"`kill -CONT {pid}`")
    return Unreachable(f"reach rorg on {where}", f"{who} within {ANSWER:g} s", "`rorg doctor`, or start it again")


def _pid(connection: socket.socket | None) -> int:
    """The pid of the process that listens at the other end; 0 if unknown."""
    if connection is None or connection.family != socket.AF_UNIX:
        return 0
    told = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    return int(struct.unpack("3i", told)[0])


def _stopped(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            return file.read().rpartition(b")")[2].split()[0] in (b"T", b"t")
    except (OSError, IndexError):
        return False
