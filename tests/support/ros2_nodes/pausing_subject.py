"""The program that is paused: it notes the age of each message, and has a service, an action and transforms:
pausing_subject.py FOLDER."""

import sys
import time

import rclpy
from caller import stay
from geometry_msgs.msg import TransformStamped
from pausing import ALIVE, FULL, STATIC, TOPICS, Log, topic
from rclpy.action import ActionServer
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty
from test_msgs.action import Fibonacci

rclpy.init()
node, log = Node("subject"), Log(f"{sys.argv[1]}/subject")
group = ReentrantCallbackGroup()


def listen(name, qos):
    node.create_subscription(
        Float64, topic(name), lambda message: log.note(name, time.time() - message.data), qos, callback_group=group
    )


def execute(goal):
    time.sleep(2.0)
    goal.succeed()
    return Fibonacci.Result()


for name, qos in TOPICS.items():
    listen(name, qos)
listen("full", FULL)
node.create_service(Empty, "~/call", lambda ask, answer: answer, callback_group=group)
ActionServer(node, Fibonacci, "~/act", execute, callback_group=group)
alive = node.create_publisher(String, "/alive", ALIVE)
node.create_timer(0.1, lambda: alive.publish(String()), callback_group=group)
static = node.create_publisher(TransformStamped, "/tf_static", STATIC)
static.publish(TransformStamped())
stay(node, MultiThreadedExecutor(4))
