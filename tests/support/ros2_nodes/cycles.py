"""Requests, checks and releases a service COUNT times, back to back, and holds it then: cycles.py FILE SERVICE COUNT.
The file lists what was not as the answers said."""

import random
import sys
import time

from caller import Caller, stay, write

file, service, count = sys.argv[1:]
node = Caller("cycles")
wrong, pauses = [], random.Random(1)
for number in range(int(count) + 1):
    done = node.call("request", id="cycle", services=[service], wait=30.0)
    found = node.call("query", name=service).status
    if not done.success or (found.state, found.health, found.wanted) != ("running", "Healthy", True):
        wrong.append([number, done.message, found.state, found.health, found.why])
    time.sleep(pauses.random() * 0.03)
    if number < int(count):
        node.call("release", id="cycle")
        time.sleep(pauses.random() * 0.03)
write(file, wrong)
stay(node)
