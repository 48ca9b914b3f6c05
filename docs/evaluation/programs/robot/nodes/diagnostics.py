"""Watches the battery, as a node of ROS 2, and answers whether it is well."""

import rclpy
from std_msgs.msg import Float32
from std_srvs.srv import Trigger

charge = 0.0


def heard(said):
    global charge
    charge = said.data


def answer(_, response):
    response.success = charge > 0.2
    return response


rclpy.init()
node = rclpy.create_node("diagnostics")
node.create_subscription(Float32, "/battery", heard, 10)
node.create_service(Trigger, "/well", answer)
print("ready", flush=True)
rclpy.spin(node)
