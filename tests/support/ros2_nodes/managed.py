"""A managed node that publishes on `chatter` while it is active: managed.py NAME [FAILING TRANSITION].

A transition of that name fails; with `hang` in front of the name, as in `hang-deactivate`, it does not return."""

import contextlib
import sys
import time

import rclpy
import rclpy.utilities
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String


class Managed(LifecycleNode):
    def __init__(self, name: str, failing: str) -> None:
        super().__init__(name)
        self.failing = failing
        self.chatter = self.create_lifecycle_publisher(String, "chatter", 10)
        self.create_timer(0.05, lambda: self.chatter.publish(String(data="hello")))

    def turn(self, transition: str, state) -> TransitionCallbackReturn:
        print(transition, flush=True)
        if self.failing == f"hang-{transition}":
            time.sleep(3600)
        if self.failing == transition:
            return TransitionCallbackReturn.FAILURE
        if transition in ("activate", "deactivate"):
            getattr(super(), f"on_{transition}")(state)
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state):
        return self.turn("configure", state)

    def on_activate(self, state):
        return self.turn("activate", state)

    def on_deactivate(self, state):
        return self.turn("deactivate", state)


words = rclpy.utilities.remove_ros_args(sys.argv)
rclpy.init()
with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Managed(words[1], words[2] if len(words) > 2 else ""))
rclpy.try_shutdown()
