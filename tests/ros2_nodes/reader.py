"""Writes down the first notification: reader.py FILE."""

import json
import sys
import time

from caller import Caller, stay, write
from std_msgs.msg import String

node = Caller("reader")
node.create_subscription(
    String, "/rorg/notifications", lambda message: write(sys.argv[1], json.loads(message.data)), 10
)
while not node.count_publishers("/rorg/notifications"):
    time.sleep(0.05)  # nothing is kept for a subscriber that comes late
print("listens", flush=True)
stay(node)
