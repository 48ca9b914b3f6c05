"""Publishes the parameter `text` on `chatter` twice a second."""

import contextlib

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String


class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.declare_parameter("text", "nothing")
        self.chatter = self.create_publisher(String, "chatter", 10)
        self.create_timer(0.5, self.talk)

    def talk(self):
        self.chatter.publish(String(data=self.get_parameter("text").value))


rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Talker())
