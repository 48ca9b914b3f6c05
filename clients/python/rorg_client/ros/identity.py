"""Finds out who calls. The name that a caller gives itself proves nothing: what the kernel says about the calling
process counts more, if that process can be seen."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any, NamedTuple

from rorg_client.client import Client
from rorg_client.errors import Forbidden, NotFound

SEEN = 10.0
"""Seconds for which the process of a node, and the service that runs it, are remembered."""


class Connection(NamedTuple):
    """The connection of a call."""

    near: bool | None = None
    """Whether it comes from this machine; None if that is unknown."""
    port: int = 0
    """TCP port of the caller's end, if it is near; otherwise 0."""
    to: int = 0
    """TCP port of our end."""


UNSEEN = Connection()


class Graph:
    """The nodes, as a bridge sees them."""

    def alive(self, node: str) -> bool:
        """Whether a node is still there; a paused one is."""
        raise NotImplementedError

    def near(self, node: str) -> bool | None:
        """Whether a node is registered as one of this machine; None if it is not registered, or that is unknown."""
        raise NotImplementedError

    def port(self, node: str) -> int:
        """The TCP port of this machine at which a node listens; 0 if it is elsewhere, or that is unknown."""
        raise NotImplementedError

    def nodes(self) -> Iterable[str]:
        """The names of all nodes."""
        raise NotImplementedError


class Identity:
    """`others` is the requester for callers without a service; by default the bridge's own."""

    def __init__(self, client: Client, graph: Graph, others: str) -> None:
        self.client, self.graph, self.others = client, graph, others
        self._seen: dict[tuple[str, int], tuple[float, str]] = {}
        """(node, its port) -> when it was looked up, and its service."""
        self._nodes: dict[int, tuple[float, dict[str, Any]]] = {}
        """Port -> when it was looked up, and the process that listened."""

    def requester(self, caller: str, via: Connection) -> str:
        """The requester of a call: the service whose process calls; if that cannot be seen, the service that runs the
        node of the given name. Raises Forbidden if another process than the node's own uses its name."""
        near = self.graph.near(caller)
        if near is not None and via.near is not None and near != via.near:
            raise _impostor(caller, "it runs on another machine than this call comes from")
        process = self._process(f"/v1/connections/{via.port}?to={via.to}") if via.port else {}
        port = self.graph.port(caller)
        if not process:
            return self._runner(caller, port) or self.others
        if not any(_same(self._listener(port, anew), process) for anew in (False, True)):
            node = self._listener(port)
            raise _impostor(caller, f"it is a process of {_told(node)}, and {_told(process)} calls")
        return str(process["service"] or self.others)

    def _process(self, address: str) -> dict[str, Any]:
        """A process as rorg sees it; empty if it cannot."""
        try:
            return dict(self.client.call("GET", address))
        except NotFound:
            return {}

    def _listener(self, port: int, anew: bool = False) -> dict[str, Any]:
        """The process that listens at a port, remembered: it takes a look at all sockets of the machine."""
        now = time.monotonic()
        at, found = self._nodes.get(port, (0.0, {}))
        if port and (anew or not found or now - at > SEEN):
            found = self._process(f"/v1/listeners/{port}")
            self._nodes = {**{k: v for k, v in dict(self._nodes).items() if now - v[0] < SEEN}, port: (now, found)}
        return found

    def _runner(self, caller: str, port: int) -> str:
        """The service that runs a node: by the process at its port, or by what manifests declare."""
        who, now = (caller, port), time.monotonic()
        at, found = self._seen.get(who, (0.0, ""))
        if not found or now - at > SEEN:
            found = self._looked_for(caller, port)
            self._seen = {**{k: v for k, v in dict(self._seen).items() if now - v[0] < SEEN}, who: (now, found)}
        return found

    def _looked_for(self, caller: str, port: int) -> str:
        found = self._process(f"/v1/listeners/{port}").get("service") if port else ""
        if found:
            return str(found)
        declared = (s for s in self.client.services() if caller in s["ros_nodes"] and s["incarnation"])
        return str(next((s["service"] for s in declared), ""))


def _same(node: dict[str, Any], process: dict[str, Any]) -> bool:
    """Whether a process may call as a node: it is the node's own, or of the same service. False for a node that is
    gone."""
    return not node or node["pid"] == process["pid"] or (node["service"] or None) == process["service"]


def _told(process: dict[str, Any]) -> str:
    return str(process["service"]) if process["service"] else f"no service (pid {process['pid']})"


def _impostor(caller: str, why: str) -> Forbidden:
    return Forbidden(f"cannot call as {caller}", why, "the node's own name", "forbidden", 403)
