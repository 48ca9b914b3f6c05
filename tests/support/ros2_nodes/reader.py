"""Writes down the first notification: reader.py FILE."""

import json
import sys
import time
from pathlib import Path

from caller import Caller, stay, write
from std_msgs.msg import String


def note(message):
    if not Path(sys.argv[1]).exists():
        write(sys.argv[1], json.loads(message.data))


node = Caller("reader")
node.create_subscription(String, "/rorg/notifications", note, 10)
while not node.count_publishers("/rorg/notifications"):
    time.sleep(0.05)  # nothing is kept for a subscriber that comes late
print("listens", flush=True)
stay(node)
