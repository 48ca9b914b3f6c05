"""Prints the state of a managed node, or makes a transition: lifecycle.py NODE [activate]."""

import sys

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.node import Node

rclpy.init()
node = Node("lifecycle_by_hand")
if len(sys.argv) > 2:
    client = node.create_client(ChangeState, f"{sys.argv[1]}/change_state")
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_ACTIVATE))
else:
    client, request = node.create_client(GetState, f"{sys.argv[1]}/get_state"), GetState.Request()
client.wait_for_service(10.0)
future = client.call_async(request)
rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
told = future.result()
print(told.success if len(sys.argv) > 2 else told.current_state.label)
rclpy.try_shutdown()
