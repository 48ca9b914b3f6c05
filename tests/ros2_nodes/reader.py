"""Writes down the first notification: reader.py FILE."""

import json
import sys

from caller import Caller, stay, write
from std_msgs.msg import String

node = Caller("reader")
node.create_subscription(
    String, "/rorg/notifications", lambda message: write(sys.argv[1], json.loads(message.data)), 10
)
print("listens", flush=True)
stay(node)
