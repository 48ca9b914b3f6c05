"""A node with an action, parameters and a topic of ten messages a second: server.py NAME [SECONDS
UNTIL IT PUBLISHES]."""

import contextlib
import sys
import time

import rclpy
import rclpy.utilities
from rclpy.action import ActionServer
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String
from test_msgs.action import Fibonacci

words = rclpy.utilities.remove_ros_args(sys.argv)
rclpy.init()
node = Node(words[1])
node.declare_parameter("speed", 0.5)
node.declare_parameter("frames.names", ["none"])
actions = ActionServer(node, Fibonacci, "~/count", lambda goal: Fibonacci.Result())
begun, publishers = time.monotonic(), []


def publish() -> None:
    """What is seen of a program that has begun is not yet what others wait for."""
    if time.monotonic() < begun + float(words[2] if len(words) > 2 else 0):
        return
    if not publishers:
        publishers.append(node.create_publisher(String, "~/chatter", 10))
        print("publishes", flush=True)
    said = f"{node.get_parameter('speed').value} {' '.join(node.get_parameter('frames.names').value)}"
    publishers[0].publish(String(data=said))


node.create_timer(0.1, publish)
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
rclpy.try_shutdown()
