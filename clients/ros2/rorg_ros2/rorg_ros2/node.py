"""The ROS 2 node /rorg: services request, release, query and restart, and the latched topic status."""

from __future__ import annotations

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rorg_ros2_interfaces.msg import ServiceStatus, Status
from rorg_ros2_interfaces.srv import QueryService, ReleaseServices, RequestServices, RestartService

from rorg.client import Client, Error
from rorg_ros2.bridge import Bridge

LEASE = 20
"""Seconds for which a caller may be out of the graph: a paused participant leaves it after 10 to 20 s."""


class RorgNode(Node):
    """Callers name themselves: a ROS 2 server is not told who calls."""

    def __init__(self) -> None:
        super().__init__("rorg")
        group = ReentrantCallbackGroup()
        self.client = Client()
        self.bridge = Bridge(Client(), self.alive)
        self.seen: dict[str, float] = {}
        self.last: Status | None = None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.publisher = self.create_publisher(Status, "~/status", latched)
        for name, kind, call in (("request", RequestServices, self.request), ("release", ReleaseServices, self.release),
                                 ("query", QueryService, self.query), ("restart", RestartService, self.restart)):
            self.create_service(kind, f"~/{name}", call, callback_group=group)
        self.create_timer(0.2, self.publish)
        self.create_timer(0.5, self.bridge.sweep)

    def alive(self, name: str) -> bool:
        now = self.get_clock().now().nanoseconds / 1e9
        present = {f"{space.rstrip('/')}/{node}" for node, space in self.get_node_names_and_namespaces()}
        if name in present:
            self.seen[name] = now
        return now - self.seen.get(name, now) < LEASE

    def request(self, ask, answer):
        answer.success, answer.message = self.bridge.request(ask.caller, ask.id, list(ask.services), ask.reason,
                                                             ask.wait)
        return answer

    def release(self, ask, answer):
        answer.success, answer.message = self.bridge.release(ask.caller, ask.id)
        return answer

    def restart(self, ask, answer):
        answer.success, answer.message = self.bridge.restart(ask.name, ask.force)
        return answer

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
    return ServiceStatus(**{field: service[field] for field in ("state", "health", "wanted", "why")},
                         name=service["service"])


def main() -> None:
    rclpy.init()
    node = RorgNode()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    finally:
        node.bridge.close()
        rclpy.shutdown()
