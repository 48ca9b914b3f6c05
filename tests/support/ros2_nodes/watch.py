"""Writes down, all the time, which other nodes are in the graph: watch.py FILE."""

import sys

import rclpy
from caller import stay, write
from rclpy.node import Node

rclpy.init()
node = Node("watch")


def look():
    write(sys.argv[1], sorted(name for name in node.get_node_names() if name != "watch"))


node.create_timer(0.1, look)
stay(node)
