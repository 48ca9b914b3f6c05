"""The peer of a program that is paused: it publishes, calls, and watches; and does what it is told by names of files:
pausing_peer.py FOLDER."""

import pathlib
import sys
import threading
import time

import rclpy
from caller import stay
from pausing import ALIVE, FULL, TOPICS, Log, topic
from rclpy.action import ActionClient
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Float64, String
from std_srvs.srv import Empty
from test_msgs.action import Fibonacci

BURST = 6000
"""Messages at once: more than Fast DDS keeps for a reliable reader that does not read, 5,000."""
folder = pathlib.Path(sys.argv[1])
rclpy.init()
node, log = Node("peer"), Log(folder / "peer")
publishers = {name: node.create_publisher(Float64, topic(name), qos) for name, qos in TOPICS.items()}
full = node.create_publisher(Float64, topic("full"), FULL)
client = node.create_client(Empty, "/subject/call")
action = ActionClient(node, Fibonacci, "/subject/act")
there = {}


def publish(name, publisher):
    began = time.time()
    try:
        publisher.publish(Float64(data=began))
    except Exception as error:
        log.note(f"publish {name} failed", str(error))
    if (took := time.time() - began) > 0.01:
        log.note(f"publish {name} took", took)


def publish_all():
    for name, publisher in publishers.items():
        publish(name, publisher)


def watch():
    for kind, now in (
        ("in the graph", "subject" in node.get_node_names()),
        ("service", client.service_is_ready()),
        ("action", action.server_is_ready()),
        ("subscribed", publishers["reliable, keep all"].get_subscription_count()),
    ):
        if there.get(kind) != now:
            there[kind] = now
            log.note(kind, now)


def obey():
    for path in folder.glob("do-*"):
        path.unlink()
        what, _, label = path.name[3:].partition("-")
        log.note(f"{what} {label} begins")
        {"call": call, "goal": goal, "burst": burst}[what](label)


def call(label):
    client.call_async(Empty.Request()).add_done_callback(lambda _: log.note(f"call {label} answered"))


def goal(label):
    def accepted(future):
        log.note(f"goal {label} accepted")
        future.result().get_result_async().add_done_callback(lambda _: log.note(f"goal {label} done"))

    action.send_goal_async(Fibonacci.Goal()).add_done_callback(accepted)


def burst(label):
    for _ in range(BURST):
        publish("full", full)
    log.note(f"burst {label} ends")


# In a node of its own: an event that comes while the executor is busy with others is lost.
listener = Node("listener")
events = SubscriptionEventCallbacks(liveliness=lambda event: log.note("alive", event.alive_count))
listener.create_subscription(String, "/alive", lambda message: None, ALIVE, event_callbacks=events)
threading.Thread(target=rclpy.spin, args=(listener, SingleThreadedExecutor()), daemon=True).start()
node.create_timer(0.05, publish_all)
node.create_timer(0.05, watch)
node.create_timer(0.02, obey)
stay(node)
