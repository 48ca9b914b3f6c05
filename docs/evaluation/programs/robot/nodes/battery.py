"""The battery's driver, a node of ROS 2: reports its charge 10 times a second."""

import rclpy
from std_msgs.msg import Float32

rclpy.init()
node = rclpy.create_node("battery")
charge = node.create_publisher(Float32, "/battery", 10)
node.create_timer(0.1, lambda: charge.publish(Float32(data=0.8)))
print("ready", flush=True)
rclpy.spin(node)
