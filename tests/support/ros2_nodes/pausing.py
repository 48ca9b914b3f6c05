"""What both programs of the measurement of pausing agree on: topics with their QoS, and a log of what happens."""

import json
import time

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

RELIABLE, BEST_EFFORT = ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT
LATCHED = DurabilityPolicy.TRANSIENT_LOCAL
TOPICS = {
    "reliable, keep all": QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=RELIABLE),
    "reliable, keep last 10": QoSProfile(depth=10, reliability=RELIABLE),
    "best effort, keep last 5": QoSProfile(depth=5, reliability=BEST_EFFORT),
    "/tf: reliable, keep last 100": QoSProfile(depth=100, reliability=RELIABLE),
    "transient local, keep last 1": QoSProfile(depth=1, reliability=RELIABLE, durability=LATCHED),
}
"""Published by the peer, 20 times a second."""
FULL = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=RELIABLE)
STATIC = QoSProfile(depth=1, reliability=RELIABLE, durability=LATCHED)
LEASE = 2.0
ALIVE = QoSProfile(depth=1, liveliness=LivelinessPolicy.AUTOMATIC, liveliness_lease_duration=Duration(seconds=LEASE))


def topic(name):
    return "/" + "".join(c if c.isalnum() else "_" for c in name.strip("/"))


class Log:
    """Lines of JSON: the time, what it is about, and a value."""

    def __init__(self, file):
        self.file = file

    def note(self, kind, value=None):
        with open(self.file, "a") as out:
            out.write(json.dumps([time.time(), kind, value]) + "\n")
