"""Prints the next message of a topic; as a node with a name, it goes on hearing: hear.py TOPIC [NAME]."""

import contextlib
import sys

import rclpy
import rclpy.utilities
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

words = rclpy.utilities.remove_ros_args(sys.argv)
rclpy.init()
node, heard = Node(words[2] if len(words) > 2 else "hearer"), []
subscription = node.create_subscription(String, words[1], lambda message: heard.append(message.data), 1)
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    while not heard or len(words) > 2:
        rclpy.spin_once(node, timeout_sec=10.0)
    print(heard[0])
rclpy.try_shutdown()
