"""A node that calls rorg's services, one call after another, and writes down what came of it."""

import contextlib
import json
import os

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rorg_ros2_interfaces import srv

KINDS = {
    "request": srv.RequestServices,
    "release": srv.ReleaseServices,
    "query": srv.QueryService,
    "restart": srv.RestartService,
    "get_manifest": srv.GetManifest,
    "put_manifest": srv.PutManifest,
    "remove_manifest": srv.RemoveManifest,
}


class Caller(Node):
    """`caller`: the name that it gives itself in calls. `limit`: seconds after which it calls again."""

    limit = 120.0

    def __init__(self, name, caller=None):
        rclpy.init()
        super().__init__(name)
        self.caller = self.get_fully_qualified_name() if caller is None else caller
        self.made = {}

    def call(self, name, /, **fields):
        """The answer of /rorg/NAME."""
        kind = KINDS[name]
        if name not in self.made:
            self.made[name] = self.create_client(kind, f"/rorg/{name}")
            assert self.made[name].wait_for_service(30), f"no service /rorg/{name}"
        named = {} if name == "query" else {"caller": self.caller}
        while True:
            future = self.made[name].call_async(kind.Request(**named, **fields))
            rclpy.spin_until_future_complete(self, future, timeout_sec=self.limit)
            if future.done():
                return future.result()
            print(f"no answer of {name} within {self.limit} s", flush=True)

    def brief(self, name, /, **fields):
        done = self.call(name, **fields)
        return [done.success, done.message]


def write(file, value):
    with open(file + ".new", "w") as out:
        json.dump(value, out)
    os.rename(file + ".new", file)


def stay(node, executor=None):
    """Until a signal ends it."""
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node, executor)
    rclpy.try_shutdown()
