"""A program that begins late: it notes when it gets the static transform and finds the subject: pausing_late.py
FOLDER."""

import sys

import rclpy
from caller import stay
from geometry_msgs.msg import TransformStamped
from pausing import STATIC, Log
from rclpy.node import Node

rclpy.init()
node, log = Node("late"), Log(f"{sys.argv[1]}/late")
log.note("begins")
node.create_subscription(TransformStamped, "/tf_static", lambda message: log.note("static transform"), STATIC)
stay(node)
