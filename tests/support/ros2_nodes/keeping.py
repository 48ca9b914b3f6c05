"""Drops the clients that nobody needs while a call waits for its answer, and says whether that arrives."""

import threading

import rclpy
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rorg_ros2.calls import Calls, NoAnswer
from std_srvs.srv import Trigger

NAME = "/slow/answer"
rclpy.init()
server, asker, executor = Node("slow"), Node("asker"), MultiThreadedExecutor(4)
calls = Calls(asker)


def answer(_, told):
    calls.keep(())  # as if `slow` had left the graph
    told.success = True
    return told


server.create_service(Trigger, NAME, answer)
for node in (server, asker):
    executor.add_node(node)
threading.Thread(target=executor.spin, daemon=True).start()
try:
    print(calls.call(Trigger, NAME, Trigger.Request(), 20.0).success)
except NoAnswer as error:
    print(error)
calls.keep(())
print(list(asker.clients))
executor.shutdown()
rclpy.try_shutdown()
