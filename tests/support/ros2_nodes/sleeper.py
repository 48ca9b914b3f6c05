"""Requests a service, and once more when it has slept for some seconds: sleeper.py FILE SERVICE. It writes down what
came of it, the second time into FILE.again."""

import sys
import time

from caller import Caller, stay, write

SLEPT = 5.0
file, service = sys.argv[1:]
node = Caller("sleeper")


def request():
    return [node.brief("request", id=service, services=[service], wait=30.0)]


write(file, request())
node.limit = 5.0  # a call is lost if it is sent before the nodes have found each other again
last = time.monotonic()
while time.monotonic() - last < SLEPT:
    last = time.monotonic()
    time.sleep(0.1)
write(f"{file}.again", request())
stay(node)
