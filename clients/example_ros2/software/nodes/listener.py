"""Prints what arrives on `chatter`."""

import contextlib

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node = Node("listener")
node.create_subscription(String, "chatter", lambda message: print("heard", message.data), 10)
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(node)
