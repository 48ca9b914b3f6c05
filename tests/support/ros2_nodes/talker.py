"""Nodes of one program that publish std_msgs/String: talker.py NAME..."""

import contextlib
import sys

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
executor = SingleThreadedExecutor()
for name in sys.argv[1:]:
    node = Node(name)
    publisher = node.create_publisher(String, f"/{name}/chatter", 10)
    node.create_timer(0.1, lambda publisher=publisher: publisher.publish(String(data="hello")))
    executor.add_node(node)
print("talks", flush=True)
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    executor.spin()
rclpy.try_shutdown()
