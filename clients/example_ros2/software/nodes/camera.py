"""A managed node: it publishes ten pictures a second on `picture` while it is active, and does nothing otherwise."""

import contextlib
import itertools

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String


class Camera(LifecycleNode):
    def __init__(self):
        super().__init__("camera")
        self.numbers = itertools.count(1)

    def on_configure(self, state):
        print("opens the device")
        self.pictures = self.create_lifecycle_publisher(String, "picture", 10)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state):
        print("takes pictures")
        self.timer = self.create_timer(0.1, self.take)
        return super().on_activate(state)

    def on_deactivate(self, state):
        print("rests")
        self.destroy_timer(self.timer)
        return super().on_deactivate(state)

    def take(self):
        self.pictures.publish(String(data=f"picture {next(self.numbers)}"))


rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Camera())
