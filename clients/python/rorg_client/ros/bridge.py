"""What rorg's ROS nodes do, without ROS: ROS 1 and ROS 2 put their services in front of the same bridge.

The bridge calls rorg in the name of the service that runs the calling node, with that service's permissions. Everything
that it holds is in rorg's requests file with a lease, so that nothing is lost while the bridge or rorg restarts. It
renews the leases of callers that are there, and releases what callers held that are gone.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterable
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

from rorg_client.client import Client
from rorg_client.errors import Error, NotFound, NotReady
from rorg_client.ros.identity import UNSEEN, Connection, Graph, Identity
from rorg_client.ros.names import address, format_seconds, holder_of, manifest, passing, request_id, tag
from rorg_client.types import RequestView, ServiceView

KEEP = 60.0
"""Seconds of a lease: the bridge may be away this long before the requests of its callers end."""
BY_HAND = 60.0
"""Seconds that a request of a passing caller lasts after the call, unless it gives a number."""
SHORTEST = 2.0
"""Seconds of the shortest lease that sweeps renew in time."""
RENEW = 5.0
"""Seconds between two renewals of a long lease."""
FORGET = 30.0
"""Seconds after which the bridge forgets a request that rorg does not know."""


class Terms(NamedTuple):
    """The terms of a request that the bridge holds."""

    holder: str
    lease: float
    """Seconds that it outlives its holder; with 0 it is released immediately, and its lease in rorg is KEEP."""
    requester: str
    at: float
    """When it was made, by our clock."""


class Done(NamedTuple):
    success: bool
    message: str
    lease: float = 0.0


class Bridge:
    """`others` is the requester for callers without a known service; by default the bridge's own service. `kind` tells
    bridges of different graphs apart."""

    def __init__(self, client: Client, graph: Graph, others: str = "", kind: str = "ros1") -> None:
        self.client, self.graph, self.kind = client, graph, kind
        self._identity = Identity(client, graph, others)
        self._terms: dict[str, Terms] = {}
        """By the id of the request in rorg."""
        self._lock = threading.Lock()
        """Held while a request is dropped, so that a new request by the same caller comes after that."""

    # -- for callers -------------------------------------------------------------------------------------------

    def request(
        self,
        caller: str,
        id: str,
        services: Iterable[str],
        reason: str,
        wait: float,
        ttl: float = 0.0,
        via: Connection = UNSEEN,
    ) -> Done:
        """Requests for as long as the caller is there, and `ttl` seconds more."""
        if not (math.isfinite(ttl) and math.isfinite(wait) and ttl >= 0):
            return Done(False, "cannot request: ttl and wait must be numbers of seconds; try 0 for the default")
        try:
            requester = self._identity.requester(caller, via)
            held, names = self._put(caller, requester, id, services, reason, ttl)
            if wait > 0:
                self._wait(names, wait)
        except Error as error:
            return Done(False, str(error))
        told = f"; {format_seconds(held.lease)} after its caller is gone it ends" if held.lease else ""
        return Done(True, f"requested {', '.join(names)}{told}", held.lease)

    def _put(
        self, caller: str, requester: str, id: str, services: Iterable[str], reason: str, ttl: float
    ) -> tuple[Terms, list[str]]:
        holder = holder_of(caller)
        key = request_id(self.kind, holder, id)
        lasts = not (ttl or passing(caller)) and self.graph.alive(caller)
        lease = max(ttl, SHORTEST) if ttl else 0.0 if lasts else BY_HAND
        names = [self.resolve(name) for name in services]
        with self._lock:
            before = self._terms.get(key)
            held = self._terms[key] = Terms(holder, lease, requester, time.monotonic())
        body = {
            "services": names,
            "reason": f"{caller}: {reason}" if reason else caller,
            "ttl": format_seconds(held.lease or KEEP),
        }
        try:
            done = self.client.call("PUT", address(key, requester), body)
        except Error:
            with self._lock:
                if before and self._terms.get(key) is held:
                    self._terms[key] = before  # the earlier one, which is still in force
            raise
        with self._lock:
            made = held._replace(requester=done["requester"])
            if self._terms.get(key) is held:
                self._terms[key] = made
        if before and before.requester != made.requester and self.graph.alive(caller):
            self.client.call("DELETE", address(key, before.requester))  # its caller now belongs to another service
        return made, names

    def _wait(self, names: list[str], seconds: float) -> None:
        """Waits until they are ready. A restart of rorg meanwhile means nothing for them: it asks again."""
        end = time.monotonic() + seconds
        while True:
            left = max(end - time.monotonic(), 0.0)
            try:
                self.client.wait(*names, timeout=left)
                return
            except NotReady:
                raise
            except Error as error:
                if 0 < error.status < 500 or left <= 0:
                    raise
            time.sleep(0.2)

    def release(self, caller: str, id: str, via: Connection = UNSEEN) -> Done:
        """Releases what the caller's requester holds under this name."""
        key = request_id(self.kind, holder_of(caller), id)
        known = self._terms.get(key)
        try:
            requester = self._identity.requester(caller, via)
            self.client.call("POST", address(key, requester, "/renew"))  # reports whether there is one
            self.client.call("DELETE", address(key, requester))
        except NotFound:
            return Done(True, "nothing to release")
        except Error as error:
            return Done(False, str(error))
        with self._lock:
            if self._terms.get(key) is known:
                self._terms.pop(key, None)
        return Done(True, "released")

    def query(self, name: str) -> tuple[bool, str, ServiceView | None]:
        try:
            return True, "", self.client.service(self.resolve(name))
        except Error as error:
            return False, str(error), None

    def restart(self, caller: str, name: str, force: bool, via: Connection = UNSEEN) -> Done:
        try:
            query = self._as(caller, via, {"force": "true"} if force else {})
            self.client.call("POST", f"/v1/services/{quote(self.resolve(name))}/restart{query}")
        except Error as error:
            return Done(False, str(error))
        return Done(True, "restart requested")

    # -- manifests ---------------------------------------------------------------------------------------------

    def get_manifest(self, caller: str, kind: str, name: str, via: Connection = UNSEEN) -> tuple[bool, str, str, str]:
        """(success, message, text, digest)."""
        try:
            query = self._as(caller, via, {})
            # The digest comes first: if the manifest changes in between, a change based on the older one is refused.
            found = self._digest(kind or "Service", name, query)
            return True, "", self.client.call("GET", manifest(kind, name) + query), found
        except Error as error:
            return False, str(error), "", ""

    def put_manifest(
        self, caller: str, kind: str, name: str, text: str, base: str, message: str, via: Connection = UNSEEN
    ) -> tuple[bool, str, str]:
        """(success, message, digest)."""
        body = {"text": text, "base": base or None, "message": message}
        try:
            done = self.client.call("PUT", manifest(kind, name) + self._as(caller, via, {}), body)
        except Error as error:
            return False, str(error), ""
        return True, f"written to {done['file']}", done["digest"]

    def remove_manifest(
        self, caller: str, kind: str, name: str, base: str, message: str, via: Connection = UNSEEN
    ) -> Done:
        try:
            base = base or self._digest(kind or "Service", name, self._as(caller, via, {}))
            query = self._as(caller, via, {"base": base, "message": message})
            self.client.call("DELETE", manifest(kind, name) + query)
        except Error as error:
            return Done(False, str(error))
        return Done(True, "removed")

    def _digest(self, kind: str, name: str, query: str) -> str:
        for found in self.client.call("GET", f"/v1/manifests{query}"):
            if (found["kind"], found["name"]) == (kind, name):
                return str(found["digest"])
        raise NotFound(f"cannot find the {kind} '{name}'", f"no such {kind}", "", "not-found", 404)

    # -- who is who --------------------------------------------------------------------------------------------

    def _as(self, caller: str, via: Connection, query: dict[str, str]) -> str:
        requester = self._identity.requester(caller, via)
        query = {**query, **({"requester": requester} if requester else {})}
        return f"?{urlencode(query)}" if query else ""

    def resolve(self, name: str) -> str:
        """The service that runs a ROS node of this name; any other name stays."""
        if not name.startswith("/"):
            return name
        for service in self.client.services():
            if name in service["ros_nodes"]:
                return str(service["service"])
        return name

    # -- leases ------------------------------------------------------------------------------------------------

    def sweep(self) -> list[str]:
        """Renews the requests of callers that are there, releases those of callers that are gone, and returns the
        latter. Raises Error if rorg does not answer."""
        before = dict(self._terms)
        mine = {r["id"]: r for r in self.client.requests() if r["id"].startswith(f"{self.kind}:") and not r["standing"]}
        self._forget(before, mine)
        terms = self._recall(mine)
        alive = {holder: self.graph.alive(holder) for holder in {held.holder for held in terms.values()}}
        gone = set()
        for key, held in terms.items():
            if alive[held.holder]:
                self._renew(mine[key])
            elif not held.lease and self._drop(key, held):
                gone.add(held.holder)
        return sorted(gone)

    def _recall(self, mine: dict[str, Any]) -> dict[str, Terms]:
        """The terms of all requests; those from before this bridge began, by the nodes that are there. A caller that
        went meanwhile is not among them: its request ends with its lease."""
        unknown = [r for key, r in mine.items() if key not in self._terms]
        nodes = {tag(holder_of(node)): node for node in self.graph.nodes()} if unknown else {}
        for request in unknown:
            node = nodes.get(request["id"].split(":")[1])
            if node:
                brief = passing(node) or request["ttl"] != KEEP
                with self._lock:
                    self._terms.setdefault(
                        request["id"],
                        Terms(
                            holder_of(node), request["ttl"] if brief else 0.0, request["requester"], time.monotonic()
                        ),
                    )
        return {key: held for key, held in dict(self._terms).items() if key in mine}

    def _forget(self, terms: dict[str, Terms], mine: dict[str, Any]) -> None:
        for key, held in terms.items():
            if key not in mine and time.monotonic() - held.at > FORGET:
                with self._lock:
                    if self._terms.get(key) is held:
                        del self._terms[key]

    def _renew(self, request: RequestView) -> None:
        left, ttl = request["expires_in"], request["ttl"]
        if left is not None and ttl is not None and left < ttl - min(ttl / 3, RENEW):
            with contextlib.suppress(NotFound):  # it was released meanwhile
                self.client.call("POST", address(request["id"], request["requester"], "/renew"))

    def _drop(self, key: str, held: Terms) -> bool:
        """Drops a request, unless its caller came back and asked again."""
        with self._lock:
            if self._terms.get(key) is not held:
                return False
            self.client.call("DELETE", address(key, held.requester))
            del self._terms[key]
        return True
