"""Requests the service `camera` from rorg, and looks at its pictures. The request ends with this program."""

import contextlib
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rorg_ros2_interfaces.srv import RequestServices
from std_msgs.msg import String


class Tour(Node):
    def __init__(self):
        super().__init__("tour")
        self.client = self.create_client(RequestServices, "/rorg/request")

    def request(self, *services):
        """Waits until they are ready."""
        self.client.wait_for_service()
        name = self.get_fully_qualified_name()
        request = RequestServices.Request(caller=name, id="tour", services=services, reason="a tour", wait=60.0)
        answer = self.client.call_async(request)
        rclpy.spin_until_future_complete(self, answer)
        if not answer.result().success:
            sys.exit(answer.result().message)

    def look(self):
        print("the camera is ready")
        self.create_subscription(String, "picture", lambda picture: print("sees", picture.data), 10)


rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    tour = Tour()
    tour.request("camera")
    tour.look()
    rclpy.spin(tour)
