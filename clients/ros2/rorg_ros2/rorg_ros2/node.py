"""The ROS 2 node /rorg: services request, release, query, restart and manifests, and the latched topic status."""

from __future__ import annotations

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rorg_ros2_interfaces.msg import ServiceStatus, Status
from rorg_ros2_interfaces.srv import (
    GetManifest,
    PutManifest,
    QueryService,
    ReleaseServices,
    RemoveManifest,
    RequestServices,
    RestartService,
)
from std_msgs.msg import String

from rorg_ros2.bridge import Bridge, Client, Error, Graph
from rorg_ros2.notifications import serve

LEASE = 20
"""Seconds for which a caller may be missing in the graph: a paused participant leaves it after 10 to 20 s."""


class Discovered(Graph):
    """The graph, as DDS discovers it. A node has no port of its own, so manifests must declare who runs it."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.seen: dict[str, float] = {}

    def alive(self, node: str) -> bool:
        now = self.node.get_clock().now().nanoseconds / 1e9
        if node in self.nodes():
            self.seen[node] = now
        return bool(node) and now - self.seen.setdefault(node, now) < LEASE

    def near(self, node: str) -> None:
        return None

    def port(self, node: str) -> int:
        return 0

    def nodes(self) -> set[str]:
        return {f"{space.rstrip('/')}/{name}" for name, space in self.node.get_node_names_and_namespaces()}


class RorgNode(Node):
    """Callers name themselves: a ROS 2 server does not learn who calls."""

    def __init__(self) -> None:
        super().__init__("rorg")
        group = ReentrantCallbackGroup()
        self.client = Client()
        self.declare_parameter("others", "")
        self.bridge = Bridge(Client(), Discovered(self), self.get_parameter("others").value, "ros2")
        self.last: Status | None = None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.publisher = self.create_publisher(Status, "~/status", latched)
        for name, kind, call in (
            ("request", RequestServices, self.request),
            ("release", ReleaseServices, self.release),
            ("query", QueryService, self.query),
            ("restart", RestartService, self.restart),
            ("get_manifest", GetManifest, self.get_manifest),
            ("put_manifest", PutManifest, self.put_manifest),
            ("remove_manifest", RemoveManifest, self.remove_manifest),
        ):
            self.create_service(kind, f"~/{name}", call, callback_group=group)
        self.declare_parameter("notifications", 0)
        if port := self.get_parameter("notifications").value:
            notifications = self.create_publisher(String, "~/notifications", 10)
            serve(port, lambda text: notifications.publish(String(data=text)))
        self.create_timer(0.2, self.publish)
        self.create_timer(0.5, self.sweep)

    def request(self, ask, answer):
        answer.success, answer.message, answer.lease = self.bridge.request(
            ask.caller, ask.id, list(ask.services), ask.reason, ask.wait, ask.ttl
        )
        return answer

    def release(self, ask, answer):
        answer.success, answer.message, _ = self.bridge.release(ask.caller, ask.id)
        return answer

    def restart(self, ask, answer):
        answer.success, answer.message, _ = self.bridge.restart(ask.caller, ask.name, ask.force)
        return answer

    def get_manifest(self, ask, answer):
        answer.success, answer.message, answer.text, answer.digest = self.bridge.get_manifest(
            ask.caller, ask.kind, ask.name
        )
        return answer

    def put_manifest(self, ask, answer):
        answer.success, answer.message, answer.digest = self.bridge.put_manifest(
            ask.caller, ask.kind, ask.name, ask.text, ask.base, ask.message
        )
        return answer

    def remove_manifest(self, ask, answer):
        answer.success, answer.message, _ = self.bridge.remove_manifest(
            ask.caller, ask.kind, ask.name, ask.base, ask.message
        )
        return answer

    def sweep(self) -> None:
        try:
            for name in self.bridge.sweep():
                self.get_logger().info(f"{name} is gone; what it held is released")
        except Error as error:
            self.get_logger().warning(str(error), throttle_duration_sec=10)

    def query(self, ask, answer):
        answer.success, answer.message, service = self.bridge.query(ask.name)
        if service:
            answer.status = status_of(service)
        return answer

    def publish(self) -> None:
        try:
            now = Status(services=[status_of(s) for s in self.client.services() if s["state"] != "meta"])
        except Error as error:
            self.get_logger().warning(str(error), throttle_duration_sec=10)
            return
        if now != self.last:
            self.publisher.publish(now)
            self.last = now


def status_of(service: dict) -> ServiceStatus:
    return ServiceStatus(
        **{field: service[field] for field in ("state", "health", "wanted", "why")}, name=service["service"]
    )


def main() -> None:
    rclpy.init()
    node = RorgNode()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    finally:
        rclpy.shutdown()
