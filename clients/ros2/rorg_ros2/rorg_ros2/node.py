"""The ROS 2 node /rorg: services to request and manage services, and the latched topic status."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
import os
import threading
import time

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.service import Service
from rorg_client import Client, Error
from rorg_client.ros.bridge import Bridge
from rorg_client.ros.notifications import serve
from rorg_ros2.graph import Ros2Graph
from rorg_ros2.reporter import Reporter
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


class RorgNode(Node):
    """
    The node: it binds the bridge to services and topics.

    Callers name themselves, because rclpy does not tell a server who calls. Each call has a
    thread, since it may wait. Leases and status have threads too: they must go on meanwhile.
    """

    def __init__(self) -> None:
        super().__init__('rorg')
        self.graph = Ros2Graph(self, Client())
        self.bridge = Bridge(
            Client(), self.graph, self.declare_parameter('others', '').value, 'ros2'
        )
        self._offer()
        self._forward_notifications(self.declare_parameter('notifications', 0).value)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.status = self.create_publisher(Status, '~/status', latched)
        self.last: Status | None = None
        self.client = Client()
        self.reporter = Reporter(self, Client, int(os.environ.get('ROS_DOMAIN_ID') or 0))
        self.reporter.start()
        self._repeat(0.2, self._publish_status)
        self._repeat(0.5, self._sweep)
        self.get_logger().info('serves requests')

    # -- services ------------------------------------------------------------------------------

    def _offer(self) -> None:
        for name, kind, call in (
            ('request', RequestServices, self._request),
            ('release', ReleaseServices, self._release),
            ('query', QueryService, self._query),
            ('restart', RestartService, self._restart),
            ('get_manifest', GetManifest, self._get_manifest),
            ('put_manifest', PutManifest, self._put_manifest),
            ('remove_manifest', RemoveManifest, self._remove_manifest),
        ):
            service = self.create_service(kind, f'~/{name}', lambda ask, answer: (ask, answer))
            answer_later(service, self._checked(call), self.context)

    def _checked(self, call: Callable) -> Callable:
        """Make a handler that refuses names which cannot be those of callers."""

        def checked(service: str, ask, answer) -> None:
            try:
                self.graph.check_caller(getattr(ask, 'caller', ''), service)
            except Error as error:
                answer.success, answer.message = False, str(error)
            else:
                call(ask, answer)

        return checked

    def _request(self, ask, answer) -> None:
        answer.success, answer.message, answer.lease = self.bridge.request(
            ask.caller, ask.id, list(ask.services), ask.reason, ask.wait, ask.ttl
        )

    def _release(self, ask, answer) -> None:
        answer.success, answer.message, _ = self.bridge.release(ask.caller, ask.id)

    def _query(self, ask, answer) -> None:
        answer.success, answer.message, service = self.bridge.query(ask.name)
        if service:
            answer.status = status_of(service)

    def _restart(self, ask, answer) -> None:
        answer.success, answer.message, _ = self.bridge.restart(ask.caller, ask.name, ask.force)

    def _get_manifest(self, ask, answer) -> None:
        answer.success, answer.message, answer.text, answer.digest = self.bridge.get_manifest(
            ask.caller, ask.kind, ask.name
        )

    def _put_manifest(self, ask, answer) -> None:
        answer.success, answer.message, answer.digest = self.bridge.put_manifest(
            ask.caller, ask.kind, ask.name, ask.text, ask.base, ask.message
        )

    def _remove_manifest(self, ask, answer) -> None:
        answer.success, answer.message, _ = self.bridge.remove_manifest(
            ask.caller, ask.kind, ask.name, ask.base, ask.message
        )

    # -- topics and leases ---------------------------------------------------------------------

    def _publish_status(self) -> None:
        now = Status(
            services=[status_of(s) for s in self.client.services() if s['state'] != 'meta']
        )
        if now != self.last:
            self.status.publish(now)
            self.last = now

    def _forward_notifications(self, port: int) -> None:
        if port:
            publisher = self.create_publisher(String, '~/notifications', 10)
            serve(port, lambda text: publisher.publish(String(data=text)))

    def _sweep(self) -> None:
        for name in self.bridge.sweep():
            self.get_logger().info(f'{name} is gone; what it held is released')

    def _repeat(self, seconds: float, do: Callable[[], None]) -> None:
        """Do something every so often in a thread of its own, and log errors of rorg."""

        def run() -> None:
            while self.context.ok():
                try:
                    with while_up(self.context):
                        do()
                except Error as error:
                    self.get_logger().warning(str(error), throttle_duration_sec=10)
                time.sleep(seconds)

        threading.Thread(target=run, daemon=True).start()


@contextlib.contextmanager
def while_up(context: Context) -> Iterator[None]:
    """Ignore what fails because the node has been shut down meanwhile."""
    try:
        yield
    except Exception:
        if context.ok():
            raise


def answer_later(service: Service, call: Callable, context: Context) -> None:
    """
    Make a service answer from a thread, once `call(service's name, request, response)` returns.

    Otherwise calls that wait would hold up all others: an executor has as many threads as there
    are processors. The service's callback must return the pair of request and response.
    """
    send, name = service.send_response, service.service_name

    def run(pair: tuple, header: object) -> None:
        with while_up(context):
            call(name, *pair)
            send(pair[1], header)

    def start(pair: tuple, header: object) -> None:
        threading.Thread(target=run, args=(pair, header), daemon=True).start()

    service.send_response = start


def status_of(service: dict) -> ServiceStatus:
    return ServiceStatus(
        **{field: service[field] for field in ('state', 'health', 'wanted', 'why')},
        name=service['service'],
    )


def main() -> None:
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(RorgNode())
    rclpy.try_shutdown()
