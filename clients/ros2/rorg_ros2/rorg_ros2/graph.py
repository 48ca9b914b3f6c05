"""The ROS 2 graph, as DDS discovers it."""

from __future__ import annotations

import time

from rclpy.node import Node, NodeNameNonExistentError
from rorg_client import Client
from rorg_client.errors import Forbidden
from rorg_client.ros.identity import Graph

MISSING = 5.0
"""Seconds for which a node may be missing before it counts as gone. A killed one stays in the graph for 20 s before."""
DISCOVERY = 3.0
"""Seconds that the graph may take to show a node that calls."""


class Ros2Graph(Graph):
    """The graph, as one of its nodes sees it. ROS 2 nodes have no port of their own, so manifests must declare which
    service runs them."""

    def __init__(self, node: Node, client: Client) -> None:
        self.node, self.client = node, client
        self._seen: dict[str, float] = {}
        """When each node that someone asked about was last there."""

    def alive(self, node: str) -> bool:
        now = time.monotonic()
        if node in self.nodes():
            self._seen = {**{k: v for k, v in dict(self._seen).items() if now - v < MISSING}, node: now}
        return now - self._seen.get(node, -MISSING) < MISSING

    def near(self, node: str) -> None:
        return None

    def port(self, node: str) -> int:
        return 0

    def nodes(self) -> set[str]:
        """Those that DDS sees, and those of paused services, which leave the graph after 20 s."""
        seen = {full_name(name, space) for name, space in self.node.get_node_names_and_namespaces()}
        paused = (s["ros_nodes"] for s in self.client.services() if s["state"] == "paused")
        return seen.union(*paused)

    def check_caller(self, caller: str, service: str) -> None:
        """Raises Forbidden if no node of this name has a client of the service: a caller cannot name just any node."""
        end = time.monotonic() + DISCOVERY
        while caller and not self._has_client(caller, service):
            if time.monotonic() > end:
                why = f"no node of this name has a client of {service}"
                raise Forbidden(f"cannot call as {caller}", why, "your own node's name", "forbidden", 403)
            time.sleep(0.05)

    def _has_client(self, node: str, service: str) -> bool:
        space, _, name = node.rpartition("/")
        try:
            clients = self.node.get_client_names_and_types_by_node(name, space or "/")
        except (NodeNameNonExistentError, ValueError, RuntimeError):  # also for what cannot be a name
            return False
        return any(found == service for found, _ in clients)


def full_name(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"
