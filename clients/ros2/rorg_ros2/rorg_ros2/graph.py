"""The ROS 2 graph, as DDS discovers it."""

from __future__ import annotations

import time

from rclpy.node import Node, NodeNameNonExistentError
from rorg_client import Client
from rorg_client.errors import Forbidden
from rorg_client.ros.identity import Graph

# Seconds for which a node may be missing before it counts as gone. DDS shows a killed one for
# 20 s more.
MISSING = 5.0
# States of services whose nodes are there.
ALIVE = ('running', 'paused')
# Seconds that the graph may take to show a node that calls.
DISCOVERY = 2.0


class Ros2Graph(Graph):
    """
    The graph, as one of its nodes sees it.

    Nodes of ROS 2 have no port of their own, so manifests must declare which service runs them.
    """

    def __init__(self, node: Node, client: Client) -> None:
        self.node, self.client = node, client
        # When each node that someone asked about was last there.
        self._seen: dict[str, float] = {}

    def alive(self, node: str) -> bool:
        now = time.monotonic()
        if node in self.nodes():
            recent = {k: v for k, v in dict(self._seen).items() if now - v < MISSING}
            self._seen = {**recent, node: now}
        return now - self._seen.get(node, -MISSING) < MISSING

    def near(self, node: str) -> None:
        return None

    def port(self, node: str) -> int:
        return 0

    def nodes(self) -> set[str]:
        return self.discovered() | self.declared()

    def discovered(self) -> set[str]:
        """List the nodes that DDS sees."""
        return {full_name(*found) for found in self.node.get_node_names_and_namespaces()}

    def declared(self) -> set[str]:
        """
        List the nodes of services that run or are paused.

        With Fast DDS, a node that was paused leaves the graph after 20 s. When it resumes it can
        talk to all others, but they never learn its name again.
        """
        services = self.client.services()
        return set().union(*(s['ros_nodes'] for s in services if s['state'] in ALIVE))

    def check_caller(self, caller: str, service: str) -> None:
        """Raise Forbidden if a caller names a node that has no client of the service."""
        end = time.monotonic() + DISCOVERY
        while caller and not self._has_client(caller, service):
            if time.monotonic() > end:
                if self._lost_its_name(caller):
                    return
                why, remedy = f'no node of this name has a client of {service}', "your node's name"
                raise Forbidden(f'cannot call as {caller}', why, remedy, 'forbidden', 403)
            time.sleep(0.05)

    def _lost_its_name(self, node: str) -> bool:
        """Tell whether it may be one that was paused; DISCOVERY later, none is only starting."""
        return node not in self.discovered() and node in self.declared()

    def _has_client(self, node: str, service: str) -> bool:
        space, _, name = node.rpartition('/')
        try:
            clients = self.node.get_client_names_and_types_by_node(name, space or '/')
        except (NodeNameNonExistentError, ValueError, RuntimeError):  # also if it cannot be a name
            return False
        return any(found == service for found, _ in clients)


def full_name(name: str, namespace: str) -> str:
    return f'{namespace.rstrip("/")}/{name}'
