"""What rorg's ROS nodes do, with no ROS in it: ROS 1 and ROS 2 put their services in front of the same bridge.

The bridge asks rorg in its own name, one request for each (caller, id), and gives up what a caller held when the caller
is gone. Should the bridge itself die, rorg drops everything with the bridge's container.
"""

from __future__ import annotations

import hashlib
import re
import threading
from collections.abc import Callable
from typing import Any

from rorg.client import Client, Error, Request

Answer = tuple[bool, str]
"""(success, message)."""


class Bridge:
    """`alive` says whether a caller is still there; a paused one is."""

    def __init__(self, client: Client, alive: Callable[[str], bool]) -> None:
        self.client, self.alive = client, alive
        self._held: dict[tuple[str, str], Request] = {}
        self._lock = threading.Lock()

    def request(self, caller: str, id: str, services: list[str], reason: str, wait: float) -> Answer:
        key = (caller, id or "request")
        try:
            names = [self.resolve(name) for name in services]
            made = self.client.request(*names, id=request_id(*key), reason=f"{caller}: {reason}" if reason else caller)
            with self._lock:
                before = self._held.get(key)
                self._held[key] = made
            if before:
                before.abandon()  # the same id has replaced it
            if wait > 0:
                self.client.wait(*names, timeout=wait)
        except Error as error:
            return False, str(error)
        return True, f"requested {', '.join(names)}"

    def release(self, caller: str, id: str) -> Answer:
        with self._lock:
            held = self._held.pop((caller, id or "request"), None)
        return self._end(held)

    @staticmethod
    def _end(held: Request | None) -> Answer:
        try:
            if held:
                held.release()
        except Error as error:
            return False, str(error)
        return True, "released" if held else "nothing to release"

    def query(self, name: str) -> tuple[bool, str, dict[str, Any]]:
        try:
            return True, "", self.client.service(self.resolve(name))
        except Error as error:
            return False, str(error), {}

    def restart(self, name: str, force: bool) -> Answer:
        try:
            self.client.restart(self.resolve(name), force)
        except Error as error:
            return False, str(error)
        return True, "restart asked for"

    def resolve(self, name: str) -> str:
        """A ROS node stands for the service that runs it; every other name for itself."""
        if not name.startswith("/"):
            return name
        for service in self.client.services():
            if name in service["ros_nodes"]:
                return service["service"]
        return name

    def sweep(self) -> list[str]:
        """Releases what callers held that are gone, and returns them."""
        with self._lock:
            held = dict(self._held)
        gone = sorted(caller for caller in {caller for caller, _ in held} if not self.alive(caller))
        for key, request in held.items():
            if key[0] in gone:
                with self._lock:
                    # Who came back meanwhile and asked again keeps what it was just granted.
                    mine = self._held.get(key) is request and bool(self._held.pop(key))
                if mine:
                    self._end(request)
        return gone

    def close(self) -> None:
        with self._lock:
            held, self._held = self._held, {}
        for request in held.values():
            self._end(request)


def request_id(caller: str, id: str) -> str:
    """An id that rorg takes, from any caller's name and id, and no other's."""
    text = re.sub(r"[^A-Za-z0-9_.:-]", ".", f"{caller.strip('/')}.{id}").strip(".")
    own = hashlib.sha256(f"{caller} {id}".encode()).hexdigest()[:8]
    return f"{text[:54].strip('.')}.{own}".strip(".")
